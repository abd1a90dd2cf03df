//! Reading a TOML file into a checked section, with errors that point into the text.

use crate::primitives::check::{Check, Checker, Invalid};
use miette::{Diagnostic, NamedSource, SourceSpan};
use serde::de::DeserializeOwned;
use std::ops::Range;
use std::path::Path;
use thiserror::Error;
use toml::de::{DeTable, DeValue};

/// A configuration file that cannot be used.
#[derive(Debug, Error, Diagnostic)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    #[diagnostic(help("give the path of a TOML file that exists and may be read"))]
    Unreadable {
        /// Path as given.
        path: String,
        /// The system's reason.
        source: std::io::Error,
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
        /// How to mend it.
        #[help]
        mend: String,
    },
}

/// Reads and checks a file.
///
/// # Errors
/// [`ConfigError`] naming file, line, key, value, allowed range and mend.
#[allow(clippy::result_large_err, reason = "made at most once a run, on the way out")]
pub fn read<T: DeserializeOwned + Check>(path: &Path) -> Result<T, ConfigError> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Unreadable { path: name.clone(), source })?;
    parse(&name, &text)
}

/// Parses and checks a text; `name` stands for it in errors.
///
/// # Errors
/// [`ConfigError::Wrong`].
#[allow(clippy::result_large_err, reason = "made at most once a run, on the way out")]
pub fn parse<T: DeserializeOwned + Check>(name: &str, text: &str) -> Result<T, ConfigError> {
    let value: T = toml::from_str(text).map_err(|e| {
        let span = e.span().unwrap_or(0..0);
        wrong(name, text, span, e.message().to_owned(), "keys and their meaning are documented in the files under boards/ and calib/")
    })?;
    let mut checker = Checker::default();
    value.check(&mut checker);
    checker.done().map_err(|Invalid { key, problem, mend }| {
        let span = span_of(text, &key).unwrap_or(0..0);
        wrong(name, text, span, format!("{key}: {problem}"), &mend)
    })?;
    Ok(value)
}

fn wrong(name: &str, text: &str, span: Range<usize>, problem: String, mend: &str) -> ConfigError {
    let line = text[..span.start.min(text.len())].matches('\n').count() + 1;
    ConfigError::Wrong {
        path: name.to_owned(),
        line,
        problem,
        text: NamedSource::new(name, text.to_owned()),
        span: span.into(),
        mend: mend.to_owned(),
    }
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
        assert_eq!(why("[a]\nx_mm = 1\nmany = [\n1.0,\n2.0]\n"), "f.toml, line 5: a.many.1: 2 is outside 0 to 1");
        assert!(why("[a]\nx_mm = 1\nmany = []\ny = 2\n").contains("line 4: unknown field `y`"));
        assert!(why("[a]\nx_mm = \"1 mm\"\nmany = []\n").contains("line 2: invalid type: string"));
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
