//! Cuts, garbage and a disk that fails, at random places.

use super::*;

/// A journal written step by step: its length and the scan after each.
struct Written {
    bytes: Vec<u8>,
    /// From the empty scan on.
    after: Vec<(usize, ScanState)>,
}

fn written(seed: u64, num_steps: usize) -> Written {
    let disk = WorseDisk::new(seed);
    let mut made = MadeScan::new(seed);
    let mut journal = Journal::create(disk.boxed()).unwrap();
    // The frame of the world comes with the first step.
    let mut after = vec![(disk.journal_bytes().len(), ScanState::default())];
    for _ in 0..num_steps {
        made.change();
        journal.follow(&made.scan).unwrap();
        let scan = as_resumed(&made.scan, made.next_id());
        after.push((disk.journal_bytes().len(), scan));
    }
    Written {
        bytes: disk.journal_bytes(),
        after,
    }
}

impl Written {
    /// Number of the last step that ends at `num_bytes` or before.
    fn last_step(&self, num_bytes: usize) -> Option<usize> {
        self.after.iter().rposition(|(end, _)| *end <= num_bytes)
    }

    /// What is found when the journal is `bytes`; goes on from there, and comes back whole.
    #[track_caller]
    fn assert_gives(&self, bytes: &[u8], expected: &ScanState, num_losses: usize) {
        let disk = WorseDisk::with_journal(bytes);
        let mut found = resumed(&disk);
        assert!(found.state == *expected, "another scan");
        assert_eq!(found.losses.len(), num_losses, "{:?}", found.losses);
        for loss in &found.losses {
            assert!(loss.contains("/disk/journal.mcap"), "{loss}");
            assert!(
                loss.contains("at byte ") && loss.contains(" bytes "),
                "{loss}"
            );
        }
        let (_, whole) = &self.after[self.after.len() - 1];
        found.journal.follow(whole).unwrap();
        drop(found);
        let again = resumed(&disk);
        assert!(again.state == *whole, "it did not catch up");
    }
}

#[test]
fn cut_anywhere_the_steps_before_come_back() {
    let written = written(11, 40);
    let num_bytes = written.bytes.len() as u64;
    let mut random = Random(0xc07);
    let mut num_in_preamble = 0;
    for i in 0..200 {
        let at = match i {
            // The ends of steps and the bytes around them are rare at random.
            0..60 => {
                let (end, _) = written.after[i % 40];
                end + i / 20 - 1
            }
            _ => usize::try_from(random.below(num_bytes)).unwrap(),
        };
        let cut = &written.bytes[..at];
        let Some(step) = written.last_step(at) else {
            num_in_preamble += 1;
            if at >= step::preamble().len() {
                written.assert_gives(
                    cut,
                    &ScanState::default(),
                    usize::from(at > step::preamble().len()),
                );
                continue;
            }
            let disk = WorseDisk::with_journal(cut);
            let Found::Nothing(Some(loss)) = Journal::resume(disk.boxed()).unwrap() else {
                panic!("a scan from {at} bytes");
            };
            assert!(loss.contains("/disk/journal.mcap: at byte 0"), "{loss}");
            drop(Journal::create(disk.boxed()).unwrap());
            resumed(&disk);
            continue;
        };
        let (end, scan) = &written.after[step];
        written.assert_gives(cut, scan, usize::from(*end != at));
    }
    assert!(num_in_preamble > 0);
}

#[test]
fn garbage_at_the_end_costs_nothing_before_it() {
    let written = written(12, 30);
    let (_, whole) = &written.after[30];
    let (last_start, before) = &written.after[29];
    let mut random = Random(0x6a4ba6e);
    for i in 0..200 {
        let mut bytes = written.bytes.clone();
        if i % 2 == 0 {
            let num_more = 1 + random.below(3000);
            let zeros = i % 4 == 0;
            bytes.extend((0..num_more).map(|_| if zeros { 0 } else { random.next() as u8 }));
            // A frame of garbage may say that it is an end or a chunk.
            bytes[written.bytes.len()] = [0, 0x06, 0x0b, 0xff][i / 2 % 4];
            written.assert_gives(&bytes, whole, 1);
        } else {
            // Within the last step: its data, but not its length.
            let start = last_start + 9 + 4 * 8;
            let at = start + usize::try_from(random.below((bytes.len() - start) as u64)).unwrap();
            bytes[at] ^= 1 << random.below(8);
            written.assert_gives(&bytes, before, 1);
        }
    }
}

