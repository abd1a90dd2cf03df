//! `retroflex calibrate imu …`: the sensor's own errors, from a recording or from a live sensor.
//!
//! Every step prints what it found with a figure of its quality, or refuses with the motion that was
//! missing, and writes into the `[imu]` table of a calibration file, whole or not at all.

use crate::cli::CommandOutcome;
use crate::cli::output;
use crate::estimation::fusion::health;
use crate::estimation::fusion::tip::{FuseConfig, Fusion, FusionInput};
use crate::estimation::imu_calibration::{CalibrationLimits, ImuCalibration, Pedigree, accel, gyro, mag, motor, mount, still};
use crate::hardware::imu::Imu;
use crate::log::bend_log::{self, BendLog};
use crate::log::error::ReadError;
use crate::log::recording;
use crate::model::drive::Drive;
use crate::primitives::sample::ImuSample;
use crate::primitives::units::{Seconds, Steps};
use embedded_hal::delay::DelayNs;
use miette::{IntoDiagnostic, Result, miette};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// What is calibrated.
#[derive(Debug, clap::Subcommand)]
pub enum Calibrate {
    /// The inertial sensor at the tip.
    Imu(Args),
    /// The transmission of a running service: Algorithm 1, or its short form.
    Transmission(crate::cli::client::args::TransmissionArgs),
}

/// Arguments of `calibrate imu`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What to find.
    #[arg(value_enum)]
    step: Step,
    /// Bend log or IMU recording, *.csv or *.csv.gz.
    #[arg(required_unless_present = "live")]
    file: Option<PathBuf>,
    /// Read a live sensor on this I²C bus instead, such as /dev/i2c-1 (gyro, accel and mag).
    #[arg(long, conflicts_with = "file")]
    live: Option<PathBuf>,
    /// How long to read a live sensor, s.
    #[arg(long, default_value_t = 30.0, value_parser = seconds)]
    seconds: f64,
    /// Calibration file whose `[imu]` table is written; the rest of it is kept.
    #[arg(long, default_value = "calib/imu.toml")]
    out: PathBuf,
    /// Day of the recording, YYYY-MM-DD; without it today.
    #[arg(long)]
    date: Option<String>,
    /// A driver idles this long after its last step, s (motors).
    #[arg(long, default_value_t = 0.35)]
    idle_after: f64,
}

/// One quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Step {
    /// Gyroscope bias, from a rest.
    Gyro,
    /// Accelerometer zero and scale, from rests on six faces or all round.
    Accel,
    /// Hard and soft iron, from a tumble with the motors off.
    Mag,
    /// Fields of the motor coils, from a bend log.
    Motors,
    /// Mount angle, from bends in a bend log.
    Mount,
}

fn seconds(text: &str) -> Result<f64, String> {
    let s: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if (1.0..=3600.0).contains(&s) { Ok(s) } else { Err(format!("{s} s is outside 1 to 3600 s")) }
}

/// Runs the command.
///
/// # Errors
/// A report that names what is wrong with the input.
pub fn run(command: &Calibrate) -> Result<CommandOutcome> {
    let args = match command {
        Calibrate::Imu(args) => args,
        Calibrate::Transmission(args) => return crate::cli::client::follow::transmission(args),
    };
    let date = args.date.clone().unwrap_or_else(today);
    let source = args.file.as_ref().or(args.live.as_ref()).map_or_else(String::new, |p| p.display().to_string());
    let from = Pedigree { date: &date, source: &source };
    let mut table = existing(&args.out)?;
    let mut found: ImuCalibration = match table.remove("imu") {
        Some(imu) => imu.try_into().map_err(|e| miette!("{}: [imu]: {e}", args.out.display()))?,
        None => ImuCalibration::default(),
    };
    match find(args, from, &mut found)? {
        Ok(line) => eprintln!("{line}"),
        Err(refusal) => {
            eprintln!("refused: {refusal}");
            return Ok(CommandOutcome::NotGoodEnough);
        }
    }
    table.insert("imu".to_owned(), toml::Value::try_from(&found).into_diagnostic()?);
    output::write(&args.out, &toml::to_string_pretty(&table).into_diagnostic()?)?;
    eprintln!("written to {}", args.out.display());
    Ok(CommandOutcome::Good)
}

fn existing(path: &Path) -> Result<toml::Table> {
    match std::fs::read_to_string(path) {
        Ok(text) => text.parse().map_err(|e| miette!("{}: {e}", path.display())),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(toml::Table::new()),
        Err(e) => Err(miette!("{}: {e}", path.display())),
    }
}

