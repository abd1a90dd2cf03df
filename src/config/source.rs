//! Reading a TOML file into a checked structure, with errors that point into the text.
//!
//! A file may build on another: `base = "pi4"` takes everything from that board, and the file states only what
//! differs. Tables are merged key by key; lists and values replace those of the base.

use crate::config::shipped;
use crate::primitives::check::{Checker, Invalid};
use crate::primitives::parameters::Check;
use miette::{Diagnostic, NamedSource, SourceSpan};
use serde::de::DeserializeOwned;
use std::io::ErrorKind;
use std::ops::Range;
use std::path::Path;
use thiserror::Error;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

/// A configuration file that cannot be used.
#[derive(Debug, Error, Diagnostic)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: {problem}")]
    #[diagnostic(help("give the path of a TOML file that exists and that this user may read"))]
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
#[allow(clippy::result_large_err, reason = "made at most once a run, on the way out")]
pub fn read<T: DeserializeOwned + Check>(path: &Path) -> Result<T, ConfigError> {
    parse(&path.display().to_string(), &text_of(path)?)
}

/// The text of a file.
///
/// # Errors
/// [`ConfigError::Unreadable`].
#[allow(clippy::result_large_err, reason = "made at most once a run, on the way out")]
pub fn text_of(path: &Path) -> Result<String, ConfigError> {
    let unreadable = |problem: String| ConfigError::Unreadable { path: path.display().to_string(), problem };
    if path.is_dir() {
        return Err(unreadable("this is a folder, not a file".to_owned()));
    }
    std::fs::read_to_string(path).map_err(|e| {
        unreadable(match e.kind() {
            ErrorKind::NotFound => "there is no such file".to_owned(),
            ErrorKind::PermissionDenied => "this user has no permission to read the file".to_owned(),
            ErrorKind::InvalidData => "this is not a text file (not valid UTF-8)".to_owned(),
            _ => format!("the file cannot be read: {e}"),
        })
    })
}

