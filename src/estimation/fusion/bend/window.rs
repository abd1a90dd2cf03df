//! Readings between two corrections, averaged in the axes of the base.
//!
//! An error of the orientation is on the left of S, so it is the same for every sample of a window, however far the tip
//! turns within it. One correction per window therefore does what one per sample would do.

use crate::estimation::fusion::intake::Mean;
use nalgebra::{Matrix3, Vector3};

/// Sum of readings of a world-fixed vector, turned into the base.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Direction {
    sum: Vector3<f64>,
    turns: Matrix3<f64>,
    /// Number of readings.
    pub n: u32,
}

impl Direction {
    /// Adds a reading without its bias, and the orientation in which it was taken.
    pub fn add(&mut self, reading: &Vector3<f64>, s: &Matrix3<f64>) {
        self.sum += s * reading;
        self.turns += s;
        self.n += 1;
    }
    /// Mean reading.
    pub fn mean(&self) -> Vector3<f64> {
        self.sum / f64::from(self.n.max(1))
    }
    /// Slope of the mean, less the reading during alignment, by the bias: the mean orientation less the first.
    pub fn by_bias(&self) -> Matrix3<f64> {
        self.turns / f64::from(self.n.max(1)) - Matrix3::identity()
    }
}

/// Everything between two corrections.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Window {
    /// Duration, s.
    pub length_s: f64,
    /// Number of samples.
    pub samples: u32,
    /// ∫ S dt, s.
    pub turns_s: Matrix3<f64>,
    /// ∫ S diag(ω) dt, rad.
    pub scaled: Matrix3<f64>,
    /// ∫ S ω dt: angle by which the tip has turned, axes of the base, rad.
    pub turned: Vector3<f64>,
    /// ∫ |ω| dt, rad.
    pub path: f64,
    /// Specific force, m/s².
    pub acc: Direction,
    /// Field, µT.
    pub mag: Direction,
    /// Changes of specific force and field since alignment that the base measures, in its present axes.
    pub base_acc: Mean,
    pub base_mag: Mean,
    /// Sum of the rates while the pistons stand, without bias, tip axes, rad/s.
    pub still: Vector3<f64>,
    /// Number of these rates.
    pub still_n: u32,
}
