//! From the state of this instant to rest at a target: the plan, its proof, and the solver.
//!
//! The solver is the step-1/step-2 mathematics of Ruckig (Berscheid and Kröger, "Jerk-limited
//! Real-time Trajectory Generation with Arbitrary Target States", RSS 2021) as ported in `rsruckig`:
//!
//! * brake: up to two phases that bring a state just outside the limits back in;
//! * step 1, per channel: the time-optimal seven-phase profile to (p_f, 0, 0), hence its least time;
//! * synchronisation: T = the greatest of the least times (moved behind any blocked interval);
//! * step 2, per channel: the profile that takes exactly T: [`crate::motion::cruise`] finds it
//!   quickest; Ruckig's own step 2 is asked when that finds none.
//!
//! `rsruckig`'s own `calculate` does the same, allocates nothing when it succeeds, and formats a long
//! error string when it does not (`format!` of the whole input, whatever the error handler). The
//! control path must not allocate then either, so the published building blocks are called here
//! directly; a failure is a [`Refusal`].
//!
//! No plan is believed unseen: [`Plan::verify`] checks limits, travel, continuity and arrival on the
//! closed form of every phase.

use crate::motion::cruise::arrive_in;
use crate::motion::limits::{Limits, POSITION_SLACK_MM, SLACK};
use crate::motion::segment::ChannelSegment;
use crate::motion::state::State;
use crate::motion::stop::Stop;
use rsruckig::block::Block;
use rsruckig::position_third_step1::PositionThirdOrderStep1;
use rsruckig::position_third_step2::PositionThirdOrderStep2;
use rsruckig::profile::Profile;

/// Most phases a channel's plan can have: two of braking and seven of the profile.
pub const LEGS_MAX: usize = 9;

/// Why there is no new plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The target is not a number.
    #[error("the target of channel {} is not a finite number", .channel + 1)]
    TargetNotFinite {
        /// Channel, from 0.
        channel: usize,
    },
    /// No time-optimal profile was found.
    #[error("no profile to the target was found for channel {}", .channel + 1)]
    NoProfile {
        /// Channel, from 0.
        channel: usize,
    },
    /// No profile of the common duration was found.
    #[error("channel {} cannot arrive together with the others", .channel + 1)]
    NoSynchronisation {
        /// Channel, from 0.
        channel: usize,
    },
    /// The profile found breaks a limit, leaves travel, jumps or misses the target.
    #[error("the profile found for channel {} breaks a limit or misses the target", .channel + 1)]
    Unsound {
        /// Channel, from 0.
        channel: usize,
    },
    /// From where the tick would end no stop stays within travel.
    #[error("no stop within travel would be left for channel {}", .channel + 1)]
    NoStop {
        /// Channel, from 0.
        channel: usize,
    },
}

/// One constant-jerk phase of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Leg {
    /// When it ends, s from the start of the plan.
    pub end_s: f64,
    /// How long it lasts, s.
    pub duration_s: f64,
    /// State at its start.
    pub start: State,
    /// Jerk, mm/s³.
    pub jerk_mm_s3: f64,
}

/// One channel's way to rest.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ChannelPlan {
    legs: [Leg; LEGS_MAX],
    len: usize,
    /// Where it comes to rest, mm.
    pub end_mm: f64,
}

impl ChannelPlan {
    /// Standing still.
    #[must_use]
    pub fn resting(position_mm: f64) -> Self {
        Self { end_mm: position_mm, ..Self::default() }
    }

    /// The shortest stop.
    #[must_use]
    pub fn stopping(stop: &Stop) -> Self {
        let mut plan = Self::resting(stop.end_mm);
        let mut at = stop.from;
        for (t, jerk) in stop.phases {
            plan.push(at, jerk, t);
            at = at.after(jerk, t);
        }
        plan
    }

    /// Appends a phase; nothing if it lasts no time.
    pub fn push(&mut self, start: State, jerk_mm_s3: f64, duration_s: f64) {
        if duration_s > 0.0 && self.len < LEGS_MAX {
            let end_s = self.duration_s() + duration_s;
            self.legs[self.len] = Leg { end_s, duration_s, start, jerk_mm_s3 };
            self.len += 1;
        }
    }

    /// The phases in order.
    #[must_use]
    pub fn legs(&self) -> &[Leg] {
        &self.legs[..self.len]
    }

