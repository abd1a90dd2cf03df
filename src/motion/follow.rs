//! The follower: piston targets in, a tick's exact motion out, whatever the targets do.
//!
//! Each tick: admit the target (clamp to travel, refuse what is no number), plan anew if it moved,
//! guard the end of the tick (a stop within travel must be possible from there), cut the tick out.
//!
//! Cost is paid only for change: at rest with the same target nothing is computed, on the way to the
//! same target the plan in hand is followed, and only a new target is planned for.

use crate::motion::limits::MotionLimits;
use crate::motion::plan::{Plan, Refusal};
use crate::motion::segment::Segment;
use crate::motion::solver::{Ruckig, Solver};
use crate::motion::state::MotionState;
use crate::motion::stop::stops_within_travel;

/// Ticks for which the plan in hand is followed although a new one was wanted and refused; then the
/// pistons are braked. At 1 kHz that is 5 ms towards a target that is no longer wanted.
pub const KEEP_TICKS_MAX: u32 = 5;

/// What the follower did in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MoveStatus {
    /// At rest at the target.
    Resting,
    /// On the way of the plan in hand.
    Following,
    /// A new plan was made and begun.
    Replanned,
    /// A new plan was wanted and refused; the one in hand is followed for now.
    Kept(Refusal),
    /// Braking within the limits, because of this.
    Braking(Option<Refusal>),
}

/// How often what happened since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Plans made.
    pub replans: u64,
    /// Plans refused.
    pub refusals: u64,
    /// Times the pistons were braked for lack of a plan or of room.
    pub brakes: u64,
}

/// Jerk-limited, time-synchronised motion of the three pistons.
#[derive(Debug, Clone)]
pub struct Motion<S = Ruckig> {
    limits: MotionLimits,
    stop_longest_mm: f64,
    solver: S,
    state: [MotionState; 3],
    /// What the plan in hand drives to; `None` when it is a stop.
    target_mm: Option<[f64; 3]>,
    plan: Box<Plan>,
    candidate: Box<Plan>,
    plan_time_s: f64,
    resting: bool,
    kept: u32,
    clamped: [bool; 3],
    outcome: MoveStatus,
    counts: Counts,
}

impl Motion<Ruckig> {
    /// At rest with all pistons at zero.
    #[must_use]
    pub fn new(limits: &MotionLimits) -> Self {
        Self::with_solver(limits, Ruckig::default())
    }
}

impl<S: Solver> Motion<S> {
    /// At rest at zero, with a solver of one's own.
    #[must_use]
    pub fn with_solver(limits: &MotionLimits, solver: S) -> Self {
        Self {
            limits: *limits,
            stop_longest_mm: limits.stop_longest_mm(),
            solver,
            state: [MotionState::rest(0.0); 3],
            target_mm: Some([0.0; 3]),
            plan: Box::new(Plan::resting([0.0; 3])),
            candidate: Box::new(Plan::resting([0.0; 3])),
            plan_time_s: 0.0,
            resting: true,
            kept: 0,
            clamped: [false; 3],
            outcome: MoveStatus::Resting,
            counts: Counts::default(),
        }
    }

    /// Declares the pistons to rest at these positions: after homing, after a fault of the step
    /// thread or when its queue ran dry (it reports where it came to rest).
    pub fn reset(&mut self, position_mm: [f64; 3]) {
        self.state = position_mm.map(MotionState::rest);
        *self.plan = Plan::resting(position_mm);
        self.target_mm = Some(position_mm);
        self.plan_time_s = 0.0;
        self.resting = true;
        self.kept = 0;
        self.outcome = MoveStatus::Resting;
    }

    /// Moves on by one tick of `dt_s` towards `target_mm` (mm, pistons 1 to 3).
    ///
    /// `dt_s` may differ from tick to tick. A `dt_s` that is not a positive number moves nothing.
    pub fn tick(&mut self, target_mm: [f64; 3], dt_s: f64) -> Segment {
        match self.admit(target_mm) {
            Ok(target_mm) if self.is_planned(&target_mm) => {
                self.kept = 0;
                self.outcome = if self.resting { MoveStatus::Resting } else { MoveStatus::Following };
            }
            Ok(target_mm) => self.replan(target_mm),
            Err(refusal) => self.refuse(refusal),
        }
        self.advance(dt_s)
    }