#[test]
fn a_damaged_step_costs_itself() {
    let written = written(13, 40);
    let (_, whole) = &written.after[40];
    let mut num_tried = 0;
    for step in 1..40 {
        let [(start, before), (end, after)] = [&written.after[step - 1], &written.after[step]];
        // The ones whose loss is told by the end: keyframes that are still there.
        let added = after
            .keyframes
            .keys()
            .find(|id| !before.keyframes.contains_key(id));
        let is_there = |id: &&KeyframeId| {
            // The last number is free again when its keyframe is lost.
            whole.keyframes.contains_key(id) && id.0 + 1 < whole.next_id.0
        };
        let Some(id) = added.filter(is_there) else {
            continue;
        };
        num_tried += 1;
        let mut bytes = written.bytes.clone();
        bytes[(start + end) / 2] ^= 0x10;
        let mut expected = whole.clone();
        expected.keyframes.remove(id);
        written.assert_gives(&bytes, &expected, 1);
    }
    assert!(num_tried > 5, "{num_tried}");
}

#[test]
fn a_step_of_an_attempt_that_failed_is_not_taken_for_the_next() {
    let [mut one, mut other] = [15, 15].map(MadeScan::new);
    let disks = [1, 2].map(WorseDisk::new);
    let mut journals = [&disks[0], &disks[1]].map(|d| Journal::create(d.boxed()).unwrap());
    for _ in 0..6 {
        one.change();
        other.change();
        journals[0].follow(&one.scan).unwrap();
        journals[1].follow(&other.scan).unwrap();
    }
    assert!(disks[0].journal_bytes() == disks[1].journal_bytes());
    // The two go different ways.
    other.random = Random(16);
    one.change();
    other.change();
    journals[0].follow(&one.scan).unwrap();
    journals[1].follow(&other.scan).unwrap();
    let num_bytes = disks[1].journal_bytes().len();
    other.change();
    journals[1].follow(&other.scan).unwrap();
    let stale = &disks[1].journal_bytes()[num_bytes..];
    let bytes = [&disks[0].journal_bytes()[..], stale].concat();
    let found = resumed(&WorseDisk::with_journal(&bytes));
    assert!(found.state == as_resumed(&one.scan, one.next_id()));
    assert!(
        found.losses[0].contains("does not follow"),
        "{:?}",
        found.losses
    );
}

#[test]
fn lengths_do_not_drive_memory() {
    let written = written(14, 3);
    let (start, scan) = &written.after[2];
    for length in [u64::MAX, 1 << 62, (1 << 30) + 1, written.bytes.len() as u64] {
        let mut bytes = written.bytes.clone();
        bytes[start + 1..start + 9].copy_from_slice(&length.to_le_bytes());
        written.assert_gives(&bytes, scan, 1);
    }
}

/// A scan and a journal of it on a disk that fails.
struct Ordeal {
    disk: WorseDisk,
    random: Random,
    made: MadeScan,
    /// What the disk has, and what it may have of what was tried since.
    acknowledged: ScanState,
    tried: Vec<ScanState>,
    num_crashes: usize,
}

impl Ordeal {
    fn faults(&mut self) -> Faults {
        let mut often = |end| u32::try_from(self.random.below(end)).unwrap();
        Faults {
            short_write: often(300),
            full: often(100),
            sync: often(200),
            truncate: often(200),
            rename: often(500),
            sync_folder: often(300),
            capacity: match often(3) {
                0 => self.disk.journal_bytes().len() + often(4000) as usize,
                _ => 0,
            },
        }
    }

