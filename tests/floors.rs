//! The house stands: no file imports from a floor above, or from a later room of its own.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::repo;
use std::path::{Path, PathBuf};

/// The rooms in the order of the table in `src/lib.rs`.
fn rooms() -> Vec<String> {
    let text = std::fs::read_to_string(repo("src/lib.rs")).unwrap();
    let rows = text.lines().filter(|l| l.starts_with("//! | F"));
    rows.flat_map(|l| l.split("[`").skip(1).filter_map(|r| r.split('`').next()).map(str::to_owned).collect::<Vec<_>>()).collect()
}

fn rust_files(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

/// Names that follow `crate::` in the code of a file; comments do not count. A group
/// `crate::{a, b::c}` gives each of its names.
fn imports(text: &str) -> Vec<String> {
    let code: String = text.lines().map(|l| l.split("//").next().unwrap_or("")).collect::<Vec<_>>().join("\n");
    let word = |s: &str| s.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let mut found = Vec::new();
    for after in code.split("crate::").skip(1) {
        if let Some(group) = after.strip_prefix('{') {
            let mut depth = 0;
            let mut names = vec![String::new()];
            for c in group.chars() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => break,
                    '}' => depth -= 1,
                    ',' if depth == 0 => names.push(String::new()),
                    _ if depth == 0 => names.last_mut().unwrap().push(c),
                    _ => {}
                }
            }
            found.extend(names.iter().map(|n| word(n)).filter(|n| !n.is_empty()));
        } else {
            found.push(word(after));
        }
    }
    found
}

#[test]
fn every_room_stands_in_the_table() {
    let text = std::fs::read_to_string(repo("src/lib.rs")).unwrap();
    let rooms = rooms();
    let modules: Vec<&str> = text.lines().filter_map(|l| l.strip_prefix("pub mod ")?.strip_suffix(';')).collect();
    assert!(modules.len() >= 12);
    for m in &modules {
        assert!(rooms.contains(&(*m).to_owned()), "the table in src/lib.rs does not say on which floor `{m}` is");
    }
    for r in &rooms {
        assert!(modules.contains(&r.as_str()), "the table in src/lib.rs names `{r}`, which is no module");
    }
}

#[test]
fn nothing_imports_upwards() {
    let (rooms, mut files) = (rooms(), Vec::new());
    rust_files(&repo("src"), &mut files);
    let place = |room: &str| rooms.iter().position(|r| r == room);
    let mut judged = 0;
    for file in &files {
        let inside = file.strip_prefix(repo("src")).unwrap();
        let room = inside.components().next().unwrap().as_os_str().to_string_lossy().trim_end_matches(".rs").to_owned();
        let Some(here) = place(&room) else { continue };
        for import in imports(&std::fs::read_to_string(file).unwrap()) {
            let Some(there) = place(&import) else { panic!("{}: `crate::{import}` is no room of the house", file.display()) };
            assert!(there <= here, "{}: imports `{import}`, which is above `{room}`", file.display());
            judged += 1;
        }
    }
    assert!(judged > 100, "{judged} imports");
}

#[test]
fn the_reader_of_imports_reads() {
    let text = "use crate::a::b;\n// crate::no\nuse crate::{c, d::{e, f}, g as h};\nfn x() -> crate::i::J {}\n//! [`crate::no`]\n";
    assert_eq!(imports(text), ["a", "c", "d", "g", "i"]);
}
