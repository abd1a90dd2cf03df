//! Reader of tables: CSV or gzip CSV with one header line, in which every column of interest holds numbers.
//!
//! An empty field or `nan` is a missing value and reads as NaN. Gzip is recognised by its first two bytes.

use crate::log::error::{ReadError, short};
use crate::primitives::file::{encoding, why_unreadable};
use flate2::read::MultiGzDecoder;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

/// First two bytes of a gzip file (RFC 1952).
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// Largest deviation of a reference quaternion's norm from one: two printed decimals of each component.
const UNIT_TOLERANCE: f64 = 0.02;

/// Longest line of a table, and most bytes of all its lines.
const BYTES_MAX: [u64; 2] = [64 << 10, 4 << 30];
/// Largest magnitude of a value: beyond a time in nanoseconds since 1970, and with a square that is finite.
const VALUE_MAX: f64 = 1e19;
/// Most values of a table: those of an hour at 500 Hz with 50 columns.
const VALUES_MAX: usize = 90_000_000;
/// Longest time between two rows: this, s, or this many times the usual one.
const STEP_MAX_S: f64 = 86_400.0;
const STEP_MAX_PERIODS: f64 = 1e4;
/// A clock stands between two rows that are nearer than this share of the median step.
const STEP_MIN_PERIODS: f64 = 1e-6;

/// What is wrong with a header line, if its columns are not separated by commas.
fn separation(header: &csv::StringRecord) -> Option<&'static str> {
    let has = |c: char| header.iter().any(|name| name.contains(c));
    match header.len() {
        1 if has(';') => Some(
            "the columns are separated by semicolons; separate them by commas, and write numbers with a decimal point",
        ),
        1 if has('\t') => Some("the columns are separated by tabs; separate them by commas"),
        _ => None,
    }
}

/// Text that ends with an error if a line, or all of it, is too long to be a table.
struct Bounded<R> {
    text: R,
    line: u64,
    all: u64,
}

impl<R: Read> Read for Bounded<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.text.read(buffer)?;
        self.all += n as u64;
        let since_end = buffer[..n].iter().rev().position(|b| *b == b'\n');
        self.line = since_end.map_or(self.line + n as u64, |k| k as u64);
        if self.line > BYTES_MAX[0] {
            return Err(io::Error::other("a line is longer than 64 KiB"));
        }
        if self.all > BYTES_MAX[1] {
            return Err(io::Error::other("the table is larger than 4 GiB"));
        }
        Ok(n)
    }
}

/// The content of a file, decompressed if it is gzip.
///
/// # Errors
/// The operating system's.
fn reader(path: &Path) -> io::Result<Box<dyn Read>> {
    let mut file = BufReader::new(File::open(path)?);
    let gzip = file.fill_buf()?.starts_with(&GZIP_MAGIC);
    Ok(if gzip {
        Box::new(MultiGzDecoder::new(file))
    } else {
        Box::new(file)
    })
}

/// Median of the finite values, the upper one of two; `None` without any.
pub fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut all: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let middle = all.len() / 2;
    (!all.is_empty()).then(|| *all.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// What a table must contain.
pub struct Schema<'a> {
    /// Columns that the header must name.
    pub required: &'a [&'a str],
    /// Whether a column holds numbers; all other columns are ignored.
    pub known: &'a dyn Fn(&str) -> bool,
    /// Least number of rows.
    pub rows_min: usize,
}

/// A table in columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    file: String,
    header: Vec<String>,
    /// Values of each column in header order; empty for ignored columns.
    columns: Vec<Vec<f64>>,
    lines: Vec<u64>,
}

impl Table {
    /// Reads a file.
    ///
    /// # Errors
    /// [`ReadError`] with file and, where there is one, line and column.
    pub fn open(path: &Path, schema: &Schema<'_>) -> Result<Self, ReadError> {
        let file = path.display().to_string();
        let text = reader(path).map_err(|e| ReadError::of_file(&file, why_unreadable(path, &e)))?;
        Self::parse(&file, text, schema)
    }