/// One step: a line for people, or why not.
fn find(args: &Args, from: Pedigree<'_>, into: &mut ImuCalibration) -> Result<Result<String, crate::estimation::imu_calibration::Refusal>> {
    let limits = CalibrationLimits::default();
    Ok(match args.step {
        Step::Gyro => gyro::at_rest(&samples(args)?, &limits).map(|fit| {
            into.set_gyro(&fit, from);
            let (bias, sigma) = (fit.bias_rad_s.map(f64::to_degrees), fit.sigma_rad_s.amax().to_degrees());
            format!("gyroscope bias {:.3} {:.3} {:.3} °/s, ± {sigma:.4} °/s, from {:.1} s of rest", bias.x, bias.y, bias.z, fit.duration_s)
        }),
        Step::Accel => {
            let rests = still::rests(&samples(args)?, &limits);
            let fit = if rests.len() >= limits.ellipsoid_samples {
                accel::ellipsoid(&rests, &limits)
            } else {
                accel::six_positions(&rests, &limits)
            };
            fit.map(|fit| {
                into.set_accel(&fit, from);
                let b = fit.bias_m_s2;
                format!(
                    "accelerometer zero {:.3} {:.3} {:.3} m/s², residual {:.4} m/s², {:.0} % of the sphere, {} rests",
                    b.x,
                    b.y,
                    b.z,
                    fit.residual_m_s2,
                    100.0 * fit.coverage,
                    rests.len()
                )
            })
        }
        Step::Mag => {
            let readings: Vec<Vector3<f64>> = samples(args)?.iter().filter_map(|s| s.mag_ut).collect();
            mag::ellipsoid(&readings, &limits).map(|fit| {
                into.set_mag(&fit, from);
                let b = fit.bias_ut;
                format!(
                    "hard iron {:.1} {:.1} {:.1} µT, ± {:.2} µT, field {:.1} µT, residual {:.2} µT, {:.0} % of the sphere",
                    b.x,
                    b.y,
                    b.z,
                    fit.bias_sigma_ut.amax(),
                    fit.field_ut,
                    fit.residual_ut,
                    100.0 * fit.coverage
                )
            })
        }
        Step::Motors => motor::fit(&motor_samples(&bend(args)?, args.idle_after), &limits, from).map(|fit| {
            let strongest = fit.field.cos_ut.iter().chain(&fit.field.sin_ut).map(|r| Vector3::from(*r).norm()).fold(0.0, f64::max);
            into.motor_field = Some(fit.field);
            format!(
                "motor fields up to {strongest:.2} µT, residual {:.2} µT, coil cycle seen {:.0} %",
                fit.residual_ut,
                100.0 * fit.coverage.into_iter().fold(1.0, f64::min)
            )
        }),
        Step::Mount => mount::from_bends(&bends(&bend(args)?), &limits).map(|fit| {
            into.set_mount(&fit, from);
            let (tilt, sigma) = (fit.r_tip_sensor.quat().angle().to_degrees(), fit.sigma_rad.map(f64::to_degrees));
            format!(
                "sensor turned by {tilt:.2}° against the tip, ± {:.2} {:.2} {:.2}°, from {} bends, {:.2}° out of their plane",
                sigma.x,
                sigma.y,
                sigma.z,
                fit.bends,
                fit.out_of_plane_rad.to_degrees()
            )
        }),
    })
}

fn bend(args: &Args) -> Result<BendLog> {
    let file =
        args.file.as_ref().ok_or_else(|| miette!("motors and mount need a bend log, in which the pistons are recorded: give its file"))?;
    bend_log::read(file).into_diagnostic()
}

/// Samples from wherever they come; those that were lost are left out.
fn samples(args: &Args) -> Result<Vec<ImuSample>> {
    let all = match (&args.file, &args.live) {
        (Some(file), _) => match bend_log::read(file) {
            Ok(log) => log_samples(&log),
            // another kind of file: its reader says what is wrong if it is neither
            Err(ReadError::Missing { .. }) => recording::read(file).into_diagnostic()?.rows.iter().map(|r| r.sample).collect(),
            Err(e) => return Err(e).into_diagnostic(),
        },
        (None, Some(bus)) => live(bus, args.seconds)?,
        (None, None) => Vec::new(),
    };
    Ok(all.into_iter().filter(ImuSample::is_finite).collect())
}

fn log_samples(log: &BendLog) -> Vec<ImuSample> {
    let Some(imu) = &log.imu else { return Vec::new() };
    let whole = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
    (0..log.t_s.len())
        .map(|k| ImuSample {
            t: Seconds(log.t_s[k]),
            gyro_rad_s: imu.gyr[k],
            acc_m_s2: imu.acc[k],
            mag_ut: imu.mag.get(k).copied().filter(whole),
        })
        .collect()
}

/// Field readings in the base frame with the motors' counts, the tip felt without the field.
fn motor_samples(log: &BendLog, idle_after_s: f64) -> Vec<motor::MotorSample> {
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
        let still = moved_s.iter().all(|m| sample.t.0 - m > 0.5);
        let told = FusionInput {
            now: sample.t,
            tip: health::ImuReading::from_world(Some(*sample)),
            base: None,
            coils_ut: Vector3::zeros(),
            still,
        };
        fusion.update(&config, &told);
        if let (Some(estimate), Some(mag)) = (fusion.estimate(), sample.mag_ut) {
            let energised = moved_s.map(|m| sample.t.0 - m < idle_after_s);
            out.push(motor::MotorSample { mag_ut: estimate.r_base_tip.apply(&mag), counts: steps.0, energised });
        }
    }
    out
}

