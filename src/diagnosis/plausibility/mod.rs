//! Refuses a bend log whose units or wiring cannot be right, before any diagnosis gives it a physical cause.
//!
//! Four kinds of check, in this order:
//!
//! * units, from the median magnitude of each sensor and from the piston speed: a still accelerometer reads 9.81 m/s², the
//!   Earth's field is 25 to 65 µT (Alken et al. 2021, IGRF-13), the pistons move millimetres in seconds;
//! * single values beyond what the machine or the sensor can do;
//! * axes of the sensors, of one or of all: gravity and the magnetic field turn in them as the gyroscope says, and the gyroscope as
//!   the pistons say;
//! * wiring, from the rotations of the tip over windows of two seconds: measured by the tracker or integrated from the
//!   gyroscope on one side, predicted from the pistons by the nominal model on the other. Exchanged pistons or reversed signs
//!   turn the prediction in a way that no effect of the catalogue does.

mod axes;
mod motion;
mod values;

use crate::log::bend_log::BendLog;
use crate::model::{Geometry, Line};
use motion::Motion;
use thiserror::Error;

/// A log whose units or wiring cannot be right.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{file}, {finding}")]
pub struct Implausible {
    file: String,
    /// The column, with the line where one value is at fault, what the values look like, and how to mend the log.
    finding: String,
}

