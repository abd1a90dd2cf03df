//! Reader of the columns that a map names.

use crate::diagnosis::rig::{MapFile, Nominal, variance};
use crate::log::error::ReadError;
use crate::log::table::{Schema, Table};
use std::ops::Range;
use std::path::Path;
use thiserror::Error;

/// Why a log cannot be used with a map.
#[derive(Debug, Error)]
pub enum MapError {
    /// The table cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The log is too short to hold out a part of it.
    #[error(
        "{0}: {1} rows remain; at least {2} are needed to hold some out: record longer, or lower `every` in the map"
    )]
    Short(String, usize, usize),
    /// A signal is constant.
    #[error("{0}, column {1}: is constant; record a log in which it changes")]
    Constant(String, String),
    /// A saved model says nothing about the log.
    #[error(
        "{0}: the inputs reach {1:.1} half ranges of the diagnosed logs, up to 2.5 are allowed: check their units, or record a log within the range of the others"
    )]
    Outside(String, f64),
    /// The inputs of a log do not determine the nominal model.
    #[error(
        "{0}: the inputs do not determine the nominal model: they move together or not at all; record them one by one"
    )]
    Undetermined(String),
}

/// Rows needed: five in each of the twelve blocks of [`crate::diagnosis::rig::regress`].
const ROWS_MIN: usize = 60;

/// Most rows of a log that are compared: an hour in as many as a few minutes.
pub const ROWS_MAX: usize = 20_000;
/// Largest part of the variance of an input that the means of rows may hide: there are fifty means or more in a period of the motion.
const HIDDEN: f64 = 1e-3;

/// Signals of a log as the map defines them, all of equal length.
#[derive(Debug, Clone, PartialEq)]
pub struct Signals {
    /// Name of the file.
    pub file: String,
    /// Inputs.
    pub inputs: Vec<Vec<f64>>,
    /// Output.
    pub output: Vec<f64>,
    /// Signal whose speed friction depends on, if there is one.
    pub motion: Option<Vec<f64>>,
    /// Time, s; row numbers if the log has no clock.
    pub t: Vec<f64>,
    /// Whether `t` is time.
    pub clocked: bool,
    /// Rows of the log; of a long one fewer are compared.
    pub logged: usize,
}

impl Signals {
    /// What is compared of a log: at most [`ROWS_MAX`] means of successive rows, as many at a time as hide nothing of the motion of the inputs.
    /// Of a log that is longer even so, it is the stretch in which the inputs move most.
    pub(super) fn compared(self) -> Self {
        let (inputs, rows) = (&self.inputs, self.t.len());
        let mut each = rows.div_ceil(ROWS_MAX).max(1);
        while each > 1 && inputs.iter().any(|u| hidden(u, each) > HIDDEN) {
            each /= 2;
        }
        let length = (ROWS_MAX * each).min(rows);
        let moves = |stretch: &Range<usize>| -> f64 {
            let of = |u: &Vec<f64>| variance(&u[stretch.clone()]) / variance(u).max(1e-300);
            inputs.iter().map(of).sum()
        };
        let stretches = (0..=rows - length).step_by(length.max(1));
        let stretches = stretches.map(|first| first..first + length);
        let stretch = stretches.max_by(|a, b| moves(a).total_cmp(&moves(b)));
        let stretch = stretch.unwrap_or(0..rows);
        let of = |x: &Vec<f64>| means(&x[stretch.clone()], each);
        Self {
            inputs: self.inputs.iter().map(of).collect(),
            output: of(&self.output),
            motion: self.motion.as_ref().map(of),
            t: of(&self.t),
            ..self
        }
    }
}

/// Part of the variance of a signal that the means of so many rows at a time do not have.
fn hidden(x: &[f64], each: usize) -> f64 {
    1.0 - variance(&means(x, each)) / variance(x)
}

/// The means of so many values at a time; fewer values at the end are left out.
fn means(x: &[f64], each: usize) -> Vec<f64> {
    let mean = |few: &[f64]| few.iter().sum::<f64>() / each as f64;
    x.chunks_exact(each).map(mean).collect()
}

/// Reads the columns that a map names.
///
/// # Errors
/// [`MapError`] with file, line and column.
pub fn read(path: &Path, map: &MapFile) -> Result<Signals, MapError> {
    let names = names(map);
    let schema = Schema {
        required: &names,
        known: &|n| names.contains(&n),
        rows_min: 1,
    };
    let table = Table::open(path, &schema)?;
    signals(&path.display().to_string(), &table, map)
}

fn names(map: &MapFile) -> Vec<&str> {
    map.columns().into_iter().map(|(_, name)| name).collect()
}

