//! A calibration of the transmission while the service runs: poses out, frames in, gains at the end.
//!
//! The same measurement as [`crate::experiment::identify`], turned inside out: there the experiment
//! drives the world, here the loop goes on and this follows its frames. Algorithm 1 (paper, §IV-C)
//! repeats all poses with the gains found so far until they change by less than 2 %; the short form is
//! one pass with the calibration in use as prior.

use crate::control::pi::Dynamics;
use crate::experiment::identify::{CONVERGED, PASSES_MAX};
use crate::experiment::schedule::{self, HOLD_S, Pose, SCORED_S};
use crate::model::arc::{Geometry, Shape};
use crate::model::bend::Bend;
use crate::model::transmission::Line;
use crate::pilot::Turned;
use crate::refine::batch::{Measurement, Prior, relative_step, solve};
use crate::refine::dynamics::DynamicsBank;
use crate::supervise::mode::Mode;
use crate::tick::{self, Command};
use crate::units::Mm;
use nalgebra::{Vector2, Vector3};

/// Rest of the set-point before a pose is measured, s.
const RESTED_S: f64 = 0.7;
/// Longest way that is waited for, s.
const WAY_MAX_S: f64 = 15.0;
/// Travel after which the side of the gap is certain, mm.
const SIDE_TRAVEL_MM: f64 = 2.4;

/// What the loop is to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// Nothing yet.
    Wait,
    /// Drive to this pose.
    Drive(Command),
    /// Go on with these gains.
    Lines([Line; 3]),
    /// Over.
    Done(Result<Found, String>),
}

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Gains.
    pub lines: [Line; 3],
    /// Lag and dead time.
    pub dynamics: Dynamics,
}

/// A calibration that runs.
#[derive(Debug, Clone)]
pub struct Session {
    geometry: Geometry,
    step_mm: f64,
    poses: Vec<Pose>,
    prior: Option<[Prior; 3]>,
    lines: [Line; 3],
    before: Found,
    pass: usize,
    at: usize,
    /// Turns since the pose was ordered, s.
    since_s: f64,
    rested_s: f64,
    sum: Vector2<f64>,
    seen: u32,
    seen_s: f64,
    pushes: Pushes,
    bank: DynamicsBank,
    data: Vec<Measurement>,
    started: bool,
}

impl Session {
    /// Algorithm 1 from zero.
    #[must_use]
    pub fn full(geometry: Geometry, step_mm: f64, before: Found) -> Self {
        let none = Line { k_epsilon: 0.0, k_lambda_mm: 0.0 };
        Self::new(geometry, step_mm, schedule::paper(), None, [none; 3], before)
    }

    /// One pass of 24 poses with a prior.
    #[must_use]
    pub fn short(geometry: Geometry, step_mm: f64, prior: [Prior; 3], before: Found) -> Self {
        Self::new(geometry, step_mm, schedule::short(), Some(prior), prior.map(|p| p.line), before)
    }

    fn new(geometry: Geometry, step_mm: f64, poses: Vec<Pose>, prior: Option<[Prior; 3]>, lines: [Line; 3], before: Found) -> Self {
        Self {
            geometry,
            step_mm,
            poses,
            prior,
            lines,
            before,
            pass: 1,
            at: 0,
            since_s: 0.0,
            rested_s: 0.0,
            sum: Vector2::zeros(),
            seen: 0,
            seen_s: 0.0,
            pushes: Pushes::default(),
            bank: DynamicsBank::default(),
            data: Vec::new(),
            started: false,
        }
    }

    /// What was in use before, to go back to.
    #[must_use]
    pub fn before(&self) -> Found {
        self.before
    }

    /// How far it is, in words.
    #[must_use]
    pub fn progress(&self) -> String {
        format!("pass {}, pose {} of {}", self.pass, self.at + 1, self.poses.len())
    }

    /// One turn of the loop.
    pub fn step(&mut self, turned: &Turned) -> Next {
        if turned.mode != Mode::Calibrating {
            return if self.started { Next::Done(Err(format!("the calibration was ended by mode {}", turned.mode))) } else { Next::Wait };
        }
        if !self.started {
            self.started = true;
            return Next::Lines(self.lines);
        }
        let frame = &turned.frame;
        self.pushes.follow(&Vector3::from(turned.counted.0.map(|n| f64::from(n) * self.step_mm)));
        let Some(felt) = frame.felt else { return Next::Wait };
        self.bank.step(frame.pistons_give.0, felt.bend.0, turned.input.dt_s);
        if self.since_s == 0.0 {
            self.since_s = turned.dt_s;
            return Next::Drive(self.command());
        }
        self.since_s += turned.dt_s;
        self.rested_s = if frame.mode == tick::Mode::Holding { self.rested_s + turned.dt_s } else { 0.0 };
        if self.since_s > HOLD_S - SCORED_S && self.rested_s > RESTED_S {
            self.sum += felt.bend.0;
            self.seen += 1;
            self.seen_s += turned.dt_s;
        }
        if self.seen_s >= SCORED_S {
            self.measure();
        } else if self.since_s < WAY_MAX_S {
            return Next::Wait;
        }
        self.go_on()
    }

    fn command(&self) -> Command {
        let pose = self.poses[self.at.min(self.poses.len() - 1)];
        Command { bend: pose.bend(), length: Mm(self.geometry.rest_length_mm) }
    }

    fn measure(&mut self) {
        let bend = Bend(self.sum / f64::from(self.seen.max(1)));
        let bellow_mm = self.geometry.lengths(&Shape { bend, length: Mm(self.geometry.rest_length_mm) });
        let Pushes { last_mm, side, .. } = self.pushes;
        self.data.push(Measurement { piston_mm: last_mm, bellow_mm, side, weight: self.pushes.weight() });
    }

    fn go_on(&mut self) -> Next {
        (self.since_s, self.rested_s, self.sum, self.seen, self.seen_s) = (0.0, 0.0, Vector2::zeros(), 0, 0.0);
        self.at += 1;
        if self.at < self.poses.len() {
            return Next::Wait;
        }
        let channels = match solve(&self.data, self.prior.as_ref()) {
            Ok(channels) => channels,
            Err(why) => return Next::Done(Err(why.to_string())),
        };
        let next = channels.map(|e| Line { k_lambda_mm: e.line.k_lambda_mm.max(0.0), ..e.line });
        if let Some(i) = next.iter().position(|l| !(0.0..=10.0).contains(&l.k_epsilon) || l.k_lambda_mm > 3.0) {
            let Line { k_epsilon, k_lambda_mm } = next[i];
            return Next::Done(Err(format!(
                "channel {} came to k_ε = {k_epsilon:.2}, k_λ = {k_lambda_mm:.2} mm, which no line has: check that line {0} reaches bellow {0} and that the motor turns the right way",
                i + 1
            )));
        }
        let converged = self.prior.is_some() || relative_step(&next, &self.lines) < CONVERGED;
        self.lines = next;
        if converged {
            let dynamics = self.bank.best(&self.before.dynamics).unwrap_or(self.before.dynamics);
            return Next::Done(Ok(Found { lines: next, dynamics }));
        }
        if self.pass >= PASSES_MAX {
            return Next::Done(Err(format!("Algorithm 1 did not converge in {PASSES_MAX} passes; use the short form, or look for a leak")));
        }
        self.pass += 1;
        self.at = 0;
        self.data.clear();
        Next::Lines(next)
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
