//! Reader of IMU recordings with an optical reference (CSV or gzip CSV).
//!
//! One header line names the columns, in any order:
//!
//! | column | unit | |
//! |---|---|---|
//! | `time_s` | s | required, strictly increasing |
//! | `acc_x` `acc_y` `acc_z` | m/s² | required: specific force, sensor axes |
//! | `gyr_x` `gyr_y` `gyr_z` | rad/s | required: angular rate, sensor axes, raw |
//! | `mag_x` `mag_y` `mag_z` | µT | optional: magnetic field, sensor axes |
//! | `ref_qw` `ref_qx` `ref_qy` `ref_qz` | – | optional: true orientation, sensor to east-north-up |
//! | `moving` | 0/1 | optional: 1 where the recording is scored; absent = everywhere |
//!
//! An empty field or `nan` is a reading that did not come; other columns are ignored. Anything else
//! that is not a number, a clock that stands or runs back, a line that is too short or too long, or
//! a file that stops in the middle is refused with file, line and column.

use super::error::ReadError;
use crate::primitives::frames::{Rotation, Sensor, World};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::Seconds;
use flate2::read::MultiGzDecoder;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// How far the length of a reference quaternion may be from one.
const UNIT_TOLERANCE: f64 = 1e-2;
/// First two bytes of a gzip file.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

/// One recording, ready to be run through a filter.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Name of the file, without its folders.
    pub name: String,
    /// The rows, in time order.
    pub rows: Vec<Row>,
}

/// One line of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// What the sensor said; a reading that did not come is NaN (field: `None`).
    pub sample: ImuSample,
    /// Where it really stood, when the markers were seen.
    pub reference: Option<Rotation<World, Sensor>>,
    /// True where the recording is scored.
    pub moving: bool,
}

/// Reads a recording; gzip is recognised by its first bytes, not by the file's name.
///
/// # Errors
/// See [`ReadError`]; each names the file and, where there is one, the line and column.
pub fn read(path: &Path) -> Result<Recording, ReadError> {
    let open = |source| ReadError::Open { file: path.to_owned(), source };
    let mut file = BufReader::new(File::open(path).map_err(open)?);
    let start = std::io::BufRead::fill_buf(&mut file).map_err(open)?;
    if start.starts_with(&GZIP_MAGIC) { parse(path, MultiGzDecoder::new(file)) } else { parse(path, file) }
}

/// Reads a recording from any source of CSV text; `path` is what errors call it.
///
/// # Errors
/// See [`ReadError`].
pub fn parse(path: &Path, text: impl Read) -> Result<Recording, ReadError> {
    let mut reader = csv::ReaderBuilder::new().flexible(true).buffer_capacity(1 << 16).trim(csv::Trim::All).from_reader(text);
    let header = reader.byte_headers().map_err(|e| broken(path, 1, e))?.clone();
    let columns = Columns::find(path, &header)?;
    let mut rows: Vec<Row> = Vec::new();
    let mut record = csv::ByteRecord::new();
    let mut line = 1;
    while reader.read_byte_record(&mut record).map_err(|e| broken(path, line + 1, e))? {
        line = record.position().map_or(line + 1, csv::Position::line);
        let row = Fields { path, line, header: &header, record: &record }.row(&columns)?;
        if let Some(before) = rows.last() {
            let (now_s, before_s) = (row.sample.t.0, before.sample.t.0);
            if now_s <= before_s {
                return Err(ReadError::Clock { file: path.to_owned(), line, now_s, before_s });
            }
        }
        rows.push(row);
    }
    if rows.len() < 2 {
        return Err(ReadError::Empty { file: path.to_owned() });
    }
    let name = path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
    Ok(Recording { name, rows })
}

fn broken(path: &Path, line: u64, error: csv::Error) -> ReadError {
    let source = match error.into_kind() {
        csv::ErrorKind::Io(source) => source,
        other => std::io::Error::other(format!("{other:?}")),
    };
    ReadError::Broken { file: path.to_owned(), line, source }
}

/// Where the columns stand.
struct Columns {
    time: usize,
    acc: [usize; 3],
    gyr: [usize; 3],
    mag: Option<[usize; 3]>,
    reference: Option<[usize; 4]>,
    moving: Option<usize>,
}

const ACC: [&str; 3] = ["acc_x", "acc_y", "acc_z"];
const GYR: [&str; 3] = ["gyr_x", "gyr_y", "gyr_z"];
const MAG: [&str; 3] = ["mag_x", "mag_y", "mag_z"];
const REF: [&str; 4] = ["ref_qw", "ref_qx", "ref_qy", "ref_qz"];

