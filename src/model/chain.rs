//! The nominal model with any set of catalogue effects, from the play operators to the tip.
//!
//! play output → 1/(1 + k_ε) → constant curvature; every effect changes the signal at its own stage. The fit of a diagnosis,
//! the feedforward and the simulator `model:` run these same laws. The first-order lag τ₀ between bellows and shape is left to
//! the caller, because each of the three integrates time in its own way.

use crate::model::effects::{Effect, Memory, Moment, Pose};
use crate::model::{Geometry, Line};
use nalgebra::Vector3;
use std::ops::Deref;

/// Number of nominal parameters: ln(1 + k_ε) × 3, k_λ (mm) × 3, τ₀ (s).
pub const NOMINAL: usize = 7;

/// The lines of a parameter vector.
pub fn lines(theta: &[f64]) -> [Line; 3] {
    std::array::from_fn(|i| Line {
        k_epsilon: theta[i].exp() - 1.0,
        k_lambda_mm: theta[3 + i].max(0.0),
    })
}

/// The nominal parameter vector of lines and a lag, the inverse of [`lines`].
pub fn nominal_theta(lines: &[Line; 3], lag_s: f64) -> Vec<f64> {
    let mut theta: Vec<f64> = lines.iter().map(|l| (1.0 + l.k_epsilon).ln()).collect();
    theta.extend(lines.iter().map(|l| l.k_lambda_mm));
    theta.push(lag_s);
    theta
}

/// First parameter of each effect in a parameter vector, and one past the last of all.
pub fn places<E: Deref<Target: Effect>>(effects: &[E]) -> Vec<usize> {
    let mut at = vec![NOMINAL];
    for e in effects {
        at.push(at[at.len() - 1] + e.params().len());
    }
    at
}

/// Effects with their parameters and gains. The state is the caller's: one [`Memory`] per effect, in the same order.
#[derive(Debug, Clone, Copy)]
pub struct Chain<'a, E> {
    /// Gains of the lines.
    pub lines: [Line; 3],
    /// Geometry of the bending section.
    pub geometry: Geometry,
    effects: &'a [E],
    at: &'a [usize],
    theta: &'a [f64],
}

impl<'a, E: Deref<Target: Effect>> Chain<'a, E> {
    /// The chain of a parameter vector; `at` are its [`places`].
    pub fn new(geometry: Geometry, effects: &'a [E], at: &'a [usize], theta: &'a [f64]) -> Self {
        Self {
            lines: lines(theta),
            geometry,
            effects,
            at,
            theta,
        }
    }

    /// Effects with their parameters.
    pub fn each(&self) -> impl Iterator<Item = (&'a E::Target, &'a [f64])> + use<'a, E> {
        let (at, theta) = (self.at, self.theta);
        let effects = self.effects.iter().enumerate();
        effects.map(move |(i, e)| (&**e, &theta[at[i]..at[i + 1]]))
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