    /// Moves on by one tick, braking: each piston comes to rest as soon as the limits allow.
    pub fn brake(&mut self, dt_s: f64) -> Segment {
        if self.target_mm.is_some() && !self.resting {
            self.begin_stop(None);
        } else if !self.resting {
            self.outcome = MoveStatus::Braking(None);
        }
        self.advance(dt_s)
    }

    /// Positions, velocities and accelerations at the end of the last tick.
    #[must_use]
    pub fn state(&self) -> &[MotionState; 3] {
        &self.state
    }

    /// What the last tick did.
    #[must_use]
    pub fn outcome(&self) -> MoveStatus {
        self.outcome
    }

    /// Which channels' last target lay beyond travel and was clamped.
    #[must_use]
    pub fn clamped(&self) -> [bool; 3] {
        self.clamped
    }

    /// Plans, refusals and brakings since the start.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Time from the end of the last tick until each channel is at rest, s.
    #[must_use]
    pub fn arrivals_s(&self) -> [f64; 3] {
        self.plan.channels.map(|c| (c.duration_s() - self.plan_time_s).max(0.0))
    }

    /// The target as it may be driven to: finite, within travel.
    fn admit(&mut self, target_mm: [f64; 3]) -> Result<[f64; 3], Refusal> {
        if let Some(channel) = target_mm.iter().position(|t| !t.is_finite()) {
            return Err(Refusal::TargetNotFinite { channel });
        }
        let travel = self.limits.travel_max_mm;
        self.clamped = target_mm.map(|t| t.abs() > travel);
        Ok(target_mm.map(|t| t.clamp(-travel, travel)))
    }

    /// Whether the plan in hand already drives there.
    fn is_planned(&self, target_mm: &[f64; 3]) -> bool {
        let least = self.limits.retarget_min_mm;
        self.target_mm.is_some_and(|planned| planned == *target_mm || planned.iter().zip(target_mm).all(|(p, t)| (p - t).abs() < least))
    }

    /// A new plan from the state of this instant, if it is sound; else [`Motion::refuse`].
    fn replan(&mut self, target_mm: [f64; 3]) {
        let found = self
            .solver
            .solve(&self.limits, &self.state, &target_mm, &mut self.candidate)
            .and_then(|()| self.candidate.verify(&self.state, &self.limits));
        if let Err(refusal) = found {
            return self.refuse(refusal);
        }
        std::mem::swap(&mut self.plan, &mut self.candidate);
        self.target_mm = Some(target_mm);
        self.plan_time_s = 0.0;
        self.resting = self.plan.duration_s() == 0.0;
        self.kept = 0;
        self.counts.replans += 1;
        self.outcome = MoveStatus::Replanned;
    }

    /// Follows the plan in hand for a few ticks, then brakes.
    fn refuse(&mut self, refusal: Refusal) {
        self.counts.refusals += 1;
        self.kept += 1;
        if self.resting || self.target_mm.is_none() {
            self.outcome = if self.resting { MoveStatus::Kept(refusal) } else { MoveStatus::Braking(Some(refusal)) };
        } else if self.kept <= KEEP_TICKS_MAX {
            self.outcome = MoveStatus::Kept(refusal);
        } else {
            self.begin_stop(Some(refusal));
        }
    }

    /// Replaces the plan in hand by the shortest stop.
    fn begin_stop(&mut self, why: Option<Refusal>) {
        *self.plan = Plan::stopping(&self.state, &self.limits);
        self.target_mm = None;
        self.plan_time_s = 0.0;
        self.counts.brakes += 1;
        self.outcome = MoveStatus::Braking(why);
    }