    fn follow(&mut self, journal: &mut Journal) {
        for _ in 0..=self.random.below(3) {
            self.made.change();
        }
        let result = journal.follow(&self.made.scan);
        match &result {
            Ok(()) => {
                // Nothing of an attempt that failed is left behind what is whole.
                let num_bytes = self.disk.journal_bytes().len() as u64;
                assert_eq!(num_bytes, journal.report().num_bytes);
                self.acknowledged = self.made.scan.clone();
                self.tried.clear();
            }
            Err(error) => {
                assert!(!error.remedy().is_empty());
                self.tried.push(self.made.scan.clone());
            }
        }
        // What is said to be acknowledged is asked for again after a crash.
        for id in journal.acknowledged_ids() {
            let known = [&self.acknowledged].into_iter().chain(&self.tried);
            assert!(
                known
                    .into_iter()
                    .any(|scan| scan.keyframes.contains_key(&id))
            );
        }
        if result.is_ok() {
            journal.min_compaction_bytes = 0;
            drop(journal.compact(&self.made.scan));
        }
    }

    fn crash(&mut self, journal: Journal) -> Journal {
        let acknowledged: Vec<_> = journal.acknowledged_ids().collect();
        drop(journal);
        self.num_crashes += 1;
        self.disk.crash();
        let found = resumed(&self.disk);
        self.check(&found.state, &acknowledged);
        self.acknowledged = found.state.clone();
        self.tried.clear();
        self.made.scan = found.state;
        found.journal
    }

    fn check(&self, found: &ScanState, acknowledged: &[KeyframeId]) {
        let known = || [&self.acknowledged].into_iter().chain(&self.tried);
        for id in acknowledged {
            let was_removed = self
                .tried
                .iter()
                .any(|scan| !scan.keyframes.contains_key(id));
            assert!(
                was_removed || found.keyframes.contains_key(id),
                "{id:?} is lost"
            );
        }
        for (id, keyframe) in &found.keyframes {
            let is_known = known().any(|scan| scan.keyframes.get(id) == Some(keyframe));
            assert!(is_known, "{id:?} is another");
        }
        let mesh = (&found.mesh, found.num_mesh_updates);
        let is_known = known().any(|scan| (&scan.mesh, scan.num_mesh_updates) == mesh);
        assert!(is_known, "another mesh");
        assert!(found.num_mesh_updates >= self.acknowledged.num_mesh_updates);
    }
}

#[test]
fn a_disk_that_fails_at_random_loses_nothing_that_was_acknowledged() {
    let (mut num_crashes, mut num_refused, mut num_compactions) = (0, 0, 0);
    for seed in 0..200 {
        let disk = WorseDisk::new(seed);
        let mut made = MadeScan::new(seed);
        made.image_bytes = 200;
        let mut journal = Journal::create(disk.boxed()).unwrap();
        let mut ordeal = Ordeal {
            disk,
            random: Random(seed ^ 0x0dea1),
            made,
            acknowledged: ScanState::default(),
            tried: Vec::new(),
            num_crashes: 0,
        };
        ordeal.follow(&mut journal);
        for _ in 0..40 {
            let faults = ordeal.faults();
            ordeal.disk.set_faults(faults);
            ordeal.follow(&mut journal);
            ordeal.disk.set_faults(Faults::default());
            if ordeal.random.below(8) == 0 {
                num_compactions += journal.report().num_compactions;
                journal = ordeal.crash(journal);
            }
        }
        // There is room again.
        ordeal.follow(&mut journal);
        assert!(ordeal.tried.is_empty(), "it did not catch up");
        journal = ordeal.crash(journal);
        drop(journal);
        num_crashes += ordeal.num_crashes;
        num_refused += ordeal.disk.num_refused();
    }
    assert!(num_crashes > 800, "{num_crashes}");
    assert!(num_refused > 1000, "{num_refused}");
    assert!(num_compactions > 0, "{num_compactions}");
}
