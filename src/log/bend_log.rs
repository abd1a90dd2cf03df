//! Bend logs: the commanded bend, the counted piston positions, the readings of the tip's sensors and, on a lab
//! rig, the tip orientation measured by a tracker.
//!
//! `docs/formats.md` lists the columns and their units. Unknown columns are reported and ignored.

use crate::log::error::ReadError;
use crate::log::table::{Schema, Table};
use crate::primitives::{ImuSample, Seconds};
use nalgebra::{UnitQuaternion, Vector3};
use std::io::Read;
use std::path::Path;

/// Samples of one 9-DoF IMU; a missing sample is NaN in all components.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImuColumns {
    /// Specific force, m/s², sensor frame.
    pub acc: Vec<Vector3<f64>>,
    /// Angular rate, rad/s, sensor frame.
    pub gyr: Vec<Vector3<f64>>,
    /// Magnetic field, µT, sensor frame.
    pub mag: Vec<Vector3<f64>>,
}

impl ImuColumns {
    /// The samples of the rows at these times.
    pub fn samples<'a>(&'a self, t_s: &'a [f64]) -> impl Iterator<Item = ImuSample> + 'a {
        t_s.iter().enumerate().map(|(k, t)| {
            let mag_ut = Some(self.mag[k]).filter(|m| m.iter().all(|x| x.is_finite()));
            ImuSample {
                t: Seconds(*t),
                gyro_rad_s: self.gyr[k],
                acc_m_s2: self.acc[k],
                mag_ut,
            }
        })
    }
}

/// A bend log in columns of equal length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BendLog {
    /// Name of the file.
    pub file: String,
    /// Time, s, strictly increasing.
    pub t_s: Vec<f64>,
    /// Commanded bend and direction in degrees and length in mm; NaN where not given.
    pub command: Vec<Vector3<f64>>,
    /// Piston displacement as counted, mm.
    pub piston_mm: Vec<Vector3<f64>>,
    /// Tip IMU, if logged.
    pub imu: Option<ImuColumns>,
    /// Second IMU on the base, if logged.
    pub base: Option<ImuColumns>,
    /// Tip orientation in the base frame from a tracker, if logged.
    pub reference: Option<Vec<Option<UnitQuaternion<f64>>>>,
    /// Gauge pressures, kPa, if logged.
    pub pressure_kpa: Option<Vec<Vector3<f64>>>,
    /// Temperature, °C, if logged.
    pub temp_c: Option<Vec<f64>>,
    /// Unknown columns.
    pub ignored: Vec<String>,
}

impl BendLog {
    /// The samples of the tip IMU; none if it is not logged.
    pub fn samples(&self) -> Vec<ImuSample> {
        let imu = self.imu.as_ref();
        imu.map_or_else(Vec::new, |imu| imu.samples(&self.t_s).collect())
    }
}

/// Names of the columns; those of an IMU without their prefix.
const TIME: &str = "time_s";
const TEMP: &str = "temp_c";
pub(crate) const PISTON: [&str; 3] = ["piston1_mm", "piston2_mm", "piston3_mm"];
pub(crate) const COMMAND: [&str; 3] = ["cmd_bend_deg", "cmd_dir_deg", "cmd_len_mm"];
pub(crate) const PRESSURE: [&str; 3] = ["pressure1_kpa", "pressure2_kpa", "pressure3_kpa"];
pub(crate) const ACC: [&str; 3] = ["acc_x_m_s2", "acc_y_m_s2", "acc_z_m_s2"];
pub(crate) const GYR: [&str; 3] = ["gyr_x_rad_s", "gyr_y_rad_s", "gyr_z_rad_s"];
pub(crate) const MAG: [&str; 3] = ["mag_x_ut", "mag_y_ut", "mag_z_ut"];
const REFERENCE: [&str; 4] = ["ref_qw", "ref_qx", "ref_qy", "ref_qz"];
/// Beginnings of the columns that an exported flight log has besides: what the loop made of the samples.
const OF_LOOP: [&str; 5] = ["setpoint_", "estimate_", "belief_", "k_", "mode"];
const SCHEMA: Schema<'_> = Schema {
    required: &[TIME, PISTON[0], PISTON[1], PISTON[2]],
    known: &known,
    rows_min: 1,
};

