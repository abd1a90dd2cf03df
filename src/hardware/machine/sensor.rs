//! One IMU in a thread of its own, which opens the bus and reads the sensor at its rate.
//!
//! Readings travel through a wait-free ring with the time at which their transfer began. A transfer ends
//! after 20 ms at the latest if the driver of the bus accepts the limit, and blocks only this thread.
//! [`ImuRecovery`] sets the chip up again after a restart or a series of failures.

use crate::hardware::imu::{self, ChipConfig, Identity, Imu, ImuRecovery, POLL_SHARE};
use crate::hardware::machine::error::HardwareError;
use crate::hardware::machine::reading;
use crate::hardware::rt::{self, RtRequest, monotonic_ns};
use crate::parameters;
use crate::primitives::{ImuReading, Seconds};
use linux_embedded_hal::{Delay, I2cdev};
use nalgebra::{UnitQuaternion, Vector3};
use std::sync::mpsc::Sender;
use std::time::Duration;

/// Longest time from opening the bus to a configured chip. The slowest part takes half a second.
const SETUP_MAX: Duration = Duration::from_secs(5);
/// Capacity of the ring: an eighth of a second at 500 Hz.
const READINGS: usize = 64;

parameters! {
    /// An IMU and its mounting.
    pub struct ImuSection {
        /// Device file of the bus. On a Raspberry Pi it is on pins 3 and 5 of the header and needs
        /// `dtparam=i2c_arm_baudrate=400000` in config.txt.
        bus: String = "/dev/i2c-1".to_owned();
        /// GPIO numbers of SDA and SCL on the header of a Raspberry Pi. With them the driver frees a bus whose SDA a chip holds
        /// low, by up to nine clock pulses; it needs access to the registers (/dev/gpiomem). Leave it out on other computers.
        bus_lines: Option<[u32; 2]> = None;
        /// What the die reads above the surface of the tip: the offset of the part, up to 15 °C, and its own heat. Measure it with
        /// a thermometer while the tip rests. A larger value shows a colder tip.
        temp_offset_c: f64 = 0.0, "°C", -30.0..=30.0, "reading of the die minus that of a thermometer";
        /// Rotation from the sensor to the tip (or base) as a rotation vector: axis times angle. With the default, z points out
        /// of the tip and x towards bellow 1. `retroflex commission` measures it; an error turns every bend plane.
        mount_deg: [f64; 3] = [0.0; 3], "deg", -360.0..=360.0, "a rotation vector: axis times angle";
        /// The part and its settings.
        chip: ChipConfig;
    }
}

impl ImuSection {
    /// The mount as a rotation.
    pub fn mount(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(Vector3::from(self.mount_deg).map(f64::to_radians))
    }
}

/// A reading with the start of its transfer, ns of the monotonic clock.
#[derive(Debug, Clone, Copy)]
pub struct StampedReading {
    /// Start of the transfer.
    pub t_ns: u64,
    /// The reading; the time inside a sample is not set.
    pub reading: ImuReading,
    /// Die temperature, °C.
    pub temp_c: Option<f64>,
}

/// The loop's handle on the thread. Dropping it ends the thread without waiting for it, because its bus may hang.
#[derive(Debug)]
pub struct Sensor {
    readings: rtrb::Consumer<StampedReading>,
    /// Device file of the bus.
    pub bus: String,
    /// What the set-up found.
    pub found: Found,
}

/// What the set-up of a sensor found.
#[derive(Debug)]
pub struct Found {
    /// The inertial chip and its rate.
    pub identity: Identity,
    /// True if the driver of the bus accepted a time limit for its transfers.
    pub bounded: bool,
    /// Duration of a reading, s.
    pub read_s: f64,
}

/// Readings at the start whose duration is measured.
const TIMED: u32 = 16;

/// What is wrong with a reading of this duration in s, if anything.
pub fn slowness(read_s: f64, rate_hz: f64) -> Option<String> {
    let (read_ms, period_ms) = (read_s * 1e3, 1e3 / rate_hz);
    (read_ms > period_ms).then(|| format!("slow bus: a reading takes {read_ms:.1} ms and the chip converts every {period_ms:.1} ms, so conversions are lost: set `dtparam=i2c_arm_baudrate=400000` in config.txt, or a smaller imu.chip.rate_hz"))
}