    /// When it comes to rest, s from the start.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        if self.len == 0 { 0.0 } else { self.legs[self.len - 1].end_s }
    }

    /// The state at a time.
    #[inline]
    #[must_use]
    pub fn at(&self, t_s: f64) -> State {
        match self.legs().iter().find(|leg| t_s < leg.end_s) {
            Some(leg) => leg.start.after(leg.jerk_mm_s3, (t_s - (leg.end_s - leg.duration_s)).max(0.0)),
            None => State::rest(self.end_mm),
        }
    }

    /// The part from `from_s` on that lasts `duration_s`, given the state at its start.
    #[inline]
    #[must_use]
    pub fn cut(&self, start: State, from_s: f64, duration_s: f64) -> ChannelSegment {
        let mut segment = ChannelSegment::starting(start);
        let to_s = from_s + duration_s;
        let mut t = from_s;
        for leg in self.legs().iter().filter(|leg| leg.end_s > from_s) {
            let until = leg.end_s.min(to_s);
            segment.push(until - t, leg.jerk_mm_s3);
            t = until;
            if t >= to_s {
                break;
            }
        }
        segment.push(to_s - t, 0.0);
        segment.ending(self.at(to_s))
    }

    /// True when every phase keeps the limits and travel, the phases join, and the end is reached.
    #[must_use]
    pub fn is_sound(&self, from: &State, limits: &Limits) -> bool {
        let mut at = *from;
        for leg in self.legs() {
            let end = leg.start.after(leg.jerk_mm_s3, leg.duration_s);
            if !joins(&at, &leg.start) || !leg_holds(leg, &end, limits) {
                return false;
            }
            at = end;
        }
        joins(&at, &State::rest(self.end_mm)) && limits.travel_holds(self.end_mm)
    }
}

/// States that are one up to rounding and the solver's own precision.
fn joins(a: &State, b: &State) -> bool {
    (a.position_mm - b.position_mm).abs() <= POSITION_SLACK_MM
        && (a.velocity_mm_s - b.velocity_mm_s).abs() <= 1e-7
        && (a.acceleration_mm_s2 - b.acceleration_mm_s2).abs() <= 1e-6
}

/// Limits over one phase: jerk; acceleration at its ends; speed there and where the acceleration
/// passes zero; position at its ends and where the speed does.
fn leg_holds(leg: &Leg, end: &State, limits: &Limits) -> bool {
    let (start, j) = (&leg.start, leg.jerk_mm_s3);
    if !(j.abs() <= limits.jerk_max_mm_s3 * (1.0 + SLACK) && limits.rates_hold(start) && limits.rates_hold(end)) {
        return false;
    }
    if start.acceleration_mm_s2 * end.acceleration_mm_s2 < 0.0 {
        let top = start.after(j, -start.acceleration_mm_s2 / j);
        if !limits.rates_hold(&State { acceleration_mm_s2: 0.0, ..top }) {
            return false;
        }
    }
    let far = start.position_mm.abs() + limits.speed_max_mm_s * leg.duration_s;
    if far <= limits.travel_max_mm {
        return true;
    }
    let (low, high) = start.reach(j, leg.duration_s);
    limits.travel_holds(low) && limits.travel_holds(high)
}

/// A plan of all three channels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Plan {
    /// The channels.
    pub channels: [ChannelPlan; 3],
}

impl Plan {
    /// Standing still.
    #[must_use]
    pub fn resting(position_mm: [f64; 3]) -> Self {
        Self { channels: position_mm.map(ChannelPlan::resting) }
    }

    /// Each channel stops as soon as it can.
    #[must_use]
    pub fn stopping(from: &[State; 3], limits: &Limits) -> Self {
        Self { channels: from.map(|s| ChannelPlan::stopping(&Stop::from(s, limits))) }
    }

    /// When all channels are at rest, s from the start.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.channels.iter().map(ChannelPlan::duration_s).fold(0.0, f64::max)
    }

    /// Checks every phase of every channel.
    ///
    /// # Errors
    /// [`Refusal::Unsound`] with the first channel that fails.
    pub fn verify(&self, from: &[State; 3], limits: &Limits) -> Result<(), Refusal> {
        for (channel, (plan, from)) in self.channels.iter().zip(from).enumerate() {
            if !plan.is_sound(from, limits) {
                return Err(Refusal::Unsound { channel });
            }
        }
        Ok(())
    }
}

/// Finds a plan from given states to rest at given positions.
pub trait Solver {
    /// Writes the plan to `out`; on a refusal `out` is garbage.
    ///
    /// # Errors
    /// [`Refusal`] when no plan was found. Soundness is the caller's to check.
    fn solve(&mut self, limits: &Limits, from: &[State; 3], target_mm: &[f64; 3], out: &mut Plan) -> Result<(), Refusal>;
}

/// The solver on `rsruckig`'s building blocks. Holds their scratch space; allocates it once.
#[derive(Debug, Clone, Default)]
pub struct Ruckig {
    scratch: Box<Scratch>,
}

