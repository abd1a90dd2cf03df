//! Pressure sensors and the temperature of the tip: limits that do not depend on the counted position.

use crate::hardware::machine::error::HardwareError;
use crate::hardware::machine::reading;
use crate::hardware::machine::sensor::open_bus;
use crate::hardware::pressure::{CONVERSION_MS, PressureError, PressureSection, PressureSensor};
use crate::hardware::rt::monotonic_ns;
use crate::motion::{Alarm, Gauges};
use embedded_hal::i2c::I2c;
use std::sync::mpsc::Sender;
use std::time::Duration;

/// Age at which a pressure counts as unknown, ns.
const STALE_NS: u64 = 100_000_000;
/// Time constant that smooths the temperature, s: one misread byte does not trip.
const SMOOTH_S: f64 = 1.0;
/// Time between two readings of all pressures, besides the conversion.
const PAUSE: Duration = Duration::from_millis(4);
/// Longest time for the first reading.
const SETUP_MAX: Duration = Duration::from_secs(2);

/// Sensors and limits.
#[derive(Debug, Clone)]
pub struct GaugeConfig {
    /// Pressure sensors, if there are any.
    pub pressure: Option<PressureSection>,
    /// Largest gauge pressure of either sign, kPa.
    pub pressure_max_kpa: f64,
    /// What the die of the tip's IMU reads too high, °C.
    pub temp_offset_c: f64,
    /// Temperature of the tip that is reported, °C.
    pub tip_warm_c: f64,
    /// Temperature of the tip that trips, °C.
    pub tip_max_c: f64,
}

/// Pressures of all lines, kPa, and the time of the reading.
type Pressures = ([f64; 3], u64);
/// The readings of the thread, and the last one.
type Watched = (rtrb::Consumer<Pressures>, Pressures);

/// The loop's side of all gauges.
pub(super) struct GaugeWatch {
    config: GaugeConfig,
    pressures: Option<Watched>,
    tip_c: Option<(f64, u64)>,
}

impl GaugeWatch {
    /// Opens the pressure sensors and starts their thread.
    ///
    /// # Errors
    /// [`HardwareError`]: no bus, no permission, or a sensor that does not answer.
    pub(super) fn start(config: &GaugeConfig) -> Result<Self, HardwareError> {
        let pressures = config.pressure.as_ref().map(start_pressures).transpose()?;
        Ok(Self {
            config: config.clone(),
            pressures,
            tip_c: None,
        })
    }

    /// Takes what has arrived; `die_c` is a new temperature of the IMU.
    pub(super) fn turn(&mut self, now_ns: u64, die_c: Option<f64>) -> (Gauges, Option<Alarm>) {
        let pressure_kpa = self.pressures.as_mut().map(|(ring, last)| {
            while let Ok(newer) = ring.pop() {
                *last = newer;
            }
            match now_ns.saturating_sub(last.1) {
                0..=STALE_NS => last.0,
                _ => [f64::NAN; 3],
            }
        });
        if let Some(die_c) = die_c {
            let new_c = die_c - self.config.temp_offset_c;
            let smooth_c = self.tip_c.map_or(new_c, |(old_c, then_ns)| {
                let keep = (-(now_ns.saturating_sub(then_ns) as f64) * 1e-9 / SMOOTH_S).exp();
                new_c + (old_c - new_c) * keep
            });
            self.tip_c = Some((smooth_c, now_ns));
        }
        let tip_c = self.tip_c.map(|(c, _)| c);
        let gauges = Gauges {
            pressure_kpa,
            tip_c,
            tip_warm: tip_c.is_some_and(|c| c >= self.config.tip_warm_c),
        };
        (gauges, self.alarm(&gauges))
    }

    /// The limit that is exceeded. A pressure that is unknown exceeds it.
    fn alarm(&self, gauges: &Gauges) -> Option<Alarm> {
        let limit_kpa = self.config.pressure_max_kpa;
        let exceeds = |kpa: &f64| kpa.is_nan() || kpa.abs() > limit_kpa;
        let over = gauges.pressure_kpa.into_iter().flatten().find(exceeds);
        let hot = gauges.tip_c.filter(|c| *c > self.config.tip_max_c);
        over.map(|kpa| Alarm::Pressure { kpa })
            .or(hot.map(|temp_c| Alarm::Hot { temp_c }))
    }
}

/// Reads all pressures once.
fn read_all<I: I2c>(sensors: &mut [PressureSensor<I>; 3]) -> Result<[f64; 3], PressureError> {
    for sensor in sensors.iter_mut() {
        sensor.start()?;
    }
    std::thread::sleep(Duration::from_millis(CONVERSION_MS));
    let mut kpa = [0.0; 3];
    for (kpa, sensor) in kpa.iter_mut().zip(sensors) {
        *kpa = sensor.fetch()?;
    }
    Ok(kpa)
}

fn start_pressures(config: &PressureSection) -> Result<Watched, HardwareError> {
    let open = |channel| {
        // if the bus refuses a limit, the age of the readings is one
        let (bus, _) = open_bus(&config.bus)?;
        Ok::<_, HardwareError>(PressureSensor::new(bus, config, channel))
    };
    watch([open(0)?, open(1)?, open(2)?], &config.bus)
}

