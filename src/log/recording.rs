//! IMU recordings with an optical reference.
//!
//! One header line names the columns, in any order:
//!
//! | column | unit | |
//! |---|---|---|
//! | `time_s` | s | required, strictly increasing |
//! | `acc_x` `acc_y` `acc_z` | m/s² | required: specific force, sensor frame |
//! | `gyr_x` `gyr_y` `gyr_z` | rad/s | required: uncorrected angular rate, sensor frame |
//! | `mag_x` `mag_y` `mag_z` | µT | optional: magnetic field, sensor frame |
//! | `ref_qw` `ref_qx` `ref_qy` `ref_qz` | – | optional: true orientation, sensor to east-north-up |
//! | `moving` | 0/1 | optional: 1 where the recording is scored; if absent, everywhere |

use crate::log::bend_log::ImuColumns;
use crate::log::error::ReadError;
use crate::log::table::{Schema, Table, median};
use crate::primitives::{ImuSample, Rotation, Sensor, World};
use nalgebra::Vector3;
use std::io::Read;
use std::path::Path;

/// A recording.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Name of the file without its folder.
    pub name: String,
    /// Rows in time order.
    pub rows: Vec<RecordingRow>,
}

/// One row of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordingRow {
    /// Readings of the sensor; a missing reading is NaN (field: `None`).
    pub sample: ImuSample,
    /// True orientation, where the optical system saw the markers.
    pub reference: Option<Rotation<World, Sensor>>,
    /// Whether the row is scored.
    pub moving: bool,
}

const TIME: &str = "time_s";
const ACC: [&str; 3] = ["acc_x", "acc_y", "acc_z"];
const GYR: [&str; 3] = ["gyr_x", "gyr_y", "gyr_z"];
const MAG: [&str; 3] = ["mag_x", "mag_y", "mag_z"];
const REFERENCE: [&str; 4] = ["ref_qw", "ref_qx", "ref_qy", "ref_qz"];
const MOVING: &str = "moving";
const SCHEMA: Schema<'_> = Schema {
    required: &[TIME, ACC[0], ACC[1], ACC[2], GYR[0], GYR[1], GYR[2]],
    known: &known,
    rows_min: 0,
};
/// Rows that a period needs; counted once the columns are known to be complete.
const ROWS_MIN: usize = 2;

fn known(name: &str) -> bool {
    [ACC, GYR, MAG].as_flattened().contains(&name)
        || REFERENCE.contains(&name)
        || [TIME, MOVING].contains(&name)
}

/// Reads a recording from a CSV or gzip CSV file.
///
/// # Errors
/// [`ReadError`] with file, line and column.
pub fn read(path: &Path) -> Result<Recording, ReadError> {
    from_table(path, &Table::open(path, &SCHEMA)?)
}

/// Reads a recording from CSV text; errors quote `path` as the name of the file.
///
/// # Errors
/// [`ReadError`] with file, line and column.
pub fn parse(path: &Path, text: impl Read) -> Result<Recording, ReadError> {
    let file = path.display().to_string();
    from_table(path, &Table::parse(&file, text, &SCHEMA)?)
}

fn from_table(path: &Path, table: &Table) -> Result<Recording, ReadError> {
    let t = table.clock(TIME)?;
    let missing = || vec![Vector3::repeat(f64::NAN); table.rows()];
    let vectors = |names| table.vectors(names).map(|v| v.unwrap_or_else(missing));
    let imu = ImuColumns {
        acc: vectors(ACC)?,
        gyr: vectors(GYR)?,
        mag: vectors(MAG)?,
    };
    let reference = table.quaternions(REFERENCE)?;
    let moving = table.column(MOVING);
    let mut flags = moving.unwrap_or_default().iter().enumerate();
    if let Some((k, value)) = flags.find(|(_, v)| **v != 0.0 && **v != 1.0) {
        return Err(table.refuse(k, MOVING, &value.to_string(), "0 or 1"));
    }
    let row = |(k, sample): (usize, ImuSample)| RecordingRow {
        sample,
        reference: reference
            .as_ref()
            .and_then(|r| r[k])
            .map(Rotation::from_enu),
        moving: moving.is_none_or(|m| m[k] == 1.0),
    };
    if table.rows() < ROWS_MIN {
        let file = path.display().to_string();
        return Err(ReadError::too_short(&file, table.rows(), ROWS_MIN));
    }
    let name = path.file_name().unwrap_or(path.as_os_str());
    Ok(Recording {
        name: name.to_string_lossy().into_owned(),
        rows: imu.samples(t).enumerate().map(row).collect(),
    })
}

impl Recording {
    /// Median time between rows, s; gaps do not affect it.
    pub fn period_s(&self) -> f64 {
        let step = |w: &[RecordingRow]| w[1].sample.t.0 - w[0].sample.t.0;
        median(self.rows.windows(2).map(step)).unwrap_or(0.0)
    }