impl Sensor {
    /// Opens the bus, sets the chip up and starts reading.
    ///
    /// # Errors
    /// [`HardwareError`]: no bus, no permission, or a chip that does not answer, is another part or does
    /// not start.
    pub fn start(config: &ImuSection, priority: i32) -> Result<Self, HardwareError> {
        let (own, bus) = (config.clone(), config.bus.clone());
        let run = move |output, started| run(&own, priority, output, &started);
        let (readings, found) = reading::start("IMU", &bus, SETUP_MAX, READINGS, run)?;
        Ok(Self {
            readings,
            bus,
            found,
        })
    }

    /// The readings since the last call as one: the newest failure, or the mean of the samples after it at the time of the
    /// newest. The mean over the interval keeps the angle that the gyroscope has measured.
    pub fn newest(&mut self) -> Option<StampedReading> {
        let readings = std::iter::from_fn(|| self.readings.pop().ok());
        readings.fold((None, 0.0), merge).0
    }
}

/// Adds a reading to the mean of `n` samples.
fn merge(
    (mean, n): (Option<StampedReading>, f64),
    next: StampedReading,
) -> (Option<StampedReading>, f64) {
    let old = mean.map(|mean| mean.reading);
    let (Some(ImuReading::Sample(old, q)), ImuReading::Sample(mut new, mut quality)) =
        (old, next.reading)
    else {
        return (Some(next), 1.0);
    };
    // equal samples keep their value exactly, so that a chip that repeats itself is still detected
    let n = n + 1.0;
    new.gyro_rad_s = old.gyro_rad_s + (new.gyro_rad_s - old.gyro_rad_s) / n;
    new.acc_m_s2 = old.acc_m_s2 + (new.acc_m_s2 - old.acc_m_s2) / n;
    new.mag_ut = new.mag_ut.or(old.mag_ut);
    quality.gyro_load = quality.gyro_load.max(q.gyro_load);
    quality.acc_load = quality.acc_load.max(q.acc_load);
    quality.mag_overflow |= q.mag_overflow;
    let reading = ImuReading::Sample(new, quality);
    (Some(StampedReading { reading, ..next }), n)
}

/// The thread: reports the result of the set-up, then reads until the handle is dropped.
fn run(
    config: &ImuSection,
    priority: i32,
    mut output: rtrb::Producer<StampedReading>,
    started: &Sender<Result<Found, HardwareError>>,
) {
    let set_up = open(config).and_then(|(driver, bounded)| {
        let mut imu = recovery(config, driver);
        let failed = |error| HardwareError::Imu(config.bus.clone(), error);
        let identity = imu.start(&mut Delay).map_err(failed)?;
        Ok((imu, identity, bounded))
    });
    let (mut imu, identity, bounded) = match set_up {
        Ok(ready) => ready,
        Err(error) => {
            let _ = started.send(Err(error));
            return;
        }
    };
    let _guard = rt::enter(&RtRequest {
        priority,
        cpu: None,
    });
    let since_ns = monotonic_ns();
    for _ in 0..TIMED {
        imu.read(&mut Delay, Seconds(monotonic_ns() as f64 * 1e-9));
    }
    let read_s = (monotonic_ns() - since_ns) as f64 * 1e-9 / f64::from(TIMED);
    // The receiver may have timed out; then the ring is abandoned.
    let _ = started.send(Ok(Found {
        identity,
        bounded,
        read_s,
    }));
    let period_ns = (1e9 / (POLL_SHARE * identity.rate_hz)) as u64;
    let mount = config.mount();
    let mut next_ns = monotonic_ns();
    while !output.is_abandoned() {
        let t_ns = monotonic_ns();
        let mut reading = imu.read(&mut Delay, Seconds(t_ns as f64 * 1e-9));
        if let ImuReading::Sample(sample, _) = &mut reading {
            sample.gyro_rad_s = mount * sample.gyro_rad_s;
            sample.acc_m_s2 = mount * sample.acc_m_s2;
            sample.mag_ut = sample.mag_ut.map(|m| mount * m);
        }
        if reading != ImuReading::Nothing {
            // A full ring means that the loop is stuck, and this reading will be outdated when it resumes.
            let _ = output.push(StampedReading {
                t_ns,
                reading,
                temp_c: imu.temp_c,
            });
        }
        // After a slow transfer the missed readings are not made up for.
        next_ns = (next_ns + period_ns).max(monotonic_ns());
        rt::sleep_until_ns(next_ns);
    }
}

