//! The result of assessing one reading.

use super::cause::{CauseSet, HealthCause};

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

/// Causes that have been cleared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recovered {
    /// The causes that this reading cleared.
    pub causes: CauseSet,
    /// The longest time that any of them was in force, s.
    pub after_s: f64,
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
    /// No usable gyroscope sample for longer than [`super::HealthConfig::blind_max_s`].
    pub blind: bool,
    /// Faults of this reading.
    pub faults: CauseSet,
    /// Causes in force, including those that are recovering.
    pub in_force: CauseSet,
    /// Causes that came into force with this reading.
    pub raised: CauseSet,
    /// The jumps rejected just before were true: enough readings in a row agree with them.
    pub confirmed: bool,
    /// Causes that this reading cleared, if any.
    pub recovered: Option<Recovered>,
}

impl HealthVerdict {
    /// The strictest consequence of the verdict.
    pub fn action(&self) -> HealthAction {
        let magnetic = |c| {
            matches!(
                c,
                HealthCause::MagOverflow | HealthCause::MagSilent | HealthCause::FieldDisturbed
            )
        };
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
