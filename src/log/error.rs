//! Why a table is refused. Every message names the file and, where there is one, the line and the column.

use std::io::ErrorKind;
use std::path::Path;

/// Longest field that an error shows, characters.
const SHOWN_MAX: usize = 100;

/// Why a file cannot be read, and what to do, in words that follow its name.
pub fn why_unreadable(path: &Path, error: &std::io::Error) -> String {
    match error.kind() {
        _ if path.is_dir() => "this is a folder, not a file; give the name of a file".to_owned(),
        ErrorKind::NotFound => "there is no such file; check the path".to_owned(),
        ErrorKind::PermissionDenied => {
            "this user has no permission to read the file; change its permissions or its owner"
                .to_owned()
        }
        ErrorKind::FileTooLarge => {
            "the file is larger than 1 MiB, so it is another file than is expected here".to_owned()
        }
        ErrorKind::InvalidData if error.get_ref().is_some() => error.to_string(),
        ErrorKind::InvalidData => "this is not a text file (not valid UTF-8)".to_owned(),
        _ => format!("the file cannot be read: {error}"),
    }
}

/// A field as an error shows it: without the many digits of a number such as 1e300, and not endless.
pub(super) fn short(field: &str) -> String {
    match field.parse::<f64>() {
        Ok(number) if field.len() > SHOWN_MAX => format!("{number:e}"),
        _ => field.chars().take(SHOWN_MAX).collect(),
    }
}

impl ReadError {
    /// A file of which `rows` are below its header, where `least` are needed.
    pub(super) fn too_short(file: &str, rows: usize, least: usize) -> Self {
        let (file, some) = (file.to_owned(), rows.to_string());
        let rows = if rows == 0 { "no".to_owned() } else { some };
        Self::TooShort { file, rows, least }
    }
}

/// Why a table cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file does not exist or cannot be opened.
    #[error("{file}: {problem}")]
    Open {
        /// File.
        file: String,
        /// The reason, with the mend.
        problem: String,
    },
    /// The file ends early, or its contents contradict its compression or encoding.
    #[error(
        "{file}, line {line}: cannot be read: {reason}; the file is cut short or damaged, copy it again"
    )]
    Broken {
        /// File.
        file: String,
        /// Line reached, counted from 1.
        line: u64,
        /// Reason given by the decoder.
        reason: String,
    },
    /// The file is a table in another notation, or too large.
    #[error("{file}, line {line}: {problem}")]
    Notation {
        /// File.
        file: String,
        /// Line, counted from 1.
        line: u64,
        /// What it is, with the mend.
        problem: &'static str,
    },
    /// The file has too few rows.
    #[error("{file}: has {rows} rows below its header line; at least {least} needed")]
    TooShort {
        /// File.
        file: String,
        /// `no`, or the number of rows.
        rows: String,
        /// Rows needed.
        least: usize,
    },
    /// The header lacks a required column.
    #[error("{file}, line 1, column {column}: is missing; the header names {header}")]
    Missing {
        /// File.
        file: String,
        /// Missing column.
        column: String,
        /// Columns that are present.
        header: String,
    },
    /// A line has a different number of fields than the header.
    #[error(
        "{file}, line {line}, column {column}: the line has {found} fields where the header has {expected}; it is cut short or has stray commas"
    )]
    Fields {
        /// File.
        file: String,
        /// Line, counted from 1.
        line: u64,
        /// First column without a field, or the last column.
        column: String,
        /// Fields found.
        found: usize,
        /// Fields in the header.
        expected: usize,
    },
    /// A field does not hold what its column requires.
    #[error("{file}, line {line}, column {column}: `{value}` is not {expected}")]
    Field {
        /// File.
        file: String,
        /// Line, counted from 1.
        line: u64,
        /// Column.
        column: String,
        /// Field as read.
        value: String,
        /// What the column requires.
        expected: String,
    },
    /// Time does not increase.
    #[error(
        "{file}, line {line}, column {column}: {} s does not come after {} s; time must strictly increase",
        short(&.now_s.to_string()), short(&.before_s.to_string())
    )]
    Clock {
        /// File.
        file: String,
        /// Line, counted from 1.
        line: u64,
        /// Column.
        column: String,
        /// Time of this line, s.
        now_s: f64,
        /// Time of the line before, s.
        before_s: f64,
    },
}
