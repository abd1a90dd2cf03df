//! From microstep counts to where the syringe plungers stand.
//!
//! `count → rotor (missed steps, faults) → rack (tooth error) → plunger (stick-slip)`. Nominally the
//! plunger stands at counts × step_mm.

pub mod gear_periodic;
pub mod missed_steps;
pub mod stick_slip;

use crate::simulation::plant::config::PlantConfig;
use crate::simulation::plant::plant_effect::active;
use gear_periodic::Teeth;
use missed_steps::Stall;
use nalgebra::Vector3;
use stick_slip::Sticking;

/// The three drives with what they remember.
#[derive(Debug, Clone)]
pub(crate) struct Drive {
    step_mm: f64,
    counts: Vector3<f64>,
    rotor: Vector3<f64>,
    stall: Option<Stall>,
    gear: Option<Teeth>,
    sticking: Option<Sticking>,
    /// What was broken at run time.
    pub(crate) broken: Broken,
}

/// Breakages of the drives.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Broken {
    /// 1, or −1 where direction is inverted, or 0 where the driver is off.
    pub(crate) gain: Vector3<f64>,
    /// Where the rack hits a stop, mm; the side is the sign.
    pub(crate) stop_mm: [Option<f64>; 3],
}

impl Default for Broken {
    fn default() -> Self {
        Self { gain: Vector3::repeat(1.0), stop_mm: [None; 3] }
    }
}

impl Drive {
    pub(crate) fn new(config: &PlantConfig) -> Self {
        let effects = &config.effects;
        Self {
            step_mm: config.drive.step_mm,
            counts: Vector3::zeros(),
            rotor: Vector3::zeros(),
            stall: active(effects.missed_steps.as_ref()).map(|c| Stall::new(c, config.drive.step_mm, config.drive.microsteps)),
            gear: active(effects.gear_periodic.as_ref()).map(Teeth::new),
            sticking: active(effects.outside.stick_slip.as_ref()).map(Sticking::new),
            broken: Broken::default(),
        }
    }

    /// Plunger positions, mm, once the counts have been followed for `dt_s` up to time `t`.
    pub(crate) fn step(&mut self, counts: &Vector3<f64>, t: f64, dt_s: f64) -> Vector3<f64> {
        let mut turned = (counts - self.counts).component_mul(&self.broken.gain);
        self.counts = *counts;
        if let Some(stall) = &mut self.stall {
            stall.hold_back(&mut turned, t, dt_s);
        }
        self.rotor += turned;
        let mut rack_mm = self.rotor * self.step_mm;
        self.stop_at_the_end(&mut rack_mm);
        if let Some(gear) = &mut self.gear {
            rack_mm += gear.error_mm(&rack_mm);
        }
        match &mut self.sticking {
            Some(sticking) => sticking.step(&rack_mm, dt_s),
            None => rack_mm,
        }
    }

    /// A rack at its stop stays, and the motor loses what it was sent beyond.
    fn stop_at_the_end(&mut self, rack_mm: &mut Vector3<f64>) {
        for i in 0..3 {
            if let Some(stop) = self.broken.stop_mm[i]
                && rack_mm[i] * stop.signum() > stop.abs()
            {
                rack_mm[i] = stop;
                self.rotor[i] = stop / self.step_mm;
            }
        }
    }

    /// Turns the rotor of a channel (from 0) by so many microsteps that nobody counted.
    pub(crate) fn slip(&mut self, channel: usize, microsteps: f64) {
        self.rotor[channel] += microsteps;
    }
}