    /// Cuts the tick out of the plan, or out of a stop if the plan would leave no room for one.
    fn advance(&mut self, dt_s: f64) -> Segment {
        let dt_s = if dt_s.is_finite() { dt_s.max(0.0) } else { 0.0 };
        if self.resting {
            return Segment::holding(self.state.map(|s| s.position_mm), dt_s);
        }
        if self.target_mm.is_some() {
            let to_s = self.plan_time_s + dt_s;
            let cornered = self.plan.channels.iter().position(|c| !stops_within_travel(&c.at(to_s), &self.limits, self.stop_longest_mm));
            if let Some(channel) = cornered {
                self.begin_stop(Some(Refusal::NoStop { channel }));
            }
        }
        let channels = std::array::from_fn(|i| self.plan.channels[i].cut(self.state[i], self.plan_time_s, dt_s));
        let segment = Segment { duration_s: dt_s, channels };
        self.state = segment.end();
        self.plan_time_s += dt_s;
        self.resting = self.plan_time_s >= self.plan.duration_s();
        segment
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::config::MotionConfig;

    fn limits() -> MotionLimits {
        MotionLimits::try_from(&MotionConfig::default()).unwrap()
    }

    /// Refuses whenever told to, else solves.
    struct Moody(Ruckig, bool);

    impl Solver for Moody {
        fn solve(&mut self, l: &MotionLimits, from: &[MotionState; 3], to: &[f64; 3], out: &mut Plan) -> Result<(), Refusal> {
            if self.1 { Err(Refusal::NoProfile { channel: 1 }) } else { self.0.solve(l, from, to, out) }
        }
    }

    #[test]
    fn at_rest_nothing_is_planned() {
        let mut m = Motion::new(&limits());
        for _ in 0..10 {
            assert!(m.tick([0.0; 3], 1e-3).is_still());
        }
        assert_eq!((m.counts().replans, m.outcome()), (0, MoveStatus::Resting));
    }

    #[test]
    fn an_unchanged_target_is_planned_once() {
        let mut m = Motion::new(&limits());
        for _ in 0..2000 {
            m.tick([3.0, -2.0, 1.0], 1e-3);
        }
        assert_eq!(m.counts(), Counts { replans: 1, ..Counts::default() });
        assert_eq!(m.state(), &[MotionState::rest(3.0), MotionState::rest(-2.0), MotionState::rest(1.0)]);
    }

    #[test]
    fn a_target_beyond_travel_is_clamped_and_said_to_be() {
        let mut m = Motion::new(&limits());
        m.tick([80.0, 0.0, -80.0], 1e-3);
        assert_eq!(m.clamped(), [true, false, true]);
        for _ in 0..4000 {
            m.tick([80.0, 0.0, -80.0], 1e-3);
        }
        assert_eq!(m.state().map(|s| s.position_mm), [25.0, 0.0, -25.0]);
    }

    #[test]
    fn a_target_that_is_no_number_is_refused_and_the_plan_kept_then_braked() {
        let mut m = Motion::new(&limits());
        for _ in 0..100 {
            m.tick([10.0; 3], 1e-3);
        }
        let refusal = Refusal::TargetNotFinite { channel: 2 };
        for _ in 0..KEEP_TICKS_MAX {
            m.tick([10.0, 10.0, f64::NAN], 1e-3);
            assert_eq!(m.outcome(), MoveStatus::Kept(refusal));
        }
        let before = m.state()[0].velocity_mm_s;
        for _ in 0..500 {
            m.tick([10.0, 10.0, f64::NAN], 1e-3);
        }
        assert!(before > 5.0);
        assert!(m.state().iter().all(MotionState::is_rest) && m.state()[0].position_mm < 9.0);
        m.tick([10.0; 3], 1e-3);
        assert_eq!(m.outcome(), MoveStatus::Replanned);
    }

    #[test]
    fn a_failing_solver_ends_in_rest_and_recovers() {
        let l = limits();
        let mut m = Motion::with_solver(&l, Moody(Ruckig::default(), false));
        for k in 0..300 {
            m.tick([10.0 + 1e-3 * f64::from(k), -5.0, 5.0], 1e-3);
        }
        m.solver.1 = true;
        for k in 0..300 {
            m.tick([-10.0 - 1e-3 * f64::from(k), -5.0, 5.0], 1e-3);
        }
        assert!(m.state().iter().all(MotionState::is_rest));
        assert_eq!(m.counts().brakes, 1);
        m.solver.1 = false;
        for _ in 0..3000 {
            m.tick([-10.0, 0.0, 5.0], 1e-3);
        }
        assert_eq!(m.state().map(|s| s.position_mm), [-10.0, 0.0, 5.0]);
    }

    #[test]
    fn braking_ends_in_rest_and_the_next_target_starts_from_there() {
        let mut m = Motion::new(&limits());
        for _ in 0..150 {
            m.tick([20.0; 3], 1e-3);
        }
        for _ in 0..300 {
            m.brake(1e-3);
        }
        let rested = m.state()[0];
        assert!(rested.is_rest() && rested.position_mm > 0.5 && rested.position_mm < 10.0);
        for _ in 0..3000 {
            m.tick([20.0; 3], 1e-3);
        }
        assert_eq!(m.state()[0], MotionState::rest(20.0));
    }

    /// A plan that turns round at the very end of travel while still decelerating hard: within every
    /// limit, yet from just before the turn no stop stays inside.
    #[test]
    fn a_plan_that_leaves_no_room_for_a_stop_is_braked_in_time() {
        struct Brinkman(f64);
        impl Solver for Brinkman {
            fn solve(&mut self, l: &MotionLimits, from: &[MotionState; 3], _: &[f64; 3], out: &mut Plan) -> Result<(), Refusal> {
                let t = self.0;
                *out = Plan::resting([0.0; 3]);
                let mut at = from[0];
                let mut plan = crate::motion::plan::ChannelPlan::default();
                for (d, sign) in [(t, 1.0), (3.0 * t, -1.0), (2.0 * t, 1.0), (3.0_f64.sqrt() * t, 1.0), (3.0_f64.sqrt() * t, -1.0)] {
                    plan.push(at, sign * l.jerk_max_mm_s3, d);
                    at = at.after(sign * l.jerk_max_mm_s3, d);
                }
                plan.end_mm = at.position_mm;
                out.channels[0] = plan;
                Ok(())
            }
        }
        let far = |t: f64| {
            // highest point of that way, from its legs
            let s = MotionState::rest(0.0).after(6000.0, t);
            s.reach(-6000.0, 3.0 * t).1
        };
        let t = 0.03;
        let start_mm = 20.0;
        let l = MotionLimits { travel_max_mm: start_mm + far(t) + 1e-6, acceleration_max_mm_s2: 1e4, ..limits() };
        let mut m = Motion::with_solver(&l, Brinkman(t));
        m.reset([start_mm, 0.0, 0.0]);
        let mut highest: f64 = 0.0;
        let mut cornered = false;
        for _ in 0..1000 {
            let segment = if cornered { m.brake(1e-3) } else { m.tick([19.0, 0.0, 0.0], 1e-3) };
            cornered |= m.outcome() == MoveStatus::Braking(Some(Refusal::NoStop { channel: 0 }));
            let mut s = segment.channels[0].start;
            for &(d, j) in segment.channels[0].pieces() {
                highest = highest.max(s.reach(j, d).1);
                s = s.after(j, d);
            }
        }
        assert!(cornered, "{:?} {:?}", m.outcome(), m.counts());
        assert!(m.state()[0].is_rest());
        assert!(highest <= l.travel_max_mm + 1e-7 && highest > l.travel_max_mm - 0.1, "{highest}");
    }

    #[test]
    fn time_that_does_not_pass_moves_nothing() {
        let mut m = Motion::new(&limits());
        for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(m.tick([5.0; 3], dt).end_mm(), [0.0; 3]);
        }
    }
}
