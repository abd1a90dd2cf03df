//! The solver: a plan from the state of this instant to rest at the target, all channels in step.
//!
//! The step-1/step-2 mathematics of Ruckig (Berscheid and Kröger, "Jerk-limited Real-time Trajectory
//! Generation with Arbitrary Target States", RSS 2021) as ported in `rsruckig`:
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
//! `rsruckig` compares with fixed tolerances (1e-8 for position and speed, 1e-10 for acceleration),
//! which presume numbers near one. So it is given a unit of time τ = √(mm / A) in which the greatest
//! acceleration is 1 mm/τ². In seconds, accelerations of 10⁴ mm/s² make it refuse one plan in a thousand.

use crate::motion::cruise::arrive_in;
use crate::motion::limits::MotionLimits;
use crate::motion::plan::{ChannelPlan, Plan, Refusal};
use crate::motion::state::MotionState;
use rsruckig::block::Block;
use rsruckig::position_third_step1::PositionThirdOrderStep1;
use rsruckig::position_third_step2::PositionThirdOrderStep2;
use rsruckig::profile::Profile;

/// Finds a plan from given states to rest at given positions.
pub trait Solver {
    /// Writes the plan to `out`; on a refusal `out` is garbage.
    ///
    /// # Errors
    /// [`Refusal`] when no plan was found. Soundness is the caller's to check.
    fn solve(&mut self, limits: &MotionLimits, from: &[MotionState; 3], target_mm: &[f64; 3], out: &mut Plan) -> Result<(), Refusal>;
}

/// The solver on `rsruckig`'s building blocks. Holds their scratch space; allocates it once.
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
    blocks: [Block; 3],
    profiles: [Profile; 3],
}

impl Solver for Ruckig {
    fn solve(&mut self, limits: &MotionLimits, from: &[MotionState; 3], target_mm: &[f64; 3], out: &mut Plan) -> Result<(), Refusal> {
        self.scratch.choose_unit(limits);
        let mut least = 0.0_f64;
        for channel in 0..3 {
            if !still(&from[channel], target_mm[channel]) {
                least = least.max(self.scratch.fastest(&from[channel], target_mm[channel], channel)?);
            }
        }
        let common = self.scratch.unblocked(least, from, target_mm);
        self.scratch.synchronise(limits, from, target_mm, common, out)
    }
}

/// A channel that rests on its target needs no profile.
fn still(from: &MotionState, target_mm: f64) -> bool {
    from.is_rest() && from.position_mm == target_mm
}

impl Scratch {
    /// The unit of time in which the greatest acceleration is 1 mm/τ².
    fn choose_unit(&mut self, l: &MotionLimits) {
        let unit_s = l.acceleration_max_mm_s2.sqrt().recip();
        self.unit_s = unit_s;
        self.speed_max = l.speed_max_mm_s * unit_s;
        self.jerk_max = l.jerk_max_mm_s3 * unit_s * unit_s * unit_s;
    }

    /// Brake and step 1: the least time of one channel, τ.
    fn fastest(&mut self, from: &MotionState, target_mm: f64, channel: usize) -> Result<f64, Refusal> {
        let (v, j) = (self.speed_max, self.jerk_max);
        let (v0, a0) = (from.velocity_mm_s * self.unit_s, from.acceleration_mm_s2 * self.unit_s * self.unit_s);
        let p = &mut self.profiles[channel];
        p.brake.get_position_brake_trajectory(v0, a0, v, -v, 1.0, -1.0, j);
        p.set_boundary(from.position_mm, v0, a0, target_mm, 0.0, 0.0);
        p.brake.finalize(&mut p.p[0], &mut p.v[0], &mut p.a[0]);
        self.step1.reset(p.p[0], p.v[0], p.a[0], target_mm, 0.0, 0.0, v, -v, 1.0, -1.0, j);
        let block = &mut self.blocks[channel];
        if self.step1.get_profile(p, block) && block.t_min.is_finite() { Ok(block.t_min) } else { Err(Refusal::NoProfile { channel }) }
    }

    /// The first duration from `t` (τ) on that lies in no channel's blocked interval.
    fn unblocked(&self, mut t: f64, from: &[MotionState; 3], target_mm: &[f64; 3]) -> f64 {
        // Each channel has at most two intervals, so six moves are enough.
        for _ in 0..6 {
            let before = t;
            for channel in (0..3).filter(|&c| !still(&from[c], target_mm[c])) {
                let block = &self.blocks[channel];
                for interval in [&block.a, &block.b].into_iter().flatten() {
                    if t > interval.left && t < interval.right {
                        t = interval.right;
                    }
                }
            }
            if t == before {
                break;
            }
        }
        t
    }

    /// Step 2: every channel's profile of the common duration, τ.
    fn synchronise(
        &mut self,
        l: &MotionLimits,
        from: &[MotionState; 3],
        target_mm: &[f64; 3],
        common: f64,
        out: &mut Plan,
    ) -> Result<(), Refusal> {
        for channel in 0..3 {
            let (to, plan) = (target_mm[channel], &mut out.channels[channel]);
            let block = &self.blocks[channel];
            let peak_mm_s = block.p_min.v[3].abs() / self.unit_s;
            if still(&from[channel], to) {
                *plan = ChannelPlan::resting(to);
            } else if common - block.t_min < 1e-12 {
                *plan = transcribe(&block.p_min, self.unit_s, to);
            } else if let Some(found) = arrive_in(l, &from[channel], to, common * self.unit_s, peak_mm_s) {
                *plan = found;
            } else {
                *plan = self.step2(to, common, channel)?;
            }
        }
        Ok(())
    }

