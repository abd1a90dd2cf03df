//! From microstep counts to the positions of the syringe plungers.
//!
//! `count → rotor → rack → plunger`. Nominally the plunger stands at counts × step_mm.

use crate::simulation::plant::law::{Step, UnitData, each};
use nalgebra::Vector3;

/// The three drives with their state.
#[derive(Debug)]
pub(crate) struct Drive {
    step_mm: f64,
    counts: Vector3<f64>,
    /// Microsteps that the rotors have turned.
    pub(crate) rotor: Vector3<f64>,
}

impl Drive {
    pub(crate) fn new(unit: &UnitData) -> Self {
        Self {
            step_mm: unit.step_mm,
            counts: Vector3::zeros(),
            rotor: Vector3::zeros(),
        }
    }

    /// Plunger positions, mm, after the drives have followed the counts for one step.
    pub(crate) fn step(&mut self, counts: &Vector3<f64>, now: &mut Step<'_>) -> Vector3<f64> {
        let (at, faults) = (&now.at, now.faults);
        let mut turned = (counts - self.counts).component_mul(&faults.drive_gain);
        self.counts = *counts;
        each(now.laws, |law| law.rotor(&mut turned, at));
        self.rotor += turned;
        let mut rack_mm = self.rotor * self.step_mm;
        for i in 0..3 {
            // a rack at its stop stays there, and the motor loses the steps beyond it
            if let Some(stop) = faults.stop_mm[i]
                && rack_mm[i] * stop.signum() > stop.abs()
            {
                rack_mm[i] = stop;
                self.rotor[i] = stop / self.step_mm;
            }
        }
        each(now.laws, |law| law.rack(&mut rack_mm, at));
        rack_mm
    }
}
