//! Data for the IMU calibration: samples of a recording or a live sensor, and what a bend log adds to them.

use crate::cli::output;
use crate::estimation::fusion::health;
use crate::estimation::fusion::tip::{FuseConfig, Fusion, FusionInput};
use crate::estimation::imu_calibration::{motor, mount, still};
use crate::hardware::imu::Imu;
use crate::log::bend_log::{self, BendLog};
use crate::log::error::ReadError;
use crate::log::recording;
use crate::model::Drive;
use crate::primitives::{ImuSample, Seconds, Steps};
use embedded_hal::delay::DelayNs;
use miette::{IntoDiagnostic, Result, miette};
use nalgebra::Vector3;
use std::path::Path;

/// A tip counts as still this long after the last step of any motor, s: longer than its slowest lag.
const STILL_AFTER_S: f64 = 0.5;

/// The samples of a bend log or an IMU recording; lost samples are omitted.
///
/// # Errors
/// A report that names file, line and column.
pub fn from_file(file: &Path) -> Result<Vec<ImuSample>> {
    let all = match bend_log::read(file) {
        Ok(log) => log_samples(&log),
        // without bend-log columns the file may be an IMU recording
        Err(ReadError::Missing { .. }) => recording::read(file)
            .into_diagnostic()?
            .rows
            .iter()
            .map(|r| r.sample)
            .collect(),
        Err(e) => return Err(e).into_diagnostic(),
    };
    Ok(finite(all))
}

fn finite(samples: Vec<ImuSample>) -> Vec<ImuSample> {
    samples.into_iter().filter(ImuSample::is_finite).collect()
}

fn log_samples(log: &BendLog) -> Vec<ImuSample> {
    let Some(imu) = &log.imu else {
        return Vec::new();
    };
    imu.samples(&log.t_s).collect()
}

/// Magnetometer readings in the base frame with the motors' step counts. The tip orientation is estimated without the
/// magnetometer.
pub fn of_motors(log: &BendLog, idle_after_s: f64) -> Vec<motor::MotorSample> {
    let mut config = FuseConfig::default();
    config.bend.use_mag = false;
    let (drive, mut fusion) = (Drive::default(), Fusion::default());
    let (mut last, mut moved_s, mut out) = (Steps::default(), [f64::NEG_INFINITY; 3], Vec::new());
    for (k, sample) in log_samples(log).iter().enumerate() {
        let steps = drive.steps(&log.piston_mm[k]);
        for (moved, (now, before)) in moved_s.iter_mut().zip(steps.0.iter().zip(last.0)) {
            if *now != before {
                *moved = sample.t.0;
            }
        }
        last = steps;
        let still = moved_s.iter().all(|m| sample.t.0 - m > STILL_AFTER_S);
        let input = FusionInput {
            now: sample.t,
            tip: health::ImuReading::from_world(Some(*sample)),
            base: None,
            coils_ut: Vector3::zeros(),
            still,
        };
        fusion.update(&config, &input);
        if let (Some(estimate), Some(mag)) = (fusion.estimate(), sample.mag_ut) {
            let energised = moved_s.map(|m| sample.t.0 - m < idle_after_s);
            out.push(motor::MotorSample {
                mag_ut: estimate.r_base_tip.apply(&mag),
                counts: steps.0,
                energised,
            });
        }
    }
    out
}

/// Rotations between two held poses in the same bending plane.
pub fn bends(log: &BendLog) -> Vec<mount::BendTurn> {
    let samples = log_samples(log);
    let Some(bias) = samples
        .get(..)
        .map(still::rests)
        .and_then(|r| r.first().map(|r| r.gyro_rad_s))
    else {
        return Vec::new();
    };
    let changes: Vec<usize> = (1..samples.len())
        .filter(|&k| log.command.get(k) != log.command.get(k - 1))
        .collect();
    let ends = changes.iter().skip(1).copied().chain([samples.len()]);
    let turn = |(&from, to): (&usize, usize)| {
        let (before, after) = (log.command[from - 1], log.command[from]);
        let direction_rad = plane(&before, &after)?.to_radians();
        let lost = samples[from..to].iter().any(|s| !s.is_finite());
        (!lost).then(|| mount::BendTurn {
            turn_rad: mount::turn_of(&samples[from..to], &bias),
            direction_rad: Some(direction_rad),
        })
    };
    changes.iter().zip(ends).filter_map(turn).collect()
}