/// Parses and checks a text; `name` stands for it in errors.
///
/// # Errors
/// [`ConfigError::Wrong`].
#[allow(clippy::result_large_err, reason = "made at most once a run, on the way out")]
pub fn parse<T: DeserializeOwned + Check>(name: &str, text: &str) -> Result<T, ConfigError> {
    let layers = layers(name, text)?;
    // each file by itself first, so that an error shows its place
    for layer in &layers {
        toml::from_str::<T>(&layer.text).map_err(|e| {
            let hint = "`retroflex board show` prints every key with its meaning, unit and range";
            layer.wrong(e.span().unwrap_or(0..0), plain(e.message()), hint)
        })?;
        let mut checker = Checker::default();
        if let Some(table) = T::TABLE {
            table.check_part(&layer.values, &mut checker);
        }
        checker.done().map_err(|e| layer.refused(&e))?;
    }
    // what is wrong only in the whole is shown where it is written: in the file, else in its base
    let own = &layers[0];
    let refused = |e: Invalid| layers.iter().find(|l| states(&l.values, &e.key)).unwrap_or(own).refused(&e);
    let mut values = Table::new();
    layers.iter().for_each(|layer| fill(&mut values, &layer.values));
    let mut checker = Checker::default();
    if let Some(table) = T::TABLE {
        table.check(&values, "", &mut checker);
    }
    checker.done().map_err(refused)?;
    let value = T::deserialize(values).map_err(|e| own.wrong(0..0, plain(e.message()), "the file and its base contradict each other"))?;
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
    #[allow(clippy::result_large_err, reason = "made at most once a run, on the way out")]
    fn new(name: &str, text: &str) -> Result<Self, ConfigError> {
        let mut layer = Self { name: name.to_owned(), text: text.to_owned(), values: Table::new() };
        layer.values = toml::from_str(text)
            .map_err(|e| layer.wrong(e.span().unwrap_or(0..0), plain(e.message()), "see https://toml.io for the form of a TOML file"))?;
        Ok(layer)
    }

    fn refused(&self, e: &Invalid) -> ConfigError {
        let span = span_of(&self.text, &e.key).unwrap_or(0..0);
        self.wrong(span, format!("{}: {}", e.shown_key(), e.problem), &e.hint)
    }

    fn wrong(&self, span: Range<usize>, problem: String, hint: &str) -> ConfigError {
        let line = self.text[..span.start.min(self.text.len())].matches('\n').count() + 1;
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
#[allow(clippy::result_large_err, reason = "made at most once a run, on the way out")]
fn layers(name: &str, text: &str) -> Result<Vec<Layer>, ConfigError> {
    let mut layers = vec![Layer::new(name, text)?];
    while let Some((layer, base)) = layers.last().and_then(|l| Some((l, l.values.get("base")?.as_str()?))) {
        let wrong = |problem: String, hint: &str| layer.wrong(span_of(&layer.text, "base").unwrap_or(0..0), problem, hint);
        if layers.len() > BASES_MAX {
            return Err(wrong(format!("base: `{base}` builds on itself"), "a base must not name a file that builds on it"));
        }
        let next = match shipped::board(base) {
            Some(text) => Layer::new(&format!("boards/{base}.toml"), text)?,
            None if base.ends_with(".toml") => {
                let path = Path::new(&layer.name).with_file_name(base);
                Layer::new(&path.display().to_string(), &text_of(&path)?)?
            }
            None => {
                return Err(wrong(
                    format!("base: there is no board `{base}`"),
                    &format!("write a file name or one of {}", shipped::names()),
                ));
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

/// Whether a dotted key is written in the values.
fn states(values: &Table, key: &str) -> bool {
    let mut parts = key.split('.');
    let first = parts.next().and_then(|k| values.get(k));
    parts
        .try_fold(first, |at, part| match at? {
            Value::Table(t) => Some(t.get(part)),
            Value::Array(a) => Some(part.parse::<usize>().ok().and_then(|i| a.get(i))),
            _ => None,
        })
        .flatten()
        .is_some()
}

/// The type names of Rust in the user's words.
fn plain(message: &str) -> String {
    const WORDS: [(&str, &str); 12] = [
        ("invalid type: ", ""),
        ("floating point `", "the number `"),
        ("integer `", "the number `"),
        ("string \"", "the text \""),
        ("boolean `", "the flag `"),
        ("sequence", "a list"),
        ("map", "a table"),
        (", expected f64", ": expected a number"),
        (", expected usize", ": expected a whole number, not negative"),
        (", expected i32", ": expected a whole number"),
        (", expected a string", ": expected a text in quotes"),
        (", expected a boolean", ": expected true or false"),
    ];
    let message = WORDS.iter().fold(message.to_owned(), |m, (from, to)| m.replace(from, to));
    ["u8", "u16", "u32", "u64"]
        .iter()
        .fold(message, |m, t| m.replace(&format!(", expected {t}"), ": expected a whole number, not negative"))
}

/// The text with the value of a dotted key replaced, everything else left as it is; `None` when the key is
/// not written in it.
#[must_use]
pub fn replace(text: &str, key: &str, value: &str) -> Option<String> {
    let (table, last) = key.rsplit_once('.')?;
    // a key that is not written is answered with its table: then the text there is no value of its own
    let span = span_of(text, key)?;
    if span_of(text, table) == Some(span.clone()) {
        return None;
    }
    let line = text[..span.start].rsplit('\n').next().unwrap_or("");
    let named = last.parse::<usize>().is_ok() || line.contains(last);
    named.then(|| format!("{}{value}{}", &text[..span.start], &text[span.end..]))
}

/// Where a dotted key's value stands in the text. A key that is not written (a default that clashes
/// with something written) points at the nearest table that is.
fn span_of(text: &str, key: &str) -> Option<Range<usize>> {
    let table = DeTable::parse(text).ok()?;
    let mut parts = key.split('.');
    let first = parts.next()?;
    let (_, mut value) = table.get_ref().iter().find(|(k, _)| k.get_ref() == first)?;
    for part in parts {
        let next = match value.get_ref() {
            DeValue::Table(t) => t.iter().find(|(k, _)| k.get_ref() == part).map(|(_, v)| v),
            DeValue::Array(a) => part.parse::<usize>().ok().and_then(|i| a.get(i)),
            _ => None,
        };
        match next {
            Some(inner) => value = inner,
            None => break,
        }
    }
    Some(value.span())
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
            to.range("a.x_mm", self.a.x_mm, 0.0..=1.0, "mm", "measure it again");
            to.ranges("a.many", &self.a.many, 0.0..=1.0, "", "");
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
        assert_eq!(why("[a]\nmany = []\nx_mm = 7.5\n"), "f.toml, line 3: a.x_mm: 7.5 mm is outside 0 to 1 mm");
        assert_eq!(why("[a]\nmany = []\nx_mm = nan\n"), "f.toml, line 3: a.x_mm: NaN mm is outside 0 to 1 mm");
        assert_eq!(why("[a]\nx_mm = 1\nmany = [\n1.0,\n2.0]\n"), "f.toml, line 5: a.many[2]: 2 is outside 0 to 1");
        assert!(why("[a]\nx_mm = 1\nmany = []\ny = 2\n").contains("line 4: unknown field `y`"));
        assert!(why("[a]\nx_mm = \"1 mm\"\nmany = []\n").contains("line 2: the text \"1 mm\": expected a number"));
        assert!(why("[a\n").contains("line 1"));
    }

    #[test]
    fn a_value_is_replaced_in_place_and_only_if_it_is_there() {
        let text = "[a]\n# why\nx_mm = 0.5 # so\n[[c]]\nn = 1\n[[c]]\nn = 2\n";
        assert_eq!(replace(text, "a.x_mm", "0.25").unwrap(), text.replace("0.5", "0.25"));
        assert_eq!(replace(text, "c.1.n", "7").unwrap(), text.replace("n = 2", "n = 7"));
        assert_eq!(replace(text, "a.y_mm", "1"), None);
        assert_eq!(replace(text, "c.1.m", "1"), None);
    }

    #[test]
    fn a_missing_file_is_named() {
        let e = read::<File>(Path::new("/nowhere/x.toml")).unwrap_err().to_string();
        assert!(e.starts_with("/nowhere/x.toml: "), "{e}");
    }
}