/// Checks a log against the nominal model with these transmission lines.
///
/// # Errors
/// [`Implausible`] for the first finding.
pub fn check(log: &BendLog, geometry: &Geometry, lines: &[Line; 3]) -> Result<(), Implausible> {
    let in_motion = || {
        let motion = Motion::of(log, geometry, lines);
        let unit = motion.piston_unit(log).or_else(|| motion.rate_unit());
        let axes = unit.or_else(|| motion.axes());
        let wiring = axes.or_else(|| motion.wiring());
        wiring.or_else(|| motion.turned())
    };
    let first = values::clock_unit(log)
        .or_else(|| values::sensor_units(log.imu.as_ref()?, ""))
        .or_else(|| values::sensor_units(log.base.as_ref()?, "base_"))
        .or_else(|| values::single_values(log))
        .or_else(in_motion);
    let Some(finding) = first else { return Ok(()) };
    let file = log.file.clone();
    Err(Implausible { file, finding })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::bend_log::ImuColumns;
    use crate::model::arc::Shape;
    use crate::model::bend::Bend;
    use crate::primitives::units::Mm;
    use nalgebra::{UnitQuaternion, Vector3};

    fn lines() -> [Line; 3] {
        [2.2, 2.5, 2.2].map(|k_epsilon| Line {
            k_epsilon,
            k_lambda_mm: 0.9,
        })
    }

    /// Bias of the gyroscope, rad/s.
    const BIAS: Vector3<f64> = Vector3::new(0.01, -0.02, 0.005);

    /// Two minutes of poses in twelve directions, 100 rows a second, of a tip that follows the nominal model.
    fn sound() -> BendLog {
        let (geometry, lines) = (Geometry::default(), lines());
        let mut log = BendLog {
            file: "x.csv".to_owned(),
            ..BendLog::default()
        };
        let mut imu = ImuColumns {
            acc: Vec::new(),
            gyr: Vec::new(),
            mag: Vec::new(),
        };
        let (mut at, mut before) = (nalgebra::Vector2::zeros(), UnitQuaternion::identity());
        let base = UnitQuaternion::from_euler_angles(0.4, -0.3, 1.0);
        for k in 0..12_000 {
            let t_s = f64::from(k + 1) * 0.01;
            let pose = (t_s / 3.0).floor();
            let target = if t_s < 3.0 {
                Bend::STRAIGHT
            } else {
                Bend::from_deg(60.0, pose * 150.0)
            };
            at += (target.0 - at) * 0.02;
            let turn = Bend(at).rotation().quat();
            let q_mm = geometry.lengths(&Shape {
                bend: Bend(at),
                length: Mm(geometry.rest_length_mm),
            });
            log.t_s.push(t_s);
            log.command.push(Vector3::new(
                target.beta().to_degrees(),
                target.delta().to_degrees(),
                20.0,
            ));
            log.piston_mm
                .push(Vector3::from_fn(|i, _| lines[i].piston_mm(q_mm[i], 0.0)));
            imu.acc
                .push((base * turn).inverse() * Vector3::new(0.0, 0.0, 9.81));
            imu.mag
                .push((base * turn).inverse() * Vector3::new(20.0, 0.0, -43.0));
            imu.gyr
                .push((before.inverse() * turn).scaled_axis() / 0.01 + BIAS);
            before = turn;
        }
        log.imu = Some(imu);
        log
    }

    /// Words of the message, and the change that makes a log wrong.
    type Case<'a, T> = (&'static str, &'a dyn Fn(&mut T));

    /// The readings of one sensor.
    type Sensor = fn(&mut ImuColumns) -> &mut Vec<Vector3<f64>>;

    fn verdict(change: impl Fn(&mut BendLog)) -> String {
        let mut log = sound();
        change(&mut log);
        check(&log, &Geometry::default(), &lines())
            .map_or_else(|e| e.to_string(), |()| "sound".to_owned())
    }

    fn imu(log: &mut BendLog) -> &mut ImuColumns {
        log.imu.as_mut().unwrap()
    }

    #[test]
    fn a_sound_log_passes() {
        assert_eq!(verdict(|_| ()), "sound");
        assert_eq!(
            verdict(|log| log.imu = None),
            "sound",
            "nothing to compare the pistons with"
        );
    }

    #[test]
    fn units_are_recognised() {
        let scale = |v: &mut Vec<Vector3<f64>>, by: f64| v.iter_mut().for_each(|x| *x *= by);
        let cases: [Case<BendLog>; 8] = [
            ("acc_* looks like g: at rest |a| = 1.0", &|log| {
                scale(&mut imu(log).acc, 1.0 / 9.81)
            }),
            ("looks like gauss", &|log| scale(&mut imu(log).mag, 0.01)),
            ("looks like tesla", &|log| scale(&mut imu(log).mag, 1e-6)),
            ("looks like nanotesla", &|log| scale(&mut imu(log).mag, 1e3)),
            ("looks like °/s", &|log| {
                scale(&mut imu(log).gyr, 180.0 / std::f64::consts::PI)
            }),
            ("looks like milliseconds", &|log| {
                log.t_s.iter_mut().for_each(|t| *t *= 1e3)
            }),
            ("looks like microseconds", &|log| {
                log.t_s.iter_mut().for_each(|t| *t *= 1e6)
            }),
            ("piston*_mm looks like m", &|log| {
                scale(&mut log.piston_mm, 1e-3)
            }),
        ];
        for (words, change) in cases {
            let message = verdict(change);
            assert!(
                message.starts_with("x.csv, column") && message.contains(words),
                "{words}: {message}"
            );
        }
    }

    #[test]
    fn axes_of_the_sensor_are_told_from_the_pistons() {
        let cases: [Case<Vector3<f64>>; 6] = [
            ("x and y look exchanged", &|v| v.swap_rows(0, 1)),
            ("x and z look exchanged", &|v| v.swap_rows(0, 2)),
            ("y and z look exchanged", &|v| v.swap_rows(1, 2)),
            ("x looks like it has the other sign", &|v| v.x = -v.x),
            ("y looks like it has the other sign", &|v| v.y = -v.y),
            ("z looks like it has the other sign", &|v| v.z = -v.z),
        ];
        for (words, change) in cases {
            for with_tracker in [false, true] {
                let message = verdict(|log| {
                    if with_tracker {
                        let mut at = UnitQuaternion::identity();
                        let turned = |rate: &Vector3<f64>| {
                            at *= UnitQuaternion::from_scaled_axis((rate - BIAS) * 0.01);
                            Some(at)
                        };
                        log.reference = Some(imu(log).gyr.iter().map(turned).collect());
                    }
                    let imu = imu(log);
                    for v in [&mut imu.acc, &mut imu.gyr, &mut imu.mag] {
                        v.iter_mut().for_each(change);
                    }
                });
                assert!(
                    message.contains("columns acc_*, gyr_*, mag_*") && message.contains(words),
                    "{words}: {message}"
                );
            }
            let one: [(&str, Sensor); 3] = [
                ("columns acc_*: ", |imu| &mut imu.acc),
                ("columns gyr_*: ", |imu| &mut imu.gyr),
                ("columns mag_*: ", |imu| &mut imu.mag),
            ];
            for (columns, of) in one {
                let message = verdict(|log| of(imu(log)).iter_mut().for_each(change));
                // a tip that bends does not turn about its own z, and a field along it with the other sign is one with hard iron
                let is_unseen = !columns.contains("acc") && words.starts_with("z");
                let expected = format!("{columns}{words}");
                assert!(
                    message.contains(&expected) || is_unseen && message == "sound",
                    "{expected}: {message}"
                );
            }
        }
        let message = verdict(|log| {
            let forwards = |v: &mut Vector3<f64>| *v = Vector3::new(v.z, v.x, v.y);
            imu(log).acc.iter_mut().for_each(forwards);
        });
        assert!(
            message.contains("columns acc_*: x, y and z look like z, x and y"),
            "{message}"
        );
        let message = verdict(|log| imu(log).gyr.iter_mut().for_each(|v| *v = -*v));
        assert!(
            message.contains("columns gyr_*: looks like it has the other sign"),
            "{message}"
        );
    }

    #[test]
    fn wiring_is_recognised() {
        let each =
            |log: &mut BendLog, f: &dyn Fn(&mut Vector3<f64>)| log.piston_mm.iter_mut().for_each(f);
        let cases: [Case<Vector3<f64>>; 6] = [
            ("piston1_mm and piston2_mm look exchanged", &|p| {
                p.swap_rows(0, 1)
            }),
            ("piston1_mm and piston3_mm look exchanged", &|p| {
                p.swap_rows(0, 2)
            }),
            ("piston2_mm and piston3_mm look exchanged", &|p| {
                p.swap_rows(1, 2)
            }),
            ("piston1_mm looks like it has the other sign", &|p| {
                p.x = -p.x
            }),
            ("piston3_mm looks like it has the other sign", &|p| {
                p.z = -p.z
            }),
            ("all pistons look like they have the other sign", &|p| {
                *p = -*p
            }),
        ];
        for (words, change) in cases {
            let message = verdict(|log| each(log, change));
            assert!(message.contains(words), "{words}: {message}");
        }
    }

    #[test]
    fn single_values_are_named_with_line_and_column() {
        let message = verdict(|log| log.piston_mm[99].y = 1e9);
        assert!(
            message.contains("line 101, column piston2_mm: 1000000000 mm is beyond"),
            "{message}"
        );
        let message = verdict(|log| log.piston_mm[99].y = 25.0);
        assert!(
            message.contains("line 101, column piston2_mm: the piston jumps by"),
            "{message}"
        );
        let message = verdict(|log| imu(log).gyr[7].z = -1e7);
        assert!(message.contains("line 9, column gyr_z_rad_s"), "{message}");
    }
}
