//! The follower: turns piston targets into exact motion, one tick at a time.
//!
//! Each tick admits the target (clamps it to travel, refuses values that are not finite), plans anew
//! if it has changed, checks that a stop within travel remains possible from the end of the tick, and
//! cuts the tick out of the plan.
//!
//! Only change costs time. At rest at an unchanged target nothing is computed, on the way to an
//! unchanged target the present plan is followed, and only a new target is planned for.

use crate::motion::plan::{Plan, PlanFault};
use crate::motion::solver::{Ruckig, Solver};
use crate::motion::stop::stops_within_travel;
use crate::motion::{MotionLimits, MotionState, Segment};

/// Ticks for which the present plan is followed after a new one was needed but failed; then the
/// pistons brake. At 1 kHz this is 5 ms towards an outdated target.
pub const KEEP_TICKS_MAX: u32 = 5;

/// What the follower did in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MoveStatus {
    /// The pistons rest at the target.
    Resting,
    /// The present plan is followed.
    Following,
    /// A new plan begins.
    Replanned,
    /// A new plan was needed but failed; the present one is followed.
    Kept(PlanFault),
    /// The pistons brake within the limits, on request or for this reason.
    Braking(Option<PlanFault>),
}

/// Jerk-limited motion of the three pistons.
#[derive(Debug, Clone)]
pub struct Motion<S = Ruckig> {
    limits: MotionLimits,
    longest_stop_mm: f64,
    solver: S,
    state: [MotionState; 3],
    /// Target of the plan; `None` if the plan is a stop.
    target_mm: Option<[f64; 3]>,
    plan: Box<Plan>,
    candidate: Box<Plan>,
    plan_time_s: f64,
    resting: bool,
    kept: u32,
    status: MoveStatus,
}

impl Motion<Ruckig> {
    /// All pistons at rest at zero.
    pub fn new(limits: &MotionLimits) -> Self {
        Self::with_solver(limits, Ruckig::default())
    }
}

impl<S: Solver> Motion<S> {
    /// All pistons at rest at zero, with another solver.
    pub fn with_solver(limits: &MotionLimits, solver: S) -> Self {
        Self {
            limits: *limits,
            longest_stop_mm: limits.longest_stop_mm(),
            solver,
            state: [MotionState::rest(0.0); 3],
            target_mm: Some([0.0; 3]),
            plan: Box::default(),
            candidate: Box::default(),
            plan_time_s: 0.0,
            resting: true,
            kept: 0,
            status: MoveStatus::Resting,
        }
    }

    /// Declares the pistons to rest at these positions, mm: after homing, a fault of the step thread or
    /// an underrun.
    pub fn reset(&mut self, position_mm: [f64; 3]) {
        self.state = position_mm.map(MotionState::rest);
        *self.plan = Plan::resting(position_mm);
        self.target_mm = Some(position_mm);
        self.plan_time_s = 0.0;
        self.resting = true;
        self.kept = 0;
        self.status = MoveStatus::Resting;
    }

    /// Advances by one tick of `dt_s` towards `target_mm` (mm, pistons 1 to 3).
    ///
    /// `dt_s` may vary from tick to tick. If it is not a positive finite number, nothing moves.
    pub fn tick(&mut self, target_mm: [f64; 3], dt_s: f64) -> Segment {
        let travel_mm = self.limits.travel_max_mm;
        if target_mm.iter().all(|t| t.is_finite()) {
            self.follow(target_mm.map(|t| t.clamp(-travel_mm, travel_mm)));
        } else {
            self.keep(PlanFault::TargetNotFinite);
        }
        self.advance(dt_s)
    }

    /// Advances by one tick while braking: each piston comes to rest as soon as the limits allow.
    pub fn brake(&mut self, dt_s: f64) -> Segment {
        if self.target_mm.is_some() && !self.resting {
            self.begin_stop(None);
        } else if !self.resting {
            self.status = MoveStatus::Braking(None);
        }
        self.advance(dt_s)
    }

    /// States of the pistons at the end of the last tick.
    pub fn state(&self) -> &[MotionState; 3] {
        &self.state
    }

    /// What the last tick did.
    pub fn status(&self) -> MoveStatus {
        self.status
    }

    /// Follows the plan, or a new one if the target has changed.
    fn follow(&mut self, target_mm: [f64; 3]) {
        let least_mm = self.limits.retarget_min_mm;
        let planned = self.target_mm.is_some_and(|planned| {
            let mut both = planned.iter().zip(target_mm);
            planned == target_mm || both.all(|(p, t)| (p - t).abs() < least_mm)
        });
        if planned {
            self.kept = 0;
            self.status = if self.resting {
                MoveStatus::Resting
            } else {
                MoveStatus::Following
            };
        } else if let Err(error) = self.replan(target_mm) {
            self.keep(error);
        }
    }

    /// Makes a plan from the present state and takes it up if it is valid.
    fn replan(&mut self, target_mm: [f64; 3]) -> Result<(), PlanFault> {
        self.solver
            .solve(&self.limits, &self.state, &target_mm, &mut self.candidate)?;
        self.candidate.verify(&self.state, &self.limits)?;
        std::mem::swap(&mut self.plan, &mut self.candidate);
        self.target_mm = Some(target_mm);
        self.plan_time_s = 0.0;
        self.resting = self.plan.duration_s() == 0.0;
        self.kept = 0;
        self.status = MoveStatus::Replanned;
        Ok(())
    }

    /// Keeps the plan for a few ticks, then brakes.
    fn keep(&mut self, error: PlanFault) {
        self.kept += 1;
        if self.resting || (self.target_mm.is_some() && self.kept <= KEEP_TICKS_MAX) {
            self.status = MoveStatus::Kept(error);
        } else if self.target_mm.is_none() {
            self.status = MoveStatus::Braking(Some(error));
        } else {
            self.begin_stop(Some(error));
        }
    }

    /// Replaces the plan by the shortest stop.
    fn begin_stop(&mut self, reason: Option<PlanFault>) {
        *self.plan = Plan::stopping(&self.state, &self.limits);
        self.target_mm = None;
        self.plan_time_s = 0.0;
        self.status = MoveStatus::Braking(reason);
    }

    /// Cuts the tick out of the plan, or out of a stop if the plan would leave no room for one.
    fn advance(&mut self, dt_s: f64) -> Segment {
        let dt_s = if dt_s.is_finite() { dt_s.max(0.0) } else { 0.0 };
        if self.resting {
            return Segment::holding(self.state.map(|s| s.position_mm), dt_s);
        }
        let to_s = self.plan_time_s + dt_s;
        let stoppable =
            |at: &MotionState| stops_within_travel(at, &self.limits, self.longest_stop_mm);
        let mut channels = self.plan.channels.iter();
        if self.target_mm.is_some() && !channels.all(|c| stoppable(&c.at(to_s))) {
            self.begin_stop(Some(PlanFault::NoStop));
        }
        let segment = self.plan.cut(&self.state, self.plan_time_s, dt_s);
        self.state = segment.end();
        self.plan_time_s += dt_s;
        self.resting = self.plan_time_s >= self.plan.duration_s();
        segment
    }
}
