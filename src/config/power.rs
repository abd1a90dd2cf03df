//! `[power]`: what trapped pressure does to a motor without current. The safe states of `[safety]` follow
//! from it.
//!
//! Law: a gauge pressure p behind a piston of area A pushes the rack with F = p A and turns the pinion
//! with M = F d/2 (d: pitch diameter). A motor without current resists with its detent torque. Where
//! M exceeds it the rack runs back until F d/2 is the detent torque again, and the tip relaxes by as
//! much; the count of steps is then worth nothing.

use crate::config::board::LimitsSection;
use crate::primitives::check::Checker;
use serde::Deserialize;

/// What pressure does to a motor without current.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PowerSection {
    /// Area of a piston, mm². Default 201: a syringe of 16 mm bore. Larger pushes the rack back harder.
    pub piston_area_mm2: f64,
    /// Torque that the energised motor holds, N·mm. Default 260. Must exceed what the largest pressure
    /// can turn.
    pub holding_torque_n_mm: f64,
    /// Torque that the motor resists with no current, N·mm. Default 15. Larger keeps more of the bend
    /// when the power fails.
    pub detent_torque_n_mm: f64,
}

impl Default for PowerSection {
    fn default() -> Self {
        Self { piston_area_mm2: 201.0, holding_torque_n_mm: 260.0, detent_torque_n_mm: 15.0 }
    }
}

impl PowerSection {
    /// Torque of a gauge pressure on the motor, N·mm.
    #[must_use]
    pub fn torque_n_mm(&self, pressure_kpa: f64, pitch_diameter_mm: f64) -> f64 {
        pressure_kpa.abs() * 1e-3 * self.piston_area_mm2 * 0.5 * pitch_diameter_mm
    }

    /// Gauge pressure that the motor keeps without current, kPa.
    #[must_use]
    pub fn kept_kpa(&self, pitch_diameter_mm: f64) -> f64 {
        self.detent_torque_n_mm / (1e-3 * self.piston_area_mm2 * 0.5 * pitch_diameter_mm)
    }

    /// Share of the largest pressure that is left without current, 0 to 1: about the share of the
    /// largest bend that the tip keeps.
    #[must_use]
    pub fn kept_share(&self, limits: &LimitsSection, pitch_diameter_mm: f64) -> f64 {
        (self.kept_kpa(pitch_diameter_mm) / limits.pressure_max_kpa).min(1.0)
    }

    pub(super) fn check(&self, limits: &LimitsSection, pitch_diameter_mm: f64, to: &mut Checker) {
        to.range("power.piston_area_mm2", self.piston_area_mm2, 1.0..=10_000.0, "mm²", "π/4 times the bore squared");
        to.range("power.detent_torque_n_mm", self.detent_torque_n_mm, 0.0..=1000.0, "N·mm", "see the motor's data sheet");
        let needed = self.torque_n_mm(limits.pressure_max_kpa, pitch_diameter_mm);
        let have = self.holding_torque_n_mm;
        to.range("power.holding_torque_n_mm", have, 1.0..=10_000.0, "N·mm", "see the motor's data sheet");
        let problem = format!(
            "{have} N·mm do not hold limits.pressure_max_kpa = {} kPa, which turns the motor with {needed:.0} N·mm",
            limits.pressure_max_kpa
        );
        to.holds("power.holding_torque_n_mm", have > needed, &problem, "lower limits.pressure_max_kpa or use a stronger motor");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The figures of docs/hardware.md.
    #[test]
    fn trapped_pressure_turns_the_motor_as_computed_by_hand() {
        let p = PowerSection::default();
        assert!((p.torque_n_mm(41.3, 30.0) - 124.5).abs() < 0.1, "{}", p.torque_n_mm(41.3, 30.0));
        assert!((p.kept_kpa(30.0) - 4.975).abs() < 0.01);
        assert!((p.kept_share(&LimitsSection::default(), 30.0) - 0.1205).abs() < 1e-3);
    }

    #[test]
    fn a_motor_that_cannot_hold_the_pressure_is_refused() {
        let mut to = Checker::default();
        PowerSection { holding_torque_n_mm: 100.0, ..PowerSection::default() }.check(&LimitsSection::default(), 30.0, &mut to);
        let e = to.done().unwrap_err();
        assert!(e.key == "power.holding_torque_n_mm" && e.problem.contains("125 N·mm"), "{e:?}");
    }
}
