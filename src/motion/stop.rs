//! The shortest jerk-limited stop: what is done when there is nothing better to do.
//!
//! From (v, a) to (0, 0) in least time under |a| ≤ A, |j| ≤ J. Releasing the acceleration at full
//! jerk would leave the speed `v_z = v + a|a|/2J`. With s = sgn(v_z) and v, a counted along s:
//!
//! 1. jerk −sJ until the acceleration is −sB, 2. hold, 3. jerk +sJ back to zero,
//!
//! where `B = min(A, √(J v + a²/2))` and the hold lasts `(v + a²/2J)/B − B/J`.
//! (Velocity-target case of Kröger and Wahl, "Online Trajectory Generation", IEEE T-RO 2010.)
//! When v and v_z differ in sign the piston first turns round; the farthest point is then there.

use crate::motion::limits::MotionLimits;
use crate::motion::segment::{ChannelSegment, Segment};
use crate::motion::state::MotionState;

/// Three constant-jerk phases that end in rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// Where it starts.
    pub from: MotionState,
    /// Duration, s, and jerk, mm/s³, of each phase.
    pub phases: [(f64, f64); 3],
    /// Where it ends, at rest, mm.
    pub end_mm: f64,
}

/// The three phases, (s, mm/s³), that take away a speed `excess_mm_s` and an acceleration in least
/// time. With the excess over another speed than zero this is the quickest way to that speed.
#[inline]
#[must_use]
pub fn settling(excess_mm_s: f64, acceleration_mm_s2: f64, limits: &MotionLimits) -> [(f64, f64); 3] {
    let (j, a_max) = (limits.jerk_max_mm_s3, limits.acceleration_max_mm_s2);
    let a = acceleration_mm_s2;
    let released = excess_mm_s + a * a.abs() / (2.0 * j);
    let s = if released < 0.0 { -1.0 } else { 1.0 };
    let (v, a) = (excess_mm_s * s, a * s);
    let impulse = (v + a * a / (2.0 * j)).max(0.0);
    let peak = (j * impulse).sqrt();
    let (brake, hold_s) = if peak <= a_max { (peak, 0.0) } else { (a_max, impulse / a_max - a_max / j) };
    [(((a + brake) / j).max(0.0), -s * j), (hold_s.max(0.0), 0.0), (brake / j, s * j)]
}

impl Stop {
    /// The shortest stop from a state.
    #[must_use]
    pub fn from(state: MotionState, limits: &MotionLimits) -> Self {
        let phases = settling(state.velocity_mm_s, state.acceleration_mm_s2, limits);
        let end = phases.iter().fold(state, |at, &(t, jerk)| at.after(jerk, t));
        Self { from: state, phases, end_mm: end.position_mm }
    }

    /// How long it takes, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.phases.iter().map(|p| p.0).sum()
    }

    /// Least and greatest position on the way, mm.
    #[must_use]
    pub fn reach(&self) -> (f64, f64) {
        let mut at = self.from;
        let mut reach = (at.position_mm, at.position_mm);
        for (t, jerk) in self.phases {
            let (low, high) = at.reach(jerk, t);
            reach = (reach.0.min(low), reach.1.max(high));
            at = at.after(jerk, t);
        }
        reach
    }
}

/// Whether a stop from this state stays within travel.
#[must_use]
pub fn stops_within_travel(state: &MotionState, limits: &MotionLimits, longest_mm: f64) -> bool {
    if state.position_mm.abs() + longest_mm <= limits.travel_max_mm || state.is_rest() {
        return limits.travel_holds(state.position_mm);
    }
    let (low, high) = Stop::from(*state, limits).reach();
    limits.travel_holds(low) && limits.travel_holds(high)
}

/// One segment that brings all three channels to rest, each as soon as it can.
///
/// Its duration is that of the longest stop, rounded up to whole nanoseconds.
#[must_use]
pub fn stop_segment(from: &[MotionState; 3], limits: &MotionLimits) -> Segment {
    let stops = from.map(|s| Stop::from(s, limits));
    let longest_s = stops.iter().map(Stop::duration_s).fold(0.0, f64::max);
    let duration_s = (longest_s * 1e9).ceil() * 1e-9;
    let channels = stops.map(|stop| {
        let mut c = ChannelSegment::starting(stop.from);
        for (t, jerk) in stop.phases {
            c.push(t, jerk);
        }
        c.push(duration_s - stop.duration_s(), 0.0);
        c.ending(MotionState::rest(stop.end_mm))
    });
    Segment { duration_s, channels }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::config::MotionConfig;
    use proptest::prelude::*;

    fn limits() -> MotionLimits {
        MotionLimits::try_from(&MotionConfig::default()).unwrap()
    }

    proptest! {
        /// Every stop ends at rest and keeps acceleration within its limit on the way.
        #[test]
        fn ends_at_rest_within_limits(v in -30.0..30.0f64, a in -300.0..300.0f64) {
            let l = limits();
            let s = MotionState { position_mm: 0.0, velocity_mm_s: v, acceleration_mm_s2: a };
            let stop = Stop::from(s, &l);
            let mut at = s;
            for (t, jerk) in stop.phases {
                prop_assert!(t >= 0.0 && jerk.abs() <= l.jerk_max_mm_s3);
                at = at.after(jerk, t);
                prop_assert!(at.acceleration_mm_s2.abs() <= l.acceleration_max_mm_s2 * (1.0 + 1e-9));
            }
            prop_assert!(at.velocity_mm_s.abs() < 1e-9, "{at:?}");
            prop_assert!(at.acceleration_mm_s2.abs() < 1e-9, "{at:?}");
            let (low, high) = stop.reach();
            prop_assert!(high - low <= l.stop_longest_mm() + 1e-9);
        }

        /// No other jerk-limited way stops sooner: random admissible brakings are never faster.
        #[test]
        fn is_the_fastest(v in 0.5..30.0f64, seed in prop::collection::vec(-1.0..1.0f64, 400)) {
            let l = limits();
            let mut s = MotionState { velocity_mm_s: v, ..MotionState::rest(0.0) };
            let best = Stop::from(s, &l).duration_s();
            let dt = best / 200.0;
            let mut t = 0.0;
            for u in seed {
                let jerk = (-1.0 + 0.6 * (u + 1.0)) * l.jerk_max_mm_s3;
                let lowest = (-l.acceleration_max_mm_s2 - s.acceleration_mm_s2) / dt;
                s = s.after(jerk.max(lowest), dt);
                t += dt;
                if s.velocity_mm_s.abs() < 1e-6 && s.acceleration_mm_s2.abs() < 1e-6 {
                    prop_assert!(t >= best - 2.0 * dt);
                }
                // the least speed attainable at t, from the same start, belongs to the stop
                if t < best * 0.5 {
                    let mut at = MotionState { velocity_mm_s: v, ..MotionState::rest(0.0) };
                    let mut left = t;
                    for (d, jerk) in Stop::from(at, &l).phases {
                        let d = d.min(left);
                        at = at.after(jerk, d);
                        left -= d;
                    }
                    prop_assert!(s.velocity_mm_s >= at.velocity_mm_s - 1e-6);
                }
            }
        }
    }

    #[test]
    fn rest_needs_no_time() {
        assert_eq!(Stop::from(MotionState::rest(4.0), &limits()).duration_s(), 0.0);
        let seg = stop_segment(&[MotionState::rest(1.0); 3], &limits());
        assert_eq!(seg.duration_s, 0.0);
    }
}
