//! Air that warms: a slow offset that follows the time since the start and no command.
//!
//! Motors warm the case and the case warms the air, two thermal masses in series:
//! `a (1 − (τ₂ e^(−t/τ₂) − τ₁ e^(−t/τ₁)) / (τ₂ − τ₁))`, which starts without a slope.

use crate::plant::cause::{Cause, largest, scale_all};
use crate::plant::check::{PlantError, range, ranges};
use crate::plant::lot::Lot;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.thermal_drift]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThermalDrift {
    /// Final offset a of each line, mm of piston. Default 0 (none); typical 0.2 to 2.5 on one line
    /// (0.5 to 7° of bend). Equal offsets lengthen the tip and do not bend it. Bigger drifts further.
    pub offset_mm: [f64; 3],
    /// Time constant τ₁ of the air, s. Default 20. Bigger starts more softly.
    pub air_s: f64,
    /// Time constant τ₂ of the case, s. Default 90. Bigger drifts for longer.
    pub case_s: f64,
}

impl Default for ThermalDrift {
    fn default() -> Self {
        Self { offset_mm: [0.0; 3], air_s: 20.0, case_s: 90.0 }
    }
}

impl Cause for ThermalDrift {
    fn check(&self) -> Result<(), PlantError> {
        ranges("effects.thermal_drift.offset_mm", &self.offset_mm, -20.0..=20.0, "a few mm at most are typical")?;
        range("effects.thermal_drift.air_s", self.air_s, 0.1..=1e5, "tens of seconds are typical")?;
        range("effects.thermal_drift.case_s", self.case_s, 0.1..=1e5, "minutes are typical")
    }
    fn size(&self) -> f64 {
        largest(&self.offset_mm)
    }
    fn scale(&mut self, factor: f64) {
        scale_all(&mut self.offset_mm, factor);
    }
    fn draw(severity: f64, lot: &mut Lot) -> Self {
        let size = lot.sized(0.4, 3.0, severity);
        let main = lot.channel() - 1;
        let sign = lot.sign();
        let share = lot.between(-0.4, 0.4);
        let mut offset_mm = [size * sign * share; 3];
        offset_mm[main] = size * sign;
        Self { offset_mm, air_s: lot.between(6.0, 25.0), case_s: lot.between(30.0, 120.0) }
    }
}

impl ThermalDrift {
    /// Offset of the three lines at `t` seconds since the start, mm of piston.
    pub(crate) fn offset_mm(&self, t: f64) -> Vector3<f64> {
        // equal masses are the limit of unequal ones; a hair apart they are told apart stably
        let case_s = if (self.case_s / self.air_s - 1.0).abs() < 1e-3 { self.case_s * 1.002 } else { self.case_s };
        let cooling = case_s * (-t / case_s).exp() - self.air_s * (-t / self.air_s).exp();
        Vector3::from(self.offset_mm) * (1.0 - cooling / (case_s - self.air_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_softly_and_ends_at_its_size() {
        for case_s in [90.0, 20.0] {
            let d = ThermalDrift { offset_mm: [1.0, 0.0, -0.5], case_s, ..ThermalDrift::default() };
            assert!(d.offset_mm(0.0).norm() < 1e-9 && d.offset_mm(1.0).norm() < 2e-3);
            assert!((d.offset_mm(2000.0) - Vector3::new(1.0, 0.0, -0.5)).norm() < 1e-4);
            assert!((0..300).all(|k| d.offset_mm(f64::from(k) + 1.0).x > d.offset_mm(f64::from(k)).x));
        }
    }
}
