//! Reader of bend logs (CSV or gzip CSV): what was asked for, what the pistons were told, what the
//! tip's sensors said and, in a lab, where the tip really was.
//!
//! Columns and units are documented in the README; an empty field is a value that is missing. Columns
//! that are not known are ignored with one warning. Everything else that is not as it should be is
//! refused with file, line and column.

use flate2::read::MultiGzDecoder;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use thiserror::Error;

/// Why a log cannot be read.
#[derive(Debug, Error)]
pub enum LogError {
    /// It is not there, or not to be opened.
    #[error("{file}: cannot be opened: {source}; give the path of a bend log, *.csv or *.csv.gz")]
    Open {
        /// File.
        file: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// It stops, or is not what its compression says.
    #[error("{file}, line {line}: cannot be read: {why}; the file is cut short or damaged, copy it again")]
    Broken {
        /// File.
        file: String,
        /// Line reached, from 1.
        line: u64,
        /// The decoder's reason.
        why: String,
    },
    /// There is nothing in it.
    #[error("{file}: has no rows; a bend log has a header line and one line per sample")]
    Empty {
        /// File.
        file: String,
    },
    /// A required column is missing.
    #[error("{file}, line 1, column {column}: is missing; a bend log needs time_s and piston1_mm to piston3_mm")]
    Missing {
        /// File.
        file: String,
        /// Column.
        column: String,
    },
    /// A line has another number of fields than the header.
    #[error(
        "{file}, line {line}, column {column}: the line has {found} fields where the header has {expected}; it is cut short or has stray commas"
    )]
    Fields {
        /// File.
        file: String,
        /// Line, from 1.
        line: u64,
        /// First column without a field.
        column: String,
        /// Fields found.
        found: usize,
        /// Fields in the header.
        expected: usize,
    },
    /// A field is not a number.
    #[error("{file}, line {line}, column {column}: `{value}` is not {wanted}")]
    Field {
        /// File.
        file: String,
        /// Line, from 1.
        line: u64,
        /// Column.
        column: String,
        /// What stands there.
        value: String,
        /// What should stand there.
        wanted: &'static str,
    },
    /// Time does not go on.
    #[error("{file}, line {line}, column time_s: {now} s does not come after {before} s; time must strictly increase")]
    Clock {
        /// File.
        file: String,
        /// Line, from 1.
        line: u64,
        /// Time of this line, s.
        now: f64,
        /// Time of the line before, s.
        before: f64,
    },
}

/// A 9-DoF IMU's columns; a sample that is missing is NaN throughout.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuColumns {
    /// Specific force, m/s².
    pub acc: Vec<Vector3<f64>>,
    /// Rate, rad/s.
    pub gyr: Vec<Vector3<f64>>,
    /// Field, µT.
    pub mag: Vec<Vector3<f64>>,
}

/// A bend log in columns.
#[derive(Debug, Clone, PartialEq)]
pub struct BendLog {
    /// File it came from.
    pub file: String,
    /// Time, s, strictly increasing.
    pub t_s: Vec<f64>,
    /// Wanted bend and direction in degrees and length in mm; NaN where not given.
    pub command: Vec<Vector3<f64>>,
    /// Piston displacement as counted, mm.
    pub piston_mm: Vec<Vector3<f64>>,
    /// The tip IMU, if logged.
    pub imu: Option<ImuColumns>,
    /// A second IMU on the base, if logged.
    pub base: Option<ImuColumns>,
    /// Tip orientation in the base frame from a tracker, if logged.
    pub reference: Option<Vec<Option<UnitQuaternion<f64>>>>,
    /// Gauge pressures, kPa, if logged.
    pub pressure_kpa: Option<Vec<Vector3<f64>>>,
    /// Temperature, °C, if logged.
    pub temp_c: Option<Vec<f64>>,
    /// Columns that are not known.
    pub ignored: Vec<String>,
}

const SINGLE: [&str; 5] = ["time_s", "cmd_bend_deg", "cmd_dir_deg", "cmd_len_mm", "temp_c"];
const PISTON: [&str; 3] = ["piston1_mm", "piston2_mm", "piston3_mm"];
const PRESSURE: [&str; 3] = ["pressure1_kpa", "pressure2_kpa", "pressure3_kpa"];
const ACC: [&str; 3] = ["acc_x_m_s2", "acc_y_m_s2", "acc_z_m_s2"];
const GYR: [&str; 3] = ["gyr_x_rad_s", "gyr_y_rad_s", "gyr_z_rad_s"];
const MAG: [&str; 3] = ["mag_x_ut", "mag_y_ut", "mag_z_ut"];
const REF: [&str; 4] = ["ref_qw", "ref_qx", "ref_qy", "ref_qz"];

/// Reads a log; gzip is recognised by its first bytes.
///
/// # Errors
/// [`LogError`], naming file, line and column.
pub fn read(path: &Path) -> Result<BendLog, LogError> {
    let file = path.display().to_string();
    let open = |source| LogError::Open { file: file.clone(), source };
    let mut reader = BufReader::new(std::fs::File::open(path).map_err(open)?);
    let gzip = reader.fill_buf().map_err(open)?.starts_with(&[0x1f, 0x8b]);
    if gzip { parse(&file, MultiGzDecoder::new(reader)) } else { parse(&file, reader) }
}

