//! A process that keeps a journal on a real disk, ended by the system in the midst of it.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use super::*;

const PATH: &str = "VENEER_TEST_JOURNAL";
const SEED: u64 = 0x6b11;
const SAYS: &str = "acknowledged ";

/// A scan to be changed on from `found`, and how many changes that was; `None` where it is none of
/// those that come about.
fn made_like(found: &ScanState) -> Option<(MadeScan, usize)> {
    let mut made = MadeScan::new(SEED);
    let mut num_changes = 0;
    while as_resumed(&made.scan, made.next_id()) != *found {
        if num_changes > 100_000 || made.next_id() > found.next_id {
            return None;
        }
        made.change();
        num_changes += 1;
    }
    Some((made, num_changes))
}

/// Not a test: the other process. Says after each change that the disk has it.
#[test]
#[ignore = "runs as another process' child"]
fn child() {
    let Some(path) = std::env::var_os(PATH) else {
        return;
    };
    let disk = || Box::new(PathDisk::new(Path::new(&path)));
    let (mut journal, mut made, mut num_changes) = match Journal::resume(disk()).unwrap() {
        Found::Nothing(_) => (Journal::create(disk()).unwrap(), MadeScan::new(SEED), 0),
        Found::Scan(resumed) => {
            let (made, num_changes) = made_like(&resumed.state).unwrap();
            (resumed.journal, made, num_changes)
        }
    };
    let mut out = std::io::stdout();
    loop {
        made.change();
        num_changes += 1;
        journal.follow(&made.scan).unwrap();
        writeln!(out, "\n{SAYS}{num_changes}").unwrap();
        journal.compact(&made.scan).unwrap();
    }
}

/// Lets the child write until it has said something `num_words` times and a while longer, and
/// ends it; the number that it said last.
fn write_and_kill(path: &Path, num_words: usize, and_then: Duration) -> usize {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args([
            "bag::journal::tests::kill::child",
            "--exact",
            "--ignored",
            "--nocapture",
        ])
        .env(PATH, OsString::from(path))
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut last = 0;
    let mut read = |num_words: usize| {
        let said = lines.by_ref().map_while(Result::ok);
        let mut numbers = said.filter_map(|line| line.strip_prefix(SAYS)?.parse().ok());
        for _ in 0..num_words {
            let Some(number) = numbers.next() else {
                return false;
            };
            last = number;
        }
        true
    };
    assert!(read(num_words), "the child has ended");
    let until = Instant::now() + and_then;
    while Instant::now() < until {
        std::hint::spin_loop();
    }
    child.kill().unwrap();
    // What it said before the end counts.
    read(usize::MAX);
    child.wait().unwrap();
    last
}

#[test]
fn a_killed_process_leaves_all_that_it_was_told_is_safe() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal.mcap");
    let mut random = Random(0x9111);
    let mut num_before = 0;
    for round in 0..12 {
        let num_words = 1 + usize::try_from(random.below(8)).unwrap();
        let and_then = Duration::from_micros(random.below(8000));
        let num_said = write_and_kill(&path, num_words, and_then);
        let Found::Scan(found) = Journal::resume(Box::new(PathDisk::new(&path))).unwrap() else {
            panic!("nothing is left in round {round}");
        };
        let (_, num_found) = made_like(&found.state).expect("a scan that never was");
        // One more may be on the disk than was told.
        let is_whole = num_found == num_said || num_found == num_said + 1;
        assert!(
            is_whole,
            "round {round}: {num_said} said, {num_found} there"
        );
        assert!(num_found > num_before);
        num_before = num_found;
    }
}