#[derive(Debug, Clone, Default)]
struct Scratch {
    step1: PositionThirdOrderStep1,
    blocks: [Block; 3],
    profiles: [Profile; 3],
}

impl Solver for Ruckig {
    fn solve(&mut self, limits: &Limits, from: &[State; 3], target_mm: &[f64; 3], out: &mut Plan) -> Result<(), Refusal> {
        let mut least_s = 0.0_f64;
        for channel in 0..3 {
            if !still(&from[channel], target_mm[channel]) {
                least_s = least_s.max(self.scratch.fastest(limits, &from[channel], target_mm[channel], channel)?);
            }
        }
        let common_s = self.scratch.unblocked(least_s, from, target_mm);
        self.scratch.synchronise(limits, from, target_mm, common_s, out)
    }
}

/// A channel that rests on its target needs no profile.
fn still(from: &State, target_mm: f64) -> bool {
    from.is_rest() && from.position_mm == target_mm
}

impl Scratch {
    /// Brake and step 1: the least time of one channel, s.
    fn fastest(&mut self, l: &Limits, from: &State, target_mm: f64, channel: usize) -> Result<f64, Refusal> {
        let (v, a, j) = (l.speed_max_mm_s, l.acceleration_max_mm_s2, l.jerk_max_mm_s3);
        let p = &mut self.profiles[channel];
        p.brake.get_position_brake_trajectory(from.velocity_mm_s, from.acceleration_mm_s2, v, -v, a, -a, j);
        p.set_boundary(from.position_mm, from.velocity_mm_s, from.acceleration_mm_s2, target_mm, 0.0, 0.0);
        p.brake.finalize(&mut p.p[0], &mut p.v[0], &mut p.a[0]);
        self.step1.reset(p.p[0], p.v[0], p.a[0], target_mm, 0.0, 0.0, v, -v, a, -a, j);
        let block = &mut self.blocks[channel];
        if self.step1.get_profile(p, block) && block.t_min.is_finite() {
            Ok(block.t_min)
        } else {
            Err(Refusal::NoProfile { channel })
        }
    }

    /// The first duration from `t_s` on that lies in no channel's blocked interval.
    fn unblocked(&self, mut t_s: f64, from: &[State; 3], target_mm: &[f64; 3]) -> f64 {
        // Each channel has at most two intervals, so six moves are enough.
        for _ in 0..6 {
            let before = t_s;
            for channel in (0..3).filter(|&c| !still(&from[c], target_mm[c])) {
                let block = &self.blocks[channel];
                for interval in [&block.a, &block.b].into_iter().flatten() {
                    if t_s > interval.left && t_s < interval.right {
                        t_s = interval.right;
                    }
                }
            }
            if t_s == before {
                break;
            }
        }
        t_s
    }

    /// Step 2: every channel's profile of the common duration.
    fn synchronise(&mut self, l: &Limits, from: &[State; 3], target_mm: &[f64; 3], common_s: f64, out: &mut Plan) -> Result<(), Refusal> {
        for channel in 0..3 {
            let (to, plan) = (target_mm[channel], &mut out.channels[channel]);
            let fastest = &self.blocks[channel].p_min;
            if still(&from[channel], to) {
                *plan = ChannelPlan::resting(to);
            } else if common_s - self.blocks[channel].t_min < 1e-12 {
                *plan = transcribe(fastest, to);
            } else if let Some(found) = arrive_in(l, &from[channel], to, common_s, fastest.v[3].abs()) {
                *plan = found;
            } else {
                *plan = self.step2(l, to, common_s, channel)?;
            }
        }
        Ok(())
    }

    /// Ruckig's step 2 for one channel, from the boundary that [`Scratch::fastest`] has set.
    fn step2(&mut self, l: &Limits, target_mm: f64, common_s: f64, channel: usize) -> Result<ChannelPlan, Refusal> {
        let (v, a, j) = (l.speed_max_mm_s, l.acceleration_max_mm_s2, l.jerk_max_mm_s3);
        let p = &mut self.profiles[channel];
        let left_s = common_s - p.brake.duration;
        let mut step2 = PositionThirdOrderStep2::new(left_s, p.p[0], p.v[0], p.a[0], target_mm, 0.0, 0.0, v, -v, a, -a, j);
        if step2.get_profile(p) { Ok(transcribe(p, target_mm)) } else { Err(Refusal::NoSynchronisation { channel }) }
    }
}