/// Reads a log from CSV text; `file` is what errors call it.
///
/// # Errors
/// [`LogError`].
pub fn parse(file: &str, text: impl Read) -> Result<BendLog, LogError> {
    let table = Table::read(file, text)?;
    let t_s = table.required("time_s")?;
    let piston = table.three(&PISTON)?.ok_or_else(|| table.missing(PISTON[0]))?;
    table.complete("time_s", &t_s)?;
    for (i, name) in PISTON.iter().enumerate() {
        table.complete(name, &piston.iter().map(|v| v[i]).collect::<Vec<_>>())?;
    }
    table.increasing(&t_s)?;
    let n = t_s.len();
    let command = {
        let one = |name| table.column(name).unwrap_or_else(|| vec![f64::NAN; n]);
        let (b, d, l) = (one(SINGLE[1]), one(SINGLE[2]), one(SINGLE[3]));
        (0..n).map(|k| Vector3::new(b[k], d[k], l[k])).collect()
    };
    Ok(BendLog {
        command,
        piston_mm: piston,
        imu: table.imu("")?,
        base: table.imu("base_")?,
        reference: table.reference()?,
        pressure_kpa: table.three(&PRESSURE)?,
        temp_c: table.column("temp_c"),
        ignored: table.unknown(),
        file: file.to_owned(),
        t_s,
    })
}

/// All columns by name, numbers row-major.
struct Table<'a> {
    file: &'a str,
    header: Vec<String>,
    values: Vec<f64>,
    lines: Vec<u64>,
}

impl<'a> Table<'a> {
    fn read(file: &'a str, text: impl Read) -> Result<Self, LogError> {
        let mut reader = csv::ReaderBuilder::new().flexible(true).trim(csv::Trim::All).from_reader(text);
        let broken = |line, e: &csv::Error| LogError::Broken { file: file.to_owned(), line, why: e.to_string() };
        let header: Vec<String> = reader.headers().map_err(|e| broken(1, &e))?.iter().map(str::to_owned).collect();
        let mut table = Self { file, header, values: Vec::new(), lines: Vec::new() };
        let mut record = csv::StringRecord::new();
        let mut line = 1;
        while reader.read_record(&mut record).map_err(|e| broken(line + 1, &e))? {
            line = record.position().map_or(line + 1, csv::Position::line);
            table.row(line, &record)?;
        }
        if table.lines.is_empty() {
            return Err(LogError::Empty { file: file.to_owned() });
        }
        Ok(table)
    }

    fn row(&mut self, line: u64, record: &csv::StringRecord) -> Result<(), LogError> {
        let (found, expected) = (record.len(), self.header.len());
        if found != expected {
            let column = self.header.get(found).or(self.header.last()).cloned().unwrap_or_default();
            return Err(LogError::Fields { file: self.file.to_owned(), line, column, found, expected });
        }
        for (field, name) in record.iter().zip(&self.header) {
            let value = if field.is_empty() {
                f64::NAN
            } else if !known(name) {
                0.0
            } else {
                field.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| self.field(line, name, field, "a finite number"))?
            };
            self.values.push(value);
        }
        self.lines.push(line);
        Ok(())
    }

    fn field(&self, line: u64, column: &str, value: &str, wanted: &'static str) -> LogError {
        LogError::Field { file: self.file.to_owned(), line, column: column.to_owned(), value: value.to_owned(), wanted }
    }
    fn missing(&self, column: &str) -> LogError {
        LogError::Missing { file: self.file.to_owned(), column: column.to_owned() }
    }
    fn column(&self, name: &str) -> Option<Vec<f64>> {
        let at = self.header.iter().position(|h| h == name)?;
        Some(self.values.iter().skip(at).step_by(self.header.len()).copied().collect())
    }
    fn required(&self, name: &str) -> Result<Vec<f64>, LogError> {
        self.column(name).ok_or_else(|| self.missing(name))
    }
    /// Three columns as vectors; none of them is no vector, some of them is an error.
    fn three(&self, names: &[&str; 3]) -> Result<Option<Vec<Vector3<f64>>>, LogError> {
        let found = names.map(|n| self.column(n));
        if found.iter().all(Option::is_none) {
            return Ok(None);
        }
        match found {
            [Some(x), Some(y), Some(z)] => Ok(Some((0..x.len()).map(|k| Vector3::new(x[k], y[k], z[k])).collect())),
            other => {
                let lacking = names.iter().zip(&other).find(|(_, c)| c.is_none()).map_or(names[0], |(n, _)| n);
                Err(self.missing(lacking))
            }
        }
    }
    fn imu(&self, prefix: &str) -> Result<Option<ImuColumns>, LogError> {
        let named = |names: [&str; 3]| names.map(|n| format!("{prefix}{n}"));
        let get = |names: [&str; 3]| {
            let owned = named(names);
            self.three(&[&owned[0], &owned[1], &owned[2]])
        };
        let nothing = || vec![Vector3::repeat(f64::NAN); self.lines.len()];
        Ok(match (get(ACC)?, get(GYR)?, get(MAG)?) {
            (None, None, None) => None,
            (acc, gyr, mag) => {
                Some(ImuColumns { acc: acc.unwrap_or_else(nothing), gyr: gyr.unwrap_or_else(nothing), mag: mag.unwrap_or_else(nothing) })
            }
        })
    }
    fn reference(&self) -> Result<Option<Vec<Option<UnitQuaternion<f64>>>>, LogError> {
        let found = REF.map(|n| self.column(n));
        if found.iter().all(Option::is_none) {
            return Ok(None);
        }
        let [Some(w), Some(x), Some(y), Some(z)] = found else {
            let lacking = REF.iter().find(|n| self.column(n).is_none()).unwrap_or(&REF[0]);
            return Err(self.missing(lacking));
        };
        let mut out = Vec::with_capacity(w.len());
        for k in 0..w.len() {
            let q = Quaternion::new(w[k], x[k], y[k], z[k]);
            let norm = q.norm();
            if norm.is_nan() {
                out.push(None);
            } else if (norm - 1.0).abs() < 0.02 {
                out.push(Some(UnitQuaternion::from_quaternion(q)));
            } else {
                let shown = format!("{} {} {} {}", w[k], x[k], y[k], z[k]);
                return Err(self.field(self.lines[k], "ref_qw", &shown, "a unit quaternion"));
            }
        }
        Ok(Some(out))
    }
    fn complete(&self, name: &str, values: &[f64]) -> Result<(), LogError> {
        match values.iter().position(|v| v.is_nan()) {
            None => Ok(()),
            Some(k) => Err(self.field(self.lines[k], name, "", "a number; this column may not be empty")),
        }
    }
    fn increasing(&self, t: &[f64]) -> Result<(), LogError> {
        match t.windows(2).position(|w| w[1] <= w[0]) {
            None => Ok(()),
            Some(k) => Err(LogError::Clock { file: self.file.to_owned(), line: self.lines[k + 1], now: t[k + 1], before: t[k] }),
        }
    }
    fn unknown(&self) -> Vec<String> {
        self.header.iter().filter(|h| !known(h)).cloned().collect()
    }
}

