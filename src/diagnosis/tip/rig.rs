//! The machine that a log was recorded on, as far as a diagnosis depends on it.

use crate::model::{Geometry, Line};

/// Geometry, prior gains and limits of a machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rig {
    /// Geometry of the bending section.
    pub geometry: Geometry,
    /// Centre of the prior of each line's gains.
    pub prior: Line,
    /// Centre of the prior of the mechanical lag τ₀, s.
    pub prior_lag_s: f64,
    /// Shortest and longest bellow, mm.
    pub bellow_mm: [f64; 2],
    /// Piston travel either way from rest, mm.
    pub travel_mm: f64,
    /// Largest piston speed, mm/s.
    pub speed_max_mm_s: f64,
}

impl Default for Rig {
    /// The machine of the paper. The prior gains are rounded means of the paper's three lines.
    fn default() -> Self {
        Self {
            geometry: Geometry::default(),
            prior: Line {
                k_epsilon: 2.2,
                k_lambda_mm: 0.87,
            },
            prior_lag_s: 0.025,
            bellow_mm: [14.0, 29.0],
            travel_mm: 30.0,
            speed_max_mm_s: 30.0,
        }
    }
}
