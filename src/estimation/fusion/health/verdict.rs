//! What the judge answers.

use super::cause::{CauseSet, HealthCause};

/// The harshest thing a verdict asks for, in rising order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum HealthAction {
    /// Use everything there is.
    Use,
    /// Gyroscope and accelerometer only.
    GravityOnly,
    /// Gyroscope only.
    CoastOnGyro,
    /// Nothing of this reading.
    Skip,
    /// Nothing may move.
    Hold,
}

/// A fault that is over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recovered {
    /// The causes that were cleared by this reading.
    pub causes: CauseSet,
    /// The longest any of them was in force, s.
    pub after_s: f64,
}

/// What may be done with one reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HealthVerdict {
    /// The filter may integrate the gyroscope.
    pub gyro: bool,
    /// The filter may correct with the accelerometer.
    pub acc: bool,
    /// The filter may correct with the magnetometer (there is a new value and it is sound).
    pub mag: bool,
    /// The pistons must be held.
    pub hold: bool,
    /// No usable gyroscope sample for longer than [`super::HealthConfig::blind_max_s`].
    pub blind: bool,
    /// What is wrong with this very reading.
    pub faults: CauseSet,
    /// What is still counted against the sensor, recovering causes included.
    pub in_force: CauseSet,
    /// Causes that came into force with this reading.
    pub raised: CauseSet,
    /// The leaps that were refused just before were true: enough readings in a row have said the same.
    pub confirmed: bool,
    /// Causes that this reading cleared, if any.
    pub recovered: Option<Recovered>,
}

impl HealthVerdict {
    /// The verdict in one word.
    #[must_use]
    pub fn action(&self) -> HealthAction {
        let shut_out = |c: &HealthCause| matches!(c, HealthCause::MagOverflow | HealthCause::MagSilent | HealthCause::FieldDisturbed);
        if self.hold {
            HealthAction::Hold
        } else if !self.gyro {
            HealthAction::Skip
        } else if !self.acc {
            HealthAction::CoastOnGyro
        } else if !self.mag && self.in_force.iter().any(|c| shut_out(&c)) {
            HealthAction::GravityOnly
        } else {
            HealthAction::Use
        }
    }
}
