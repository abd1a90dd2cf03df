//! Reading a TOML file into a checked structure, with errors that point into the text.
//!
//! A file may build on another: `base = "pi4"` takes everything from that board, and the file states only what
//! differs. Tables are merged key by key; lists and values replace those of the base.

#![allow(
    clippy::result_large_err,
    reason = "an error is made at most once a run, on the way out"
)]

use crate::config::message::plain;
use crate::config::place::{key_at, span_of, value_of};
use crate::config::shipped;
use crate::primitives::file::{is_irregular, text, why_unreadable};
use crate::primitives::{Check, Checker, Invalid, shown};
use miette::{Diagnostic, NamedSource, SourceSpan};
use serde::de::DeserializeOwned;
use std::ops::Range;
use std::path::Path;
use thiserror::Error;
use toml::{Table, Value};

/// A configuration file that cannot be used.
#[derive(Debug, Error, Diagnostic)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: {problem}")]
    Unreadable {
        /// Path as given.
        path: String,
        /// The reason.
        problem: String,
    },
    /// The text is not what the file should hold.
    #[error("{path}, line {line}: {problem}")]
    Wrong {
        /// Path as given.
        path: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        problem: String,
        /// The whole text.
        #[source_code]
        text: NamedSource<String>,
        /// Where.
        #[label("here")]
        span: SourceSpan,
        /// How to correct it.
        #[help]
        hint: String,
    },
}

/// Reads and checks a file.
///
/// # Errors
/// [`ConfigError`] with file, line, key, value, accepted range and hint.
pub fn read<T: DeserializeOwned + Check>(path: &Path) -> Result<T, ConfigError> {
    parse(&path.display().to_string(), &text_of(path)?)
}

/// The text of a file.
///
/// # Errors
/// [`ConfigError::Unreadable`].
pub fn text_of(path: &Path) -> Result<String, ConfigError> {
    text(path).map_err(|e| ConfigError::Unreadable {
        path: path.display().to_string(),
        problem: why_unreadable(path, &e),
    })
}

/// Parses and checks a text; `name` stands for it in errors.
///
/// # Errors
/// [`ConfigError::Wrong`].
pub fn parse<T: DeserializeOwned + Check>(name: &str, text: &str) -> Result<T, ConfigError> {
    let layers = layers(name, text)?;
    let check = |values: &Table, is_whole: bool| {
        let mut checker = Checker::default();
        if let Some(table) = T::TABLE {
            table.check(values, "", is_whole, &mut checker);
        }
        checker.done()
    };
    // each file by itself first, so that an error shows its place
    for layer in &layers {
        toml::from_str::<T>(&layer.text).map_err(|e| layer.mistyped::<T>(&e))?;
        check(&layer.values, false).map_err(|e| layer.refused(&e))?;
    }
    // what is wrong only in the whole is shown where it is written: in the file, else in its base
    let own = &layers[0];
    let refused = |e: Invalid| {
        let stating = layers.iter().find(|l| value_of(&l.text, &e.key).is_some());
        stating.unwrap_or(own).refused(&e)
    };
    let mut values = Table::new();
    for layer in &layers {
        fill(&mut values, &layer.values);
    }
    check(&values, true).map_err(refused)?;
    let value = T::deserialize(values).map_err(|e| {
        let hint = "the file and its base contradict each other";
        own.wrong(0..0, plain(e.message(), "", None), hint)
    })?;
    let mut checker = Checker::default();
    value.check(&mut checker);
    checker.done().map_err(refused)?;
    Ok(value)
}

/// A text and its values.
struct Layer {
    name: String,
    text: String,
    values: Table,
}

impl Layer {
    fn new(name: &str, text: &str) -> Result<Self, ConfigError> {
        let mut layer = Self {
            name: name.to_owned(),
            text: text.to_owned(),
            values: Table::new(),
        };
        layer.values = toml::from_str(text).map_err(|e| {
            let span = e.span().unwrap_or(0..0);
            let hint = "see https://toml.io for the form of a TOML file";
            layer.wrong(span, plain(e.message(), "", None), hint)
        })?;
        Ok(layer)
    }

    /// A key that is not known, or a value that its type does not accept.
    fn mistyped<T: Check>(&self, e: &toml::de::Error) -> ConfigError {
        let span = e.span().unwrap_or(0..0);
        let key = if span.is_empty() {
            String::new()
        } else {
            key_at(&self.text, &span)
        };
        let row = T::TABLE.and_then(|table| table.row(&key));
        let hint = row.map(|r| r.hint).filter(|h| !h.is_empty());
        let hint = hint.unwrap_or(T::REMEDY);
        self.wrong(span, plain(e.message(), &shown(&key), row), hint)
    }

    fn refused(&self, e: &Invalid) -> ConfigError {
        let span = span_of(&self.text, &e.key).unwrap_or(0..0);
        self.wrong(span, format!("{}: {}", e.shown_key(), e.problem), &e.hint)
    }

