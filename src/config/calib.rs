//! Calibration files: what this tip is.

use crate::control::learning::batch::Prior;
use crate::control::pi::Dynamics;
use crate::estimation::imu_calibration::ImuCalibration;
use crate::model::transmission::Line;
use crate::primitives::check::{Check, Checker};
use serde::{Deserialize, Serialize};

/// A calibration file.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Extension and backlash.
    pub transmission: TransmissionSection,
    /// Lag and dead time.
    #[serde(default)]
    pub dynamics: DynamicsSection,
    /// The tip IMU's own errors, as `retroflex calibrate imu` writes them.
    #[serde(default)]
    pub imu: ImuCalibration,
}

/// Extension and backlash of the three lines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransmissionSection {
    /// Extension gains k_ε, dimensionless, channel 1 to 3. A larger gain moves the piston further
    /// for the same bellow.
    pub k_epsilon: [f64; 3],
    /// Backlash half-widths k_λ, mm. A larger one makes a larger jump at every reversal.
    pub k_lambda_mm: [f64; 3],
    /// 1 σ of k_ε; default 0.25, the spread between units.
    #[serde(default = "default_k_epsilon_sigma")]
    pub k_epsilon_sigma: [f64; 3],
    /// 1 σ of k_λ, mm; default 0.08.
    #[serde(default = "default_k_lambda_sigma_mm")]
    pub k_lambda_sigma_mm: [f64; 3],
    /// Tip the calibration was made on; empty if it was not said.
    #[serde(default)]
    pub tip: String,
    /// Day of the calibration, `YYYY-MM-DD`; empty if it was not said.
    #[serde(default)]
    pub date: String,
    /// What it was made from: a log, a command, a publication.
    #[serde(default)]
    pub source: String,
}

fn default_k_epsilon_sigma() -> [f64; 3] {
    [0.25; 3]
}
fn default_k_lambda_sigma_mm() -> [f64; 3] {
    [0.08; 3]
}

impl Default for TransmissionSection {
    /// No compensation: where Algorithm 1 starts.
    fn default() -> Self {
        Self {
            k_epsilon: [0.0; 3],
            k_lambda_mm: [0.0; 3],
            k_epsilon_sigma: default_k_epsilon_sigma(),
            k_lambda_sigma_mm: default_k_lambda_sigma_mm(),
            tip: String::new(),
            date: String::new(),
            source: String::new(),
        }
    }
}

/// Lag and dead time from piston to felt bend.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DynamicsSection {
    /// First-order lag τ, s. Default 0.03. Larger leads the feedforward further ahead and raises K_p.
    pub lag_s: f64,
    /// Dead time T, s. Default 0.01. Larger makes the loop more patient.
    pub delay_s: f64,
}

impl Default for DynamicsSection {
    fn default() -> Self {
        Self { lag_s: 0.03, delay_s: 0.01 }
    }
}

impl DynamicsSection {
    /// For the control law.
    #[must_use]
    pub fn law(&self) -> Dynamics {
        Dynamics { lag_s: self.lag_s, delay_s: self.delay_s }
    }
}

impl Calibration {
    /// The transmission law per channel.
    #[must_use]
    pub fn lines(&self) -> [Line; 3] {
        let t = &self.transmission;
        std::array::from_fn(|i| Line { k_epsilon: t.k_epsilon[i], k_lambda_mm: t.k_lambda_mm[i] })
    }

    /// As the prior of a new tip's calibration.
    #[must_use]
    pub fn prior(&self) -> [Prior; 3] {
        let (t, lines) = (&self.transmission, self.lines());
        std::array::from_fn(|i| Prior { line: lines[i], k_epsilon_sigma: t.k_epsilon_sigma[i], k_lambda_sigma_mm: t.k_lambda_sigma_mm[i] })
    }
}

impl Check for Calibration {
    fn check(&self, to: &mut Checker) {
        let t = &self.transmission;
        to.ranges(
            "transmission.k_epsilon",
            &t.k_epsilon,
            0.0..=10.0,
            "",
            "the paper found 2.2 to 2.5; identify it with `retroflex evaluate`",
        );
        to.ranges("transmission.k_lambda_mm", &t.k_lambda_mm, 0.0..=3.0, "mm", "the paper found 0.8 to 0.9 mm");
        to.ranges("transmission.k_epsilon_sigma", &t.k_epsilon_sigma, 1e-4..=5.0, "", "the spread between units is about 0.25");
        to.ranges("transmission.k_lambda_sigma_mm", &t.k_lambda_sigma_mm, 1e-4..=2.0, "mm", "the spread between units is about 0.08 mm");
        to.range("dynamics.lag_s", self.dynamics.lag_s, 0.001..=2.0, "s", "0.03 for a bare tip");
        to.range("dynamics.delay_s", self.dynamics.delay_s, 0.0..=0.3, "s", "0.01 for a local bus");
    }
}