/// Pure bends: motions between two held poses of one plane.
fn bends(log: &BendLog) -> Vec<mount::BendTurn> {
    let samples = log_samples(log);
    let Some(bias) = samples.get(..).map(|s| still::rests(s, &CalibrationLimits::default())).and_then(|r| r.first().map(|r| r.gyro_rad_s))
    else {
        return Vec::new();
    };
    let changes: Vec<usize> = (1..samples.len()).filter(|&k| log.command.get(k) != log.command.get(k - 1)).collect();
    let ends = changes.iter().skip(1).copied().chain([samples.len()]);
    let turn = |(&from, to): (&usize, usize)| {
        let (before, after) = (log.command[from - 1], log.command[from]);
        let direction_rad = plane(&before, &after)?.to_radians();
        let lost = samples[from..to].iter().any(|s| !s.is_finite());
        (!lost).then(|| mount::BendTurn { turn_rad: mount::turn_of(&samples[from..to], &bias), direction_rad: Some(direction_rad) })
    };
    changes.iter().zip(ends).filter_map(turn).collect()
}

/// Direction, degrees, in which the bend grows from one command to the next, if it is one plane.
fn plane(before: &Vector3<f64>, after: &Vector3<f64>) -> Option<f64> {
    let one_plane = before.x == 0.0 || after.x == 0.0 || (before.y - after.y).abs() < 1e-6;
    let grows = after.x > before.x;
    let direction = if grows { after.y } else { before.y + 180.0 };
    (one_plane && direction.is_finite() && after.x != before.x).then_some(direction)
}

/// Reads a sensor for a while; a reading that fails is left out.
///
/// # Errors
/// The sensor's, when it does not come up or half of the readings fail.
pub fn record(sensor: &mut dyn Imu, delay: &mut dyn DelayNs, seconds: f64, progress: &mut dyn FnMut(f64)) -> Result<Vec<ImuSample>> {
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

#[cfg(feature = "hw")]
fn live(bus: &Path, seconds: f64) -> Result<Vec<ImuSample>> {
    use crate::hardware::imu::{self, ChipConfig};
    use linux_embedded_hal::{Delay, I2cdev};
    let open = I2cdev::new(bus).map_err(|e| miette!("{}: {e}; name an I²C bus that exists and may be opened", bus.display()))?;
    let mut sensor = imu::open(&ChipConfig::default(), imu::linux::Classified(open)).into_diagnostic()?;
    let bar = output::bar(1000, "{percent} %");
    let samples = record(sensor.as_mut(), &mut Delay, seconds, &mut |share| bar.set_position((share * 1000.0) as u64));
    bar.finish_and_clear();
    samples
}

#[cfg(not(feature = "hw"))]
fn live(bus: &Path, _: f64) -> Result<Vec<ImuSample>> {
    Err(miette!("{}: this program was built without hardware; build it with the feature `hw`", bus.display()))
}

/// Today in UTC, as in `2026-01-31`.
fn today() -> String {
    time::OffsetDateTime::now_utc().date().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::imu::fake::{FakeBus, FakeIcm20948, Motion};
    use crate::hardware::imu::icm20948::{self, Icm20948};

    #[test]
    fn a_live_chip_is_read_through_its_driver() {
        let bus = FakeBus::new();
        bus.machine().attach(FakeIcm20948::new(0x68, 1));
        let bias = Vector3::new(0.01, -0.02, 0.005);
        bus.machine().set_motion(&Motion { gyro_rad_s: bias, ..Motion::default() });
        let mut chip = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
        let mut shares = Vec::new();
        let samples = record(&mut chip, &mut bus.delay(), 5.0, &mut |s| shares.push(s)).unwrap();
        assert!(samples.len() > 2000 && shares.windows(2).all(|w| w[0] < w[1]));
        let fit = gyro::at_rest(&samples, &CalibrationLimits::default()).unwrap();
        assert!((fit.bias_rad_s - bias).amax() < 1e-3, "{}", fit.bias_rad_s);
        bus.machine().stuck = true;
        assert!(record(&mut chip, &mut bus.delay(), 1.0, &mut |_| ()).is_err());
    }

    #[test]
    fn one_plane_and_its_direction() {
        let v = |bend: f64, dir: f64| Vector3::new(bend, dir, 20.0);
        assert_eq!(plane(&v(0.0, 0.0), &v(30.0, 120.0)), Some(120.0));
        assert_eq!(plane(&v(30.0, 120.0), &v(0.0, 0.0)), Some(300.0));
        assert_eq!(plane(&v(60.0, 90.0), &v(30.0, 90.0)), Some(270.0));
        assert_eq!(plane(&v(60.0, 90.0), &v(30.0, 120.0)), None);
        assert_eq!(today().len(), 10);
    }
}
