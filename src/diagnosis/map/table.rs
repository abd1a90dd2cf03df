//! The columns that a map names, read from CSV or gzip CSV.

use crate::diagnosis::map::file::{MapFile, Nominal};
use flate2::read::MultiGzDecoder;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use thiserror::Error;

/// Why a log does not go with a map.
#[derive(Debug, Error)]
pub enum MapError {
    /// Not there or damaged.
    #[error("{0}: cannot be read: {1}; check the path, and copy the file again if it is cut short")]
    Broken(String, String),
    /// A column is not in the header.
    #[error("{file}, line 1, column {column}: is missing; the map names it, the header has {header}")]
    Missing {
        /// File.
        file: String,
        /// Column.
        column: String,
        /// Columns that are there.
        header: String,
    },
    /// A field is no number, or missing.
    #[error("{file}, line {line}, column {column}: `{value}` is not a finite number")]
    Field {
        /// File.
        file: String,
        /// Line, from 1.
        line: u64,
        /// Column.
        column: String,
        /// What stands there.
        value: String,
    },
    /// Time does not go on.
    #[error("{0}, line {1}, column {2}: time does not increase; it must strictly increase")]
    Clock(String, u64, String),
    /// Not enough to hold anything out.
    #[error("{0}: {1} rows; at least {2} are needed to hold some out: record longer, or lower `every` in the map")]
    Short(String, usize, usize),
    /// Nothing changes.
    #[error("{0}, column {1}: stands at one value; record a log in which it changes")]
    Still(String, String),
}

/// Rows needed at least.
const ROWS_MIN: usize = 60;

/// A log as the map sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Signals {
    /// Inputs.
    pub inputs: Vec<Vec<f64>>,
    /// Output.
    pub output: Vec<f64>,
    /// What friction follows, if there is anything.
    pub motion: Option<Vec<f64>>,
    /// Time, s; row numbers if the log has no clock.
    pub t: Vec<f64>,
    /// Whether `t` is time.
    pub clocked: bool,
}

/// Reads the columns that a map names.
///
/// # Errors
/// [`MapError`], naming file, line and column.
pub fn read(path: &Path, map: &MapFile) -> Result<Signals, MapError> {
    let file = path.display().to_string();
    let broken = |e: std::io::Error| MapError::Broken(file.clone(), e.to_string());
    let mut reader = BufReader::new(std::fs::File::open(path).map_err(broken)?);
    let gzip = reader.fill_buf().map_err(broken)?.starts_with(&[0x1f, 0x8b]);
    if gzip { parse(&file, MultiGzDecoder::new(reader), map) } else { parse(&file, reader, map) }
}

/// The same from text; `file` is what errors call it.
///
/// # Errors
/// [`MapError`].
pub fn parse(file: &str, text: impl Read, map: &MapFile) -> Result<Signals, MapError> {
    let broken = |e: csv::Error| MapError::Broken(file.to_owned(), e.to_string());
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text);
    let header: Vec<String> = reader.headers().map_err(broken)?.iter().map(str::to_owned).collect();
    let inputs = map.input.as_ref().map(|i| i.names()).unwrap_or_default();
    let outputs = map.output.names();
    let wanted: Vec<&str> = inputs.iter().chain(&outputs).copied().chain(map.motion.as_deref()).chain(map.time.as_deref()).collect();
    let mut at = Vec::new();
    for name in &wanted {
        let lost = || MapError::Missing { file: file.to_owned(), column: (*name).to_owned(), header: header.join(", ") };
        at.push(header.iter().position(|h| h == name).ok_or_else(lost)?);
    }
    let (mut columns, mut lines): (Vec<Vec<f64>>, Vec<u64>) = (vec![vec![]; wanted.len()], vec![]);
    for (row, record) in reader.records().enumerate() {
        let record = record.map_err(broken)?;
        if row % map.every != 0 {
            continue;
        }
        // a row in which a value is missing says nothing
        if at.iter().any(|&k| record[k].is_empty()) {
            continue;
        }
        let line = record.position().map_or(0, csv::Position::line);
        for ((column, &k), name) in columns.iter_mut().zip(&at).zip(&wanted) {
            let value = &record[k];
            let bad = || MapError::Field { file: file.to_owned(), line, column: (*name).to_owned(), value: value.to_owned() };
            column.push(value.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(bad)?);
        }
        lines.push(line);
    }
    assemble(file, map, columns, &lines, (inputs.len(), outputs.len()))
}

fn assemble(
    file: &str,
    map: &MapFile,
    mut columns: Vec<Vec<f64>>,
    lines: &[u64],
    (inputs, outputs): (usize, usize),
) -> Result<Signals, MapError> {
    let n = lines.len();
    if n < ROWS_MIN {
        return Err(MapError::Short(file.to_owned(), n, ROWS_MIN));
    }
    let time = map.time.as_ref().and_then(|_| columns.pop());
    let motion = map.motion.as_ref().and_then(|_| columns.pop());
    if let (Some(t), Some(name)) = (&time, &map.time)
        && let Some(k) = t.windows(2).position(|w| w[1] <= w[0])
    {
        return Err(MapError::Clock(file.to_owned(), lines[k + 1], name.clone()));
    }
    let answers = columns.split_off(inputs);
    let output = if outputs == 1 {
        answers.into_iter().next().unwrap_or_default()
    } else {
        (0..n).map(|k| answers.iter().map(|c| c[k] * c[k]).sum::<f64>().sqrt()).collect()
    };
    let moves = |c: &[f64]| c.iter().any(|v| *v != c[0]);
    if map.nominal != Nominal::Still
        && let Some(k) = columns.iter().position(|c| !moves(c))
        && inputs == 1
    {
        return Err(MapError::Still(file.to_owned(), map.input.as_ref().map_or(String::new(), |i| i.names()[k].to_owned())));
    }
    if !moves(&output) {
        return Err(MapError::Still(file.to_owned(), map.output.names().join(", ")));
    }
    let step = map.rate_hz.map_or(1.0, |r| map.every as f64 / r);
    let clocked = time.is_some() || map.rate_hz.is_some();
    let t = time.unwrap_or_else(|| (0..n).map(|k| k as f64 * step).collect());
    Ok(Signals { motion: motion.or_else(|| columns.first().cloned()), inputs: columns, output, t, clocked })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn why(map: &str, text: &str) -> String {
        match parse("x.csv", text.as_bytes(), &toml::from_str(map).unwrap()) {
            Ok(_) => String::new(),
            Err(e) => e.to_string(),
        }
    }

    #[test]
    fn a_log_that_does_not_go_with_its_map_is_refused_by_line_and_column() {
        let map = "input = \"u\"\noutput = \"y\"\ntime = \"t\"\n";
        let rows = |f: fn(usize) -> String| format!("t,u,y\n{}", (0..80).map(f).collect::<String>());
        assert_eq!(why(map, &rows(|k| format!("{k},{k},{}\n", k * k))), "");
        assert!(why(map, "t,x,y\n0,0,0\n").contains("line 1, column u: is missing; the map names it, the header has t, x, y"));
        assert!(why(map, "t,u,y\n0,0,0\n1,?,0\n").contains("line 3, column u: `?`"));
        assert!(why(map, "t,u,y\n0,0,0\n").contains("1 rows; at least 60"));
        assert!(why(map, &rows(|k| format!("{},{k},{k}\n", k % 40))).contains("line 42, column t: time does not increase"));
        assert!(why(map, &rows(|k| format!("{k},5,{k}\n"))).contains("column u: stands at one value"));
    }
}
