//! From microstep counts to the positions of the syringe plungers.
//!
//! `count → rotor → rack → plunger`. Nominally the plunger stands at counts × step_mm.

use crate::simulation::plant::law::{Laws, Moment, UnitData};
use nalgebra::Vector3;

/// The three drives with their state.
#[derive(Debug, Clone)]
pub(crate) struct Drive {
    step_mm: f64,
    counts: Vector3<f64>,
    rotor: Vector3<f64>,
    /// Injected faults.
    pub(crate) faults: DriveFaults,
}

/// Faults of the drives.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DriveFaults {
    /// 1, or −1 where the direction is inverted, or 0 where the driver is off.
    pub(crate) gain: Vector3<f64>,
    /// Where the rack hits a stop, mm; its sign is the side.
    pub(crate) stop_mm: [Option<f64>; 3],
}

impl Default for DriveFaults {
    fn default() -> Self {
        Self {
            gain: Vector3::repeat(1.0),
            stop_mm: [None; 3],
        }
    }
}

impl Drive {
    pub(crate) fn new(unit: &UnitData) -> Self {
        Self {
            step_mm: unit.step_mm,
            counts: Vector3::zeros(),
            rotor: Vector3::zeros(),
            faults: DriveFaults::default(),
        }
    }

    /// Plunger positions, mm, after the drives have followed the counts for one step.
    pub(crate) fn step(
        &mut self,
        counts: &Vector3<f64>,
        at: &Moment,
        laws: &mut Laws,
    ) -> Vector3<f64> {
        let mut turned = (counts - self.counts).component_mul(&self.faults.gain);
        self.counts = *counts;
        laws.iter_mut().for_each(|law| law.rotor(&mut turned, at));
        self.rotor += turned;
        let mut rack_mm = self.rotor * self.step_mm;
        self.stop_at_the_end(&mut rack_mm);
        laws.iter_mut().for_each(|law| law.rack(&mut rack_mm, at));
        rack_mm
    }

    /// A rack at its stop stays there, and the motor loses the steps beyond it.
    fn stop_at_the_end(&mut self, rack_mm: &mut Vector3<f64>) {
        for i in 0..3 {
            if let Some(stop) = self.faults.stop_mm[i]
                && rack_mm[i] * stop.signum() > stop.abs()
            {
                rack_mm[i] = stop;
                self.rotor[i] = stop / self.step_mm;
            }
        }
    }

    /// Turns the rotor of a channel (from 0) by microsteps that nothing counts.
    pub(crate) fn slip(&mut self, channel: usize, microsteps: f64) {
        self.rotor[channel] += microsteps;
    }
}
