//! Measures poses held one after the other: the rows of Eq. 22 from frames.
//!
//! A pose is measured once the set-point has rested; its bend is the mean over the scored time. The counted steps give the
//! side of each piston (Eq. 21): the row of a channel counts only if its piston has moved further than the widest
//! backlash since its last reversal. The motion between the poses yields lag and dead time
//! ([`crate::control::observer::bank`]).

use crate::control::learning::batch::Measurement;
use crate::control::learning::schedule::{HOLD_S, Pose, SCORED_S};
use crate::control::learning::sides::Sides;
use crate::control::observer::bank::DynamicsBank;
use crate::control::{DynamicsPrior, Frame, TickPhase};
use crate::model::{Bend, Geometry, Shape};
use nalgebra::{Vector2, Vector3};

/// Time for which the set-point must have rested before a pose is measured, s.
const RESTED_S: f64 = 0.7;
/// Longest time to reach a pose, s.
const WAY_MAX_S: f64 = 15.0;

/// Progress of a round after a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The pose is being approached or measured.
    Waiting,
    /// The pose has ended; [`Round::command`] is the next.
    Next,
    /// All poses have ended.
    Over,
}

/// Progress of the present pose.
#[derive(Debug, Clone, Copy, Default)]
struct PoseProgress {
    /// Time since the command, time at rest, and measured time, s.
    since_s: f64,
    rested_s: f64,
    measured_s: f64,
    /// Sum of the measured bends, rad, and their number.
    sum: Vector2<f64>,
    samples: u32,
}

/// One round of poses.
#[derive(Debug, Clone, Default)]
pub struct Round {
    geometry: Geometry,
    poses: Vec<Pose>,
    at: usize,
    pose: PoseProgress,
    sides: Sides,
    bank: DynamicsBank,
    /// Measurements so far; a pose that was not reached in time has none.
    pub data: Vec<Measurement>,
}

impl Round {
    /// A round before its first command.
    pub fn new(geometry: Geometry, poses: Vec<Pose>) -> Self {
        Self {
            geometry,
            data: Vec::with_capacity(poses.len()),
            poses,
            ..Self::default()
        }
    }
    /// Starts again at the first pose. The sides of the pistons stay known.
    pub fn again(&mut self) {
        self.data.clear();
        self.at = 0;
        self.bank = DynamicsBank::default();
    }
    /// Index of the present pose, and the number of poses.
    pub fn at(&self) -> (usize, usize) {
        (self.at, self.poses.len())
    }
    /// Command for the present pose, or for the last one when all have ended.
    pub fn command(&self) -> Shape {
        let pose = self.poses.get(self.at).or(self.poses.last());
        let bend = pose.map_or(Bend::STRAIGHT, Pose::bend);
        Shape::new(bend.0, self.geometry.rest_length_mm)
    }
    /// Lag and dead time of this round, with what `before` contributes.
    pub fn dynamics(&self, before: &DynamicsPrior) -> DynamicsPrior {
        self.bank.assess(before, &before.range()).prior()
    }
    /// Follows the pistons before the first command.
    pub fn follow(&mut self, piston_mm: &Vector3<f64>) {
        self.sides.follow(piston_mm);
    }
    /// One frame of `dt_s` after the command; `piston_mm` are the counted positions.
    pub fn step(&mut self, frame: &Frame, piston_mm: &Vector3<f64>, dt_s: f64) -> Step {
        let half_s = 0.5 * dt_s; // tolerance for rounding in the sums of periods
        self.sides.follow(piston_mm);
        let pose = &mut self.pose;
        pose.since_s += dt_s;
        let holds = frame.phase == TickPhase::Holding;
        pose.rested_s = if holds { pose.rested_s + dt_s } else { 0.0 };
        if let Some(estimate) = frame.estimate {
            let bend = estimate.bend.0;
            self.bank.step(frame.bend_from_pistons.0, bend, dt_s);
            if pose.since_s > HOLD_S - SCORED_S + half_s && pose.rested_s > RESTED_S + half_s {
                pose.sum += bend;
                pose.samples += 1;
                pose.measured_s += dt_s;
            }
        }
        if pose.measured_s > SCORED_S - half_s {
            self.measure();
        } else if pose.since_s < WAY_MAX_S - half_s {
            return Step::Waiting;
        }
        self.pose = PoseProgress::default();
        self.at += 1;
        if self.at < self.poses.len() {
            Step::Next
        } else {
            Step::Over
        }
    }
    fn measure(&mut self) {
        let bend = self.pose.sum / f64::from(self.pose.samples.max(1));
        let shape = Shape::new(bend, self.geometry.rest_length_mm);
        self.data.push(Measurement {
            piston_mm: self.sides.piston_mm(),
            bellow_mm: self.geometry.lengths(&shape),
            side: self.sides.side,
            weight: self.sides.weight(),
        });
    }
}
