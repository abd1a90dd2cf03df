//! Reads a sensor and initialises it again when reading alone cannot restore it.
//!
//! ```text
//! read ── good ──────────────────────────────▶ Sample
//!   ├── restarted, or another part ──▶ init ─▶ Failed (and Sample from the next reading on)
//!   ├── an axis that repeats itself ─▶ init ─▶ Nothing, again after 2, 4, … 64 s
//!   └── failed RETRY_AFTER times ────▶ init ─▶ Failed, with the error of the initialisation
//! ```
//!
//! Before an initialisation the bus is freed, if the board states its lines ([`ImuRecovery::freeing_bus`]). A reading
//! without a new conversion is dropped, unless the chip has stopped converting.
//!
//! An initialisation takes up to half a second, so this runs in the sensor's own thread and never in the
//! loop. Meanwhile the loop receives failures or nothing, and the supervisor holds the pistons. Samples
//! are scaled but not corrected; the loop applies the calibration. Time is an argument.

use super::bus_clear::BusState;
use super::{Identity, Imu, ImuError, RawImu};
use crate::primitives::{ImuReading, ReadFault, Seconds};
use embedded_hal::delay::DelayNs;

/// Consecutive failed readings after which the chip is initialised again: 50 ms at 500 Hz. A chip that
/// reports a restart is initialised at once.
const RETRY_AFTER: u32 = 25;
/// Readings per conversion. The chip's clock may be 1 % off and a reading may come late by a fifth of the period; every
/// conversion is then still read.
pub const POLL_SHARE: f64 = 1.25;
/// Consecutive readings without a new conversion after which they are delivered all the same, so that the health monitor
/// detects a chip that has stopped converting.
const STALE_MAX: u32 = 3;
/// Least time between two initialisations, s, which leaves the bus to other sensors.
const RETRY_EVERY_S: f64 = 0.05;

/// An inertial axis whose count repeats for this long has stopped converting, s.
const FROZEN_S: f64 = 2.0;
/// The same for the magnetometer, which is slower; a silent one repeats its last value.
const MAG_FROZEN_S: f64 = 1.0;
/// Longest time between two attempts to set up a part that stays frozen, s. It doubles from attempt to attempt.
const FROZEN_RETRY_MAX_S: f64 = 64.0;

/// Recognises axes that repeat themselves: each has noise, so its count changes.
#[derive(Debug, Clone, Copy)]
struct Repetition<const N: usize> {
    /// The last count of each axis, and when it came.
    last: Option<([i16; N], [f64; N])>,
    patience_s: f64,
    wait_s: f64,
    next_s: f64,
}

impl<const N: usize> Repetition<N> {
    fn new(patience_s: f64) -> Self {
        Self {
            last: None,
            patience_s,
            wait_s: patience_s,
            next_s: 0.0,
        }
    }

    /// Takes the counts of a reading, if it has new ones; true if the part has to be set up again, at once if it is `lost`.
    fn is_due(&mut self, counts: Option<[i16; N]>, lost: bool, now_s: f64) -> bool {
        let first = (counts.unwrap_or([0; N]), [now_s; N]);
        let (last, changed_s) = self.last.get_or_insert(first);
        for (i, count) in counts.iter().flatten().enumerate() {
            if *count != last[i] {
                (last[i], changed_s[i]) = (*count, now_s);
            }
        }
        let repeats = changed_s.iter().any(|t| now_s - t > self.patience_s);
        if now_s < self.next_s || !(repeats || lost) {
            if !repeats && now_s >= self.next_s + self.patience_s {
                self.wait_s = self.patience_s;
            }
            return false;
        }
        *changed_s = [now_s; N];
        self.next_s = now_s + self.wait_s;
        self.wait_s = (2.0 * self.wait_s).min(FROZEN_RETRY_MAX_S);
        true
    }
}

/// Frees the bus of a sensor.
type FreeBus = Box<dyn FnMut(&mut dyn DelayNs) -> BusState + Send>;

/// A sensor that is initialised again when necessary.
pub struct ImuRecovery<S: Imu + ?Sized> {
    sensor: Box<S>,
    free_bus: Option<FreeBus>,
    stale: u32,
    /// Die temperature at the last sample, °C.
    pub temp_c: Option<f64>,
    failures: u32,
    tried_s: Option<f64>,
    init_error: Option<ImuError>,
    restarts: u32,
    inertial: Repetition<6>,
    magnetic: Repetition<3>,
}

impl<S: Imu + ?Sized> ImuRecovery<S> {
    /// Wraps a sensor, which may be uninitialised.
    pub fn new(sensor: Box<S>) -> Self {
        Self {
            sensor,
            free_bus: None,
            stale: 0,
            temp_c: None,
            failures: 0,
            tried_s: None,
            init_error: None,
            restarts: 0,
            inertial: Repetition::new(FROZEN_S),
            magnetic: Repetition::new(MAG_FROZEN_S),
        }
    }

