//! Poses held one after the other and measured: the rows of Eq. 22 from frames.
//!
//! A pose counts once the set-point has rested; its bend is the mean over the scored seconds. The side
//! of each piston (Eq. 21) is read from the pulses: a channel's row counts only once its piston has
//! pushed further than the widest backlash since it last turned. What lies between the poses tells lag
//! and dead time, by the race of [`crate::control::learning::dynamics`].

use crate::control::learning::batch::Measurement;
use crate::control::learning::dynamics::DynamicsBank;
use crate::control::pi::Dynamics;
use crate::control::tick::{Command, Frame, TickPhase};
use crate::experiment::schedule::{HOLD_S, Pose, SCORED_S};
use crate::model::arc::{Geometry, Shape};
use crate::model::bend::Bend;
use crate::primitives::units::Mm;
use nalgebra::{Vector2, Vector3};

/// Rest of the set-point before a pose is measured, s: a long way takes longer than a hold.
const RESTED_S: f64 = 0.7;
/// Longest way that is waited for, s.
const WAY_MAX_S: f64 = 15.0;
/// Twice the widest backlash half-width that is believed, mm: travel after which a side is certain.
const SIDE_TRAVEL_MM: f64 = 2.4;

/// Where a round of poses is after a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// On its way, or at rest and being measured.
    Waiting,
    /// The pose is over: [`Round::command`] is the next.
    Next,
    /// All poses are over.
    Over,
}

/// One round of poses.
#[derive(Debug, Clone)]
pub struct Round {
    geometry: Geometry,
    poses: Vec<Pose>,
    at: usize,
    since_s: f64,
    rested_s: f64,
    sum: Vector2<f64>,
    seen: u32,
    seen_s: f64,
    pushes: Pushes,
    bank: DynamicsBank,
    /// The rows so far; a pose that was not reached in time has none.
    pub data: Vec<Measurement>,
}

impl Round {
    /// A round over `poses`, none of them ordered yet.
    #[must_use]
    pub fn new(geometry: Geometry, poses: Vec<Pose>) -> Self {
        Self {
            geometry,
            data: Vec::with_capacity(poses.len()),
            poses,
            at: 0,
            since_s: 0.0,
            rested_s: 0.0,
            sum: Vector2::zeros(),
            seen: 0,
            seen_s: 0.0,
            pushes: Pushes::default(),
            bank: DynamicsBank::default(),
        }
    }
    /// From the first pose again; which way the pistons push is still known.
    pub fn again(&mut self) {
        self.data.clear();
        self.at = 0;
        self.bank = DynamicsBank::default();
    }
    /// The pose it is at, from 0, and how many there are.
    #[must_use]
    pub fn at(&self) -> (usize, usize) {
        (self.at, self.poses.len())
    }
    /// What to order for the pose it is at; the last one stays when all are over.
    #[must_use]
    pub fn command(&self) -> Command {
        let bend = self.poses.get(self.at).or(self.poses.last()).map_or(Bend(Vector2::zeros()), Pose::bend);
        Command { bend, length: Mm(self.geometry.rest_length_mm) }
    }
    /// Lag and dead time as the round showed them, else `before`.
    #[must_use]
    pub fn dynamics(&self, before: &Dynamics) -> Dynamics {
        self.bank.best(before).unwrap_or(*before)
    }
    /// Pulses that came before the pose was ordered.
    pub fn follow(&mut self, piston_mm: &Vector3<f64>) {
        self.pushes.follow(piston_mm);
    }
    /// One frame of `dt_s` at the pose that was ordered; `piston_mm` is what was pulsed.
    pub fn step(&mut self, frame: &Frame, piston_mm: &Vector3<f64>, dt_s: f64) -> Step {
        let half_s = 0.5 * dt_s; // sums of periods meet their bounds to within rounding
        self.pushes.follow(piston_mm);
        self.since_s += dt_s;
        self.rested_s = if frame.phase == TickPhase::Holding { self.rested_s + dt_s } else { 0.0 };
        if let Some(estimate) = frame.estimate {
            self.bank.step(frame.bend_from_pistons.0, estimate.bend.0, dt_s);
            if self.since_s > HOLD_S - SCORED_S + half_s && self.rested_s > RESTED_S + half_s {
                self.sum += estimate.bend.0;
                self.seen += 1;
                self.seen_s += dt_s;
            }
        }
        let measured = self.seen_s > SCORED_S - half_s;
        if measured {
            self.measure();
        } else if self.since_s < WAY_MAX_S - half_s {
            return Step::Waiting;
        }
        (self.since_s, self.rested_s, self.sum, self.seen, self.seen_s) = (0.0, 0.0, Vector2::zeros(), 0, 0.0);
        self.at += 1;
        if self.at < self.poses.len() { Step::Next } else { Step::Over }
    }
    fn measure(&mut self) {
        let bend = Bend(self.sum / f64::from(self.seen.max(1)));
        let bellow_mm = self.geometry.lengths(&Shape { bend, length: Mm(self.geometry.rest_length_mm) });
        let Pushes { last_mm, side, .. } = self.pushes;
        self.data.push(Measurement { piston_mm: last_mm, bellow_mm, side, weight: self.pushes.weight() });
    }
}

/// Which way each piston pushes and how far it has since it turned.
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
    fn a_side_counts_once_the_piston_has_pushed_past_the_widest_backlash() {
        let mut pushes = Pushes::default();
        let mut weights = Vec::new();
        for x in [1.0, 3.0, 2.0, 0.5] {
            pushes.follow(&Vector3::new(x, 0.0, -x));
            weights.push((pushes.side[0], pushes.weight()[0]));
        }
        assert_eq!(weights, [(1.0, 0.0), (1.0, 1.0), (-1.0, 0.0), (-1.0, 1.0)]);
        assert_eq!((pushes.side[1], pushes.weight()[1]), (0.0, 0.0), "a piston at rest pushes nowhere");
    }
}
