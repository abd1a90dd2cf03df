//! Why a table is refused. Every message names the file and, where there is one, the line and the column.

use std::fmt::Display;

/// Longest field that an error shows, characters.
const SHOWN_MAX: usize = 100;

/// A field as an error shows it: without the many digits of a number such as 1e300, and not endless.
pub(super) fn short(field: &str) -> String {
    match field.parse::<f64>() {
        Ok(number) if field.len() > SHOWN_MAX => format!("{number:e}"),
        _ => field.chars().take(SHOWN_MAX).collect(),
    }
}

/// Why a table cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct ReadError {
    /// The file and, where there is one, the line, counted from 1, and the column.
    place: String,
    /// What is wrong, with the mend.
    problem: String,
    /// A required column that the header lacks; the file may be a table of another kind.
    pub lacking: Option<String>,
}

impl ReadError {
    /// A problem of a whole file.
    pub(super) fn of_file(file: &str, problem: String) -> Self {
        Self {
            place: file.to_owned(),
            problem,
            lacking: None,
        }
    }

    /// A problem of a line.
    pub(super) fn of_line(file: &str, line: u64, problem: &str) -> Self {
        Self::of_file(&format!("{file}, line {line}"), problem.to_owned())
    }

    /// A problem of a column in a line.
    pub(super) fn of_column(file: &str, line: u64, column: &str, problem: String) -> Self {
        Self::of_file(&format!("{file}, line {line}, column {column}"), problem)
    }

    /// A required column that the header lacks.
    pub(super) fn lacking(file: &str, column: &str, header: &str) -> Self {
        let problem = format!("is missing; the header names {header}");
        Self {
            lacking: Some(column.to_owned()),
            ..Self::of_column(file, 1, column, problem)
        }
    }

    /// A file that ends early, or whose contents contradict its compression or encoding, as a decoder says.
    pub(super) fn broken(file: &str, line: u64, reason: impl Display) -> Self {
        let mend = "the file is cut short or damaged, copy it again";
        Self::of_line(file, line, &format!("cannot be read: {reason}; {mend}"))
    }

    /// A file of which `rows` are below its header, where `least` are needed.
    pub(super) fn too_short(file: &str, rows: usize, least: usize) -> Self {
        let have = if rows == 0 {
            "no".to_owned()
        } else {
            rows.to_string()
        };
        let problem = format!("has {have} rows below its header line; at least {least} needed");
        Self::of_file(file, problem)
    }
}