    /// Frees the bus by `free` before every initialisation.
    #[must_use]
    pub fn freeing_bus(
        mut self,
        free: impl FnMut(&mut dyn DelayNs) -> BusState + Send + 'static,
    ) -> Self {
        self.free_bus = Some(Box::new(free));
        self
    }

    /// Initialises the sensor for the first time.
    ///
    /// # Errors
    /// The error of the sensor. [`Self::read`] tries again.
    pub fn start(&mut self, delay: &mut dyn DelayNs) -> Result<Identity, ImuError> {
        let result = self.init(delay);
        self.init_error = result.as_ref().err().copied();
        result
    }

    /// Reads once at time `now`, and initialises the sensor again if that is due.
    pub fn read(&mut self, delay: &mut dyn DelayNs, now: Seconds) -> ImuReading {
        let error = match self.sensor.read() {
            Ok(raw) => {
                (self.failures, self.init_error) = (0, None);
                if let Some(reading) = self.thaw(&raw, delay, now.0) {
                    return reading;
                }
                self.stale = if raw.fresh {
                    0
                } else {
                    self.stale.saturating_add(1)
                };
                if (1..=STALE_MAX).contains(&self.stale) {
                    return ImuReading::Nothing;
                }
                let scale = self.sensor.scale();
                self.temp_c = Some(scale.temperature_c(&raw));
                return ImuReading::Sample(scale.sample(&raw, now), raw.quality());
            }
            Err(error) => error,
        };
        self.failures = match error.fault() {
            // Reading again would only repeat these faults.
            ReadFault::BrownOut | ReadFault::WrongId => self.failures.max(RETRY_AFTER),
            _ => self.failures.saturating_add(1),
        };
        if self.failures < RETRY_AFTER {
            return ImuReading::Failed(error.fault());
        }
        if self.tried_s.is_none_or(|t| now.0 - t >= RETRY_EVERY_S) {
            self.tried_s = Some(now.0);
            self.restarts = self.restarts.saturating_add(1);
            self.init_error = self.init(delay).err();
        }
        ImuReading::Failed(self.init_error.unwrap_or(error).fault())
    }

    /// Sets up what repeats itself. Returns a reading if the inertial chip was set up, which takes the place of the old one.
    fn thaw(&mut self, raw: &RawImu, delay: &mut dyn DelayNs, now_s: f64) -> Option<ImuReading> {
        let ([gx, gy, gz], [ax, ay, az]) = (raw.gyro, raw.acc);
        let inertial = Some([gx, gy, gz, ax, ay, az]);
        if self.inertial.is_due(inertial, false, now_s) {
            self.restarts = self.restarts.saturating_add(1);
            self.init_error = self.init(delay).err();
            let failed = |error: ImuError| ImuReading::Failed(error.fault());
            return Some(self.init_error.map_or(ImuReading::Nothing, failed));
        }
        let lost = matches!(raw.mag_fault, Some(ImuError::ResetToDefaults { .. }));
        if self.magnetic.is_due(raw.mag, lost, now_s) {
            self.restarts = self.restarts.saturating_add(1);
            // if it fails, the magnetometer stays silent, and it is tried again later
            let _ = self.sensor.restart_mag(delay);
        }
        None
    }

    fn init(&mut self, delay: &mut dyn DelayNs) -> Result<Identity, ImuError> {
        if let Some(free) = &mut self.free_bus {
            free(delay);
        }
        self.sensor.init(delay)
    }

