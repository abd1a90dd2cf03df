//! Algorithm 1 of the paper (§IV-C): apply k, hold the poses, solve Eq. 25, repeat until k changes by less than 2 %.
//!
//! A pose is measured once the set-point has rested; its bend is the mean over the scored time. The counted steps give the
//! side of each piston (Eq. 21): the row of a channel counts only if its piston has moved further than the widest
//! backlash since its last reversal. The motion between the poses of the last pass yields lag and dead time
//! ([`crate::control::observer::bank`]).

use crate::control::learning::batch::{
    Estimate, Measurement, Prior, Unidentifiable, relative_step, solve,
};
use crate::control::learning::schedule::{HOLD_S, Pose, SCORED_S};
use crate::control::learning::sides::Sides;
use crate::control::observer::bank::DynamicsBank;
use crate::control::{DynamicsPrior, Frame, TickPhase};
use crate::model::{Bend, Geometry, Line, Shape};
use nalgebra::{Vector2, Vector3};

/// Time for which the set-point must have rested before a pose is measured, s.
const RESTED_S: f64 = 0.7;
/// Longest time to reach a pose, s.
const WAY_MAX_S: f64 = 15.0;
/// The paper's criterion: relative step below 2 %.
const CONVERGED: f64 = 0.02;
/// Share by which k_ε changes from one calibration to the next: the absolute temperature of the air in a line rises by 5 % from a room
/// at 22 °C to a body at 37 °C.
const WARMED: f64 = 0.05;
/// Largest number of passes.
pub const PASSES_MAX: usize = 12;

/// Result of an identification.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// Gains with covariance, per channel.
    pub channels: [Estimate; 3],
    /// Lag and dead time.
    pub dynamics: DynamicsPrior,
    /// Gains initially and after every pass.
    pub history: Vec<[Line; 3]>,
    /// The criterion of 2 % was reached.
    pub converged: bool,
}

impl Identified {
    /// The gains without their uncertainty.
    pub fn lines(&self) -> [Line; 3] {
        self.channels.map(|e| e.line)
    }

    /// Standard deviations of k_ε and k_λ in mm, per channel, no smaller than a calibration is repeatable.
    pub fn line_sigmas(&self) -> [[f64; 2]; 3] {
        self.channels.map(|e| {
            let sigma = |i, least| e.covariance[(i, i)].max(0.0).sqrt().max(least);
            [sigma(0, 0.05), sigma(1, 0.03)]
        })
    }

    /// Standard deviations of k_ε per channel, with what the temperature of the air changes until another calibration of the same tip.
    /// The loop, which follows such a change, does without it.
    pub fn later_sigmas(&self) -> [f64; 3] {
        let of_lines = self.line_sigmas();
        std::array::from_fn(|i| of_lines[i][0].hypot(WARMED * self.channels[i].line.k_epsilon))
    }
}

/// Next step of an identification.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// Wait for the next frame.
    Wait,
    /// Move to this pose.
    Drive(Shape),
    /// Use these gains, then move to the first pose.
    Lines([Line; 3]),
    /// The identification has ended.
    Done(Identified),
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

/// Algorithm 1 in progress, for whoever runs the loop: frames in, poses and gains out.
#[derive(Debug, Clone)]
pub struct Algorithm1 {
    geometry: Geometry,
    poses: Vec<Pose>,
    prior: Option<[Prior; 3]>,
    before: DynamicsPrior,
    history: Vec<[Line; 3]>,
    at: usize,
    pose: PoseProgress,
    sides: Sides,
    bank: DynamicsBank,
    /// Measurements of this pass; a pose that was not reached in time has none.
    data: Vec<Measurement>,
}

impl Algorithm1 {
    /// Starts with the gains `start` and passes through these poses. With a prior it starts at the gains of the prior and
    /// makes one pass: the short calibration of a new tip. `before` is what is known of lag and dead time.
    pub fn new(
        geometry: Geometry,
        poses: Vec<Pose>,
        start: [Line; 3],
        prior: Option<[Prior; 3]>,
        before: DynamicsPrior,
    ) -> Self {
        Self {
            geometry,
            data: Vec::with_capacity(poses.len()),
            poses,
            prior,
            before,
            history: vec![prior.map_or(start, |prior| prior.map(|p| p.line))],
            at: 0,
            pose: PoseProgress::default(),
            sides: Sides::default(),
            bank: DynamicsBank::default(),
        }
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

    /// Follows the pistons before the first command.
    pub fn follow(&mut self, piston_mm: &Vector3<f64>) {
        self.sides.follow(piston_mm);
    }

    /// Gains of this pass.
    pub fn lines(&self) -> [Line; 3] {
        self.history[self.pass() - 1]
    }

    /// Number of this pass, from 1.
    pub fn pass(&self) -> usize {
        self.history.len()
    }

    /// Processes one frame of `dt_s` after a command; `piston_mm` are the counted positions.
    ///
    /// # Errors
    /// [`Unidentifiable`] from the data.
    pub fn step(
        &mut self,
        frame: &Frame,
        piston_mm: &Vector3<f64>,
        dt_s: f64,
    ) -> Result<Next, Unidentifiable> {
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
            return Ok(Next::Wait);
        }
        self.pose = PoseProgress::default();
        self.at += 1;
        if self.at < self.poses.len() {
            Ok(Next::Drive(self.command()))
        } else {
            self.conclude()
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

    fn conclude(&mut self) -> Result<Next, Unidentifiable> {
        let channels = solve(&self.data, self.prior.as_ref())?;
        let (before, now) = (self.lines(), plausible(&channels)?);
        let converged = self.prior.is_some() || relative_step(&now, &before) < CONVERGED;
        let last = converged || self.pass() >= PASSES_MAX;
        self.history.push(now);
        if last {
            return Ok(Next::Done(Identified {
                channels,
                dynamics: self.bank.assess(&self.before, &self.before.range()).prior(),
                history: std::mem::take(&mut self.history),
                converged,
            }));
        }
        // the sides of the pistons stay known
        self.data.clear();
        self.at = 0;
        self.bank = DynamicsBank::default();
        Ok(Next::Lines(now))
    }
}

/// The gains of `channels`, if they are within the physical range.
fn plausible(channels: &[Estimate; 3]) -> Result<[Line; 3], Unidentifiable> {
    for (i, e) in channels.iter().enumerate() {
        let (k_epsilon, k_lambda_mm) = (e.line.k_epsilon, e.line.k_lambda_mm);
        if !(0.0..=10.0).contains(&k_epsilon) || !(-0.3..=3.0).contains(&k_lambda_mm) {
            return Err(Unidentifiable::Unphysical {
                channel: i + 1,
                k_epsilon,
                k_lambda_mm,
            });
        }
    }
    // noise may make a small backlash slightly negative
    Ok(channels.map(|e| Line {
        k_lambda_mm: e.line.k_lambda_mm.max(0.0),
        ..e.line
    }))
}
