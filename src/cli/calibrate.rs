//! `retroflex calibrate imu …`: identifies the errors of the IMU from a recording or from a live sensor.
//!
//! Each step prints its result with a figure of its quality and writes it into the `[imu]` table of a calibration file. If the data do
//! not suffice, it names the motion that is missing and writes nothing.

use crate::cli::client::follow::{TransmissionArgs, transmission};
use crate::cli::{Refused, ResultFile, output, within};
use crate::config::{MOTORS_IDLE_AFTER_S, calib, source};
use crate::estimation::imu_calibration::{
    ELLIPSOID_SAMPLES_MIN, ImuCalibration, Pedigree, Refusal, accel, driven, gyro, mag, motor,
    mount, still,
};
use crate::hardware::imu::{self, ChipConfig, Imu};
use crate::log::bend_log::{self, BendLog};
use crate::log::recording;
use crate::primitives::{ImuSample, Seconds};
use embedded_hal::delay::DelayNs;
use linux_embedded_hal::{Delay, I2cdev};
use miette::{IntoDiagnostic, Result, miette};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

commands! {
    /// Subcommands of `calibrate`.
    pub enum Calibrate;

    /// Identify an error of the IMU in the tip.
    Imu(Args) => run,
    /// Identify the transmission gains on a running service, with Algorithm 1 or its short form.
    Transmission(TransmissionArgs) => transmission,
}

/// Arguments of `calibrate imu`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Quantity to identify.
    #[arg(value_enum)]
    step: Step,
    /// Bend log or IMU recording, *.csv or *.csv.gz.
    #[arg(required_unless_present = "live")]
    file: Option<PathBuf>,
    /// Read a live sensor on this I²C bus instead, for example /dev/i2c-1 (gyro, accel and mag only).
    #[arg(long, conflicts_with = "file")]
    live: Option<PathBuf>,
    /// Duration of a live reading, s.
    #[arg(long, default_value_t = 30.0, value_parser = within(1.0..=3600.0, "s"))]
    seconds: f64,
    /// Calibration file whose `[imu]` table is updated; the other values in it are kept, comments are not.
    #[arg(long, default_value = "calib/imu.toml")]
    out: ResultFile,
    /// Day of the recording, YYYY-MM-DD; the default is today.
    #[arg(long, value_parser = day)]
    date: Option<String>,
}

/// A quantity that can be identified.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Step {
    /// Gyroscope bias, from a standstill.
    Gyro,
    /// Accelerometer bias and scale, from standstills on six faces or in many attitudes.
    Accel,
    /// Hard and soft iron, from a rotation through all attitudes with the motors off.
    Mag,
    /// Magnetic fields of the motor coils, from a bend log.
    Motors,
    /// Mounting angle of the sensor, from the bends of a bend log.
    Mount,
}

/// Runs the command.
///
/// # Errors
/// A report that names what is wrong with the input.
pub fn run(args: &Args) -> Result<()> {
    let date = args.date.clone().unwrap_or_else(today);
    let source = args.file.as_ref().or(args.live.as_ref());
    let source = source.map_or_else(String::new, |p| p.display().to_string());
    let mut table = existing(&args.out)?;
    let imu = table.remove("imu").unwrap_or(toml::Table::new().into());
    let calibration: std::result::Result<ImuCalibration, _> = imu.try_into();
    let mut calibration = calibration.map_err(|e| miette!("{}: [imu]: {e}", args.out.display()))?;
    let (date, source) = (&*date, &*source);
    let identified = identify(args, Pedigree { date, source }, &mut calibration)?;
    output::print(identified.map_err(Refused::report)? + "\n");
    let imu = toml::Value::try_from(&calibration).into_diagnostic()?;
    table.insert("imu".to_owned(), imu);
    let text = toml::to_string_pretty(&table).into_diagnostic()?;
    output::write(&args.out, text)?;
    eprintln!("written to {}", args.out.display());
    Ok(())
}

/// A day as `--date` gives it.
fn day(text: &str) -> std::result::Result<String, String> {
    let wrong = || "a day is written YYYY-MM-DD, such as 2026-03-31".to_owned();
    calib::is_day(text)
        .then(|| text.to_owned())
        .ok_or_else(wrong)
}

/// The tables of a calibration file that a command updates; none if there is no such file yet.
///
/// # Errors
/// A report that names the file.
pub fn existing(path: &Path) -> Result<toml::Table> {
    // to read a pipe would wait for ever
    if !path.is_file() {
        return Ok(toml::Table::new());
    }
    let text = source::text_of(path)?;
    text.parse().map_err(|e| miette!("{}: {e}", path.display()))
}

/// A line that describes the result, or the reason why the data do not suffice.
type Identified = Result<String, Refusal>;