    /// Mean time between rows with a magnetometer reading, s; the row period if there is none.
    pub fn mag_period_s(&self) -> f64 {
        let with_mag = self.rows.iter().filter(|r| r.sample.mag_ut.is_some());
        match with_mag.count() {
            0 => self.period_s(),
            n => self.period_s() / (n as f64 / self.rows.len() as f64),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::Seconds;

    const HEADER: &str = "time_s,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z,mag_x,mag_y,mag_z,ref_qw,ref_qx,ref_qy,ref_qz,moving";
    const GOOD: &str =
        "0.0,0,0,9.8,0.1,0.2,0.3,16,0,-41,1,0,0,0,0\n0.01,0,0,9.8,0.1,0.2,0.3,16,0,-41,1,0,0,0,1\n";

    fn text(lines: &str) -> Result<Recording, ReadError> {
        parse(
            Path::new("folder/trial.csv"),
            format!("{HEADER}\n{lines}").as_bytes(),
        )
    }

    /// The error message; it must name the file.
    fn error(lines: &str) -> String {
        let message = text(lines).unwrap_err().to_string();
        assert!(message.starts_with("folder/trial.csv"), "{message}");
        message
    }

    #[test]
    fn rows_are_read_and_the_reference_is_expressed_in_the_world_frame() {
        let r = text(GOOD).unwrap();
        assert_eq!((r.name.as_str(), r.rows.len()), ("trial.csv", 2));
        let row = &r.rows[1];
        assert_eq!(row.sample.t, Seconds(0.01));
        assert_eq!(row.sample.gyro_rad_s, Vector3::new(0.1, 0.2, 0.3));
        assert_eq!(row.sample.mag_ut, Some(Vector3::new(16.0, 0.0, -41.0)));
        assert!(row.moving && !r.rows[0].moving);
        let north = row.reference.unwrap().apply(&Vector3::y());
        assert!(
            (north - Vector3::x()).norm() < 1e-12,
            "north is y in the file and x in the world: {north}"
        );
        assert!((r.period_s() - 0.01).abs() < 1e-12);
    }

    #[test]
    fn missing_readings_are_not_errors() {
        let r =
            text("0,nan,0,9.8,,0,0,,,,nan,nan,nan,nan,0\n1,0,0,9.8,0,0,0,16,nan,-41,1,0,,0,1\n")
                .unwrap();
        assert!(r.rows[0].sample.acc_m_s2.x.is_nan() && r.rows[0].sample.gyro_rad_s.x.is_nan());
        for row in &r.rows {
            assert_eq!((row.sample.mag_ut, row.reference), (None, None));
        }
        let bare = "acc_x,acc_y,acc_z,extra,gyr_x,gyr_y,gyr_z,time_s\n0,0,9.8,hello,0,0,0,1\n0,0,9.8,,0,0,0,2\n";
        let r = parse(Path::new("x.csv"), bare.as_bytes()).unwrap();
        assert!(
            r.rows
                .iter()
                .all(|row| row.moving && row.reference.is_none() && row.sample.mag_ut.is_none())
        );
        assert_eq!(r.mag_period_s(), 1.0);
    }

    #[test]
    fn errors_name_line_column_and_value() {
        let bad_number = error(&GOOD.replace(
            "9.8,0.1,0.2,0.3,16,0,-41,1,0,0,0,1",
            "9.8,0.1,0.2,0.3,16,0,x1,1,0,0,0,1",
        ));
        assert!(
            bad_number.contains("line 3")
                && bad_number.contains("mag_z")
                && bad_number.contains("`x1`"),
            "{bad_number}"
        );
        for (lines, parts) in [
            (
                "0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0\n0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0\n",
                ["line 3", "time_s"],
            ),
            (
                "0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0\n1,0,0,9.8,0,0,0,16,0,-4\n",
                ["line 3", "ref_qw"],
            ),
            (
                "0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0,7\n",
                ["line 2", "16 fields"],
            ),
            (
                "0,0,0,9.8,0,0,0,16,0,-41,0.5,0,0,0,0\n1,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0\n",
                ["line 2", "ref_qw"],
            ),
            (
                "0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,yes\n",
                ["line 2", "moving"],
            ),
            (
                "0,0,0,9.8,inf,0,0,16,0,-41,1,0,0,0,1\n",
                ["line 2", "gyr_x"],
            ),
            (
                "nan,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,1\n1,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,1\n",
                ["line 2", "time_s"],
            ),
            ("", ["no rows", "header"]),
            (
                "0,0,0,9.8,0,0,0,16,0,-41,1,0,0,0,0\n",
                ["1 rows", "at least 2"],
            ),
        ] {
            let message = error(lines);
            assert!(parts.iter().all(|p| message.contains(p)), "{message}");
        }
        let headless = parse(Path::new("h.csv"), "time_s,acc_x,acc_y\n".as_bytes())
            .unwrap_err()
            .to_string();
        assert!(
            headless.contains("acc_z") && headless.contains("line 1"),
            "{headless}"
        );
        let half = parse(Path::new("h.csv"), HEADER.replace(",mag_y", "").as_bytes())
            .unwrap_err()
            .to_string();
        assert!(half.contains("mag_y"), "{half}");
    }
}