    /// Number of initialisations by [`Self::read`].
    pub fn restarts(&self) -> u32 {
        self.restarts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::imu::fake::{FakeBus, FakeIcm20948};
    use crate::hardware::imu::icm20948::{self, Icm20948};

    const DT_S: f64 = 0.002;

    fn recovering() -> (FakeBus, ImuRecovery<Icm20948<FakeBus>>) {
        let bus = FakeBus::new();
        bus.machine().attach(FakeIcm20948::new(0x68, 3));
        let sensor = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
        let mut imu = ImuRecovery::new(Box::new(sensor));
        imu.start(&mut bus.delay()).unwrap();
        (bus, imu)
    }

    /// Reads for a while; returns the number of samples and the last fault.
    fn read_for(
        bus: &FakeBus,
        imu: &mut ImuRecovery<Icm20948<FakeBus>>,
        from_s: f64,
        seconds: f64,
    ) -> (u32, Option<ReadFault>) {
        let (mut samples, mut last) = (0, None);
        for k in 0..(seconds / DT_S) as u32 {
            bus.machine().advance(DT_S);
            match imu.read(&mut bus.delay(), Seconds(from_s + f64::from(k) * DT_S)) {
                ImuReading::Sample(..) => samples += 1,
                ImuReading::Failed(fault) => last = Some(fault),
                ImuReading::Nothing => {}
            }
        }
        (samples, last)
    }

    #[test]
    fn a_chip_that_restarted_is_initialised_at_once() {
        let (bus, mut imu) = recovering();
        assert_eq!(read_for(&bus, &mut imu, 0.0, 0.2), (100, None));
        bus.machine().brown_out();
        let (samples, fault) = read_for(&bus, &mut imu, 1.0, 0.2);
        assert!(
            samples > 80 && fault == Some(ReadFault::BrownOut),
            "{samples} {fault:?}"
        );
        assert_eq!(imu.restarts(), 1);
    }

    #[test]
    fn a_few_lost_readings_do_not_cause_an_initialisation_and_a_dead_bus_does() {
        let (bus, mut imu) = recovering();
        bus.machine().nack(0x68, 10);
        assert_eq!(
            read_for(&bus, &mut imu, 0.0, 0.2),
            (90, Some(ReadFault::Nack))
        );
        assert_eq!(imu.restarts(), 0);
        bus.machine().stuck = true;
        let (samples, fault) = read_for(&bus, &mut imu, 1.0, 0.5);
        assert!(samples == 0 && fault.is_some() && imu.restarts() > 2 && imu.init_error.is_some());
        bus.machine().stuck = false;
        let (samples, _) = read_for(&bus, &mut imu, 2.0, 0.5);
        assert!(samples > 200 && imu.init_error.is_none(), "{samples}");
    }

    /// Polls for `seconds` at a share of the conversion rate with wake-ups that are late by up to a fifth of a period.
    fn polled(share: f64, seconds: f64) -> (u32, u32) {
        let (bus, mut imu) = recovering();
        let converts_hz = icm20948::BASE_RATE_HZ / 2.0;
        let period_s = 1.0 / (share * converts_hz);
        let (mut samples, mut t_s, mut polls) = (0, 0.0, 0_u32);
        while t_s < seconds {
            polls += 1;
            let late_s = if polls % 7 == 0 {
                0.2 / converts_hz
            } else {
                0.0
            };
            let next_s = f64::from(polls) * period_s + late_s;
            bus.machine().advance(next_s - t_s);
            t_s = next_s;
            samples += u32::from(matches!(
                imu.read(&mut bus.delay(), Seconds(t_s)),
                ImuReading::Sample(..)
            ));
        }
        (samples, (seconds * converts_hz) as u32)
    }

    #[test]
    fn every_conversion_is_read_once() {
        let (samples, conversions) = polled(POLL_SHARE, 10.0);
        assert!(
            samples.abs_diff(conversions) <= 2,
            "{samples} of {conversions}"
        );
        let (samples, conversions) = polled(500.0 / 562.5, 10.0);
        assert!(
            samples + 500 < conversions,
            "a slower poll loses conversions, and this test sees it: {samples} of {conversions}"
        );
    }

    #[test]
    fn a_chip_that_stops_converting_is_still_delivered() {
        let (bus, mut imu) = recovering();
        assert_eq!(read_for(&bus, &mut imu, 0.0, 0.1), (50, None));
        bus.machine().spoil(0x68, |q| q.frozen = true);
        assert_eq!(read_for(&bus, &mut imu, 1.0, 0.1), (50 - STALE_MAX, None));
    }

    #[test]
    fn the_bus_is_freed_before_an_initialisation() {
        let (bus, imu) = recovering();
        let held = bus.clone();
        let mut imu = imu.freeing_bus(move |_| {
            held.machine().stuck = false;
            BusState::Freed(3)
        });
        bus.machine().stuck = true;
        let (samples, _) = read_for(&bus, &mut imu, 0.0, 0.5);
        assert!(
            samples > 100 && imu.restarts() == 1,
            "{samples} {}",
            imu.restarts()
        );
    }

    #[test]
    fn the_die_temperature_follows_the_chip() {
        let (bus, mut imu) = recovering();
        assert_eq!(imu.temp_c, None);
        bus.machine()
            .set_motion(&crate::hardware::imu::fake::Motion {
                temp_c: 38.5,
                ..Default::default()
            });
        read_for(&bus, &mut imu, 0.0, 0.1);
        assert!((imu.temp_c.unwrap() - 38.5).abs() < 0.01);
    }

    /// The ways in which a magnetometer falls silent although its chip goes on.
    const LOSSES: [&str; 4] = ["mode", "master", "brown-out", "mode"];

    /// Reads for some seconds and takes away the magnetometer, or its chip's inertial half, at a drawn moment; returns how long the
    /// magnetometer gave nothing new and the inertial axes no sample, at most, and whether the former came back.
    fn lose(loss: &str, two_chips: bool, seed: u64) -> (f64, f64, u32) {
        use crate::hardware::imu::fake::{FakeLis2mdl, FakeLsm6dso};
        use crate::hardware::imu::{lis2mdl, lsm6dso};
        let bus = FakeBus::new();
        let sensor: Box<dyn Imu> = if two_chips {
            bus.machine().attach(FakeLsm6dso::new(0x6A, seed));
            bus.machine().attach(FakeLis2mdl::new(seed));
            let config = lsm6dso::LsmConfig::default();
            Box::new(
                lsm6dso::Lsm6dsoLis2mdl::new(bus.clone(), &config, lsm6dso::Variant::Dso).unwrap(),
            )
        } else {
            bus.machine().attach(FakeIcm20948::new(0x68, seed));
            let config = icm20948::IcmConfig::default();
            Box::new(Icm20948::new(bus.clone(), &config).unwrap())
        };
        let mut imu = ImuRecovery::new(sensor);
        imu.start(&mut bus.delay()).unwrap();
        let lost_at = 1000 + (seed * 7919 % 1000) as u32;
        let (mut last_mag, mut mag_s, mut gyro_s) = (None, 0.0, 0.0);
        let (mut longest_mag_s, mut longest_s): (f64, f64) = (0.0, 0.0);
        for k in 0..6000 {
            if k == lost_at {
                let mut bus = bus.machine();
                let write = |bus: &mut crate::hardware::imu::fake::Machine, bytes: &[u8]| {
                    bus.write(0x68, bytes).unwrap();
                };
                match (loss, two_chips) {
                    (_, true) if loss == "brown-out" => {
                        bus.device(lis2mdl::ADDRESS).unwrap().brown_out();
                    }
                    (_, true) => bus.write(lis2mdl::ADDRESS, &[0x60, 0x03]).unwrap(),
                    ("master", false) => {
                        // EXT_SLV_SENS_DATA keeps its last content, data-ready bit included
                        write(&mut bus, &[0x7F, 0x30]);
                        write(&mut bus, &[0x05, 0x00]);
                        write(&mut bus, &[0x7F, 0x00]);
                    }
                    (_, false) => {
                        let (register, value) = if loss == "mode" {
                            (0x31, 0x00)
                        } else {
                            (0x32, 0x01)
                        };
                        write(&mut bus, &[0x7F, 0x30]);
                        write(&mut bus, &[0x13, 0x0C, register]);
                        write(&mut bus, &[0x16, value]);
                        write(&mut bus, &[0x15, 0x80]);
                        write(&mut bus, &[0x7F, 0x00]);
                    }
                }
            }
            bus.machine().advance(DT_S);
            let t_s = f64::from(k) * DT_S;
            if let ImuReading::Sample(sample, _) = imu.read(&mut bus.delay(), Seconds(t_s)) {
                longest_s = longest_s.max(t_s - gyro_s);
                gyro_s = t_s;
                if sample.mag_ut.is_some() && sample.mag_ut != last_mag {
                    (last_mag, mag_s) = (sample.mag_ut, t_s);
                }
            }
            longest_mag_s = longest_mag_s.max(t_s - mag_s);
        }
        (longest_mag_s, longest_s, imu.restarts())
    }

    #[test]
    fn a_magnetometer_that_falls_silent_is_set_up_again_while_the_other_axes_go_on() {
        for seed in 0..16 {
            let (loss, two) = (LOSSES[seed as usize % 4], seed % 8 > 3);
            let (mag_s, inertial_s, restarts) = lose(loss, two, seed);
            println!(
                "{loss}, two chips {two}: silent for {mag_s:.2} s, no sample for {inertial_s:.3} s, {restarts}"
            );
            assert!(
                mag_s < 1.5 && restarts == 1,
                "{loss} {two}: {mag_s} s, {restarts}"
            );
            assert!(inertial_s < 0.05, "{loss} {two}: {inertial_s} s");
        }
    }

    #[test]
    fn a_chip_that_stays_frozen_is_set_up_at_growing_intervals_and_a_healthy_one_never() {
        let (bus, mut imu) = recovering();
        assert_eq!(read_for(&bus, &mut imu, 0.0, 60.0).1, None);
        assert_eq!(imu.restarts(), 0);
        bus.machine().spoil(0x68, |q| q.frozen = true);
        read_for(&bus, &mut imu, 60.0, 120.0);
        let tried = imu.restarts();
        assert!((5..=16).contains(&tried), "{tried}");
        bus.machine().spoil(0x68, |q| q.frozen = false);
        let (samples, fault) = read_for(&bus, &mut imu, 180.0, 30.0);
        assert!(samples > 14_000 && fault.is_none(), "{samples} {fault:?}");
        bus.machine().spoil(0x68, |q| q.mag_dead = true);
        read_for(&bus, &mut imu, 210.0, 60.0);
        assert!(imu.restarts() - tried < 10, "{}", imu.restarts() - tried);
    }
}
