//! A plan: the motion of all three channels to rest as constant-jerk phases, and its verification.
//!
//! No plan is followed unverified, whichever solver made it: [`Plan::verify`] checks limits, travel,
//! continuity and arrival on the closed form of every phase.

use crate::motion::config::{POSITION_TOLERANCE_MM, TOLERANCE};
use crate::motion::{ChannelSegment, MotionLimits, MotionState, Segment, Stop};

/// Most phases of one channel's plan: two of braking and seven of the profile.
pub const PHASES_MAX: usize = 9;

/// Why there is no new plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlanFault {
    /// A target is infinite or not a number.
    TargetNotFinite,
    /// There is no time-optimal profile to a target.
    NoProfile,
    /// A profile exceeds a limit, leaves travel, is discontinuous or misses the target.
    Invalid,
    /// From the end of the tick no stop stays within travel.
    NoStop,
}

/// One constant-jerk phase of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Phase {
    /// End, s from the start of the plan.
    pub end_s: f64,
    /// Duration, s.
    pub duration_s: f64,
    /// State at its start.
    pub start: MotionState,
    /// Jerk, mm/s³.
    pub jerk_mm_s3: f64,
}

/// One channel's motion to rest.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ChannelPlan {
    phases: [Phase; PHASES_MAX],
    len: usize,
    /// Final rest position, mm.
    pub end_mm: f64,
}

impl ChannelPlan {
    /// A plan without phases that is at rest at a position. [`ChannelPlan::push`] adds phases.
    pub fn resting(position_mm: f64) -> Self {
        Self {
            end_mm: position_mm,
            ..Self::default()
        }
    }

    /// The shortest stop.
    pub fn stopping(stop: &Stop) -> Self {
        let mut plan = Self::resting(stop.end_mm);
        let mut at = stop.from;
        for (t, jerk) in stop.phases {
            plan.push(at, jerk, t);
            at = at.after(jerk, t);
        }
        plan
    }

    /// Appends a phase; does nothing if `duration_s` is not positive.
    pub fn push(&mut self, start: MotionState, jerk_mm_s3: f64, duration_s: f64) {
        if duration_s > 0.0 && self.len < PHASES_MAX {
            let end_s = self.duration_s() + duration_s;
            self.phases[self.len] = Phase {
                end_s,
                duration_s,
                start,
                jerk_mm_s3,
            };
            self.len += 1;
        }
    }

    fn phases(&self) -> &[Phase] {
        &self.phases[..self.len]
    }

    /// Time from the start to rest, s.
    pub fn duration_s(&self) -> f64 {
        self.phases().last().map_or(0.0, |phase| phase.end_s)
    }

    /// The state at a time.
    pub fn at(&self, t_s: f64) -> MotionState {
        let Some(phase) = self.phases().iter().find(|phase| t_s < phase.end_s) else {
            return MotionState::rest(self.end_mm);
        };
        let since_s = (t_s - (phase.end_s - phase.duration_s)).max(0.0);
        phase.start.after(phase.jerk_mm_s3, since_s)
    }

    /// The part from `from_s` on that lasts `duration_s`, given the state at its start.
    pub fn cut(&self, start: MotionState, from_s: f64, duration_s: f64) -> ChannelSegment {
        let mut segment = ChannelSegment::starting(start);
        let to_s = from_s + duration_s;
        let mut t = from_s;
        for phase in self.phases().iter().filter(|phase| phase.end_s > from_s) {
            let until = phase.end_s.min(to_s);
            segment.push(until - t, phase.jerk_mm_s3);
            t = until;
            if t >= to_s {
                break;
            }
        }
        segment.push(to_s - t, 0.0);
        segment.ending(self.at(to_s))
    }

    /// Whether every phase keeps the limits and travel, the phases join, and the last one arrives.
    pub fn is_valid(&self, from: &MotionState, limits: &MotionLimits) -> bool {
        let mut at = *from;
        for phase in self.phases() {
            let end = phase.start.after(phase.jerk_mm_s3, phase.duration_s);
            if !joins(&at, &phase.start, limits) || !keeps_limits(phase, &end, limits) {
                return false;
            }
            at = end;
        }
        joins(&at, &MotionState::rest(self.end_mm), limits) && limits.contains_position(self.end_mm)
    }
}

