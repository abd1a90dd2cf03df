//! A plan: the way of all three channels to rest, in constant-jerk phases, and its proof.
//!
//! No plan is believed unseen, whoever made it: [`Plan::verify`] checks limits, travel, continuity
//! and arrival on the closed form of every phase.

use crate::motion::limits::{MotionLimits, POSITION_SLACK_MM, SLACK};
use crate::motion::segment::ChannelSegment;
use crate::motion::state::MotionState;
use crate::motion::stop::Stop;

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
    pub start: MotionState,
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
    pub fn push(&mut self, start: MotionState, jerk_mm_s3: f64, duration_s: f64) {
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
    pub fn at(&self, t_s: f64) -> MotionState {
        match self.legs().iter().find(|leg| t_s < leg.end_s) {
            Some(leg) => leg.start.after(leg.jerk_mm_s3, (t_s - (leg.end_s - leg.duration_s)).max(0.0)),
            None => MotionState::rest(self.end_mm),
        }
    }

    /// The part from `from_s` on that lasts `duration_s`, given the state at its start.
    #[inline]
    #[must_use]
    pub fn cut(&self, start: MotionState, from_s: f64, duration_s: f64) -> ChannelSegment {
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
    pub fn is_sound(&self, from: &MotionState, limits: &MotionLimits) -> bool {
        let mut at = *from;
        for leg in self.legs() {
            let end = leg.start.after(leg.jerk_mm_s3, leg.duration_s);
            if !joins(&at, &leg.start, limits) || !leg_holds(leg, &end, limits) {
                return false;
            }
            at = end;
        }
        joins(&at, &MotionState::rest(self.end_mm), limits) && limits.travel_holds(self.end_mm)
    }
}

/// States that are one up to rounding and the solver's own precision (1e-8 mm/τ, see [`super::solver`]).
fn joins(a: &MotionState, b: &MotionState, limits: &MotionLimits) -> bool {
    let a_max = limits.acceleration_max_mm_s2;
    (a.position_mm - b.position_mm).abs() <= POSITION_SLACK_MM
        && (a.velocity_mm_s - b.velocity_mm_s).abs() <= 1e-7 * (1.0 + a_max.sqrt())
        && (a.acceleration_mm_s2 - b.acceleration_mm_s2).abs() <= 1e-7 * (1.0 + a_max)
}

/// Limits over one phase: jerk; acceleration at its ends; speed there and where the acceleration
/// passes zero; position at its ends and where the speed does.
fn leg_holds(leg: &Leg, end: &MotionState, limits: &MotionLimits) -> bool {
    let (start, j) = (&leg.start, leg.jerk_mm_s3);
    if !(j.abs() <= limits.jerk_max_mm_s3 * (1.0 + SLACK) && limits.rates_hold(start) && limits.rates_hold(end)) {
        return false;
    }
    if start.acceleration_mm_s2 * end.acceleration_mm_s2 < 0.0 {
        let top = start.after(j, -start.acceleration_mm_s2 / j);
        if !limits.rates_hold(&MotionState { acceleration_mm_s2: 0.0, ..top }) {
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
    pub fn stopping(from: &[MotionState; 3], limits: &MotionLimits) -> Self {
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
    pub fn verify(&self, from: &[MotionState; 3], limits: &MotionLimits) -> Result<(), Refusal> {
        for (channel, (plan, from)) in self.channels.iter().zip(from).enumerate() {
            if !plan.is_sound(from, limits) {
                return Err(Refusal::Unsound { channel });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::config::MotionConfig;
    use crate::motion::solver::{Ruckig, Solver};

    fn limits() -> MotionLimits {
        MotionLimits::try_from(&MotionConfig::default()).unwrap()
    }

    #[test]
    fn a_plan_that_breaks_a_limit_is_unsound() {
        let l = limits();
        let from = [MotionState::rest(0.0); 3];
        let mut plan = Plan::default();
        Ruckig::default().solve(&l, &from, &[5.0, -3.0, 1.0], &mut plan).unwrap();
        assert_eq!(plan.verify(&from, &l), Ok(()));
        let with = |change: fn(&mut MotionLimits)| {
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
