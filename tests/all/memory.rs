//! The budget of memory, as the system counts it.

use crate::command::{said, veneer};

#[test]
fn the_peak_keeps_to_the_budget() {
    let dir = tempfile::tempdir().unwrap();
    let bag = concat!(env!("CARGO_MANIFEST_DIR"), "/bags/tabletop.mcap");
    // Without a budget it takes 220 MB. Each thread has a frame in work.
    let budget_mb = 180.0;
    let budget = format!("memory.budget_mb:={budget_mb}");
    let out = dir.path().to_str().unwrap();
    let args = [
        "-q",
        "--threads",
        "2",
        "replay",
        bag,
        "--json",
        "--out",
        out,
    ];
    let output = veneer(&[&args[..], &["-p", &budget]].concat());
    assert!(output.status.success(), "{}", said(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    // Where the system does not tell, there is nothing to hold it against.
    let Some(peak_bytes) = report["peak_memory_bytes"].as_f64() else {
        return;
    };
    assert!(peak_bytes <= 1.1 * budget_mb * 1e6, "{peak_bytes} bytes");
}