impl Columns {
    fn find(path: &Path, header: &csv::ByteRecord) -> Result<Self, ReadError> {
        let place = |name: &str| header.iter().position(|h| h.trim_ascii() == name.as_bytes());
        let need = |column: &'static str| place(column).ok_or_else(|| ReadError::MissingColumn { file: path.to_owned(), column });
        let need_all =
            |names: [&'static str; 3]| -> Result<[usize; 3], ReadError> { Ok([need(names[0])?, need(names[1])?, need(names[2])?]) };
        let has_any = |names: &[&str]| names.iter().any(|n| place(n).is_some());
        Ok(Self {
            time: need("time_s")?,
            acc: need_all(ACC)?,
            gyr: need_all(GYR)?,
            mag: if has_any(&MAG) { Some(need_all(MAG)?) } else { None },
            reference: if has_any(&REF) { Some([need(REF[0])?, need(REF[1])?, need(REF[2])?, need(REF[3])?]) } else { None },
            moving: place("moving"),
        })
    }
}

/// One line on its way to a [`Row`].
struct Fields<'a> {
    path: &'a Path,
    line: u64,
    header: &'a csv::ByteRecord,
    record: &'a csv::ByteRecord,
}

impl Fields<'_> {
    fn row(&self, columns: &Columns) -> Result<Row, ReadError> {
        self.check_count()?;
        let t = self.number(columns.time, "time_s")?;
        if !t.is_finite() {
            return Err(self.refuse(columns.time, "time_s", "a time in seconds"));
        }
        let mag_ut = match columns.mag {
            Some(at) => Some(self.vector(at, MAG)?).filter(|m| m.iter().all(|x| !x.is_nan())),
            None => None,
        };
        let sample =
            ImuSample { t: Seconds(t), gyro_rad_s: self.vector(columns.gyr, GYR)?, acc_m_s2: self.vector(columns.acc, ACC)?, mag_ut };
        let reference = columns.reference.map(|at| self.reference(at)).transpose()?.flatten();
        let moving = columns.moving.map_or(Ok(true), |at| self.flag(at))?;
        Ok(Row { sample, reference, moving })
    }

    fn check_count(&self) -> Result<(), ReadError> {
        let (found, expected) = (self.record.len(), self.header.len());
        if found == expected {
            return Ok(());
        }
        let column = self.header.get(found.min(expected - 1)).map_or_else(String::new, lossy);
        Err(ReadError::Fields { file: self.path.to_owned(), line: self.line, column, found, expected })
    }

    fn text(&self, at: usize) -> &[u8] {
        self.record.get(at).unwrap_or_default()
    }

    fn refuse(&self, at: usize, column: &'static str, wanted: &'static str) -> ReadError {
        ReadError::Field { file: self.path.to_owned(), line: self.line, column, value: lossy(self.text(at)), wanted }
    }

    /// A number; empty is NaN, a reading that did not come.
    fn number(&self, at: usize, column: &'static str) -> Result<f64, ReadError> {
        let text = self.text(at);
        if text.is_empty() {
            return Ok(f64::NAN);
        }
        let number = std::str::from_utf8(text).ok().and_then(|t| t.parse::<f64>().ok());
        number.filter(|x| !x.is_infinite()).ok_or_else(|| self.refuse(at, column, "a number"))
    }

    fn vector(&self, at: [usize; 3], names: [&'static str; 3]) -> Result<Vector3<f64>, ReadError> {
        Ok(Vector3::new(self.number(at[0], names[0])?, self.number(at[1], names[1])?, self.number(at[2], names[2])?))
    }

    /// The reference, turned from east-north-up to the world (north-west-up).
    fn reference(&self, at: [usize; 4]) -> Result<Option<Rotation<World, Sensor>>, ReadError> {
        let mut q = [0.0; 4];
        for k in 0..4 {
            q[k] = self.number(at[k], REF[k])?;
        }
        if q.iter().any(|x| x.is_nan()) {
            return Ok(None);
        }
        let q = Quaternion::new(q[0], q[1], q[2], q[3]);
        if (q.norm() - 1.0).abs() > UNIT_TOLERANCE {
            return Err(self.refuse(at[0], REF[0], "part of a quaternion of length 1"));
        }
        let r_enu_sensor = UnitQuaternion::from_quaternion(q);
        let r_world_enu = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -std::f64::consts::FRAC_PI_2);
        Ok(Some(Rotation::assert_frames(r_world_enu * r_enu_sensor)))
    }

    fn flag(&self, at: usize) -> Result<bool, ReadError> {
        match self.text(at) {
            b"0" => Ok(false),
            b"1" => Ok(true),
            _ => Err(self.refuse(at, "moving", "0 or 1")),
        }
    }
}

