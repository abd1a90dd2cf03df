//! Causes of a trip, the safe state of each cause, and the limits of the gate.

use serde::{Deserialize, Serialize};

/// A condition that trips the gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TripCause {
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The step generator raised an alarm.
    StepGenerator,
    /// A tick is late.
    Late,
    /// The controller requested motion while the drivers were not armed.
    Unarmed,
    /// The requested position is outside the travel of a piston.
    Travel,
    /// The requested speed of a piston is too high.
    Rate,
    /// The requested acceleration of a piston is too high.
    Acceleration,
    /// The requested position compresses or stretches the air of a line too far.
    Pressure,
    /// The last usable orientation is too old.
    Stale,
    /// The two orientation filters disagree.
    Disagreement,
    /// The tip does not follow the set-point.
    Following,
}

/// Reaction of the gate to a trip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SafeState {
    /// Brake within the limits and stand with the drivers energised; the lines keep their pressure.
    #[default]
    Hold,
    /// Brake, return to zero slowly, then release the drivers.
    Relax,
    /// Release the drivers at once; the air pushes the pistons back.
    Release,
}

/// Limits and safe states. Lengths are in mm, angles in rad and times in s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GateLimits {
    /// Piston travel per microstep, mm.
    pub step_mm: f64,
    /// Nominal period of a tick, s.
    pub tick_s: f64,
    /// Largest travel in either direction, mm.
    pub travel_mm: f64,
    /// Largest piston speed, mm/s.
    pub speed_mm_s: f64,
    /// Largest piston acceleration, mm/s².
    pub acceleration_mm_s2: f64,
    /// Largest length of air that a piston may compress or stretch, mm: the pressure limit divided by the stiffness
    /// in kPa/mm.
    pub squeeze_mm: f64,
    /// Largest distance between estimated bend and set-point while the set-point rests, rad.
    pub following_rad: f64,
    /// Increase of that distance per rad/s of recent set-point speed, s.
    pub following_s: f64,
    /// Time for which the distance may be exceeded, s.
    pub following_for_s: f64,
    /// Largest age of the last usable orientation, s.
    pub stale_s: f64,
    /// Largest time between two ticks, s.
    pub late_s: f64,
    /// Deceleration of the gate's own motion, mm/s².
    pub brake_mm_s2: f64,
    /// Speed of the return to zero, mm/s.
    pub relax_mm_s: f64,
    /// Safe state of each cause.
    pub on: SafeStates,
}

/// Safe state of each cause (`[safety.on]` of the board file).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SafeStates {
    /// Emergency stop pressed. Default `release`.
    pub emergency_stop: SafeState,
    /// Alarm of the step generator. Default `hold`.
    pub step_generator: SafeState,
    /// Late tick. Default `hold`.
    pub late: SafeState,
    /// Motion while not armed. Default `hold`.
    pub unarmed: SafeState,
    /// Travel. Default `hold`.
    pub travel: SafeState,
    /// Speed. Default `hold`.
    pub rate: SafeState,
    /// Acceleration. Default `hold`.
    pub acceleration: SafeState,
    /// Pressure. Default `relax`.
    pub pressure: SafeState,
    /// Stale orientation. Default `hold`.
    pub stale: SafeState,
    /// Filters disagree. Default `hold`.
    pub disagreement: SafeState,
    /// Following error. Default `hold`.
    pub following: SafeState,
}

impl Default for SafeStates {
    fn default() -> Self {
        let hold = SafeState::Hold;
        Self {
            emergency_stop: SafeState::Release,
            step_generator: hold,
            late: hold,
            unarmed: hold,
            travel: hold,
            rate: hold,
            acceleration: hold,
            pressure: SafeState::Relax,
            stale: hold,
            disagreement: hold,
            following: hold,
        }
    }
}

impl SafeStates {
    /// Returns the safe state of `cause`.
    #[must_use]
    pub fn of(&self, cause: TripCause) -> SafeState {
        match cause {
            TripCause::EmergencyStop => self.emergency_stop,
            TripCause::StepGenerator => self.step_generator,
            TripCause::Late => self.late,
            TripCause::Unarmed => self.unarmed,
            TripCause::Travel => self.travel,
            TripCause::Rate => self.rate,
            TripCause::Acceleration => self.acceleration,
            TripCause::Pressure => self.pressure,
            TripCause::Stale => self.stale,
            TripCause::Disagreement => self.disagreement,
            TripCause::Following => self.following,
        }
    }
}
