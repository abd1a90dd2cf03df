//! The shortest jerk-limited stop, the fallback whenever motion cannot continue as planned.
//!
//! A stop leads from (v, a) to (0, 0) in least time under |a| ≤ A, |j| ≤ J. Releasing the
//! acceleration at full jerk would leave the speed `v_z = v + a|a|/2J`. With s = sgn(v_z), and v and a
//! counted along s, the phases are
//!
//! 1. jerk −sJ until the acceleration is −sB, 2. constant acceleration, 3. jerk +sJ back to zero,
//!
//! where `B = min(A, √(J v + a²/2))` and phase 2 lasts `(v + a²/2J)/B − B/J`.
//! (Velocity-target case of Kröger and Wahl, "Online Trajectory Generation", IEEE T-RO 2010.)
//! If v and v_z differ in sign, the piston reverses first, and the extreme position is at the reversal.

use crate::motion::{MotionLimits, MotionState};

/// Three constant-jerk phases that end at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// Start state.
    pub from: MotionState,
    /// Duration, s, and jerk, mm/s³, of each phase.
    pub phases: [(f64, f64); 3],
    /// Final rest position, mm.
    pub end_mm: f64,
}

impl Stop {
    /// The shortest stop from a state.
    pub fn from(state: MotionState, limits: &MotionLimits) -> Self {
        let (j, a_max) = (limits.jerk_max_mm_s3, limits.acceleration_max_mm_s2);
        let (v, a) = (state.velocity_mm_s, state.acceleration_mm_s2);
        let v_z = v + a * a.abs() / (2.0 * j);
        let s = if v_z < 0.0 { -1.0 } else { 1.0 };
        let (v, a) = (v * s, a * s);
        let impulse = (v + a * a / (2.0 * j)).max(0.0);
        let peak = (j * impulse).sqrt();
        let (brake, hold_s) = if peak <= a_max {
            (peak, 0.0)
        } else {
            (a_max, impulse / a_max - a_max / j)
        };
        let phases = [
            (((a + brake) / j).max(0.0), -s * j),
            (hold_s.max(0.0), 0.0),
            (brake / j, s * j),
        ];
        let after = |at: MotionState, (t, jerk)| at.after(jerk, t);
        Self {
            from: state,
            phases,
            end_mm: phases.into_iter().fold(state, after).position_mm,
        }
    }

    /// Least and greatest position on the way, mm.
    pub fn position_range(&self) -> (f64, f64) {
        let mut at = self.from;
        let mut range = (at.position_mm, at.position_mm);
        for (t, jerk) in self.phases {
            let (low, high) = at.position_range(jerk, t);
            range = (range.0.min(low), range.1.max(high));
            at = at.after(jerk, t);
        }
        range
    }
}

impl MotionLimits {
    /// The longest stop from any state within the limits, mm.
    ///
    /// The stopping distance grows with speed and with acceleration, so this is the stop from the state in
    /// which both are at their limits.
    pub fn longest_stop_mm(&self) -> f64 {
        let fastest = MotionState {
            position_mm: 0.0,
            velocity_mm_s: self.speed_max_mm_s,
            acceleration_mm_s2: self.acceleration_max_mm_s2,
        };
        Stop::from(fastest, self).end_mm
    }
}

/// Whether the shortest stop from a state stays within travel. `longest_mm` is [`MotionLimits::longest_stop_mm`]; it
/// saves the calculation far from the ends of travel.
pub fn stops_within_travel(state: &MotionState, limits: &MotionLimits, longest_mm: f64) -> bool {
    if state.position_mm.abs() + longest_mm <= limits.travel_max_mm || state.is_rest() {
        return limits.contains_position(state.position_mm);
    }
    let (low, high) = Stop::from(*state, limits).position_range();
    limits.contains_position(low) && limits.contains_position(high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn limits() -> MotionLimits {
        MotionLimits::default()
    }

    fn duration_s(stop: &Stop) -> f64 {
        stop.phases.iter().map(|p| p.0).sum()
    }

    proptest! {
        #[test]
        fn a_stop_ends_at_rest_within_the_limits(v in -30.0..30.0f64, share in -1.0..1.0f64) {
            let l = limits();
            let a = share * l.acceleration_max_mm_s2;
            let mut at = MotionState { position_mm: 0.0, velocity_mm_s: v, acceleration_mm_s2: a };
            let stop = Stop::from(at, &l);
            for (t, jerk) in stop.phases {
                prop_assert!(t >= 0.0 && jerk.abs() <= l.jerk_max_mm_s3);
                at = at.after(jerk, t);
                prop_assert!(at.acceleration_mm_s2.abs() <= l.acceleration_max_mm_s2 * (1.0 + 1e-9));
            }
            prop_assert!(at.velocity_mm_s.abs() < 1e-9, "{at:?}");
            prop_assert!(at.acceleration_mm_s2.abs() < 1e-9, "{at:?}");
            let (low, high) = stop.position_range();
            prop_assert!(high - low <= l.longest_stop_mm() + 1e-9);
        }

        /// Random admissible braking is never faster, and never slower in speed at the same time.
        #[test]
        fn no_other_braking_is_faster(v in 0.5..30.0f64, random in prop::collection::vec(-1.0..1.0f64, 400)) {
            let l = limits();
            let from = MotionState { velocity_mm_s: v, ..MotionState::rest(0.0) };
            let best = Stop::from(from, &l);
            let dt = duration_s(&best) / 200.0;
            let (mut s, mut t) = (from, 0.0);
            for u in random {
                let jerk = (-1.0 + 0.6 * (u + 1.0)) * l.jerk_max_mm_s3;
                let lowest = (-l.acceleration_max_mm_s2 - s.acceleration_mm_s2) / dt;
                s = s.after(jerk.max(lowest), dt);
                t += dt;
                if s.velocity_mm_s.abs() < 1e-6 && s.acceleration_mm_s2.abs() < 1e-6 {
                    prop_assert!(t >= duration_s(&best) - 2.0 * dt);
                }
                if t < duration_s(&best) * 0.5 {
                    let (mut at, mut left) = (from, t);
                    for (d, jerk) in best.phases {
                        at = at.after(jerk, d.min(left));
                        left -= d.min(left);
                    }
                    prop_assert!(s.velocity_mm_s >= at.velocity_mm_s - 1e-6);
                }
            }
        }
    }

    #[test]
    fn a_stop_from_rest_takes_no_time() {
        assert_eq!(
            duration_s(&Stop::from(MotionState::rest(4.0), &limits())),
            0.0
        );
    }
}
