//! The sensing half of the tick: fusion of the samples, and supervision of the base.

use super::state::{LoopState, QuietPose};
use super::types::{Input, LoopConfig};
use crate::estimation::fusion::base_watch::{Watch, WatchInput};
use crate::estimation::fusion::tip::{FusionInput, STILL_AFTER_S};
use crate::model::Bend;
use crate::primitives::{LIKELY_SIGMAS, lasting};
use nalgebra::Vector3;

/// Updates the fusion with the samples, the motors' field and whether the pistons rest.
pub(super) fn estimate(config: &LoopConfig, state: &mut LoopState, input: &Input) {
    let motors = &mut state.motors;
    let (now, before) = (input.steps, motors.last_steps);
    motors.still_s = lasting(now == before, motors.still_s, input.dt_s);
    for i in 0..3 {
        motors.idle_s[i] = lasting(now.0[i] == before.0[i], motors.idle_s[i], input.dt_s);
    }
    motors.last_steps = now;
    let energised = motors.idle_s.map(|s| s < config.motors_idle_after_s);
    let coils = config.motors.as_ref();
    let coils_ut = coils.map_or_else(Vector3::zeros, |m| m.at(&input.steps.0, &energised));
    let tip = input
        .imu
        .map(|sample, _| *sample = config.imu.apply(sample));
    let still = motors.still_s >= STILL_AFTER_S;
    if let (Some(described), Some(rest), Some(_)) = (
        &mut state.described,
        state.fusion.alignment(),
        &config.feedback,
    ) {
        described.zero(rest.acc_rest_m_s2.normalize());
    }
    let input = FusionInput {
        now: input.t,
        tip,
        base: input.base_imu,
        coils_ut,
        still,
    };
    state.fusion.update(&config.fuse, &input);
}

/// Detects a base that turns, if no base IMU measures it.
pub(super) fn watch_base(
    config: &LoopConfig,
    state: &mut LoopState,
    input: &Input,
    estimate: Bend,
) {
    if state.fusion.tracks_base() {
        // also again: what was noticed while the base IMU was lost no longer counts
        (state.base.moved, state.base.watch) = (false, Watch::default());
    }
    let rate_rad_s = state.fusion.rate_rad_s();
    let Some(rate_rad_s) = rate_rad_s.filter(|_| !state.fusion.tracks_base()) else {
        return;
    };
    let observed = WatchInput {
        rate_rad_s,
        estimate: estimate.0,
        model: state.shown_by_accepted,
        setpoint: state.setpoint.bend.at,
        remaining: state.setpoint.target.bend.0 - estimate.0,
        still_s: state.motors.still_s,
        response_s: state.dynamics.response_max_s,
        turn_variance: state.fusion.turn_variance(config.fuse.watch.memory_s),
        dt_s: input.dt_s,
    };
    let (played, quiet) = (state.played(), state.base.quiet);
    let (observer, before) = (&state.observer, &state.before_base.laws[0]);
    let open_loop_rad = || observer.settled_sigma(before);
    let watch = &mut state.base.watch;
    let flagged = watch.step(&config.fuse.watch, &observed, open_loop_rad);
    if state.base.moved {
        let bend = state.fusion.bend_on_standing_base().unwrap_or(estimate).0;
        let unexplained = bend - quiet.estimate - (played - quiet.played);
        state.base.moved = !state.base.watch.returned(&unexplained, input.dt_s);
        return;
    }
    state.base.moved = flagged;
    if flagged {
        state.base.watch.forget(&config.fuse.watch);
        // the tip is where it was in the last quiet pose, moved by what the pistons have done since; what was learned
        // since the base began to turn is taken back; not further, because a base that sways passes through quiet poses
        let by_pistons = quiet.estimate + played - quiet.played;
        state.return_to_known(&by_pistons, LIKELY_SIGMAS);
        state.unlearn(&by_pistons, LIKELY_SIGMAS);
    } else if state.base.watch.quiet() {
        state.base.quiet = QuietPose {
            estimate: estimate.0,
            played,
        };
    }
}
