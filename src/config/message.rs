//! The messages of serde and TOML in the words of whoever wrote the file: keys, values, lists and tables instead of types.

use crate::primitives::{Allowed, Parameter};

/// Longest list of known keys in a message; `board show` prints longer ones.
const LISTED_MAX: usize = 9;

/// A message of serde about `key`, whose row, if it is a parameter, gives range and unit.
pub fn plain(message: &str, key: &str, row: Option<&Parameter>) -> String {
    // a list of tables begins where its first table begins
    let key = if message.starts_with("invalid length") {
        key.trim_end_matches(|c: char| "[]".contains(c) || c.is_ascii_digit())
    } else {
        key
    };
    let text = match message.split('`').nth(1) {
        Some(name) if message.starts_with("unknown field") => {
            return format!("`{key}` is not a known key{}", instead(name, message));
        }
        Some(name) if message.starts_with("unknown variant") => {
            format!("`{name}` is not a known value{}", instead(name, message))
        }
        Some(name) if message.starts_with("missing field") => {
            format!("the key `{name}` is missing")
        }
        _ => typed(message, row),
    };
    match key {
        "" => text,
        key => format!("{key}: {text}"),
    }
}

/// The most similar of the accepted words or, if none is similar and they are few, all of them.
fn instead(name: &str, message: &str) -> String {
    let known: Vec<&str> = message.split('`').skip(3).step_by(2).collect();
    let scored = known.iter().map(|k| (strsim::jaro_winkler(name, k), k));
    let near = scored.filter(|(score, _)| *score > 0.8);
    if let Some((_, nearest)) = near.max_by(|a, b| a.0.total_cmp(&b.0)) {
        return format!("; did you mean `{nearest}`?");
    }
    match known.split_last() {
        Some((last, [])) => format!("; expected `{last}`"),
        Some((last, rest)) if rest.len() < LISTED_MAX => {
            format!("; expected `{}` or `{last}`", rest.join("`, `"))
        }
        _ => String::new(),
    }
}

/// A value of the wrong type or a list of the wrong length.
fn typed(message: &str, row: Option<&Parameter>) -> String {
    const VALUES: [(&str, &str); 13] = [
        ("invalid type: ", ""),
        ("invalid value: ", ""),
        ("floating point `", "the number `"),
        ("integer `", "the number `"),
        ("string \"", "the text \""),
        ("boolean `", "the flag `"),
        // serde says both with and without the article
        ("a sequence", "sequence"),
        ("a map", "map"),
        ("sequence", "a list"),
        ("map", "a table"),
        ("invalid length ", "a list of length "),
        ("duplicate key", "this key is stated twice"),
        ("wanted string or table", "expected a text in quotes"),
    ];
    let words = |text: String, (from, to): &(&str, &str)| text.replace(from, to);
    let text = VALUES.iter().fold(message.to_owned(), words);
    let Some((found, expected)) = text.split_once(", expected ") else {
        return text;
    };
    let limits = match row.map(|r| (r.allowed, r.unit)) {
        None | Some((Allowed::Any, _)) => String::new(),
        Some((one_of @ Allowed::OneOf(_), _)) => format!(", {one_of}"),
        Some((range, unit)) => format!(" from {range} {unit}").trim_end().to_owned(),
    };
    let expected = match expected {
        "f64" => format!("a number{limits}"),
        "i32" => format!("a whole number{limits}"),
        "u8" | "u16" | "u32" | "u64" | "usize" if limits.is_empty() => {
            "a whole number, not negative".to_owned()
        }
        "u8" | "u16" | "u32" | "u64" | "usize" => format!("a whole number{limits}"),
        "a string" | "path string" => "a text in quotes".to_owned(),
        "a boolean" => "true or false".to_owned(),
        other if other.starts_with("struct ") => "a table".to_owned(),
        other => match other.strip_prefix("an array of length ") {
            Some(n) => format!("a list of {n} values"),
            None => other.to_owned(),
        },
    };
    format!("{found}: expected {expected}")
}
