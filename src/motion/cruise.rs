//! Arriving later on purpose: the profile of a given duration, by choosing the cruising speed.
//!
//! A channel that could arrive earlier than the slowest one goes to a lower speed c, cruises there
//! and stops. With t₁(c), d₁(c) the quickest change of speed to c ([`settling`]) and t₂(c), d₂(c) the
//! stop from c, the distance D to the target is closed in the common time T when
//!
//! `g(c) = D − d₁(c) − d₂(c) − c (T − t₁(c) − t₂(c)) = 0`.
//!
//! Distances count along the side of the target as seen from where the shortest stop would end, so
//! g(0) ≥ 0. A speed too high leaves no way to cruise on, then the missing way itself is the gap
//! (the time at c counts as zero), so g(c) < 0 beyond the root, which false position (Anderson and
//! Björck, BIT 1973) finds in about six trials. All parts keep acceleration and jerk by construction.
//!
//! This is what Ruckig's step 2 gives when there is a plateau, at a third of the cost of going through
//! all its cases. Not all profiles have one: a channel that is braking hard gains a little time by
//! easing the brake. There the root has no time left to cruise, and the answer is `None`.

use crate::motion::limits::MotionLimits;
use crate::motion::plan::ChannelPlan;
use crate::motion::state::MotionState;
use crate::motion::stop::settling;

/// How exactly the distance is closed, mm.
const CLOSE_MM: f64 = 1e-10;
/// Steps of false position before giving up.
const STEPS_MAX: u32 = 40;

/// One trial of a cruising speed.
struct Trial {
    gap_mm: f64,
    cruise_s: f64,
}

/// The problem of one channel, mirrored so that the target lies ahead.
struct Cruise<'a> {
    limits: &'a MotionLimits,
    from: MotionState,
    way_mm: f64,
    duration_s: f64,
}

impl Cruise<'_> {
    /// Duration and distance of the stop from a cruise.
    fn stopping(&self, speed_mm_s: f64) -> (f64, f64) {
        let (a, j) = (self.limits.acceleration_max_mm_s2, self.limits.jerk_max_mm_s3);
        let t = if speed_mm_s * j > a * a { speed_mm_s / a + a / j } else { 2.0 * (speed_mm_s / j).sqrt() };
        (t, 0.5 * speed_mm_s * t)
    }

    fn phases(&self, speed_mm_s: f64) -> [(f64, f64); 3] {
        settling(self.from.velocity_mm_s - speed_mm_s, self.from.acceleration_mm_s2, self.limits)
    }

    fn attempt(&self, speed_mm_s: f64) -> Trial {
        let phases = self.phases(speed_mm_s);
        let ramp_s = phases[0].0 + phases[1].0 + phases[2].0;
        let ramp_mm = phases.iter().fold(self.from, |s, &(t, jerk)| s.after(jerk, t)).position_mm;
        let (stop_s, stop_mm) = self.stopping(speed_mm_s);
        let cruise_s = self.duration_s - ramp_s - stop_s;
        Trial { gap_mm: self.way_mm - ramp_mm - stop_mm - speed_mm_s * cruise_s.max(0.0), cruise_s }
    }

    /// The cruising speed that closes the gap, and the time spent at it.
    fn solve(&self, peak_mm_s: f64) -> Option<(f64, f64)> {
        let (mut low, mut high) = (0.0, peak_mm_s);
        let (mut gap_low, mut gap_high) = (self.attempt(low).gap_mm, self.attempt(high).gap_mm);
        if gap_high >= 0.0 {
            high = self.limits.speed_max_mm_s;
            gap_high = self.attempt(high).gap_mm;
        }
        if !(gap_low > 0.0 && gap_high < 0.0) {
            return None;
        }
        let mut last = None;
        for _ in 0..STEPS_MAX {
            let speed = (low * gap_high - high * gap_low) / (gap_high - gap_low);
            let Trial { gap_mm, cruise_s } = self.attempt(speed);
            if gap_mm.abs() < CLOSE_MM {
                return (cruise_s >= -1e-12).then_some((speed, cruise_s));
            }
            // An end that stays put twice counts for less, so that both ends close in.
            let slow = gap_mm > 0.0;
            let (moved, stayed) = if slow { (&mut gap_low, &mut gap_high) } else { (&mut gap_high, &mut gap_low) };
            if last == Some(slow) {
                let weight = 1.0 - gap_mm / *moved;
                *stayed *= if weight > 0.0 { weight } else { 0.5 };
            }
            *moved = gap_mm;
            *(if slow { &mut low } else { &mut high }) = speed;
            last = Some(slow);
        }
        None
    }
}

