//! What becomes of an effect once it is named. `gap diagnose` advises it, and `gap apply` does it.

use crate::model::effects::{Effect, Stage, by_name};
use crate::named;

named! {
    /// What becomes of an effect; the advice says what to do, as the end of a sentence.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Remedy {
        /// It happens once: its cause is mended, and nothing is fed forward.
        Mend = "mend": "mend the cause, which acted once",
        /// A calibration file holds it.
        Calibrate = "calibrate": "write it into the calibration with `gap apply --calib`",
        /// It drifts, and the service estimates it while it runs.
        Estimate = "estimate": "leave it to the service, which estimates it while it runs",
        /// `retroflex calibrate imu motors` identifies it.
        Motors = "motors": "identify it with `calibrate imu motors`",
        /// The feedforward follows its inverse.
        Feedforward = "feedforward": "feed it forward with `gap apply`",
    }
}

impl Remedy {
    /// The remedy of the effect of this name, if there is such an effect.
    pub fn named(name: &str) -> Option<Self> {
        by_name(name).map(Self::of)
    }

    /// The remedy of an effect.
    pub fn of(e: &dyn Effect) -> Self {
        match e.name() {
            _ if e.info().is_event() => Self::Mend,
            "gyro_bias" => Self::Estimate,
            "motor_field" => Self::Motors,
            _ if e.stage() == Stage::Timing || e.sensing_only() => Self::Calibrate,
            _ => Self::Feedforward,
        }
    }
}
