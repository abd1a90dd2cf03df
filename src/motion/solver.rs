//! The solver: a plan from the present state to rest at the target, each channel as fast as the limits allow.
//!
//! The mathematics is that of Ruckig (Berscheid and Kröger, "Jerk-limited Real-time Trajectory
//! Generation with Arbitrary Target States", RSS 2021) as ported in `rsruckig`:
//!
//! * brake: up to two phases that bring a state just outside the limits back in;
//! * step 1: the time-optimal seven-phase profile to (p_f, 0, 0).
//!
//! The channels are not synchronised. A piston that crosses its backlash would hold the other two back, which then leave
//! the bend that the set-point asks for.
//!
//! `rsruckig::calculate` does the same and allocates nothing when it succeeds, but formats a long error
//! string when it fails, whatever the error handler. The control path must not allocate in either
//! case, so this file calls the published building blocks directly and reports a [`PlanFault`].
//!
//! `rsruckig` compares with fixed tolerances (1e-8 for position and speed, 1e-10 for acceleration),
//! which presume numbers near one. This file therefore scales time to a unit τ = √(mm / A), in which
//! the largest acceleration is 1 mm/τ². In seconds, with accelerations of 10⁴ mm/s², `rsruckig` refuses
//! one plan in a thousand.

use crate::motion::plan::{ChannelPlan, Plan, PlanFault};
use crate::motion::{MotionLimits, MotionState};
use rsruckig::block::Block;
use rsruckig::position_third_step1::PositionThirdOrderStep1;
use rsruckig::profile::Profile;

/// Finds a plan from given states to rest at given positions.
pub trait Solver {
    /// Writes the plan to `out`; after an error the content of `out` is unspecified.
    ///
    /// # Errors
    /// [`PlanFault`] when there is no plan. The caller checks the validity of a plan.
    fn solve(
        &mut self,
        limits: &MotionLimits,
        from: &[MotionState; 3],
        target_mm: &[f64; 3],
        out: &mut Plan,
    ) -> Result<(), PlanFault>;
}

/// The solver built from the parts of `rsruckig`. It owns their scratch space and allocates it once.
#[derive(Debug, Clone, Default)]
pub struct Ruckig {
    scratch: Box<Scratch>,
}

#[derive(Debug, Clone, Default)]
struct Scratch {
    unit_s: f64,
    speed_max: f64,
    jerk_max: f64,
    step1: PositionThirdOrderStep1,
    block: Block,
    profile: Profile,
}

impl Solver for Ruckig {
    fn solve(
        &mut self,
        limits: &MotionLimits,
        from: &[MotionState; 3],
        target_mm: &[f64; 3],
        out: &mut Plan,
    ) -> Result<(), PlanFault> {
        let scratch = &mut *self.scratch;
        scratch.choose_unit(limits);
        for (plan, (from, &to)) in out.channels.iter_mut().zip(from.iter().zip(target_mm)) {
            // A channel at rest on its target needs no profile.
            let rests = from.is_rest() && from.position_mm == to;
            *plan = if rests {
                ChannelPlan::resting(to)
            } else {
                scratch.fastest(from, to).ok_or(PlanFault::NoProfile)?
            };
        }
        Ok(())
    }
}

impl Scratch {
    /// Sets the unit of time in which the largest acceleration is 1 mm/τ².
    fn choose_unit(&mut self, l: &MotionLimits) {
        let unit_s = l.acceleration_max_mm_s2.sqrt().recip();
        self.unit_s = unit_s;
        self.speed_max = l.speed_max_mm_s * unit_s;
        self.jerk_max = l.jerk_max_mm_s3 * unit_s * unit_s * unit_s;
    }

