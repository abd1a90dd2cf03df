//! Online refinement of k_ε: whether the observer's gains are taken, and how far.

use crate::model::Line;
use crate::parameters;

parameters! {
    /// Online refinement of the transmission gains: guards.
    pub struct RefineConfig: Copy {
        /// Learns k_ε and k_λ during operation.
        enabled: bool = true;
        /// Range of k_ε around the calibration, as a fraction of 1 + k_ε. A larger value follows a worn tip further, and a fault
        /// as well.
        range: f64 = 0.5, "", 0.01..=2.0, "0.5 allows half of 1 + k_ε either way";
    }
}

impl RefineConfig {
    /// Least and largest k_ε, and k_λ in mm, of a channel with this calibration.
    pub fn bounds(&self, prior: &Line) -> [[f64; 2]; 2] {
        let around = |x: f64, range: f64| [(x - range).max(0.0), x + range];
        [
            around(prior.k_epsilon, self.range * (1.0 + prior.k_epsilon)),
            around(prior.k_lambda_mm, LAMBDA_RANGE_MM),
        ]
    }
}

/// Largest distance of k_λ from the calibration, mm.
pub const LAMBDA_RANGE_MM: f64 = 0.8;
