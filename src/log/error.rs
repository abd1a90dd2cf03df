//! Why a file of samples cannot be read: every message names the file, and the line and column where there is one.

use std::path::PathBuf;

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file is not there, or not to be opened.
    #[error("{}: cannot be opened: {source}: check the path and its permissions", file.display())]
    Open {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file stops, or is not what its compression says.
    #[error("{}, line {line}: cannot be read: {source}: the file is cut short or damaged, copy it again", file.display())]
    Broken {
        /// The file.
        file: PathBuf,
        /// Last line that was begun, counted from 1.
        line: u64,
        /// What the decoder said.
        source: std::io::Error,
    },
    /// The file holds no rows.
    #[error("{}: has no rows: a header line and at least two samples are needed", file.display())]
    Empty {
        /// The file.
        file: PathBuf,
    },
    /// A required column is not in the header.
    #[error("{}, line 1: column {column} is missing: the header must name it", file.display())]
    MissingColumn {
        /// The file.
        file: PathBuf,
        /// The column.
        column: &'static str,
    },
    /// A line has another number of fields than the header.
    #[error("{}, line {line}, column {column}: {found} fields where the header has {expected}: the line is cut short or has stray commas", file.display())]
    Fields {
        /// The file.
        file: PathBuf,
        /// The line, counted from 1.
        line: u64,
        /// First column without a field, or the last one.
        column: String,
        /// Fields found.
        found: usize,
        /// Fields in the header.
        expected: usize,
    },
    /// A field is not what its column holds.
    #[error("{}, line {line}, column {column}: \"{value}\" is not {wanted}", file.display())]
    Field {
        /// The file.
        file: PathBuf,
        /// The line, counted from 1.
        line: u64,
        /// The column.
        column: &'static str,
        /// What stands there.
        value: String,
        /// What should stand there.
        wanted: &'static str,
    },
    /// Time does not increase.
    #[error("{}, line {line}, column time_s: {now_s} s does not come after {before_s} s: time must strictly increase", file.display())]
    Clock {
        /// The file.
        file: PathBuf,
        /// The line, counted from 1.
        line: u64,
        /// Time of this line, s.
        now_s: f64,
        /// Time of the line before, s.
        before_s: f64,
    },
}