    /// Reads CSV text; errors quote `file` as the name of the file.
    ///
    /// # Errors
    /// [`ReadError`], as for [`Table::open`].
    pub fn parse(file: &str, text: impl Read, schema: &Schema<'_>) -> Result<Self, ReadError> {
        let mut text = BufReader::new(Bounded {
            text,
            line: 0,
            all: 0,
        });
        let notation = |problem| ReadError::of_line(file, 1, problem);
        // a decoder says it once
        let start = text.fill_buf().map_err(|e| ReadError::broken(file, 1, e))?;
        if let Some(problem) = encoding(start) {
            return Err(notation(problem));
        }

        let mut options = csv::ReaderBuilder::new();
        let options = options.flexible(true).trim(csv::Trim::All);
        let mut reader = options.from_reader(text);
        let header = reader.headers();
        let header = header.map_err(|e| ReadError::broken(file, 1, e))?;
        if let Some(problem) = separation(header) {
            return Err(notation(problem));
        }
        let header: Vec<String> = header.iter().map(str::to_owned).collect();
        let mut table = Self {
            file: file.to_owned(),
            columns: vec![vec![]; header.len()],
            header,
            lines: vec![],
        };
        if !table.header.is_empty() {
            let mut names = schema.required.iter();
            names.try_for_each(|name| table.position(name).map(drop))?;
        }
        table.distinct(schema)?;

        let known: Vec<bool> = table
            .header
            .iter()
            .map(|name| (schema.known)(name))
            .collect();
        let mut record = csv::StringRecord::new();
        let mut line = 1;
        while reader
            .read_record(&mut record)
            .map_err(|e| ReadError::broken(file, line + 1, e))?
        {
            line = record.position().map_or(line + 1, csv::Position::line);
            table.push(line, &record, &known)?;
        }
        if table.rows() < schema.rows_min {
            return Err(ReadError::too_short(file, table.rows(), schema.rows_min));
        }
        Ok(table)
    }

    fn push(
        &mut self,
        line: u64,
        record: &csv::StringRecord,
        known: &[bool],
    ) -> Result<(), ReadError> {
        let (found, expected) = (record.len(), self.header.len());
        if found != expected {
            // the first column without a field, or the last one
            let column = self.header.get(found).or(self.header.last());
            let problem = format!(
                "the line has {found} fields where the header has {expected}; it is cut short or has stray commas"
            );
            let column = column.map_or("", String::as_str);
            return Err(ReadError::of_column(&self.file, line, column, problem));
        }
        if record.iter().all(str::is_empty) {
            let (row, column) = (self.rows(), self.header[0].clone());
            self.lines.push(line);
            return Err(self.refuse(row, &column, "", "a row with values"));
        }
        if (self.rows() + 1) * known.iter().filter(|known| **known).count() > VALUES_MAX {
            let problem = "the table has more than 90 million values; split it";
            return Err(ReadError::of_line(&self.file, line, problem));
        }
        self.lines.push(line);
        for (k, field) in record.iter().enumerate().filter(|(k, _)| known[*k]) {
            let (row, column) = (self.rows() - 1, &self.header[k]);
            let value = match field.parse::<f64>() {
                _ if field.is_empty() => f64::NAN.copysign(1.0),
                // the sign tells a field that says `nan` from an empty one
                Ok(value) if value.is_nan() => value.copysign(-1.0),
                Ok(value) if value.abs() <= VALUE_MAX => value,
                Ok(value) if value.is_finite() => {
                    return Err(self.refuse(row, column, field, "a number from -1e19 to 1e19"));
                }
                _ => return Err(self.refuse(row, column, field, "a finite number")),
            };
            self.columns[k].push(value);
        }
        Ok(())
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.lines.len()
    }

    /// Names of the columns.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// Refuses a header that names a column of interest twice.
    fn distinct(&self, schema: &Schema<'_>) -> Result<(), ReadError> {
        let known = |name: &&String| !name.is_empty() && (schema.known)(name);
        for (k, name) in self.header.iter().enumerate().filter(|(_, n)| known(n)) {
            let first = self.position(name)?;
            if first != k {
                let (first, second) = (first + 1, k + 1);
                let problem = format!(
                    "the header names it twice, as columns {first} and {second}; rename or remove one of them"
                );
                return Err(ReadError::of_column(&self.file, 1, name, problem));
            }
        }
        Ok(())
    }

    fn position(&self, name: &str) -> Result<usize, ReadError> {
        let found = self.header.iter().position(|h| h == name);
        found.ok_or_else(|| ReadError::lacking(&self.file, name, &self.header.join(", ")))
    }

