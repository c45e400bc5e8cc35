//! What the repository says of itself is true.

use std::path::Path;

use veneer::config::{Config, listing};

fn read(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

#[test]
fn the_page_of_parameters_is_the_one_that_the_code_writes() {
    let expected = listing::to_markdown(&mut Config::default());
    assert!(
        read("docs/parameters.md") == expected,
        "run: veneer params --markdown > docs/parameters.md"
    );
}

#[test]
fn sample_bags_have_the_checksums_that_are_stated() {
    let bags = Path::new(env!("CARGO_MANIFEST_DIR")).join("bags");
    let sums = read("bags/SHA256SUMS");
    assert!(!sums.is_empty());
    for line in sums.lines() {
        let (sum, name) = line.split_once("  ").unwrap();
        let actual = veneer::export::hashes::sha256_hex(&bags.join(name)).unwrap();
        assert_eq!(actual, sum, "{name}");
        let size = std::fs::metadata(bags.join(name)).unwrap().len();
        assert!(size <= 8_000_000, "{name} has {size} bytes");
    }
}

#[test]
fn links_between_pages_lead_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for page in [
        "README.md",
        "CONTRIBUTING.md",
        "ARCHITECTURE.md",
        "bags/README.md",
        "CHANGELOG.md",
        "docs/viewers/rviz2.md",
        "docs/viewers/foxglove.md",
        "docs/viewers/blender.md",
    ] {
        let text = read(page);
        for target in text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split(')').next())
        {
            if target.starts_with("http") {
                continue;
            }
            let path = root.join(page).parent().unwrap().join(target);
            assert!(
                path.exists(),
                "{page} links to {target}, which is not there"
            );
        }
    }
}

#[test]
fn every_limit_is_in_the_table_of_limits() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = std::fs::read_to_string(root.join("docs/topics.md")).unwrap();
    let table = page
        .split("## Limits on what peers control")
        .nth(1)
        .unwrap();
    let table = table.split("\n## ").next().unwrap();
    let names = veneer::config::tree::PARAMETERS.iter().map(|row| row.name);
    let mut limits = names.filter(|name| name.starts_with("limits.")).peekable();
    assert!(limits.peek().is_some());
    for name in limits {
        assert!(table.contains(&format!("`{name}`")), "{name}");
    }
}
