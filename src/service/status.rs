//! The status of the service as a JSON object, and the frame that subscribers receive.

use crate::control::Frame;
use crate::control::saturation::Saturation;
use crate::model::Bend;
use crate::service::protocol::VERSION;
use crate::supervisor::{CycleOutput, Guidance, Mode, SupervisorConfig, TripCause};
use serde_json::{Value, json};

/// What tripped, and the remedy.
pub fn trip_message(cause: TripCause) -> &'static str {
    match cause {
        TripCause::EmergencyStop => {
            "the emergency stop is pressed: release it, then `retroflex reset-fault`"
        }
        TripCause::StepGenerator => {
            "the step generator raised an alarm: see `remarks`, then `retroflex reset-fault`"
        }
        TripCause::Late => {
            "the control loop was delayed: check real-time limits and load with `retroflex doctor`"
        }
        TripCause::Unarmed => {
            "motion was commanded while disarmed: this is a defect of the program, please report it"
        }
        TripCause::Travel => "a piston would have left its travel: see [limits] of the board file",
        TripCause::Rate => "a piston would have exceeded its speed: see [motion] of the board file",
        TripCause::Acceleration => {
            "a piston would have exceeded its acceleration: see [motion] of the board file"
        }
        TripCause::Pressure => {
            "the pressure of a line was or would have been too high: look for a kink and at `alarm`, or relax and calibrate again"
        }
        TripCause::Temperature => {
            "the tip is hotter than safety.tip_max_c: withdraw it, and let it cool before `retroflex reset-fault`"
        }
        TripCause::Stale => {
            "no usable orientation for too long: check the cable of the IMU; `retroflex doctor`"
        }
        TripCause::Disagreement => {
            "the two orientation filters disagree: `retroflex relax`, then `retroflex zero`"
        }
        TripCause::Following => "the tip does not follow its set-point: see the suspected cause",
    }
}

/// Name of a trip cause as in files and status lines.
pub fn trip_name(cause: TripCause) -> String {
    json!(cause).as_str().unwrap_or_default().to_owned()
}

/// True if the tip cannot get nearer to its target.
pub fn blocked(f: &Frame) -> bool {
    f.blocked || f.saturation != Saturation::No
}

/// Why the tip cannot get nearer to its target.
pub fn shortfall(f: &Frame) -> Option<&'static str> {
    let obstructed = "the tip does not follow the pistons: an obstruction holds it, or the target is out of its reach; remove the \
                      obstruction, or choose another target";
    f.saturation
        .words()
        .or_else(|| f.blocked.then_some(obstructed))
}

/// What is known about a base that turned.
pub fn base(f: &Frame) -> Option<&'static str> {
    if f.base_moved {
        return Some("the base has turned: `retroflex relax`, then `retroflex zero`");
    }
    let slowly = "the estimated tip twists, which its mechanism cannot: the base may have turned slowly, or a magnetic field is near; `relax`, then `zero`";
    f.base_doubted.then_some(slowly)
}

/// What is said of an orientation in the world that the tip keeps.
pub fn world(guidance: Guidance) -> Option<&'static str> {
    match guidance {
        Guidance::World => Some("the tip keeps its orientation in the world"),
        Guidance::WorldOutOfReach => Some(
            "the orientation in the world is out of reach: the tip bends towards it as far as it can",
        ),
        Guidance::WorldLost => Some(
            "the IMU on the base failed: the tip keeps its bend, and turns with the base; repair it, then give `retroflex bend --world` again",
        ),
        _ => None,
    }
}

/// True if the tip is commanded in this mode; if it is not, it has no target to fall short of.
pub fn commanded(mode: Mode) -> bool {
    matches!(mode, Mode::Holding | Mode::Tracking | Mode::Calibrating)
}