    fn wrong(&self, span: Range<usize>, problem: String, hint: &str) -> ConfigError {
        let before = &self.text[..span.start.min(self.text.len())];
        let line = before.matches('\n').count() + 1;
        ConfigError::Wrong {
            path: self.name.clone(),
            line,
            problem,
            text: NamedSource::new(&self.name, self.text.clone()),
            span: span.into(),
            hint: hint.to_owned(),
        }
    }
}

/// Bases that build on each other at most; a longer chain is a circle.
const BASES_MAX: usize = 8;

/// The text itself, then the base that it names, then that one's base. `base = "pi4"` names a board that comes with
/// the program, `base = "mine.toml"` a file beside the one that names it.
fn layers(name: &str, text: &str) -> Result<Vec<Layer>, ConfigError> {
    let mut layers = vec![Layer::new(name, text)?];
    while let Some((layer, base)) = layers
        .last()
        .and_then(|l| Some((l, l.values.get("base")?.as_str()?)))
    {
        let wrong = |problem: String, hint: &str| {
            layer.wrong(span_of(&layer.text, "base").unwrap_or(0..0), problem, hint)
        };
        if layers.len() > BASES_MAX {
            let problem = format!("base: `{base}` builds on itself");
            let hint = "a base must not name a file that builds on it";
            return Err(wrong(problem, hint));
        }
        let next = match shipped::board(base) {
            Some(text) => Layer::new(&format!("boards/{base}.toml"), text)?,
            None if base.ends_with(".toml") => {
                let path = Path::new(&layer.name).with_file_name(base);
                // a running service reads its gains again, and a pipe would keep it waiting
                if is_irregular(&path) {
                    let problem = format!("base: `{base}` is no regular file");
                    return Err(wrong(problem, "name a file of this kind"));
                }
                Layer::new(&path.display().to_string(), &text_of(&path)?)?
            }
            None => {
                let hint = format!("write a file name or one of {}", shipped::names());
                return Err(wrong(format!("base: there is no board `{base}`"), &hint));
            }
        };
        layers.push(next);
    }
    Ok(layers)
}

/// Adds what `values` leave open: tables are merged, everything else is taken as a whole.
fn fill(values: &mut Table, base: &Table) {
    for (key, theirs) in base {
        match (values.get_mut(key), theirs) {
            (None, _) => drop(values.insert(key.clone(), theirs.clone())),
            (Some(Value::Table(ours)), Value::Table(theirs)) => fill(ours, theirs),
            (Some(_), _) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct File {
        a: Part,
    }
    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Part {
        x_mm: f64,
        many: Vec<f64>,
    }
    impl Check for File {
        fn check(&self, to: &mut Checker) {
            to.at("a.x_mm")
                .range(self.a.x_mm, 0.0..=1.0, "mm")
                .hint("measure it again");
            to.each("a.many", &self.a.many, &(0.0..=1.0), "", "");
        }
    }

    fn why(text: &str) -> String {
        match parse::<File>("f.toml", text) {
            Ok(_) => String::new(),
            Err(e) => e.to_string(),
        }
    }

    #[test]
    fn errors_name_file_line_key_value_and_range() {
        assert_eq!(why("[a]\nx_mm = 0.5\nmany = [1.0]\n"), "");
        assert_eq!(
            why("[a]\nmany = []\nx_mm = 7.5\n"),
            "f.toml, line 3: a.x_mm: 7.5 mm is outside 0 to 1 mm"
        );
        assert_eq!(
            why("[a]\nmany = []\nx_mm = nan\n"),
            "f.toml, line 3: a.x_mm: NaN mm is outside 0 to 1 mm"
        );
        assert_eq!(
            why("[a]\nx_mm = 1\nmany = [\n1.0,\n2.0]\n"),
            "f.toml, line 5: a.many[2]: 2 is outside 0 to 1"
        );
        assert!(
            why("[a]\nx_mm = 1\nmany = []\ny = 2\n")
                .contains("line 4: `a.y` is not a known key; expected `x_mm` or `many`")
        );
        assert!(
            why("[a]\nx_mm = \"1 mm\"\nmany = []\n")
                .contains("line 2: a.x_mm: the text \"1 mm\": expected a number")
        );
        assert!(why("[a\n").contains("line 1"));
    }

    #[test]
    fn a_missing_file_is_named() {
        let e = read::<File>(Path::new("/nowhere/x.toml"))
            .unwrap_err()
            .to_string();
        assert!(e.starts_with("/nowhere/x.toml: "), "{e}");
    }

    #[test]
    fn a_base_is_a_regular_file() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("folder.toml")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", folder.path().join("device.toml")).unwrap();
        let name = folder.path().join("f.toml").display().to_string();
        for base in ["folder.toml", "device.toml"] {
            let found = parse::<File>(&name, &format!("base = \"{base}\"\n"));
            let why = found.unwrap_err().to_string();
            assert!(
                why.contains("line 1") && why.contains("no regular file"),
                "{why}"
            );
        }
    }
}
