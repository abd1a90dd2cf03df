//! Why a table is refused. Every message names the file and, where there is one, the line and the column.

/// Why a table cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file does not exist or cannot be opened.
    #[error("{file}: cannot be opened: {source}; check the path and its permissions")]
    Open {
        /// File.
        file: String,
        /// Reason given by the operating system.
        source: std::io::Error,
    },
    /// The file ends early, or its contents contradict its compression or encoding.
    #[error("{file}, line {line}: cannot be read: {reason}; the file is cut short or damaged, copy it again")]
    Broken {
        /// File.
        file: String,
        /// Line reached, counted from 1.
        line: u64,
        /// Reason given by the decoder.
        reason: String,
    },
    /// The file has too few rows.
    #[error("{file}: has {rows} rows; a header line and at least {least} rows are needed")]
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
    #[error("{file}, line {line}, column {column}: {now_s} s does not come after {before_s} s; time must strictly increase")]
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