/// The part of the status that one cycle determines.
pub fn cycle(output: &CycleOutput, step_mm: f64) -> Value {
    let f = &output.frame;
    let commanded = commanded(output.mode);
    let pose = |b: &Bend| json!({"bend_deg": round(b.beta().to_degrees()), "dir_deg": round(b.delta().to_degrees())});
    json!({
        "t": output.sensed.t.0,
        "mode": output.mode.name(),
        "target": commanded.then(|| pose(&f.target.bend)),
        "setpoint": pose(&f.setpoint.bend),
        "estimate": f.estimate.map(|x| pose(&x.bend)),
        "sigma_deg": f.estimate.and_then(|x| x.sigma_rad).map(|s| round(s.to_degrees())),
        "length_mm": round(f.setpoint.length.0),
        "piston_mm": output.counted.0.map(|n| round(f64::from(n) * step_mm)),
        "counted": output.counted.0,
        "energised": output.sensed.energised,
        "at_rest": f.at_rest,
        "blocked": commanded && blocked(f),
        "shortfall": shortfall(f).filter(|_| commanded),
        "base_moved": f.base_moved,
        "base": base(f),
        "path": null,
        "world": world(output.guidance),
        "base_imu": output.base_imu.map(|(follows, active)| {
            let state = if follows { "follows" } else { "lost" };
            json!({"state": state, "active": active.iter().map(|c| c.name()).collect::<Vec<_>>()})
        }),
        "latched": output.latched.map(trip_name),
        "fault": output.latched.map(trip_message),
        "stopped": output.stopped,
        "suspicion": output.suspicion.map(|s| s.to_string()),
        "sensor": {
            "action": format!("{:?}", f.senses.action),
            "active": f.senses.in_force.iter().map(|c| c.name()).collect::<Vec<_>>(),
            "advice": f.senses.in_force.iter().map(|c| c.advice()).collect::<Vec<_>>(),
            "held": f.senses.held,
            "disagree": f.senses.disagrees,
        },
        "emergency_stop": output.sensed.inputs.emergency_stop,
        "alarm": output.sensed.alarm.map(|a| a.to_string()),
        "pressure_kpa": output.sensed.gauges.pressure_kpa.map(|all| all.map(round)),
        "tip_c": output.sensed.gauges.tip_c.map(round),
        "tip_warm": output.sensed.gauges.tip_warm,
        "unverified": output.unverified,
        "k_epsilon": f.k_epsilon.map(round),
        "k_lambda_mm": f.k_lambda_mm.map(round),
        "k_epsilon_sigma": f.belief.line_sigmas.map(|s| round(s[0])),
        "k_lambda_sigma_mm": f.belief.line_sigmas.map(|s| round(s[1])),
        "belief": pose(&Bend(f.belief.settled)),
        "belief_sigma_deg": round(f.belief.sigma_rad.to_degrees()),
        "residual_deg": round(f.belief.residual.norm().to_degrees()),
        "response_error_s": round(f.belief.response_error_s),
        "periodic_hz": f.belief.periodic_hz.map(round),
        "lag_s": round(f.dynamics.lag_s),
        "delay_s": round(f.dynamics.delay_s),
    })
}

/// The line that a subscriber receives.
pub fn frame_line(output: &CycleOutput, step_mm: f64) -> String {
    let mut value = cycle(output, step_mm);
    value["v"] = json!(VERSION);
    value["event"] = json!("frame");
    value.to_string() + "\n"
}

/// Travel of the pistons either way, and the least and largest gains that the loop may learn.
pub fn limits(config: &SupervisorConfig) -> Value {
    let bounds = config
        .tick
        .lines
        .map(|line| config.tick.refine.bounds(&line));
    let [k_epsilon, k_lambda_mm] = [0, 1].map(|n| bounds.map(|of| of[n].map(round)));
    json!({"travel_mm": config.tick.limits.travel_mm, "k_epsilon": k_epsilon, "k_lambda_mm": k_lambda_mm})
}

fn round(x: f64) -> f64 {
    (x * 1e4).round() / 1e4
}