fn lossy(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

impl Recording {
    /// Usual time between rows, seconds: the median, so that gaps do not count.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        let mut steps: Vec<f64> = self.rows.windows(2).map(|w| w[1].sample.t.0 - w[0].sample.t.0).collect();
        let middle = steps.len() / 2;
        if steps.is_empty() { 0.0 } else { *steps.select_nth_unstable_by(middle, f64::total_cmp).1 }
    }
    /// Mean time between rows that hold a magnetometer reading, seconds; the row period without any.
    #[must_use]
    pub fn mag_period_s(&self) -> f64 {
        let with_mag = self.rows.iter().filter(|r| r.sample.mag_ut.is_some()).count();
        let share = with_mag as f64 / self.rows.len() as f64;
        if with_mag > 0 { self.period_s() / share } else { self.period_s() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    const HEADER: &str = "time_s,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z,mag_x,mag_y,mag_z,ref_qw,ref_qx,ref_qy,ref_qz,moving";
    const GOOD: &str = "0.0,0,0,9.8,0.1,0.2,0.3,16,0,-41,1,0,0,0,0\n0.01,0,0,9.8,0.1,0.2,0.3,16,0,-41,1,0,0,0,1\n";

    fn text(lines: &str) -> Result<Recording, ReadError> {
        parse(Path::new("folder/trial.csv"), format!("{HEADER}\n{lines}").as_bytes())
    }

    /// The message, which must name the file.
    fn complaint(lines: &str) -> String {
        let message = text(lines).unwrap_err().to_string();
        assert!(message.starts_with("folder/trial.csv"), "{message}");
        message
    }

    #[test]
    fn rows_are_read_and_the_reference_is_turned_to_the_world() {
        let r = text(GOOD).unwrap();
        assert_eq!((r.name.as_str(), r.rows.len()), ("trial.csv", 2));
        let row = &r.rows[1];
        assert_eq!(row.sample.t, Seconds(0.01));
        assert_eq!(row.sample.gyro_rad_s, Vector3::new(0.1, 0.2, 0.3));
        assert_eq!(row.sample.mag_ut, Some(Vector3::new(16.0, 0.0, -41.0)));
        assert!(row.moving && !r.rows[0].moving);
        let north = row.reference.unwrap().apply(&Vector3::y());
        assert!((north - Vector3::x()).norm() < 1e-12, "y is north in the file, x is here: {north}");
        assert!((r.period_s() - 0.01).abs() < 1e-12);
    }

    #[test]
    fn readings_that_did_not_come_are_not_errors() {
        let r = text("0,nan,0,9.8,,0,0,,,,nan,nan,nan,nan,0\n1,0,0,9.8,0,0,0,16,nan,-41,1,0,,0,1\n").unwrap();
        assert!(r.rows[0].sample.acc_m_s2.x.is_nan() && r.rows[0].sample.gyro_rad_s.x.is_nan());
        for row in &r.rows {
            assert_eq!((row.sample.mag_ut, row.reference), (None, None));
        }
        let bare = "acc_x,acc_y,acc_z,extra,gyr_x,gyr_y,gyr_z,time_s\n0,0,9.8,hello,0,0,0,1\n0,0,9.8,,0,0,0,2\n";
        let r = parse(Path::new("x.csv"), bare.as_bytes()).unwrap();
        assert!(r.rows.iter().all(|row| row.moving && row.reference.is_none() && row.sample.mag_ut.is_none()));
        assert_eq!(r.mag_period_s(), 1.0);
    }

    #[test]
    fn complaints_name_line_column_and_value() {
        let bad_number = complaint(&GOOD.replace("9.8,0.1,0.2,0.3,16,0,-41,1,0,0,0,1", "9.8,0.1,0.2,0.3,16,0,x1,1,0,0,0,1"));
        assert!(bad_number.contains("line 3") && bad_number.contains("mag_z") && bad_number.contains("\"x1\""), "{bad_number}");
        for (lines, parts) in [
            ("0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0\n0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0\n", ["line 3", "time_s"]),
            ("0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0\n1,0,0,9.8,0,0,0,16,0,-4\n", ["line 3", "ref_qw"]),
            ("0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0,7\n", ["line 2", "16 fields"]),
            ("0,0,0,9.8,0,0,0,16,0,-41,0.5,0,0,0,0\n", ["line 2", "ref_qw"]),
            ("0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,yes\n", ["line 2", "moving"]),
            ("0,0,0,9.8,inf,0,0,16,0,-41,1,0,0,0,1\n", ["line 2", "gyr_x"]),
            ("nan,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,1\n", ["line 2", "time_s"]),
            ("", ["no rows", "header"]),
            ("0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0\n", ["no rows", "two"]),
        ] {
            let message = complaint(lines);
            assert!(parts.iter().all(|p| message.contains(p)), "{message}");
        }
        let headless = parse(Path::new("h.csv"), "time_s,acc_x,acc_y\n".as_bytes()).unwrap_err().to_string();
        assert!(headless.contains("acc_z") && headless.contains("line 1"), "{headless}");
        let half = parse(Path::new("h.csv"), HEADER.replace(",mag_y", "").as_bytes()).unwrap_err().to_string();
        assert!(half.contains("mag_y"), "{half}");
    }

    #[test]
    fn gzip_is_known_by_its_bytes_and_a_cut_one_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("plainly_named.csv");
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        packed.write_all(format!("{HEADER}\n{GOOD}").as_bytes()).unwrap();
        let packed = packed.finish().unwrap();
        std::fs::write(&path, &packed).unwrap();
        assert_eq!(read(&path).unwrap().rows.len(), 2);
        std::fs::write(&path, &packed[..packed.len() - 9]).unwrap();
        assert!(matches!(read(&path), Err(ReadError::Broken { .. })));
        std::fs::write(&path, "").unwrap();
        assert!(matches!(read(&path), Err(ReadError::MissingColumn { .. } | ReadError::Empty { .. })));
        assert!(matches!(read(&dir.path().join("none.csv")), Err(ReadError::Open { .. })));
    }
}
