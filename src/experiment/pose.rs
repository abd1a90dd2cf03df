//! Measures poses held one after the other: the rows of Eq. 22 from frames.
//!
//! A pose is measured once the set-point has rested; its bend is the mean over the scored time. The counted steps give the
//! side of each piston (Eq. 21): the row of a channel counts only if its piston has moved further than the widest
//! backlash since its last reversal. The motion between the poses yields lag and dead time
//! ([`crate::control::learning::dynamics`]).

use crate::control::learning::batch::Measurement;
use crate::control::learning::dynamics::DynamicsBank;
use crate::control::pi::Dynamics;
use crate::control::tick::{Command, Frame, TickPhase};
use crate::experiment::schedule::{HOLD_S, Pose, SCORED_S};
use crate::model::arc::{Geometry, Shape};
use crate::model::bend::Bend;
use crate::primitives::units::Mm;
use nalgebra::{Vector2, Vector3};

/// Time for which the set-point must have rested before a pose is measured, s.
const RESTED_S: f64 = 0.7;
/// Longest time to reach a pose, s.
const WAY_MAX_S: f64 = 15.0;
/// Travel after a reversal that crosses the widest plausible backlash, mm: twice a half-width of 1.2 mm.
const SIDE_TRAVEL_MM: f64 = 2.4;

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
#[derive(Debug, Clone)]
pub struct Round {
    geometry: Geometry,
    poses: Vec<Pose>,
    at: usize,
    pose: PoseProgress,
    pushes: Pushes,
    bank: DynamicsBank,
    /// Measurements so far; a pose that was not reached in time has none.
    pub data: Vec<Measurement>,
}

impl Round {
    /// A round before its first command.
    #[must_use]
    pub fn new(geometry: Geometry, poses: Vec<Pose>) -> Self {
        Self {
            geometry,
            data: Vec::with_capacity(poses.len()),
            poses,
            at: 0,
            pose: PoseProgress::default(),
            pushes: Pushes::default(),
            bank: DynamicsBank::default(),
        }
    }
    /// Starts again at the first pose. The sides of the pistons stay known.
    pub fn again(&mut self) {
        self.data.clear();
        self.at = 0;
        self.bank = DynamicsBank::default();
    }
    /// Index of the present pose, and the number of poses.
    #[must_use]
    pub fn at(&self) -> (usize, usize) {
        (self.at, self.poses.len())
    }
    /// Command for the present pose, or for the last one when all have ended.
    #[must_use]
    pub fn command(&self) -> Command {
        let bend = self.poses.get(self.at).or(self.poses.last()).map_or(Bend(Vector2::zeros()), Pose::bend);
        Command { bend, length: Mm(self.geometry.rest_length_mm) }
    }
    /// Lag and dead time of this round, or `before` if it does not determine them.
    #[must_use]
    pub fn dynamics(&self, before: &Dynamics) -> Dynamics {
        self.bank.best(before).unwrap_or(*before)
    }
    /// Follows the pistons before the first command.
    pub fn follow(&mut self, piston_mm: &Vector3<f64>) {
        self.pushes.follow(piston_mm);
    }
    /// One frame of `dt_s` after the command; `piston_mm` are the counted positions.
    pub fn step(&mut self, frame: &Frame, piston_mm: &Vector3<f64>, dt_s: f64) -> Step {
        let half_s = 0.5 * dt_s; // tolerance for rounding in the sums of periods
        self.pushes.follow(piston_mm);
        self.pose.since_s += dt_s;
        self.pose.rested_s = if frame.phase == TickPhase::Holding { self.pose.rested_s + dt_s } else { 0.0 };
        if let Some(estimate) = frame.estimate {
            self.bank.step(frame.bend_from_pistons.0, estimate.bend.0, dt_s);
            if self.pose.since_s > HOLD_S - SCORED_S + half_s && self.pose.rested_s > RESTED_S + half_s {
                self.pose.sum += estimate.bend.0;
                self.pose.samples += 1;
                self.pose.measured_s += dt_s;
            }
        }
        let measured = self.pose.measured_s > SCORED_S - half_s;
        if measured {
            self.measure();
        } else if self.pose.since_s < WAY_MAX_S - half_s {
            return Step::Waiting;
        }
        self.pose = PoseProgress::default();
        self.at += 1;
        if self.at < self.poses.len() { Step::Next } else { Step::Over }
    }
    fn measure(&mut self) {
        let bend = Bend(self.pose.sum / f64::from(self.pose.samples.max(1)));
        let bellow_mm = self.geometry.lengths(&Shape { bend, length: Mm(self.geometry.rest_length_mm) });
        let Pushes { last_mm, side, .. } = self.pushes;
        self.data.push(Measurement { piston_mm: last_mm, bellow_mm, side, weight: self.pushes.weight() });
    }
}

/// Direction of each piston, and its travel since the last reversal.
#[derive(Debug, Clone, Copy, Default)]
struct Pushes {
    last_mm: Vector3<f64>,
    side: Vector3<f64>,
    travel_mm: Vector3<f64>,
}

impl Pushes {
    fn follow(&mut self, piston_mm: &Vector3<f64>) {
        for i in 0..3 {
            let step = piston_mm[i] - self.last_mm[i];
            if step * self.side[i] < 0.0 || (self.side[i] == 0.0 && step != 0.0) {
                (self.side[i], self.travel_mm[i]) = (step.signum(), 0.0);
            }
            self.travel_mm[i] += step.abs();
        }
        self.last_mm = *piston_mm;
    }
    fn weight(&self) -> Vector3<f64> {
        self.travel_mm.map(|t| if t >= SIDE_TRAVEL_MM { 1.0 } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_side_counts_once_the_piston_has_crossed_the_widest_backlash() {
        let mut pushes = Pushes::default();
        let mut weights = Vec::new();
        for x in [1.0, 3.0, 2.0, 0.5] {
            pushes.follow(&Vector3::new(x, 0.0, -x));
            weights.push((pushes.side[0], pushes.weight()[0]));
        }
        assert_eq!(weights, [(1.0, 0.0), (1.0, 1.0), (-1.0, 0.0), (-1.0, 1.0)]);
        assert_eq!((pushes.side[1], pushes.weight()[1]), (0.0, 0.0), "a piston at rest has no side");
    }
}