/// Starts the thread and waits for its first reading. A later one that fails is left out, and its age tells.
fn watch<I: I2c + Send + 'static>(
    mut sensors: [PressureSensor<I>; 3],
    bus: &str,
) -> Result<Watched, HardwareError> {
    let path = bus.to_owned();
    let run = move |mut output: rtrb::Producer<Pressures>, first: Sender<_>| {
        let mut read = || read_all(&mut sensors).map(|kpa| (kpa, monotonic_ns()));
        let result = read().map_err(|e| HardwareError::Bus(path, e.to_string()));
        let failed = result.is_err();
        if first.send(result).is_err() || failed {
            return;
        }
        while !output.is_abandoned() {
            std::thread::sleep(PAUSE);
            if let Ok(pressures) = read() {
                // a full ring means that the loop is stuck
                let _ = output.push(pressures);
            }
        }
    };
    reading::start("pressure", bus, SETUP_MAX, 16, run)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::imu::fake::{FakeBus, FakePressure};
    use embedded_hal::i2c::{ErrorType, Operation};

    const CONFIG: GaugeConfig = GaugeConfig {
        pressure: None,
        pressure_max_kpa: 41.3,
        temp_offset_c: 2.0,
        tip_warm_c: 39.0,
        tip_max_c: 41.0,
    };

    /// The fake's time passes with every transfer.
    struct Passing(FakeBus);

    impl ErrorType for Passing {
        type Error = <FakeBus as ErrorType>::Error;
    }

    impl I2c for Passing {
        fn transaction(
            &mut self,
            address: u8,
            operations: &mut [Operation<'_>],
        ) -> Result<(), Self::Error> {
            self.0.machine().advance(0.006);
            self.0.transaction(address, operations)
        }
    }

    fn watched(kpa: [f64; 3]) -> (FakeBus, Result<GaugeWatch, HardwareError>) {
        let (bus, section) = (FakeBus::new(), PressureSection::default());
        for (address, kpa) in section.addresses.into_iter().zip(kpa) {
            bus.machine().attach(FakePressure::new(address).at(kpa));
        }
        let sensors =
            [0, 1, 2].map(|channel| PressureSensor::new(Passing(bus.clone()), &section, channel));
        let watch = watch(sensors, "/dev/i2c-1");
        (
            bus,
            watch.map(|pressures| GaugeWatch {
                config: CONFIG,
                pressures: Some(pressures),
                tip_c: None,
            }),
        )
    }

    #[test]
    fn a_measured_pressure_above_the_limit_is_an_alarm() {
        let (_bus, watch) = watched([10.0, -30.0, 41.0]);
        let (gauges, alarm) = watch.unwrap().turn(monotonic_ns(), None);
        let measured = gauges.pressure_kpa.unwrap();
        assert!(
            [10.0, -30.0, 41.0]
                .iter()
                .zip(measured)
                .all(|(a, b)| (a - b).abs() < 1e-3),
            "{measured:?}"
        );
        assert_eq!(alarm, None);
        for kpa in [[0.0, 42.0, 0.0], [0.0, 0.0, -42.0]] {
            let (_bus, watch) = watched(kpa);
            let alarm = watch.unwrap().turn(monotonic_ns(), None).1;
            assert!(
                matches!(alarm, Some(Alarm::Pressure { kpa }) if kpa.abs() > 41.9),
                "{alarm:?}"
            );
        }
    }

    #[test]
    fn a_sensor_that_falls_silent_is_an_alarm_and_one_that_is_missing_is_an_error() {
        let (bus, watch) = watched([0.0; 3]);
        let mut watch = watch.unwrap();
        bus.machine().stuck = true;
        std::thread::sleep(Duration::from_millis(50));
        let (gauges, alarm) = watch.turn(monotonic_ns() + STALE_NS, None);
        assert!(gauges.pressure_kpa.unwrap().iter().all(|kpa| kpa.is_nan()));
        assert!(alarm.is_some_and(|a| a.to_string().contains("does not answer")));
        bus.machine().stuck = false;
        std::thread::sleep(Duration::from_millis(200));
        assert_eq!(watch.turn(monotonic_ns(), None).1, None, "it answers again");

        let section = PressureSection::default();
        let nobody =
            [0, 1, 2].map(|channel| PressureSensor::new(FakeBus::new(), &section, channel));
        let error = super::watch(nobody, "/dev/i2c-1")
            .map(|_| ())
            .unwrap_err()
            .to_string();
        assert!(error.contains("0x18 does not answer"), "{error}");
    }

    #[test]
    fn a_hot_tip_is_an_alarm_and_a_misread_byte_is_not() {
        let mut watch = GaugeWatch {
            config: CONFIG,
            pressures: None,
            tip_c: None,
        };
        let mut t_ns = 0;
        let mut at = |die_c: f64, seconds: u32| {
            (0..500 * seconds).fold((Gauges::default(), None), |_, _| {
                t_ns += 2_000_000;
                watch.turn(t_ns, Some(die_c))
            })
        };
        assert_eq!(
            at(40.0, 1),
            (
                Gauges {
                    pressure_kpa: None,
                    tip_c: Some(38.0),
                    tip_warm: false
                },
                None
            )
        );
        let (gauges, alarm) = at(42.0, 10);
        assert!(
            gauges.tip_warm && alarm.is_none(),
            "40 °C is warm: {gauges:?}"
        );
        assert!(matches!(at(43.5, 10).1, Some(Alarm::Hot { temp_c }) if temp_c > 41.0));
        assert_eq!(at(40.0, 10).1, None);
        assert_eq!(
            watch.turn(t_ns + 2_000_000, Some(300.0)).1,
            None,
            "one reading of many"
        );
    }
}