fn identify(args: &Args, from: Pedigree<'_>, into: &mut ImuCalibration) -> Result<Identified> {
    let log = || {
        let file = args.file.as_deref().ok_or_else(|| {
            miette!("motors and mount need a bend log with piston positions; give its file")
        })?;
        bend_log::read(file).into_diagnostic()
    };
    let read = || match (&args.file, &args.live) {
        (Some(file), _) => from_file(file),
        (None, Some(bus)) => from_bus(bus, args.seconds),
        (None, None) => Ok(Vec::new()),
    };
    Ok(match args.step {
        Step::Gyro => gyro_bias(&read()?, from, into),
        Step::Accel => accel_bias(&read()?, from, into),
        Step::Mag => hard_iron(&read()?, from, into),
        Step::Motors => motor_fields(&log()?, from, into),
        Step::Mount => mount_angle(&log()?, from, into),
    })
}

fn gyro_bias(samples: &[ImuSample], from: Pedigree<'_>, into: &mut ImuCalibration) -> Identified {
    let fit = gyro::at_rest(samples)?;
    into.set_gyro(&fit, from);
    let bias = list(fit.bias_rad_s.map(f64::to_degrees), 3);
    let (sigma, duration_s) = (fit.sigma_rad_s.amax().to_degrees(), fit.duration_s);
    Ok(format!(
        "gyroscope bias {bias} °/s, ± {sigma:.4} °/s, from {duration_s:.1} s of standstill"
    ))
}

fn accel_bias(samples: &[ImuSample], from: Pedigree<'_>, into: &mut ImuCalibration) -> Identified {
    let rests = still::rests(samples);
    let fit = if rests.len() >= ELLIPSOID_SAMPLES_MIN {
        accel::ellipsoid(&rests)?
    } else {
        accel::six_positions(&rests)?
    };
    into.set_accel(&fit, from);
    Ok(format!(
        "accelerometer bias {} m/s², residual {:.4} m/s², {:.0} % of the sphere covered, {} standstills",
        list(fit.bias, 3),
        fit.residual,
        100.0 * fit.coverage,
        rests.len()
    ))
}

fn hard_iron(samples: &[ImuSample], from: Pedigree<'_>, into: &mut ImuCalibration) -> Identified {
    let readings: Vec<Vector3<f64>> = samples.iter().filter_map(|s| s.mag_ut).collect();
    let fit = mag::ellipsoid(&readings)?;
    into.set_mag(&fit, from);
    Ok(format!(
        "hard iron {} µT, ± {:.2} µT, field {:.1} µT, residual {:.2} µT, {:.0} % of the sphere covered",
        list(fit.bias, 1),
        fit.bias_sigma.amax(),
        fit.length,
        fit.residual,
        100.0 * fit.coverage
    ))
}

fn motor_fields(log: &BendLog, from: Pedigree<'_>, into: &mut ImuCalibration) -> Identified {
    let readings = driven::of_motors(&log.samples(), &log.piston_mm, MOTORS_IDLE_AFTER_S);
    let fit = motor::fit(&readings, from)?;
    let fields = fit.field.cos_ut.iter().chain(&fit.field.sin_ut);
    let strongest = fields.map(|r| Vector3::from(*r).norm()).fold(0.0, f64::max);
    into.motor_field = Some(fit.field);
    let coverage = 100.0 * fit.coverage.into_iter().fold(1.0, f64::min);
    Ok(format!(
        "motor fields up to {strongest:.2} µT, residual {:.2} µT, {coverage:.0} % of the coil cycle covered",
        fit.residual_ut
    ))
}

fn mount_angle(log: &BendLog, from: Pedigree<'_>, into: &mut ImuCalibration) -> Identified {
    let fit = mount::from_bends(&driven::bends(&log.samples(), &log.command))?;
    into.set_mount(&fit, from);
    Ok(format!(
        "sensor rotated by {:.2}° against the tip, ± {}°, from {} bends, {:.2}° out of their plane",
        fit.r_tip_sensor.quat().angle().to_degrees(),
        list(fit.sigma_rad.map(f64::to_degrees), 2),
        fit.bends,
        fit.out_of_plane_rad.to_degrees()
    ))
}

fn list(v: Vector3<f64>, digits: usize) -> String {
    format!("{:.digits$} {:.digits$} {:.digits$}", v.x, v.y, v.z)
}

/// Today in UTC, for example `2026-01-31`.
pub(crate) fn today() -> String {
    time::OffsetDateTime::now_utc().date().to_string()
}

/// The samples of a bend log or an IMU recording; lost samples are omitted.
///
/// # Errors
/// A report that names file, line and column.
fn from_file(file: &Path) -> Result<Vec<ImuSample>> {
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
fn record(
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
fn from_bus(bus: &Path, seconds: f64) -> Result<Vec<ImuSample>> {
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