    /// Ruckig's step 2 for one channel, from the boundary that [`Scratch::fastest`] has set.
    fn step2(&mut self, target_mm: f64, common: f64, channel: usize) -> Result<ChannelPlan, Refusal> {
        let (v, j) = (self.speed_max, self.jerk_max);
        let p = &mut self.profiles[channel];
        let left = common - p.brake.duration;
        let mut step2 = PositionThirdOrderStep2::new(left, p.p[0], p.v[0], p.a[0], target_mm, 0.0, 0.0, v, -v, 1.0, -1.0, j);
        if step2.get_profile(p) { Ok(transcribe(p, self.unit_s, target_mm)) } else { Err(Refusal::NoSynchronisation { channel }) }
    }
}

/// A profile's phases in the words and units of this house.
fn transcribe(p: &Profile, unit_s: f64, end_mm: f64) -> ChannelPlan {
    let mut out = ChannelPlan::resting(end_mm);
    let rate = unit_s.recip();
    let mut push = |p: f64, v: f64, a: f64, j: f64, t: f64| {
        let start = MotionState { position_mm: p, velocity_mm_s: v * rate, acceleration_mm_s2: a * rate * rate };
        out.push(start, j * rate * rate * rate, t * unit_s);
    };
    if p.brake.duration > 0.0 {
        for i in 0..2 {
            push(p.brake.p[i], p.brake.v[i], p.brake.a[i], p.brake.j[i], p.brake.t[i]);
        }
    }
    for i in 0..7 {
        push(p.p[i], p.v[i], p.a[i], p.j[i], p.t[i]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::config::MotionConfig;
    use proptest::prelude::*;

    fn limits() -> MotionLimits {
        MotionLimits::try_from(&MotionConfig::default()).unwrap()
    }

    /// A state from which the speed limit can still be kept.
    fn state() -> impl Strategy<Value = MotionState> {
        (-20.0..20.0f64, -30.0..30.0f64, -300.0..300.0f64).prop_map(|(p, v, a)| {
            let room = 30.0 - a * a / 12_000.0;
            MotionState { position_mm: p, velocity_mm_s: v.clamp(-room, room), acceleration_mm_s2: a }
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        /// From any state to any target: a plan is found, and all channels take the same time.
        #[test]
        fn arrives_together(from in prop::array::uniform3(state()), to in prop::array::uniform3(-10.0..10.0f64)) {
            let mut plan = Plan::default();
            Ruckig::default().solve(&limits(), &from, &to, &mut plan).unwrap();
            let roomy = MotionLimits { travel_max_mm: 60.0, ..limits() };
            prop_assert_eq!(plan.verify(&from, &roomy), Ok(()));
            for c in &plan.channels {
                prop_assert!((c.duration_s() - plan.duration_s()).abs() < 1e-9);
            }
        }

        /// Ruckig's own step 2 and the cruise are two answers to one question: both sound, both of
        /// the duration asked for.
        #[test]
        fn step_2_agrees_with_the_cruise(from in state(), to in -10.0..10.0f64, extra in 1e-3..2.0f64) {
            let l = MotionLimits { travel_max_mm: 60.0, ..limits() };
            let mut scratch = Scratch::default();
            scratch.choose_unit(&l);
            let common = scratch.fastest(&from, to, 0).unwrap() + extra / scratch.unit_s;
            let common_s = common * scratch.unit_s;
            let cruise = arrive_in(&l, &from, to, common_s, l.speed_max_mm_s);
            prop_assert!(cruise.is_some() || extra < 0.5, "only a little more than the least time has no cruise");
            let step2 = scratch.step2(to, common, 0).unwrap();
            for plan in cruise.iter().chain([&step2]) {
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
                    prop_assert!((walked.position_mm - cut.end.position_mm).abs() < 1e-7);
                    prop_assert!((walked.velocity_mm_s - cut.end.velocity_mm_s).abs() < 1e-6);
                    t += dt;
                    at = cut.end;
                }
                prop_assert_eq!(at, MotionState::rest(c.end_mm));
            }
        }
    }

    /// Braking hard towards a near target, a little more time than the least is gained by easing the
    /// brake, not by a cruise: that is Ruckig's own step 2.
    #[test]
    fn easing_the_brake_is_left_to_step_2() {
        let l = limits();
        let braking = MotionState { position_mm: -5.316_876, velocity_mm_s: 22.819_162, acceleration_mm_s2: -186.081_428 };
        let mut scratch = Scratch::default();
        scratch.choose_unit(&l);
        let least = scratch.fastest(&braking, -3.938_170, 0).unwrap();
        let least_s = least * scratch.unit_s;
        assert_eq!(arrive_in(&l, &braking, -3.938_170, least_s + 0.001, 30.0), None);
        let eased = scratch.step2(-3.938_170, least + 0.001 / scratch.unit_s, 0).unwrap();
        assert!(eased.is_sound(&braking, &l) && (eased.duration_s() - least_s - 0.001).abs() < 1e-8);
    }
}