/// A profile's phases in the words of this house.
fn transcribe(p: &Profile, end_mm: f64) -> ChannelPlan {
    let mut out = ChannelPlan::resting(end_mm);
    let state = |position_mm, velocity_mm_s, acceleration_mm_s2| State { position_mm, velocity_mm_s, acceleration_mm_s2 };
    if p.brake.duration > 0.0 {
        for i in 0..2 {
            out.push(state(p.brake.p[i], p.brake.v[i], p.brake.a[i]), p.brake.j[i], p.brake.t[i]);
        }
    }
    for i in 0..7 {
        out.push(state(p.p[i], p.v[i], p.a[i]), p.j[i], p.t[i]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::config::MotionConfig;
    use proptest::prelude::*;

    fn limits() -> Limits {
        Limits::try_from(&MotionConfig::default()).unwrap()
    }

    /// A state from which the speed limit can still be kept.
    fn state() -> impl Strategy<Value = State> {
        (-20.0..20.0f64, -30.0..30.0f64, -300.0..300.0f64).prop_map(|(p, v, a)| {
            let room = 30.0 - a * a / 12_000.0;
            State { position_mm: p, velocity_mm_s: v.clamp(-room, room), acceleration_mm_s2: a }
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        /// From any state to any target: a plan is found, and all channels take the same time.
        #[test]
        fn arrives_together(from in prop::array::uniform3(state()), to in prop::array::uniform3(-10.0..10.0f64)) {
            let mut plan = Plan::default();
            Ruckig::default().solve(&limits(), &from, &to, &mut plan).unwrap();
            let roomy = Limits { travel_max_mm: 60.0, ..limits() };
            prop_assert_eq!(plan.verify(&from, &roomy), Ok(()));
            for c in &plan.channels {
                prop_assert!((c.duration_s() - plan.duration_s()).abs() < 1e-9);
            }
        }

        /// Ruckig's own step 2 and the cruise are two answers to one question: both sound, both of
        /// the duration asked for.
        #[test]
        fn step_2_agrees_with_the_cruise(from in state(), to in -10.0..10.0f64, extra in 1e-3..2.0f64) {
            let l = Limits { travel_max_mm: 60.0, ..limits() };
            let mut scratch = Scratch::default();
            let common_s = scratch.fastest(&l, &from, to, 0).unwrap() + extra;
            let cruise = arrive_in(&l, &from, to, common_s, l.speed_max_mm_s).unwrap();
            let step2 = scratch.step2(&l, to, common_s, 0).unwrap();
            for plan in [cruise, step2] {
                prop_assert!(plan.is_sound(&from, &l));
                prop_assert!((plan.duration_s() - common_s).abs() < 1e-8);
            }
        }

        /// Cutting a plan into ticks and walking the pieces meets the plan at every boundary.
        #[test]
        fn cuts_join(from in prop::array::uniform3(state()), to in prop::array::uniform3(-10.0..10.0f64), dt in 1e-4..5e-3f64) {
            let mut plan = Plan::default();
            Ruckig::default().solve(&limits(), &from, &to, &mut plan).unwrap();
            for (c, from) in plan.channels.iter().zip(from) {
                let (mut t, mut at) = (0.0, from);
                while t < plan.duration_s() + dt {
                    let cut = c.cut(at, t, dt);
                    let walked = cut.pieces().iter().fold(at, |s, &(d, j)| s.after(j, d));
                    prop_assert!(joins(&walked, &cut.end));
                    t += dt;
                    at = cut.end;
                }
                prop_assert_eq!(at, State::rest(c.end_mm));
            }
        }
    }

    #[test]
    fn a_plan_that_breaks_a_limit_is_unsound() {
        let l = limits();
        let from = [State::rest(0.0); 3];
        let mut plan = Plan::default();
        Ruckig::default().solve(&l, &from, &[5.0, -3.0, 1.0], &mut plan).unwrap();
        assert_eq!(plan.verify(&from, &l), Ok(()));
        let with = |change: fn(&mut Limits)| {
            let mut tight = l;
            change(&mut tight);
            plan.verify(&from, &tight)
        };
        assert_eq!(with(|l| l.speed_max_mm_s *= 0.5), Err(Refusal::Unsound { channel: 0 }));
        assert_eq!(with(|l| l.acceleration_max_mm_s2 *= 0.5), Err(Refusal::Unsound { channel: 0 }));
        assert_eq!(with(|l| l.jerk_max_mm_s3 *= 0.9), Err(Refusal::Unsound { channel: 0 }));
        assert_eq!(with(|l| l.travel_max_mm = 2.0), Err(Refusal::Unsound { channel: 0 }));
        let mut torn = plan;
        torn.channels[1].legs[2].start.position_mm += 1e-3;
        assert_eq!(torn.verify(&from, &l), Err(Refusal::Unsound { channel: 1 }));
        let mut missing = plan;
        missing.channels[2].end_mm = 0.9;
        assert_eq!(missing.verify(&from, &l), Err(Refusal::Unsound { channel: 2 }));
    }
}
