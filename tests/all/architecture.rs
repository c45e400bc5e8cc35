//! Holds ARCHITECTURE.md's table of who may import whom against the sources.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

fn source_files(dir: &Path, files: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = std::fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            source_files(&path, files);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
}

/// The table in ARCHITECTURE.md: rows `| module | may import |` with names in backticks.
fn allowed_imports(root: &Path) -> BTreeMap<String, BTreeSet<String>> {
    let text = std::fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap();
    let names = |cell: &str| -> Vec<String> {
        cell.split('`')
            .skip(1)
            .step_by(2)
            .map(str::to_owned)
            .collect()
    };
    let mut allowed = BTreeMap::new();
    let table = text
        .lines()
        .skip_while(|l| !l.starts_with("| module | may import"));
    for row in table.skip(2).take_while(|l| l.starts_with('|')) {
        let mut cells = row.trim_matches('|').split('|');
        let (Some(modules), Some(imports)) = (cells.next(), cells.next()) else {
            continue;
        };
        for module in names(modules) {
            allowed.insert(module, names(imports).into_iter().collect());
        }
    }
    allowed
}

/// Modules named by `crate::x` in a file, those within `#[cfg(test)]` modules excepted.
fn crate_imports(text: &str) -> BTreeSet<String> {
    let product = text.split("#[cfg(test)]\nmod tests").next().unwrap_or(text);
    product
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"))
        .flat_map(|line| {
            line.match_indices("crate::")
                .map(move |(at, m)| &line[at + m.len()..])
        })
        .map(|rest| {
            rest.chars()
                .take_while(|c| c.is_ascii_alphanumeric() || *c == '_')
                .collect::<String>()
        })
        .filter(|name| !name.is_empty())
        .collect()
}

#[test]
fn modules_import_only_what_the_architecture_allows() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let allowed = allowed_imports(root);
    let mut files = Vec::new();
    source_files(&root.join("src"), &mut files);
    let mut offences = Vec::new();
    let mut modules_seen = BTreeSet::new();
    for path in &files {
        let relative = path.strip_prefix(root.join("src")).unwrap();
        let module = relative
            .components()
            .next()
            .and_then(|c| Path::new(c.as_os_str()).file_stem())
            .and_then(|s| s.to_str())
            .unwrap()
            .to_owned();
        if module == "lib" {
            continue;
        }
        let Some(may_import) = allowed.get(&module) else {
            offences.push(format!("{module} is not in the table of ARCHITECTURE.md"));
            continue;
        };
        modules_seen.insert(module.clone());
        let text = std::fs::read_to_string(path).unwrap();
        for import in crate_imports(&text) {
            let is_allowed =
                import == module || may_import.contains(&import) || may_import.contains("anything");
            if !is_allowed {
                offences.push(format!("{}: crate::{import}", relative.display()));
            }
        }
    }
    assert!(
        offences.is_empty(),
        "imports against the table:\n{}",
        offences.join("\n")
    );
    let stale: Vec<_> = allowed
        .keys()
        .filter(|m| !modules_seen.contains(*m))
        .collect();
    assert!(
        stale.is_empty(),
        "the table names modules that are not there: {stale:?}"
    );
}

#[test]
fn imports_are_found_where_they_stand() {
    let found =
        crate_imports("use crate::geom::Stamp;\n// crate::ros\nlet x = crate::mesh::f();\n");
    assert_eq!(found, ["geom", "mesh"].map(str::to_owned).into());
}