/// A driver that is recovered, with its bus if the board states the lines.
fn recovery(config: &ImuSection, driver: Box<dyn Imu + Send>) -> ImuRecovery<dyn Imu + Send> {
    let imu = ImuRecovery::new(driver);
    if let Some(lines) = config.bus_lines {
        return imu.freeing_bus(move |delay| imu::bus_clear::clear_header(lines, delay));
    }
    imu
}

/// A handle on a bus, and whether its transfers have a time limit. The libraries merge the causes of a failure; opening the file here
/// distinguishes them.
pub(super) fn open_bus(path: &str) -> Result<(I2cdev, bool), HardwareError> {
    let other = |e: &dyn std::error::Error| HardwareError::Bus(path.to_owned(), e.to_string());
    let opened = std::fs::File::options().read(true).write(true).open(path);
    let file = opened.map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => HardwareError::NoBus(path.to_owned()),
        std::io::ErrorKind::PermissionDenied => HardwareError::BusPermission(path.to_owned()),
        _ => other(&e),
    })?;
    let bounded = imu::linux::bound_transfers(&file).is_ok();
    Ok((I2cdev::new(path).map_err(|e| other(&e))?, bounded))
}

/// The driver on its bus, and whether transfers have a time limit.
fn open(config: &ImuSection) -> Result<(Box<dyn Imu + Send>, bool), HardwareError> {
    let (bus, bounded) = open_bus(&config.bus)?;
    let bus = imu::linux::Classified(bus);
    Ok((imu::open(&config.chip, bus)?, bounded))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::sample::ImuSample;
    use crate::primitives::{Quality, ReadFault};

    fn sample(rate: f64, mag: Option<f64>, load: f64) -> StampedReading {
        let v = |x: f64| Vector3::new(x, 0.0, 0.0);
        let sample = ImuSample {
            t: Seconds(0.0),
            gyro_rad_s: v(rate),
            acc_m_s2: v(9.81),
            mag_ut: mag.map(v),
        };
        let quality = Quality {
            gyro_load: load,
            ..Quality::default()
        };
        StampedReading {
            t_ns: (rate * 1e3) as u64,
            reading: ImuReading::Sample(sample, quality),
            temp_c: None,
        }
    }

    fn merged(readings: &[StampedReading]) -> StampedReading {
        readings.iter().copied().fold((None, 0.0), merge).0.unwrap()
    }

    #[test]
    fn the_readings_of_a_turn_become_their_mean() {
        let one = merged(&[
            sample(1.0, Some(20.0), 0.9),
            sample(2.0, None, 0.1),
            sample(6.0, None, 0.2),
        ]);
        let ImuReading::Sample(mean, quality) = one.reading else {
            panic!("{one:?}")
        };
        assert!((mean.gyro_rad_s.x - 3.0).abs() < 1e-12 && (mean.acc_m_s2.x - 9.81).abs() < 1e-12);
        assert_eq!(
            (one.t_ns, mean.mag_ut.map(|m| m.x), quality.gyro_load),
            (6000, Some(20.0), 0.9)
        );
        let same = merged(&[sample(0.1, None, 0.0); 3]).reading;
        assert!(
            matches!(same, ImuReading::Sample(s, _) if s.gyro_rad_s.x == 0.1),
            "a frozen chip stays recognisable"
        );
    }

    #[test]
    fn a_reading_that_takes_longer_than_a_conversion_is_named() {
        for rate_hz in [104.0, 281.25, 562.5, 833.0, 960.0] {
            for share in [0.1, 0.5, 0.9, 1.1, 2.0, 9.0] {
                let named = slowness(share / rate_hz, rate_hz);
                assert_eq!(named.is_some(), share > 1.0, "{rate_hz} {share}: {named:?}");
            }
        }
    }

    #[test]
    fn a_failure_ends_the_mean() {
        let failed = StampedReading {
            reading: ImuReading::Failed(ReadFault::BrownOut),
            ..sample(0.0, None, 0.0)
        };
        assert_eq!(
            merged(&[sample(1.0, None, 0.0), failed]).reading,
            failed.reading
        );
        let after = merged(&[sample(1.0, None, 0.0), failed, sample(5.0, None, 0.0)]).reading;
        assert!(matches!(after, ImuReading::Sample(s, _) if s.gyro_rad_s.x == 5.0));
    }
}
