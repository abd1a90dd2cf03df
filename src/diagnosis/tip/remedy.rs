//! What becomes of an effect once it is named. `gap diagnose` advises it, and `gap apply` does it.

use crate::model::effects::{Effect, Stage};

/// What becomes of an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Remedy {
    /// It happens once: its cause is mended, and nothing is fed forward.
    Mend,
    /// A calibration file holds it.
    Calibrate,
    /// It drifts, and the service estimates it while it runs.
    Estimate,
    /// `retroflex calibrate imu motors` identifies it.
    Motors,
    /// The feedforward follows its inverse.
    Feedforward,
}

impl Remedy {
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

    /// What to do, as the end of a sentence.
    pub fn advice(self) -> &'static str {
        match self {
            Self::Mend => "mend the cause, which acted once",
            Self::Calibrate => "write it into the calibration with `gap apply --calib`",
            Self::Estimate => "leave it to the service, which estimates it while it runs",
            Self::Motors => "identify it with `calibrate imu motors`",
            Self::Feedforward => "feed it forward with `gap apply`",
        }
    }
}