/// Whether two states are equal up to rounding and the solver's precision of 1e-8, which counts in
/// units of time of 1/√A seconds (see [`super::solver`]).
fn joins(a: &MotionState, b: &MotionState, limits: &MotionLimits) -> bool {
    let a_max = limits.acceleration_max_mm_s2;
    (a.position_mm - b.position_mm).abs() <= POSITION_TOLERANCE_MM
        && (a.velocity_mm_s - b.velocity_mm_s).abs() <= 1e-7 * (1.0 + a_max.sqrt())
        && (a.acceleration_mm_s2 - b.acceleration_mm_s2).abs() <= 1e-7 * (1.0 + a_max)
}

/// Whether one phase keeps all limits. Acceleration is extreme at its ends, speed there and where the
/// acceleration is zero, position there and where the speed is zero.
fn keeps_limits(phase: &Phase, end: &MotionState, limits: &MotionLimits) -> bool {
    let (start, j) = (&phase.start, phase.jerk_mm_s3);
    if !(j.abs() <= limits.jerk_max_mm_s3 * (1.0 + TOLERANCE)
        && limits.contains_rates(start)
        && limits.contains_rates(end))
    {
        return false;
    }
    if start.acceleration_mm_s2 * end.acceleration_mm_s2 < 0.0 {
        let mut fastest = start.after(j, -start.acceleration_mm_s2 / j);
        fastest.acceleration_mm_s2 = 0.0;
        if !limits.contains_rates(&fastest) {
            return false;
        }
    }
    let farthest_mm = start.position_mm.abs() + limits.speed_max_mm_s * phase.duration_s;
    if farthest_mm <= limits.travel_max_mm {
        return true;
    }
    let (low, high) = start.position_range(j, phase.duration_s);
    limits.contains_position(low) && limits.contains_position(high)
}

/// A plan of all three channels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Plan {
    /// The channels.
    pub channels: [ChannelPlan; 3],
}

impl Plan {
    /// Rest.
    pub fn resting(position_mm: [f64; 3]) -> Self {
        Self {
            channels: position_mm.map(ChannelPlan::resting),
        }
    }

    /// The shortest stop of each channel.
    pub fn stopping(from: &[MotionState; 3], limits: &MotionLimits) -> Self {
        Self {
            channels: from.map(|s| ChannelPlan::stopping(&Stop::from(s, limits))),
        }
    }

    /// Time from the start until all channels are at rest, s.
    pub fn duration_s(&self) -> f64 {
        let durations_s = self.channels.iter().map(ChannelPlan::duration_s);
        durations_s.fold(0.0, f64::max)
    }

    /// The part from `from_s` on that lasts `duration_s`, given the states at its start.
    pub fn cut(&self, start: &[MotionState; 3], from_s: f64, duration_s: f64) -> Segment {
        Segment {
            duration_s,
            channels: std::array::from_fn(|i| self.channels[i].cut(start[i], from_s, duration_s)),
        }
    }

    /// Checks every phase of every channel.
    ///
    /// # Errors
    /// [`PlanFault::Invalid`].
    pub fn verify(&self, from: &[MotionState; 3], limits: &MotionLimits) -> Result<(), PlanFault> {
        let mut channels = self.channels.iter().zip(from);
        let valid = channels.all(|(plan, from)| plan.is_valid(from, limits));
        valid.then_some(()).ok_or(PlanFault::Invalid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::solver::{Ruckig, Solver};

    #[test]
    fn a_plan_that_exceeds_a_limit_is_invalid() {
        let l = MotionLimits::default();
        let from = [MotionState::rest(0.0); 3];
        let mut plan = Plan::default();
        Ruckig::default()
            .solve(&l, &from, &[5.0, -3.0, 1.0], &mut plan)
            .unwrap();
        assert_eq!(plan.verify(&from, &l), Ok(()));
        let invalid = Err(PlanFault::Invalid);
        let with = |change: fn(&mut MotionLimits)| {
            let mut tight = l;
            change(&mut tight);
            plan.verify(&from, &tight)
        };
        assert_eq!(with(|l| l.speed_max_mm_s *= 0.3), invalid);
        assert_eq!(with(|l| l.acceleration_max_mm_s2 *= 0.3), invalid);
        assert_eq!(with(|l| l.jerk_max_mm_s3 *= 0.9), invalid);
        assert_eq!(with(|l| l.travel_max_mm = 2.0), invalid);
        let mut discontinuous = plan;
        discontinuous.channels[1].phases[2].start.position_mm += 1e-3;
        assert_eq!(discontinuous.verify(&from, &l), invalid);
        let mut missing = plan;
        missing.channels[2].end_mm = 0.9;
        assert_eq!(missing.verify(&from, &l), invalid);
    }
}
