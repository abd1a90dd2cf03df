//! The nominal model with any set of catalogue effects, from the play operators to the tip.
//!
//! play output → 1/(1 + k_ε) → constant curvature; every effect changes the signal at its own stage. The fit of a diagnosis,
//! the feedforward and the simulator `model:` run these same laws. The first-order lag τ₀ between bellows and shape is left to
//! the caller, because each of the three integrates time in its own way.

use crate::model::effects::{Effect, Memory, Moment, Pose};
use crate::model::{Geometry, Line, Model, lines};
use nalgebra::Vector3;

/// Effects with their parameters and gains. The state is the caller's: one [`Memory`] per effect, in the same order.
#[derive(Debug, Clone, Copy)]
pub struct Chain<'a> {
    /// Gains of the lines.
    pub lines: [Line; 3],
    /// Geometry of the bending section.
    pub geometry: Geometry,
    model: &'a Model,
    theta: &'a [f64],
}

impl<'a> Chain<'a> {
    /// The chain of a model with these parameters.
    pub fn new(geometry: Geometry, model: &'a Model, theta: &'a [f64]) -> Self {
        Self {
            lines: lines(theta),
            geometry,
            model,
            theta,
        }
    }

    /// Effects with their parameters.
    pub fn each(&self) -> impl Iterator<Item = (&'static dyn Effect, &'a [f64])> + use<'a> {
        self.model.each(self.theta)
    }

    /// An instant at rest, `dt_s` after the start.
    pub fn moment(&self, up_base: Vector3<f64>, dt_s: f64) -> Moment {
        Moment {
            t_s: 0.0,
            dt_s,
            counted_mm: Vector3::zeros(),
            up_base,
            k_epsilon: Vector3::from(self.lines.map(|l| l.k_epsilon)),
            r_mm: self.geometry.r_mm,
            idle_s: 0.0,
        }
    }

    /// True piston positions for the counted ones, mm.
    pub fn pistons(
        &self,
        memory: &mut [Memory],
        at: &Moment,
        counted_mm: &Vector3<f64>,
    ) -> Vector3<f64> {
        let mut u = *counted_mm;
        for ((e, p), m) in self.each().zip(memory) {
            e.pistons(p, m, at, &mut u);
        }
        u
    }

    /// Outputs of the play operators after the pistons have moved to `piston_mm`, mm.
    pub fn play(&self, w_mm: &Vector3<f64>, piston_mm: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|c, _| self.lines[c].play(w_mm[c], piston_mm[c]))
    }

    /// Bellow length changes for the outputs of the play operators, before the lag, mm.
    pub fn bellows(
        &self,
        memory: &mut [Memory],
        at: &Moment,
        play_output_mm: &Vector3<f64>,
    ) -> Vector3<f64> {
        let mut w = *play_output_mm;
        for ((e, p), m) in self.each().zip(&mut *memory) {
            e.play_output(p, m, at, &mut w);
        }
        let mut q = Vector3::from_fn(|c, _| self.lines[c].bellow_mm(w[c]));
        for ((e, p), m) in self.each().zip(memory) {
            e.bellows(p, m, at, &mut q);
        }
        q
    }

    /// Tip shape for bellow length changes: constant curvature with the effects on it.
    pub fn pose(&self, memory: &mut [Memory], at: &Moment, bellow_mm: &Vector3<f64>) -> Pose {
        let mut pose = Pose {
            bend: self.geometry.shape(bellow_mm).bend.0,
            twist: 0.0,
            bellow_mm: *bellow_mm,
        };
        for ((e, p), m) in self.each().zip(memory) {
            e.shape(p, m, at, &mut pose);
        }
        pose
    }
}