/// The plan from `from` to rest at `target_mm` that takes `duration_s`.
///
/// `peak_mm_s` is a guess of the speed that would be too high, best that of the time-optimal profile.
/// `None` when no cruise takes that long: see above, or less than the least time was asked for, or the
/// target is exactly where the shortest stop ends. The duration is kept to rounding.
#[must_use]
pub fn arrive_in(limits: &MotionLimits, from: &MotionState, target_mm: f64, duration_s: f64, peak_mm_s: f64) -> Option<ChannelPlan> {
    let stop_mm =
        settling(from.velocity_mm_s, from.acceleration_mm_s2, limits).iter().fold(*from, |s, &(t, jerk)| s.after(jerk, t)).position_mm;
    let side = if target_mm >= stop_mm { 1.0 } else { -1.0 };
    let mirrored =
        MotionState { position_mm: 0.0, velocity_mm_s: from.velocity_mm_s * side, acceleration_mm_s2: from.acceleration_mm_s2 * side };
    let way_mm = (target_mm - from.position_mm) * side;
    let cruise = Cruise { limits, from: mirrored, way_mm, duration_s };
    let (speed, cruise_s) = cruise.solve(peak_mm_s)?;
    let mut plan = ChannelPlan::resting(target_mm);
    let mut at = *from;
    let mut go = |t: f64, jerk: f64| {
        plan.push(at, jerk, t);
        at = at.after(jerk, t);
    };
    for (t, jerk) in cruise.phases(speed) {
        go(t, jerk * side);
    }
    go(cruise_s, 0.0);
    for (t, jerk) in settling(speed, 0.0, limits) {
        go(t, jerk * side);
    }
    Some(plan)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::config::MotionConfig;
    use crate::motion::plan::Plan;
    use crate::motion::solver::{Ruckig, Solver};
    use proptest::prelude::*;

    proptest! {
        /// From any state, any duration from the least on: if there is a cruise it is sound and as long
        /// as asked, and with time to spare there is one.
        #[test]
        fn takes_as_long_as_asked(
            v in -20.0..20.0f64, a in -300.0..300.0f64, to in -15.0..15.0f64, extra in 1e-6..4.0f64,
        ) {
            let l = MotionLimits { travel_max_mm: 60.0, ..MotionLimits::try_from(&MotionConfig::default()).unwrap() };
            let from = MotionState { position_mm: 0.3, velocity_mm_s: v, acceleration_mm_s2: a };
            let mut fastest = Plan::default();
            Ruckig::default().solve(&l, &[from, MotionState::rest(0.0), MotionState::rest(0.0)], &[to, 0.0, 0.0], &mut fastest).unwrap();
            let least_s = fastest.duration_s();
            let plan = arrive_in(&l, &from, to, least_s + extra, 0.0);
            prop_assert!(plan.is_some() || extra < 0.5);
            if let Some(plan) = plan {
                prop_assert!(plan.is_sound(&from, &l));
                prop_assert!((plan.duration_s() - least_s - extra).abs() < 1e-9);
            }
            prop_assert_eq!(arrive_in(&l, &from, to, least_s * 0.99, 0.0), None);
        }
    }
}