    /// Brake and step 1: the time-optimal plan of one channel.
    fn fastest(&mut self, from: &MotionState, target_mm: f64) -> Option<ChannelPlan> {
        let (v, j, unit_s) = (self.speed_max, self.jerk_max, self.unit_s);
        let v0 = from.velocity_mm_s * unit_s;
        let a0 = from.acceleration_mm_s2 * unit_s * unit_s;
        let p = &mut self.profile;
        p.brake
            .get_position_brake_trajectory(v0, a0, v, -v, 1.0, -1.0, j);
        p.set_boundary(from.position_mm, v0, a0, target_mm, 0.0, 0.0);
        p.brake.finalize(&mut p.p[0], &mut p.v[0], &mut p.a[0]);
        self.step1.reset(
            p.p[0], p.v[0], p.a[0], target_mm, 0.0, 0.0, v, -v, 1.0, -1.0, j,
        );
        let found = self.step1.get_profile(p, &mut self.block) && self.block.t_min.is_finite();
        found.then(|| transcribe(&self.block.p_min, self.unit_s, target_mm))
    }
}

/// Converts a profile in units of τ to a plan in seconds.
fn transcribe(p: &Profile, unit_s: f64, end_mm: f64) -> ChannelPlan {
    let mut out = ChannelPlan::resting(end_mm);
    let rate = unit_s.recip();
    let mut push = |p: f64, v: f64, a: f64, j: f64, t: f64| {
        let start = MotionState {
            position_mm: p,
            velocity_mm_s: v * rate,
            acceleration_mm_s2: a * rate * rate,
        };
        out.push(start, j * rate * rate * rate, t * unit_s);
    };
    if p.brake.duration > 0.0 {
        let b = &p.brake;
        (0..2).for_each(|i| push(b.p[i], b.v[i], b.a[i], b.j[i], b.t[i]));
    }
    (0..7).for_each(|i| push(p.p[i], p.v[i], p.a[i], p.j[i], p.t[i]));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn limits() -> MotionLimits {
        MotionLimits {
            travel_max_mm: 60.0,
            ..MotionLimits::default()
        }
    }

    /// A state from which the speed limit can still be kept.
    fn state() -> impl Strategy<Value = MotionState> {
        let l = limits();
        let (v_max, a_max) = (l.speed_max_mm_s, l.acceleration_max_mm_s2);
        (-20.0..20.0f64, -v_max..v_max, -a_max..a_max).prop_map(move |(p, v, a)| {
            let room = v_max - a * a / (2.0 * l.jerk_max_mm_s3);
            MotionState {
                position_mm: p,
                velocity_mm_s: v.clamp(-room, room),
                acceleration_mm_s2: a,
            }
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn a_valid_plan_exists_from_any_state_and_no_channel_waits_for_another(
            from in prop::array::uniform3(state()), to in prop::array::uniform3(-10.0..10.0f64),
        ) {
            let mut plan = Plan::default();
            Ruckig::default().solve(&limits(), &from, &to, &mut plan).unwrap();
            prop_assert_eq!(plan.verify(&from, &limits()), Ok(()));
            for i in 0..3 {
                let mut alone = Plan::default();
                let (start, goal) = ([from[i]; 3], [to[i]; 3]);
                Ruckig::default().solve(&limits(), &start, &goal, &mut alone).unwrap();
                prop_assert_eq!(alone.channels[i], plan.channels[i]);
            }
        }

        #[test]
        fn segments_cut_from_a_plan_join(
            from in prop::array::uniform3(state()), to in prop::array::uniform3(-10.0..10.0f64), dt in 1e-4..5e-3f64,
        ) {
            let mut plan = Plan::default();
            Ruckig::default().solve(&limits(), &from, &to, &mut plan).unwrap();
            for (c, from) in plan.channels.iter().zip(from) {
                let (mut t, mut at) = (0.0, from);
                while t < plan.duration_s() + dt {
                    let cut = c.cut(at, t, dt);
                    let walked = cut.pieces().iter().fold(at, |s, &(d, j)| s.after(j, d));
                    prop_assert!((walked.position_mm - cut.end.position_mm).abs() < 1e-7);
                    prop_assert!((walked.velocity_mm_s - cut.end.velocity_mm_s).abs() < 1e-6);
                    t += dt;
                    at = cut.end;
                }
                prop_assert_eq!(at, MotionState::rest(c.end_mm));
            }
        }
    }
}
