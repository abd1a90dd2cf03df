//! `[power]`: the effect of trapped pressure on a motor without current.
//!
//! Law: a gauge pressure p behind a piston of area A pushes the rack with F = p A and turns the pinion with M = F d/2
//! (d: pitch diameter). A motor without current resists with its detent torque. Where M exceeds it, the rack runs back
//! until F d/2 equals the detent torque, and the tip relaxes accordingly; the count of steps is then void.

use crate::parameters;

parameters! {
    /// Power loss. At the default values the largest pressure turns the motor with 125 N·mm: half of what it holds with
    /// current, eight times what it resists without. Without current (supply lost, EN high, emergency stop) the rack therefore
    /// runs back until about 5 kPa are left, an eighth of the largest bend; the tip goes soft and nearly straight by its own air
    /// and without software. This direction is always towards rest, so de-energising is safe for the tip; zero must be found
    /// again afterwards. Current without a computer is NOT safe: the breakout pulls EN low, so between power-on and the start of
    /// the service the motors hold wherever they stand. If that matters, the emergency stop must cut the motor supply as well.
    pub struct PowerSection: Copy {
        /// Area of a piston; the default is a syringe of 16 mm bore. A larger value pushes the rack back harder.
        piston_area_mm2: f64 = 201.0, "mm²", 1.0..=10_000.0, "π/4 times the bore squared";
        /// Torque that the energised motor holds, at the current the driver is set to. It must exceed the torque of
        /// `limits.pressure_max_kpa`. A larger value holds a larger pressure.
        holding_torque_n_mm: f64 = 260.0, "N·mm", 1.0..=10_000.0, "see the motor's data sheet";
        /// Torque that the motor resists without current. A larger value keeps more of the bend when the power fails.
        detent_torque_n_mm: f64 = 15.0, "N·mm", 0.0..=1000.0, "see the motor's data sheet";
    }
}

impl PowerSection {
    /// Torque of a gauge pressure on the motor, N·mm.
    pub fn torque_n_mm(&self, pressure_kpa: f64, pitch_diameter_mm: f64) -> f64 {
        pressure_kpa.abs() * 1e-3 * self.piston_area_mm2 * 0.5 * pitch_diameter_mm
    }

    /// Gauge pressure that the energised motor can make, kPa.
    pub fn stall_kpa(&self, pitch_diameter_mm: f64) -> f64 {
        self.holding_torque_n_mm / self.torque_n_mm(1.0, pitch_diameter_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The figures of docs/hardware.md.
    #[test]
    fn trapped_pressure_turns_the_motor_as_computed_by_hand() {
        let p = PowerSection::default();
        assert!(
            (p.torque_n_mm(41.3, 30.0) - 124.5).abs() < 0.1,
            "{}",
            p.torque_n_mm(41.3, 30.0)
        );
        assert!((p.stall_kpa(30.0) - 86.24).abs() < 0.01);
        // what the motor keeps without current
        let kept_kpa = p.detent_torque_n_mm / p.torque_n_mm(1.0, 30.0);
        assert!((kept_kpa - 4.975).abs() < 0.01);
        assert!((kept_kpa / 41.3 - 0.1205).abs() < 1e-3);
    }
}