fn signals(file: &str, table: &Table, map: &MapFile) -> Result<Signals, MapError> {
    let columns = names(map).into_iter().map(|n| table.required(n));
    let columns = columns.collect::<Result<Vec<_>, _>>()?;
    // a row with a missing value is left out
    let whole = |k: &usize| columns.iter().all(|c| !c[*k].is_nan());
    let rows: Vec<usize> = (0..table.rows()).step_by(map.every).filter(whole).collect();
    if rows.len() < ROWS_MIN {
        return Err(MapError::Short(file.to_owned(), rows.len(), ROWS_MIN));
    }
    let taken = |name: &str| -> Result<Vec<f64>, ReadError> {
        let column = table.required(name)?;
        Ok(rows.iter().map(|&k| column[k]).collect())
    };
    let all = |names: Vec<&str>| names.into_iter().map(taken).collect::<Result<Vec<_>, _>>();
    let constant = |c: &[f64]| c.iter().all(|v| *v == c[0]);
    let fails = |names: &[&str]| Err(MapError::Constant(file.to_owned(), names.join(", ")));
    let inputs = all(map.inputs())?;
    if map.nominal != Nominal::Still && inputs.len() == 1 && constant(&inputs[0]) {
        return fails(&map.inputs());
    }
    let answers = all(map.output.names())?;
    let norm = |k: usize| answers.iter().map(|c| c[k] * c[k]).sum::<f64>().sqrt();
    let output = match answers.as_slice() {
        [one] => one.clone(),
        _ => (0..rows.len()).map(norm).collect(),
    };
    if constant(&output) {
        return fails(&map.output.names());
    }
    let t = match map.time() {
        Some(name) => {
            table.increasing(name, rows.iter().copied())?;
            taken(name)?
        }
        None => {
            let step = map.rate_hz.map_or(1.0, |r| map.every as f64 / r);
            (0..rows.len()).map(|k| k as f64 * step).collect()
        }
    };
    let motion = map.motion().map(taken).transpose()?;
    let name = Path::new(file).file_name().unwrap_or_default();
    Ok(Signals {
        file: name.to_string_lossy().into_owned(),
        motion: motion.or_else(|| inputs.first().cloned()),
        inputs,
        output,
        t,
        clocked: map.is_clocked(),
        logged: rows.len(),
    }
    .compared())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(map: &str, text: &str) -> String {
        let map: MapFile = toml::from_str(map).unwrap();
        let names = names(&map);
        let table = Table::parse(
            "x.csv",
            text.as_bytes(),
            &Schema {
                required: &names,
                known: &|n| names.contains(&n),
                rows_min: 1,
            },
        );
        table
            .map_err(MapError::from)
            .and_then(|t| signals("x.csv", &t, &map))
            .map_or_else(|e| e.to_string(), |_| String::new())
    }

    #[test]
    fn a_log_that_contradicts_its_map_is_refused_by_line_and_column() {
        let map = "input = \"u\"\noutput = \"y\"\ntime = \"t\"\n";
        let rows =
            |f: fn(usize) -> String| format!("t,u,y\n{}", (0..80).map(f).collect::<String>());
        assert_eq!(error(map, &rows(|k| format!("{k},{k},{}\n", k * k))), "");
        assert!(
            error(map, "t,x,y\n0,0,0\n")
                .contains("line 1, column u: is missing; the header names t, x, y")
        );
        assert!(error(map, "t,u,y\n0,0,0\n1,?,0\n").contains("line 3, column u: `?`"));
        assert!(error(map, "t,u,y\n0,0,0\n").contains("1 rows remain; at least 60"));
        assert!(
            error(map, &rows(|k| format!("{},{k},{k}\n", k % 40)))
                .contains("line 42, column t: 0 s does not come after 39 s")
        );
        assert!(error(map, &rows(|k| format!("{k},5,{k}\n"))).contains("column u: is constant"));
        assert!(
            error(map, &rows(|k| format!("{k},{k},{k}e120\n")))
                .contains("line 3, column y: `1e120` is not a number from -1e19 to 1e19")
        );
    }

    #[test]
    fn rows_with_missing_values_are_left_out() {
        let map: MapFile = toml::from_str("input = \"u\"\noutput = [\"y\", \"z\"]\n").unwrap();
        let names = names(&map);
        let text: String = (0..80)
            .map(|k| {
                if k == 7 {
                    "1,,2\n".to_owned()
                } else {
                    format!("{k},3,4\n")
                }
            })
            .collect();
        let schema = Schema {
            required: &names,
            known: &|n| names.contains(&n),
            rows_min: 1,
        };
        let table = Table::parse("x.csv", format!("u,y,z\n{text}").as_bytes(), &schema).unwrap();
        let e = signals("x.csv", &table, &map).unwrap_err().to_string();
        assert!(
            e.contains("y, z: is constant"),
            "the norm is 5 in every complete row: {e}"
        );
    }
}
