//! Data for the IMU calibration: samples of a recording or a live sensor, and what a bend log adds to them.

use crate::cli::output;
use crate::hardware::imu::{self, ChipConfig, Imu};
use crate::log::bend_log;
use crate::log::recording;
use crate::primitives::{ImuSample, Seconds};
use embedded_hal::delay::DelayNs;
use linux_embedded_hal::{Delay, I2cdev};
use miette::{IntoDiagnostic, Result, miette};
use std::path::Path;

/// The samples of a bend log or an IMU recording; lost samples are omitted.
///
/// # Errors
/// A report that names file, line and column.
pub fn from_file(file: &Path) -> Result<Vec<ImuSample>> {
    let all = match bend_log::read(file) {
        Ok(log) => log.samples(),
        // without bend-log columns the file may be an IMU recording
        Err(e) if e.lacking.is_some() => {
            let recording = recording::read(file).into_diagnostic()?;
            recording.rows.iter().map(|r| r.sample).collect()
        }
        Err(e) => return Err(e).into_diagnostic(),
    };
    Ok(finite(all))
}

fn finite(samples: Vec<ImuSample>) -> Vec<ImuSample> {
    samples.into_iter().filter(ImuSample::is_finite).collect()
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
pub fn from_bus(bus: &Path, seconds: f64) -> Result<Vec<ImuSample>> {
    let name = bus.display();
    let open = I2cdev::new(bus)
        .map_err(|e| miette!("{name}: {e}; give an I²C bus that exists and that you may open"))?;
    let sensor = imu::open(&ChipConfig::default(), imu::linux::Classified(open));
    let mut sensor = sensor.into_diagnostic()?;
    let bar = output::bar(1000, "{percent} %");
    let samples = record(sensor.as_mut(), &mut Delay, seconds, &mut |share| {
        bar.set_position((share * 1000.0) as u64)
    });
    samples.map(finite)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::imu_calibration::gyro;
    use crate::hardware::imu::fake::{FakeBus, FakeIcm20948, Motion};
    use crate::hardware::imu::icm20948::{self, Icm20948};
    use nalgebra::Vector3;

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
}