fn known(name: &str) -> bool {
    let bare = name.strip_prefix("base_").unwrap_or(name);
    let imu = [ACC, GYR, MAG].iter().flatten().any(|n| *n == bare);
    imu || SINGLE.contains(&name) || PISTON.contains(&name) || PRESSURE.contains(&name) || REF.contains(&name)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "time_s,piston1_mm,piston2_mm,piston3_mm,note,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2\n";

    fn why(body: &str) -> String {
        match parse("x.csv", format!("{HEAD}{body}").as_bytes()) {
            Ok(_) => String::new(),
            Err(e) => e.to_string(),
        }
    }

    #[test]
    fn reads_what_is_there_and_says_what_it_ignored() {
        let log = parse("x.csv", format!("{HEAD}0.01,0,0,0,hello,0,0,9.8\n0.02,1,2,3,,,,\n").as_bytes()).unwrap();
        assert_eq!(log.ignored, ["note"]);
        assert_eq!(log.piston_mm[1], Vector3::new(1.0, 2.0, 3.0));
        assert!(log.imu.unwrap().acc[1].x.is_nan());
        assert!(log.reference.is_none());
    }

    #[test]
    fn refuses_with_file_line_and_column() {
        assert!(why("").contains("x.csv: has no rows"));
        assert!(why("0.01,0,0,0,,0,0,9.8\n0.02,0,0\n").contains("line 3, column piston3_mm: the line has 3 fields"));
        assert!(why("0.01,0,abc,0,,0,0,9.8\n").contains("line 2, column piston2_mm: `abc`"));
        assert!(why("0.01,0,,0,,0,0,9.8\n").contains("line 2, column piston2_mm"));
        assert!(why("0.01,0,nan,0,,0,0,9.8\n").contains("column piston2_mm: `nan`"));
        assert!(why("0.02,0,0,0,,0,0,9.8\n0.02,0,0,0,,0,0,9.8\n").contains("line 3, column time_s"));
        let e = parse("x.csv", "time_s,piston1_mm\n0,0\n".as_bytes()).unwrap_err().to_string();
        assert!(e.contains("column piston2_mm: is missing"), "{e}");
        let e = parse("x.csv", "".as_bytes()).unwrap_err().to_string();
        assert!(e.contains("no rows"), "{e}");
    }

    #[test]
    fn a_gzip_that_stops_is_refused() {
        use std::io::Write;
        let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        let rows: String = (0..5000).map(|k| format!("{},0,0,0,,0,0,9.{}\n", 0.01 * f64::from(k + 1), k * 7919 % 1000)).collect();
        gz.write_all(format!("{HEAD}{rows}").as_bytes()).unwrap();
        let bytes = gz.finish().unwrap();
        let cut = MultiGzDecoder::new(&bytes[..bytes.len() / 2]);
        let e = parse("x.csv.gz", cut).unwrap_err().to_string();
        assert!(e.contains("cut short"), "{e}");
    }
}
