//! Causes of a trip, the safe state of each cause, and the limits of the gate.

use crate::{choices, named, parameters};
use serde::{Deserialize, Serialize};

named! {
    /// A condition that trips the gate.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum TripCause {
        /// The emergency stop is pressed.
        EmergencyStop = "emergency_stop": "the emergency stop is pressed: release it, then `retroflex reset-fault`",
        /// The step generator raised an alarm.
        StepGenerator = "step_generator": "the step generator raised an alarm: see `remarks`, then `retroflex reset-fault`",
        /// A tick is late.
        Late = "late": "the control loop was delayed: check real-time limits and load with `retroflex doctor`",
        /// The controller requested motion while the drivers were not armed.
        Unarmed = "unarmed": "motion was commanded while disarmed: this is a defect of the program, please report it",
        /// The requested position is outside the travel of a piston.
        Travel = "travel": "a piston would have left its travel: see [limits] of the board file",
        /// A piston is counted faster than permitted.
        Rate = "rate": "a piston would have exceeded its speed: see [motion] of the board file",
        /// The counted acceleration of a piston is too high.
        Acceleration = "acceleration": "a piston would have exceeded its acceleration: see [motion] of the board file",
        /// The requested position compresses or stretches the air of a line too far, or a sensor measures too much pressure.
        Pressure = "pressure": "the pressure of a line was or would have been too high: look for a kink and at `alarm`, or relax and calibrate again",
        /// The tip is too hot.
        Temperature = "temperature": "the tip is hotter than safety.tip_max_c: withdraw it, and let it cool before `retroflex reset-fault`",
        /// The last usable orientation is too old.
        Stale = "stale": "no usable orientation for too long: check the cable of the IMU; `retroflex doctor`",
        /// The two orientation filters disagree.
        Disagreement = "disagreement": "the two orientation filters disagree: `retroflex relax`, then `retroflex zero`",
        /// The tip does not follow the set-point.
        Following = "following": "the tip does not follow its set-point: see the suspected cause",
    }
}

choices! {
    /// Reaction of the gate to a trip.
    pub enum SafeState {
        /// Brake within the limits and stand, energised: the tip keeps its pressure.
        Hold = "hold",
        /// Brake, return to zero slowly, then release.
        Relax = "relax",
        /// Release the drivers at once: the air pushes the pistons back.
        Release = "release",
    }
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
    /// Time that the machine needs to begin to brake, s.
    pub react_s: f64,
    /// Time for which the counts must be those sent until the machine certainly rests, s.
    pub rest_s: f64,
    /// Deceleration of the gate's own motion, mm/s².
    pub brake_mm_s2: f64,
    /// Speed of the return to zero, mm/s.
    pub relax_mm_s: f64,
    /// Safe state of each cause.
    pub on: SafeStates,
}

parameters! {
    /// Safe state of each cause: `hold` (brake and stand, energised: the tip keeps its bend), `relax` (brake, return to zero
    /// slowly, then release the drivers) or `release` (release the drivers at once: the tip goes soft and straight by its own
    /// air, and zero must be found again).
    pub struct SafeStates: Copy, Eq by TripCause -> SafeState {
        /// The emergency stop is pressed. The step thread reacts by itself: `release` takes the current away at once; anything
        /// else brakes within the limits and keeps pressure on tissue.
        emergency_stop of EmergencyStop: SafeState = SafeState::Release;
        /// Alarm of the step thread: late, starved, torn motion, pins. What was pulsed is counted.
        step_generator of StepGenerator: SafeState = SafeState::Hold;
        /// A turn of the loop came late; motion stands.
        late of Late: SafeState = SafeState::Hold;
        /// Motion was commanded while not armed: a software fault, and nothing has moved.
        unarmed of Unarmed: SafeState = SafeState::Hold;
        /// A piston would leave its travel; the tip is not at fault.
        travel of Travel: SafeState = SafeState::Hold;
        /// A piston is too fast.
        rate of Rate: SafeState = SafeState::Hold;
        /// A piston is accelerated too strongly.
        acceleration of Acceleration: SafeState = SafeState::Hold;
        /// A line would be compressed too far: less pressure is the way out.
        pressure of Pressure: SafeState = SafeState::Relax;
        /// The tip is hotter than `safety.tip_max_c`. Motion does not cool it; `relax` prepares its withdrawal.
        temperature of Temperature: SafeState = SafeState::Hold;
        /// No usable orientation for too long: a bus often recovers within a second.
        stale of Stale: SafeState = SafeState::Hold;
        /// The two orientation filters disagree; one of them may be right.
        disagreement of Disagreement: SafeState = SafeState::Hold;
        /// The tip does not follow its set-point. `relax` suits places where tissue may be caught.
        following of Following: SafeState = SafeState::Hold;
    }
}