    /// A column, if the header names it.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.position(name).ok().map(|k| self.columns[k].as_slice())
    }

    /// A column that the header must name.
    ///
    /// # Errors
    /// [`ReadError`] if it does not.
    pub fn required(&self, name: &str) -> Result<&[f64], ReadError> {
        self.position(name).map(|k| self.columns[k].as_slice())
    }

    /// Several columns; `None` if the header names none of them.
    ///
    /// # Errors
    /// [`ReadError`] if the header names only some of them.
    pub fn group<const N: usize>(
        &self,
        names: [&str; N],
    ) -> Result<Option<[&[f64]; N]>, ReadError> {
        if names.iter().all(|n| self.column(n).is_none()) {
            return Ok(None);
        }
        let mut out: [&[f64]; N] = [&[]; N];
        for (column, name) in out.iter_mut().zip(names) {
            *column = self.required(name)?;
        }
        Ok(Some(out))
    }

    /// Three columns as vectors; `None` if the header names none of them. A vector of which one component is missing is missing: all its
    /// components are NaN.
    ///
    /// # Errors
    /// [`ReadError`] if the header names only some of them.
    pub fn vectors(&self, names: [&str; 3]) -> Result<Option<Vec<Vector3<f64>>>, ReadError> {
        let Some([x, y, z]) = self.group(names)? else {
            return Ok(None);
        };
        let row = |k: usize| match Vector3::new(x[k], y[k], z[k]) {
            v if v.iter().any(|x| x.is_nan()) => Vector3::repeat(f64::NAN),
            v => v,
        };
        Ok(Some((0..self.rows()).map(row).collect()))
    }

    /// Four columns `w`, `x`, `y`, `z` as unit quaternions; an element is `None` where a value is missing.
    ///
    /// # Errors
    /// [`ReadError`] as for [`Table::vectors`], and if a norm is not one.
    pub fn quaternions(
        &self,
        names: [&str; 4],
    ) -> Result<Option<Vec<Option<UnitQuaternion<f64>>>>, ReadError> {
        let Some([w, x, y, z]) = self.group(names)? else {
            return Ok(None);
        };
        let one = |k: usize| {
            let q = Quaternion::new(w[k], x[k], y[k], z[k]);
            // a tracker that has lost its markers writes nothing, or zeros
            if q.norm().is_nan() || q.norm() == 0.0 {
                return Ok(None);
            }
            if (q.norm() - 1.0).abs() > UNIT_TOLERANCE {
                let value = format!("{} {} {} {}", w[k], x[k], y[k], z[k]);
                return Err(self.refuse(k, names[0], &value, "a unit quaternion"));
            }
            Ok(Some(UnitQuaternion::from_quaternion(q)))
        };
        let all: Result<_, _> = (0..self.rows()).map(one).collect();
        all.map(Some)
    }

    /// Refuses a column in which a value is missing.
    ///
    /// # Errors
    /// [`ReadError`] for the first missing value, and if the header does not name the column.
    pub fn complete(&self, name: &str) -> Result<&[f64], ReadError> {
        let values = self.required(name)?;
        let Some(row) = values.iter().position(|v| v.is_nan()) else {
            return Ok(values);
        };
        let says_nan = values[row].is_sign_negative();
        let text = if says_nan { "nan" } else { "" };
        Err(self.refuse(row, name, text, "a number; this column must not have gaps"))
    }

    /// A complete column of strictly increasing times, s.
    ///
    /// # Errors
    /// [`ReadError`] at the first row that is not later than the one before, and as for [`Table::complete`].
    pub fn clock(&self, name: &str) -> Result<&[f64], ReadError> {
        let t = self.complete(name)?;
        self.increasing(name, 0..self.rows())?;
        Ok(t)
    }

    /// Refuses a column of times that does not strictly increase over `rows`, in which no value is missing.
    ///
    /// # Errors
    /// [`ReadError`] at the first row that is not later than the one before.
    pub fn increasing(
        &self,
        name: &str,
        rows: impl IntoIterator<Item = usize>,
    ) -> Result<(), ReadError> {
        let t = self.required(name)?;
        let rows: Vec<usize> = rows.into_iter().collect();
        let steps_s = rows.windows(2).map(|w| t[w[1]] - t[w[0]]);
        let usual_s = median(steps_s).unwrap_or(0.0);
        let longest_s = STEP_MAX_S.max(STEP_MAX_PERIODS * usual_s);
        let mut before_s = f64::NEG_INFINITY;
        for row in rows {
            if before_s.is_finite() && t[row] - before_s > longest_s {
                let latest_s = before_s + longest_s;
                let [latest, longest] = [latest_s, longest_s].map(|s| (s * 1e3).round() / 1e3);
                let expected = format!(
                    "at most {latest} s, which is {longest} s after the row before; split the table where the clock jumps, or correct the value"
                );
                return Err(self.refuse(row, name, &t[row].to_string(), &expected));
            }
            if t[row] - before_s <= STEP_MIN_PERIODS * usual_s.max(0.0) {
                let [now, before] = [t[row], before_s].map(|s| short(&s.to_string()));
                let problem =
                    format!("{now} s does not come after {before} s; time must strictly increase");
                let line = self.lines[row];
                return Err(ReadError::of_column(&self.file, line, name, problem));
            }
            before_s = t[row];
        }
        Ok(())
    }

    /// The error for a value that its column does not allow; `row` counts from 0.
    pub fn refuse(&self, row: usize, column: &str, value: &str, expected: &str) -> ReadError {
        let problem = format!("`{}` is not {expected}", short(value));
        ReadError::of_column(&self.file, self.lines[row], column, problem)
    }
}

#[cfg(test)]
mod tests;
