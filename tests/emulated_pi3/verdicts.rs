//! What was asked and how it came out: a line each, and a tally at the end.

use std::fs::File;
use std::io::Write;
use std::path::Path;

/// The tally.
pub struct Verdicts {
    to: File,
    passed: u32,
    failed: u32,
}

impl Verdicts {
    /// Nothing asked yet; lines go to a file too.
    pub fn new(path: &Path) -> Self {
        Self {
            to: File::create(path).expect("a file for verdicts"),
            passed: 0,
            failed: 0,
        }
    }

    /// One question.
    pub fn hold(&mut self, what: &str, holds: bool, found: &str) -> bool {
        let mark = if holds { "pass" } else { "FAIL" };
        *(if holds {
            &mut self.passed
        } else {
            &mut self.failed
        }) += 1;
        self.say(&format!("{mark}  {what}: {found}"));
        holds
    }

    /// The same for text that must contain all of some words.
    pub fn says(&mut self, what: &str, text: &str, words: &[&str]) -> bool {
        let missing: Vec<_> = words.iter().filter(|w| !text.contains(**w)).collect();
        let found = if missing.is_empty() {
            words.join(" … ")
        } else {
            format!("{missing:?} not in: {text}")
        };
        self.hold(what, missing.is_empty(), &found)
    }

    /// A line of information.
    pub fn say(&mut self, line: &str) {
        println!("{line}");
        writeln!(self.to, "{line}").expect("the file for verdicts");
    }

    /// The tally; true if nothing failed.
    pub fn end(mut self) -> bool {
        let tally = format!("{} passed, {} failed", self.passed, self.failed);
        self.say(&tally);
        self.failed == 0 && self.passed > 0
    }
}
