mod faults;
mod kill;
mod made;
mod worse_disk;

use super::*;
use made::{MadeScan, Random};
use worse_disk::{Faults, WorseDisk};

fn resumed(disk: &WorseDisk) -> Resumed {
    match Journal::resume(disk.boxed()).unwrap() {
        Found::Scan(resumed) => resumed,
        Found::Nothing(loss) => panic!("nothing there: {loss:?}"),
    }
}

/// The scan as a journal gives it back: its epoch begins anew.
fn as_resumed(scan: &ScanState, next_id: KeyframeId) -> ScanState {
    ScanState {
        epoch: 0,
        next_id,
        ..scan.clone()
    }
}

#[test]
fn a_scan_comes_back_to_the_bit() {
    let disk = WorseDisk::new(1);
    let mut made = MadeScan::new(1);
    let mut journal = Journal::create(disk.boxed()).unwrap();
    for _ in 0..40 {
        made.change();
        journal.follow(&made.scan).unwrap();
    }
    drop(journal);
    let back = resumed(&disk);
    assert_eq!(back.losses, [""; 0]);
    assert_eq!(back.state, as_resumed(&made.scan, made.next_id()));
    assert!(made.has_had_everything(), "{:?}", made.num_by_kind);
}

#[test]
fn following_the_same_scan_writes_nothing() {
    let disk = WorseDisk::new(2);
    let mut made = MadeScan::new(2);
    let mut journal = Journal::create(disk.boxed()).unwrap();
    for _ in 0..10 {
        made.change();
    }
    journal.follow(&made.scan).unwrap();
    let before = disk.journal_bytes();
    let report = journal.report().clone();
    assert_eq!(report.num_keyframes, made.scan.keyframes.len());
    journal.follow(&made.scan).unwrap();
    assert_eq!(*journal.report(), report);
    drop(journal);
    // Nor does going on with it.
    let mut back = resumed(&disk);
    back.journal.follow(&back.state).unwrap();
    drop(back);
    assert!(disk.journal_bytes() == before);
}

#[test]
fn a_closed_journal_is_a_recording_that_others_read() {
    let disk = WorseDisk::new(3);
    let mut made = MadeScan::new(3);
    for _ in 0..12 {
        made.change();
    }
    let mut journal = Journal::create(disk.boxed()).unwrap();
    journal.follow(&made.scan).unwrap();
    journal.close().unwrap();
    let bytes = disk.journal_bytes();
    let mut num_by_topic = BTreeMap::<String, usize>::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        *num_by_topic
            .entry(message.channel.topic.clone())
            .or_default() += 1;
    }
    let num_keyframes = made.scan.keyframes.len();
    let num_with_depth = made.scan.keyframes.values().filter(|k| k.depth.is_some());
    let expected = [
        ("/camera/color/image_raw/compressed", num_keyframes),
        ("/camera/color/camera_info", num_keyframes),
        ("/camera/depth/camera_info", num_with_depth.count()),
        ("/tf", num_keyframes),
        ("/mesh", 1),
        ("/veneer/journal", num_keyframes + 2),
    ];
    for (topic, num) in expected {
        assert_eq!(num_by_topic.get(topic), Some(&num), "{topic}");
    }
    // And goes on as if it had not been closed.
    let mut back = resumed(&disk);
    assert_eq!(back.losses, [""; 0]);
    made.change();
    back.journal
        .follow(&as_resumed(&made.scan, made.next_id()))
        .unwrap();
    drop(back);
    assert_eq!(resumed(&disk).state, as_resumed(&made.scan, made.next_id()));
}

#[test]
fn what_is_dead_is_left_behind() {
    let disk = WorseDisk::new(4);
    let mut made = MadeScan::new(4);
    made.image_bytes = 60_000;
    let mut journal = Journal::create(disk.boxed()).unwrap();
    let mut num_compactions = 0;
    for _ in 0..120 {
        made.change();
        while made.scan.keyframes.len() > 4 {
            made.remove();
        }
        journal.follow(&made.scan).unwrap();
        journal.compact(&made.scan).unwrap();
        let report = journal.report();
        let limit = (2 * (report.num_bytes - report.num_dead_bytes)).max(4 << 20);
        assert!(report.num_bytes <= limit, "{report:?}");
        assert_eq!(report.num_bytes, disk.journal_bytes().len() as u64);
        if report.num_compactions > 0 {
            num_compactions += 1;
            drop(journal);
            let back = resumed(&disk);
            assert_eq!(back.state, as_resumed(&made.scan, made.next_id()));
            journal = back.journal;
        }
    }
    assert!(num_compactions > 1, "{num_compactions}");
    assert!(disk.journal_bytes().len() < 5 << 20);
}

#[test]
fn a_reset_begins_anew_with_numbers_of_its_own() {
    let disk = WorseDisk::new(5);
    let mut journal = Journal::create(disk.boxed()).unwrap();
    let mut made = MadeScan::new(5);
    for _ in 0..8 {
        made.change();
    }
    journal.follow(&made.scan).unwrap();
    let mut other = MadeScan::new(6);
    for _ in 0..5 {
        other.change();
    }
    other.scan.epoch = 1;
    journal.follow(&other.scan).unwrap();
    drop(journal);
    assert_eq!(
        resumed(&disk).state,
        as_resumed(&other.scan, other.next_id())
    );
}

#[test]
fn what_is_no_journal_is_left_as_it_is() {
    for bytes in [&b"\x89MCAP0\r\nand more, of another writer"[..], b"a text"] {
        let disk = WorseDisk::with_journal(bytes);
        let refused = Journal::resume(disk.boxed()).err().unwrap();
        let words = refused.to_string();
        assert!(matches!(refused, JournalError::NotAJournal { .. }));
        assert!(
            words.contains(worse_disk::named().to_str().unwrap()),
            "{words}"
        );
        assert!(Journal::create(disk.boxed()).is_err());
        assert_eq!(disk.journal_bytes(), bytes);
    }
}

#[test]
fn one_process_at_a_time() {
    let disk = WorseDisk::new(7);
    let journal = Journal::create(disk.boxed()).unwrap();
    drop(journal);
    let held = resumed(&disk);
    let refused = Journal::resume(disk.boxed()).err().unwrap();
    assert!(refused.is_held(), "{refused}");
    drop(held);
    // The file system's own locks do the same.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal.mcap");
    let on_path = || Box::new(PathDisk::new(&path));
    let journal = Journal::create(on_path()).unwrap();
    let refused = Journal::resume(on_path()).err().unwrap();
    assert!(refused.is_held(), "{refused}");
    drop(journal);
    assert!(matches!(Journal::resume(on_path()), Ok(Found::Scan(_))));
}

#[test]
fn an_existing_scan_is_not_begun_over() {
    let disk = WorseDisk::new(8);
    let mut made = MadeScan::new(8);
    made.change();
    let mut journal = Journal::create(disk.boxed()).unwrap();
    journal.follow(&made.scan).unwrap();
    drop(journal);
    let refused = Journal::create(disk.boxed()).err().unwrap();
    assert!(matches!(refused, JournalError::IsThere { .. }), "{refused}");
}
