//! The status: everything worth knowing, as one JSON object; and what of a turn a subscriber gets.

use crate::control::saturation::Saturation;
use crate::control::tick::Frame;
use crate::service::protocol::VERSION;
use crate::supervisor::cycle::CycleOutput;
use crate::supervisor::gate::TripCause;
use serde_json::{Value, json};

/// A cause in words, with the mend.
#[must_use]
pub fn words(cause: TripCause) -> &'static str {
    match cause {
        TripCause::EmergencyStop => "the emergency stop is pressed: release it, then `retroflex reset-fault`",
        TripCause::StepGenerator => "the step generator raised an alarm: see `remarks`, then `retroflex reset-fault`",
        TripCause::Late => "the loop was kept from running: see `retroflex doctor` for real-time limits and load",
        TripCause::Unarmed => "motion was wanted while disarmed: a fault of the program, please report it",
        TripCause::Travel => "a piston would have left its travel: see [limits] of the board file",
        TripCause::Rate => "a piston would have been too fast: see [motion] of the board file",
        TripCause::Acceleration => "a piston would have been pushed too hard: see [motion] of the board file",
        TripCause::Pressure => "a line would have been compressed too far: look for a kink, or relax and calibrate again",
        TripCause::Stale => "no usable orientation for too long: check the IMU's cable; `retroflex doctor`",
        TripCause::Disagreement => "the two orientation filters disagree: `retroflex relax`, then `retroflex zero`",
        TripCause::Following => "the tip is not where it was led: see what is suspected",
    }
}

/// Name of a cause as in files and status lines.
#[must_use]
pub fn name(cause: TripCause) -> String {
    serde_json::to_value(cause).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}

/// The tip will not get any nearer to its target.
#[must_use]
pub fn blocked(f: &Frame) -> bool {
    f.blocked || f.saturation != Saturation::No
}

/// What is known of a base that turned, in words.
#[must_use]
pub fn base(f: &Frame) -> Option<&'static str> {
    let moved = f.base_moved.then_some("the base has turned: `retroflex relax`, then `retroflex zero`");
    let slowly = "the tip twists as its mechanism cannot: the base may have turned slowly, or a field is near; `relax`, then `zero`";
    moved.or_else(|| f.base_doubted.then_some(slowly))
}

/// Why it will not, in words.
#[must_use]
pub fn short(f: &Frame) -> Option<&'static str> {
    let held = "the tip is pushed and does not come: something holds it; move it away, or give another target";
    f.saturation.words().or_else(|| f.blocked.then_some(held))
}

/// What the turn says of tip and pistons.
#[must_use]
pub fn turn(turned: &CycleOutput, step_mm: f64) -> Value {
    let f = &turned.frame;
    let pose = |b: &crate::model::bend::Bend| json!({"bend_deg": round(b.beta().to_degrees()), "dir_deg": round(b.delta().to_degrees())});
    json!({
        "t": turned.sensed.t.0,
        "mode": turned.mode.name(),
        "target": pose(&f.target.bend),
        "setpoint": pose(&f.setpoint.bend),
        "felt": f.estimate.map(|x| pose(&x.bend)),
        "sigma_deg": f.estimate.and_then(|x| x.sigma_rad).map(|s| round(s.to_degrees())),
        "length_mm": round(f.setpoint.length.0),
        "piston_mm": turned.counted.0.map(|n| round(f64::from(n) * step_mm)),
        "counted": turned.counted.0,
        "energised": turned.sensed.energised,
        "at_rest": f.at_rest,
        "blocked": blocked(f),
        "short": short(f),
        "base_moved": f.base_moved,
        "base": base(f),
        "latched": turned.latched.map(name),
        "suspicion": turned.suspicion.map(|s| s.to_string()),
        "senses": {
            "action": format!("{:?}", f.senses.action),
            "in_force": f.senses.in_force.iter().map(|c| c.name()).collect::<Vec<_>>(),
            "advice": f.senses.in_force.iter().map(|c| c.advice()).collect::<Vec<_>>(),
            "held": f.senses.held,
            "disagree": f.senses.disagrees,
        },
        "emergency_stop": turned.sensed.inputs.emergency_stop,
        "alarm": turned.sensed.alarm.map(|a| a.to_string()),
        "k_epsilon": f.k_epsilon.map(round),
        "lag_s": round(f.dynamics.lag_s),
        "delay_s": round(f.dynamics.delay_s),
    })
}

/// The line of a subscriber.
#[must_use]
pub fn frame_line(turned: &CycleOutput, step_mm: f64) -> String {
    let mut value = turn(turned, step_mm);
    value["v"] = json!(VERSION);
    value["event"] = json!("frame");
    value.to_string() + "\n"
}

fn round(x: f64) -> f64 {
    (x * 1e4).round() / 1e4
}
