//! The monitor: tracks every cause over time and derives the verdict.

use super::cause::{CauseSet, HealthCause};
use super::checks::{Checks, Findings, KnownErrors};
use super::config::{HealthConfig, Policy};
use crate::estimation::fusion::align::Alignment;
use crate::primitives::{ImuReading, Seconds};

/// A disturbance that returns within this time counts as the same one, s.
const RETURN_S: f64 = 60.0;
/// Number of returns up to which the recovery time doubles: 2¹⁰ times ten values at 100 Hz are 100 s.
const RETURNS_MAX: u32 = 10;

/// History of one cause.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Track {
    /// Time at which it came into force, s; `None` while it is clear.
    since: Option<f64>,
    /// Good readings in a row since.
    good: u32,
    /// Time at which it was last cleared, s.
    cleared: Option<f64>,
    /// Returns in a row, each within [`RETURN_S`].
    returns: u32,
}

/// The strictest consequence of a verdict, in rising order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub enum HealthAction {
    /// Use all sensors.
    Use,
    /// Use gyroscope and accelerometer only.
    GravityOnly,
    /// Use the gyroscope only.
    CoastOnGyro,
    /// Use nothing of this reading.
    Skip,
    /// Hold the pistons.
    Hold,
}

/// What may be done with one reading.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HealthVerdict {
    /// The filter may integrate the gyroscope.
    pub gyro: bool,
    /// The filter may correct with the accelerometer.
    pub acc: bool,
    /// The filter may correct with the magnetometer: there is a new, valid value.
    pub mag: bool,
    /// The pistons must be held.
    pub hold: bool,
    /// No usable gyroscope sample for longer than [`HealthConfig::blind_max_s`].
    pub blind: bool,
    /// Faults of this reading.
    pub faults: CauseSet,
    /// Causes in force, including those that are recovering.
    pub in_force: CauseSet,
    /// Causes that came into force with this reading.
    pub raised: CauseSet,
    /// The jumps rejected just before were true: enough readings in a row agree with them.
    pub confirmed: bool,
    /// Causes that this reading cleared.
    pub recovered: CauseSet,
}

impl HealthVerdict {
    /// The strictest consequence of the verdict.
    pub fn action(&self) -> HealthAction {
        use HealthCause::{FieldDisturbed, MagOverflow, MagSilent};
        let magnetic = |c| matches!(c, MagOverflow | MagSilent | FieldDisturbed);
        if self.hold {
            HealthAction::Hold
        } else if !self.gyro {
            HealthAction::Skip
        } else if !self.acc {
            HealthAction::CoastOnGyro
        } else if !self.mag && self.in_force.iter().any(magnetic) {
            HealthAction::GravityOnly
        } else {
            HealthAction::Use
        }
    }
}

/// Assesses the readings of one sensor. It has a fixed size and is cloned for replay.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SensorMonitor {
    tracks: [Track; HealthCause::ALL.len()],
    checks: Checks,
    /// Time of the last usable gyroscope sample, s.
    used_s: Option<f64>,
    verdict: Option<HealthVerdict>,
}

impl SensorMonitor {
    /// Sets the estimated sensor errors, and the alignment from whose raw means the references of gravity and field are
    /// computed.
    pub fn set_known(&mut self, known: KnownErrors, rest: &Alignment) {
        self.checks.set_known(known, rest);
    }
    /// The verdict on the last reading.
    pub fn verdict(&self) -> Option<HealthVerdict> {
        self.verdict
    }
    fn track(&self, cause: HealthCause) -> &Track {
        &self.tracks[cause as usize]
    }

    /// Assesses one reading; `now` is on the clock of the sample stamps.
    pub fn assess(
        &mut self,
        config: &HealthConfig,
        now: Seconds,
        reading: &ImuReading,
    ) -> HealthVerdict {
        let shaken = self.track(HealthCause::AccelDisturbed).since.is_some();
        let found = self.checks.inspect(config, now.0, reading, shaken);
        let mut verdict = HealthVerdict {
            faults: found.faults,
            confirmed: found.confirmed,
            ..HealthVerdict::default()
        };
        self.update_tracks(config, now.0, &found, &mut verdict);
        self.apply_policies(config, now.0, reading, &mut verdict);
        *self.verdict.insert(verdict)
    }

    /// Advances the track of every cause by one reading, and notes the causes raised and those cleared.
    fn update_tracks(
        &mut self,
        config: &HealthConfig,
        now: f64,
        found: &Findings,
        verdict: &mut HealthVerdict,
    ) {
        for cause in HealthCause::ALL {
            let track = &mut self.tracks[cause as usize];
            if found.faults.contains(cause) {
                track.good = 0;
                if track.since.is_none() {
                    track.since = Some(now);
                    let soon = track.cleared.is_some_and(|at| now - at < RETURN_S);
                    let again = track.returns.saturating_add(1);
                    track.returns = if soon { again } else { 0 };
                    verdict.raised.insert(cause);
                }
            } else if track.since.is_some() && found.tested.contains(cause) {
                track.good += 1;
                if track.good >= readings_to_clear(config, cause, track.returns) {
                    (track.since, track.cleared) = (None, Some(now));
                    verdict.recovered.insert(cause);
                }
            }
        }
    }

    /// Applies the policies of all causes in force to the reading.
    fn apply_policies(
        &mut self,
        config: &HealthConfig,
        now: f64,
        reading: &ImuReading,
        verdict: &mut HealthVerdict,
    ) {
        let (sample, faults) = (reading.sample(), verdict.faults);
        verdict.gyro = sample.is_some();
        verdict.acc = sample.is_some();
        verdict.mag = sample.is_some_and(|s| s.mag_ut.is_some());
        let in_force = |cause: &HealthCause| self.track(*cause).since.is_some();
        verdict.in_force = HealthCause::ALL.into_iter().filter(in_force).collect();
        for cause in verdict.in_force.iter() {
            let since = self.track(cause).since.unwrap_or(now);
            match config.policy.of(cause) {
                Policy::Skip => verdict.gyro &= !faults.contains(cause),
                Policy::GravityOnly => verdict.mag = false,
                Policy::CoastOnGyro { for_s } => {
                    (verdict.acc, verdict.mag) = (false, false);
                    verdict.hold |= now - since > for_s;
                }
                Policy::Hold => {
                    verdict.hold = true;
                    verdict.gyro &= !faults.contains(cause);
                }
            }
        }
        // under any policy: it would corrupt the filter
        verdict.gyro &= !faults.contains(HealthCause::NotFinite);
        let used = *self.used_s.get_or_insert(now);
        verdict.blind = !verdict.gyro && now - used > config.blind_max_s;
        if verdict.gyro {
            self.used_s = Some(now);
        }
        verdict.acc &= verdict.gyro;
        verdict.mag &= verdict.gyro;
        verdict.hold |= verdict.blind;
    }
}

/// Good readings in a row that clear a cause. A field that motors disturb again and again matches the reference now
/// and then by chance, so every return doubles the number.
fn readings_to_clear(config: &HealthConfig, cause: HealthCause, returns: u32) -> u32 {
    match cause {
        HealthCause::FieldDisturbed => config
            .recover_mag_samples
            .saturating_mul(1 << returns.min(RETURNS_MAX)),
        HealthCause::MagOverflow | HealthCause::MagSilent => config.recover_mag_samples,
        HealthCause::AccelDisturbed => config.recover_acc_samples,
        _ => config.recover_samples,
    }
}