fn known(name: &str) -> bool {
    let imu = name.strip_prefix("base_").unwrap_or(name);
    [PISTON, COMMAND, PRESSURE].as_flattened().contains(&name)
        || [ACC, GYR, MAG].as_flattened().contains(&imu)
        || REFERENCE.contains(&name)
        || [TIME, TEMP].contains(&name)
}

/// Reads a log from a CSV or gzip CSV file.
///
/// # Errors
/// [`ReadError`] with file, line and column.
pub fn read(path: &Path) -> Result<BendLog, ReadError> {
    from_table(path.display().to_string(), &Table::open(path, &SCHEMA)?)
}

/// Reads a log from CSV text; errors quote `file` as the name of the file.
///
/// # Errors
/// [`ReadError`] with file, line and column.
pub fn parse(file: &str, text: impl Read) -> Result<BendLog, ReadError> {
    from_table(file.to_owned(), &Table::parse(file, text, &SCHEMA)?)
}

fn from_table(file: String, table: &Table) -> Result<BendLog, ReadError> {
    for name in PISTON {
        table.complete(name)?;
    }
    let rows = |columns: [Option<&[f64]>; 3]| {
        let row = |k: usize| Vector3::from(columns.map(|c| c.map_or(f64::NAN, |c| c[k])));
        (0..table.rows()).map(row).collect()
    };
    let columns = |names: [&str; 3]| names.map(|name| table.column(name));
    let of_loop = |name: &str| OF_LOOP.iter().any(|start| name.starts_with(start));
    let ignored = |name: &&String| !known(name) && !of_loop(name);
    Ok(BendLog {
        file,
        t_s: table.clock(TIME)?.to_vec(),
        command: rows(columns(COMMAND)),
        piston_mm: rows(columns(PISTON)),
        imu: imu(table, "")?,
        base: imu(table, "base_")?,
        reference: table.quaternions(REFERENCE)?,
        pressure_kpa: table.vectors(PRESSURE)?,
        temp_c: table.column(TEMP).map(<[f64]>::to_vec),
        ignored: table.header().iter().filter(ignored).cloned().collect(),
    })
}

fn imu(table: &Table, prefix: &str) -> Result<Option<ImuColumns>, ReadError> {
    let vectors = |names: [&str; 3]| {
        let names = names.map(|n| format!("{prefix}{n}"));
        table.vectors([&names[0], &names[1], &names[2]])
    };
    let (acc, gyr, mag) = (vectors(ACC)?, vectors(GYR)?, vectors(MAG)?);
    let is_logged = acc.is_some() || gyr.is_some() || mag.is_some();
    let missing = || vec![Vector3::repeat(f64::NAN); table.rows()];
    let [acc, gyr, mag] = [acc, gyr, mag].map(|v| v.unwrap_or_else(missing));
    Ok(is_logged.then_some(ImuColumns { acc, gyr, mag }))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str =
        "time_s,piston1_mm,piston2_mm,piston3_mm,note,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2\n";

    fn error(body: &str) -> String {
        parse("x.csv", format!("{HEAD}{body}").as_bytes())
            .map_or_else(|e| e.to_string(), |_| String::new())
    }

    #[test]
    fn a_log_is_read_and_unknown_columns_are_listed() {
        let log = parse(
            "x.csv",
            format!("{HEAD}0.01,0,0,0,hello,0,0,9.8\n0.02,1,2,3,,,,\n").as_bytes(),
        )
        .unwrap();
        assert_eq!(log.ignored, ["note"]);
        assert_eq!(log.piston_mm[1], Vector3::new(1.0, 2.0, 3.0));
        assert!(log.imu.unwrap().acc[1].x.is_nan());
        assert!(log.reference.is_none() && log.command[0].x.is_nan());
    }

    #[test]
    fn times_and_pistons_must_be_complete() {
        assert!(error("0.01,0,,0,,0,0,9.8\n").contains("line 2, column piston2_mm"));
        assert!(error("0.01,0,nan,0,,0,0,9.8\n").contains("line 2, column piston2_mm"));
        assert!(
            error("0.02,0,0,0,,0,0,9.8\n0.02,0,0,0,,0,0,9.8\n").contains("line 3, column time_s")
        );
        let e = parse("x.csv", "time_s,piston1_mm\n0,0\n".as_bytes())
            .unwrap_err()
            .to_string();
        assert!(e.contains("column piston2_mm: is missing"), "{e}");
    }
}