/// Direction, degrees, in which the bend increases from one command to the next, if both lie in one plane.
fn plane(before: &Vector3<f64>, after: &Vector3<f64>) -> Option<f64> {
    let one_plane = before.x == 0.0 || after.x == 0.0 || (before.y - after.y).abs() < 1e-6;
    let grows = after.x > before.x;
    let direction = if grows { after.y } else { before.y + 180.0 };
    (one_plane && direction.is_finite() && after.x != before.x).then_some(direction)
}

/// Reads a sensor for a given time; failed readings are omitted. `progress` receives the fraction done.
///
/// # Errors
/// The sensor's error, if it does not start or more than half of the readings fail.
pub fn record(
    sensor: &mut dyn Imu,
    delay: &mut dyn DelayNs,
    seconds: f64,
    progress: &mut dyn FnMut(f64),
) -> Result<Vec<ImuSample>> {
    let identity = sensor.init(delay).into_diagnostic()?;
    let scale = sensor.scale();
    let period_s = 1.0 / identity.rate_hz;
    let wanted = (seconds / period_s).ceil() as u32;
    let (mut samples, mut last_error) = (Vec::with_capacity(wanted as usize), None);
    for k in 0..wanted {
        delay.delay_us((period_s * 1e6).round() as u32);
        match sensor.read() {
            Ok(raw) => samples.push(scale.sample(&raw, Seconds(f64::from(k) * period_s))),
            Err(e) => last_error = Some(e),
        }
        progress(f64::from(k) / f64::from(wanted));
    }
    match last_error {
        Some(e) if samples.len() * 2 < wanted as usize => Err(e).into_diagnostic(),
        _ => Ok(samples),
    }
}

/// The samples of a live sensor.
///
/// # Errors
/// A report that names the bus.
#[cfg(feature = "hw")]
pub fn from_bus(bus: &Path, seconds: f64) -> Result<Vec<ImuSample>> {
    use crate::hardware::imu::{self, ChipConfig};
    use linux_embedded_hal::{Delay, I2cdev};
    let open = I2cdev::new(bus).map_err(|e| {
        miette!(
            "{}: {e}; give an I²C bus that exists and that you may open",
            bus.display()
        )
    })?;
    let mut sensor =
        imu::open(&ChipConfig::default(), imu::linux::Classified(open)).into_diagnostic()?;
    let bar = output::bar(1000, "{percent} %");
    let samples = record(sensor.as_mut(), &mut Delay, seconds, &mut |share| {
        bar.set_position((share * 1000.0) as u64)
    });
    samples.map(finite)
}

/// The samples of a live sensor, which this build cannot read.
///
/// # Errors
/// Always.
#[cfg(not(feature = "hw"))]
pub fn from_bus(bus: &Path, _: f64) -> Result<Vec<ImuSample>> {
    Err(miette!(
        "{}: this program was built without hardware support; build it with the feature `hw`",
        bus.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::imu_calibration::gyro;
    use crate::hardware::imu::fake::{FakeBus, FakeIcm20948, Motion};
    use crate::hardware::imu::icm20948::{self, Icm20948};

    #[test]
    fn a_live_chip_is_read_through_its_driver() {
        let bus = FakeBus::new();
        bus.machine().attach(FakeIcm20948::new(0x68, 1));
        let bias = Vector3::new(0.01, -0.02, 0.005);
        bus.machine().set_motion(&Motion {
            gyro_rad_s: bias,
            ..Motion::default()
        });
        let mut chip = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
        let mut shares = Vec::new();
        let samples = record(&mut chip, &mut bus.delay(), 5.0, &mut |s| shares.push(s)).unwrap();
        assert!(samples.len() > 2000 && shares.windows(2).all(|w| w[0] < w[1]));
        let fit = gyro::at_rest(&samples).unwrap();
        assert!((fit.bias_rad_s - bias).amax() < 1e-3, "{}", fit.bias_rad_s);
        bus.machine().stuck = true;
        assert!(record(&mut chip, &mut bus.delay(), 1.0, &mut |_| ()).is_err());
    }

    #[test]
    fn a_plane_has_the_direction_of_growing_bend() {
        let v = |bend: f64, dir: f64| Vector3::new(bend, dir, 20.0);
        assert_eq!(plane(&v(0.0, 0.0), &v(30.0, 120.0)), Some(120.0));
        assert_eq!(plane(&v(30.0, 120.0), &v(0.0, 0.0)), Some(300.0));
        assert_eq!(plane(&v(60.0, 90.0), &v(30.0, 90.0)), Some(270.0));
        assert_eq!(plane(&v(60.0, 90.0), &v(30.0, 120.0)), None);
    }
}
