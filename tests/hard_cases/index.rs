//! The index of cases: each test of this folder has a row in the table of `docs/numerics.md`, and each row a test.

use std::collections::BTreeSet;
use std::path::Path;

/// Names of the tests in a source text.
fn tests(text: &str) -> impl Iterator<Item = &str> {
    text.split("#[test]").skip(1).filter_map(|rest| {
        let start = rest.find("fn ")? + 3;
        let end = start + rest[start..].find('(')?;
        Some(&rest[start..end])
    })
}

/// Names in the rows `| `name` | ... |` of the section "Hard cases".
fn rows(text: &str) -> impl Iterator<Item = &str> {
    let section = text.split("\n## Hard cases\n").nth(1).unwrap_or("");
    let section = section.split("\n## ").next().unwrap_or("");
    section.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next())
}

#[test]
fn every_case_is_explained() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut named: BTreeSet<String> = BTreeSet::new();
    for entry in std::fs::read_dir(root.join("tests/hard_cases")).unwrap() {
        let path = entry.unwrap().path();
        if path.file_name().is_some_and(|name| name != "index.rs") {
            let text = std::fs::read_to_string(path).unwrap();
            named.extend(tests(&text).map(str::to_string));
        }
    }
    let text = std::fs::read_to_string(root.join("docs/numerics.md")).unwrap();
    let explained: BTreeSet<String> = rows(&text).map(str::to_string).collect();
    assert!(named.len() > 25, "the tests are found");
    assert_eq!(named, explained, "tests on the left, rows of docs/numerics.md on the right");
}

#[test]
fn names_are_read_as_they_stand() {
    assert_eq!(tests("#[test]\n#[ignore]\nfn a_b() {}\nfn c() {}").collect::<Vec<_>>(), ["a_b"]);
    let text = "x\n## Hard cases\n| case | why |\n|---|---|\n| `a_b` | so |\n## Else\n| `c` | |\n";
    assert_eq!(rows(text).collect::<Vec<_>>(), ["a_b"]);
}
