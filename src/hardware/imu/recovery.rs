//! Keeps a sensor going: reads it, and sets it up again when reading alone will not help.
//!
//! ```text
//! read ── good ─────────────────────────────▶ Sample
//!   ├── restarted, or another chip ──▶ init ─▶ Failed (and Sample from the next reading on)
//!   └── failed `retry_after` times ──▶ init ─▶ Failed, with what stands in its way
//! ```
//!
//! An init takes up to half a second, so the supervisor lives in the sensor's own thread, never in the
//! loop's; the loop meanwhile sees failures and silence, and its judge holds the pistons. What comes out is
//! scaled and stamped but not corrected: the loop does that. Time comes in with the call.

use super::{Identity, Imu, ImuError};
use crate::estimation::fusion::health::{ImuReading, ReadFault};
use crate::primitives::units::Seconds;
use embedded_hal::delay::DelayNs;
use serde::Deserialize;

/// When to set a sensor up again.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecoveryConfig {
    /// Failed readings in a row after which the chip is set up again. Default 25 (50 ms at 500 Hz). Larger
    /// waits longer before it interferes; a chip that says it restarted is set up at once.
    pub retry_after: u32,
    /// Least time between two attempts, s. Default 0.05. Larger leaves the bus to others for longer.
    pub retry_every_s: f64,
}

impl Default for RecoveryConfig {
    fn default() -> Self {
        Self { retry_after: 25, retry_every_s: 0.05 }
    }
}

/// A sensor and its keeper.
pub struct ImuRecovery<S: Imu + ?Sized> {
    config: RecoveryConfig,
    failures: u32,
    tried_s: Option<f64>,
    in_the_way: Option<ImuError>,
    restarts: u32,
    sensor: Box<S>,
}

impl<S: Imu + ?Sized> ImuRecovery<S> {
    /// Over a sensor that need not be set up yet.
    #[must_use]
    pub fn new(sensor: Box<S>, config: RecoveryConfig) -> Self {
        Self { config, failures: 0, tried_s: None, in_the_way: None, restarts: 0, sensor }
    }

    /// Sets the sensor up for the first time.
    ///
    /// # Errors
    /// The sensor's; [`Self::read`] will go on trying.
    pub fn start(&mut self, delay: &mut dyn DelayNs) -> Result<Identity, ImuError> {
        let said = self.sensor.init(delay);
        self.in_the_way = said.as_ref().err().copied();
        said
    }

    /// One reading at `now`, and an attempt to set the sensor up again where that is due.
    pub fn read(&mut self, delay: &mut dyn DelayNs, now: Seconds) -> ImuReading {
        let scale = self.sensor.scale();
        let error = match self.sensor.read() {
            Ok(raw) => {
                (self.failures, self.in_the_way) = (0, None);
                return ImuReading::Sample(scale.sample(&raw, now), raw.quality());
            }
            Err(error) => error,
        };
        self.failures = match error.fault() {
            // reading on would say the same for ever
            ReadFault::BrownOut | ReadFault::WrongId => self.failures.max(self.config.retry_after),
            _ => self.failures.saturating_add(1),
        };
        if self.failures >= self.config.retry_after {
            if self.tried_s.is_none_or(|t| now.0 - t >= self.config.retry_every_s) {
                self.tried_s = Some(now.0);
                self.restarts = self.restarts.saturating_add(1);
                self.in_the_way = self.sensor.init(delay).err();
            }
            // what stands in the way of setting it up is what is wrong
            return ImuReading::Failed(self.in_the_way.unwrap_or(error).fault());
        }
        ImuReading::Failed(error.fault())
    }

    /// How often the sensor was set up again.
    #[must_use]
    pub fn restarts(&self) -> u32 {
        self.restarts
    }
    /// Why it cannot be set up at present.
    #[must_use]
    pub fn in_the_way(&self) -> Option<ImuError> {
        self.in_the_way
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::imu::fake::{FakeBus, FakeIcm20948};
    use crate::hardware::imu::icm20948::{self, Icm20948};

    const DT_S: f64 = 0.002;

    fn watched() -> (FakeBus, ImuRecovery<Icm20948<FakeBus>>) {
        let bus = FakeBus::new();
        bus.machine().attach(FakeIcm20948::new(0x68, 3));
        let sensor = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
        let mut watched = ImuRecovery::new(Box::new(sensor), RecoveryConfig::default());
        watched.start(&mut bus.delay()).unwrap();
        (bus, watched)
    }

    /// Reads for a while; how many samples came and which fault was said last.
    fn live(bus: &FakeBus, watched: &mut ImuRecovery<Icm20948<FakeBus>>, from_s: f64, seconds: f64) -> (u32, Option<ReadFault>) {
        let (mut samples, mut last) = (0, None);
        for k in 0..(seconds / DT_S) as u32 {
            bus.machine().advance(DT_S);
            match watched.read(&mut bus.delay(), Seconds(from_s + f64::from(k) * DT_S)) {
                ImuReading::Sample(..) => samples += 1,
                ImuReading::Failed(fault) => last = Some(fault),
                ImuReading::Nothing => {}
            }
        }
        (samples, last)
    }

    #[test]
    fn a_chip_that_restarted_is_set_up_at_once() {
        let (bus, mut watched) = watched();
        assert_eq!(live(&bus, &mut watched, 0.0, 0.2), (100, None));
        bus.machine().brown_out();
        let (samples, fault) = live(&bus, &mut watched, 1.0, 0.2);
        assert!(samples > 80 && fault == Some(ReadFault::BrownOut), "{samples} {fault:?}");
        assert_eq!(watched.restarts(), 1);
    }

    #[test]
    fn a_few_lost_readings_are_no_reason_and_a_dead_bus_is_tried_in_vain() {
        let (bus, mut watched) = watched();
        bus.machine().nack(0x68, 10);
        assert_eq!(live(&bus, &mut watched, 0.0, 0.2), (90, Some(ReadFault::Nack)));
        assert_eq!(watched.restarts(), 0);
        bus.machine().stuck = true;
        let (samples, fault) = live(&bus, &mut watched, 1.0, 0.5);
        assert!(samples == 0 && fault.is_some() && watched.restarts() > 2 && watched.in_the_way().is_some());
        bus.machine().stuck = false;
        let (samples, _) = live(&bus, &mut watched, 2.0, 0.5);
        assert!(samples > 200 && watched.in_the_way().is_none(), "{samples}");
    }
}
