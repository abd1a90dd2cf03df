//! The status of the service as a JSON object, and the frame that subscribers receive.

use crate::control::saturation::Saturation;
use crate::control::{Frame, SETTLED_DEG};
use crate::model::Bend;
use crate::service::LearnedGains;
use crate::service::protocol::VERSION;
use crate::supervisor::{CycleOutput, Mode, Source, SupervisorConfig, TripCause};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// True if the tip cannot get nearer to its target.
pub fn blocked(f: &Frame) -> bool {
    f.blocked || f.saturation != Saturation::No
}

/// The tip rests, and is believed to be where it was told to within [`SETTLED_DEG`], or as near as it can get.
pub fn settled(f: &Frame) -> bool {
    let missing = f.target.bend.0 - f.belief.settled;
    blocked(f) || f.at_rest && missing.norm().to_degrees() < SETTLED_DEG
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
pub fn world(source: Source) -> Option<&'static str> {
    match source {
        Source::World { reached: true, .. } => Some("the tip keeps its orientation in the world"),
        Source::World { .. } => Some(
            "the orientation in the world is out of reach: the tip bends towards it as far as it can",
        ),
        Source::WorldLost => Some(
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
    let pose = |b: &Bend| Pose {
        bend_deg: round(b.beta().to_degrees()),
        dir_deg: round(b.delta().to_degrees()),
    };
    json!({
        "t": output.sensed.t.0,
        "mode": output.mode.name(),
        "target": commanded.then(|| pose(&f.target.bend)),
        "target_length_mm": commanded.then(|| round(f.target.length.0)),
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
        "world": world(output.source),
        "base_imu": output.base_imu.map(|(follows, active)| {
            let state = if follows { "follows" } else { "lost" };
            json!({"state": state, "active": active.iter().map(|c| c.name()).collect::<Vec<_>>()})
        }),
        "latched": output.latched.map(TripCause::name),
        "fault": output.latched.map(TripCause::advice),
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

/// A status as its readers know it: the command line, of a running service or of a flight log, which shows a part of it. The names are
/// those of [`cycle`] and of the hub.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Status {
    /// Time of the loop, s.
    pub t: f64,
    /// Mode of the supervisor.
    pub mode: Option<Mode>,
    /// Bend that was asked for, while the tip is commanded.
    pub target: Option<Pose>,
    /// Length that was asked for, while the tip is commanded, mm.
    pub target_length_mm: Option<f64>,
    /// Bend that the loop tracks.
    pub setpoint: Option<Pose>,
    /// Estimated bend.
    pub estimate: Option<Pose>,
    /// Length of the set-point, mm.
    pub length_mm: Option<f64>,
    /// Counted positions of the pistons, mm.
    pub piston_mm: Option<[f64; 3]>,
    /// Counted steps.
    pub counted: Option<[i64; 3]>,
    /// The drivers are energised.
    pub energised: bool,
    /// The tip is at its target.
    pub settled: bool,
    /// The tip cannot get nearer to its target.
    pub blocked: bool,
    /// A stop is latched.
    pub stopped: bool,
    /// Stops since the service started.
    pub stops: u64,
    /// The service is ending, and accepts no more commands.
    pub ending: bool,
    /// The operator has stated the zero, and no measurement has confirmed it.
    pub unverified: bool,
    /// Why the tip cannot get nearer to its target.
    pub shortfall: Option<String>,
    /// What is known about a base that turned.
    pub base: Option<String>,
    /// What is said of an orientation in the world that the tip keeps.
    pub world: Option<String>,
    /// What the residual monitor suspects.
    pub suspicion: Option<String>,
    /// Alarm of the step generator.
    pub alarm: Option<String>,
    /// Latched fault with its remedy.
    pub fault: Option<String>,
    /// Why the position is lost.
    pub lost: Option<String>,
    /// Progress of a calibration.
    pub calibrating: Option<String>,
    /// Why the last calibration identified no gains.
    pub calibration_failed: Option<String>,
    /// Source of the gains in use.
    pub calibration: Option<String>,
    /// File of the model for the feedforward.
    pub feedforward: Option<String>,
    /// Identity of the mounted tip.
    pub tip: Option<String>,
    /// How the last recording ended.
    pub recording_ended: Option<String>,
    /// The present recording.
    pub recording: RecordingState,
    /// The flight log.
    pub flight_log: FlightLogState,
    /// The memory of the position.
    pub memory: MemoryState,
    /// Extension gains k_ε in use.
    pub k_epsilon: Option<[f64; 3]>,
    /// Half-widths k_λ in use, mm.
    pub k_lambda_mm: Option<[f64; 3]>,
    /// Lag in use, s.
    pub lag_s: Option<f64>,
    /// Dead time in use, s.
    pub delay_s: Option<f64>,
    /// Limits of pistons and gains.
    pub limits: Option<Limits>,
    /// Gains that wait for `calibrate transmission --accept`.
    pub proposed: Option<LearnedGains>,
    /// The path that is followed.
    pub path: Option<PathState>,
    /// Cycles of the loop, those that were late, their largest lateness in µs, and frames that were lost.
    pub cycles: Option<u64>,
    /// See [`Self::cycles`].
    pub late_cycles: u64,
    /// See [`Self::cycles`].
    pub max_lateness_us: u64,
    /// See [`Self::cycles`].
    pub lost_frames: u64,
    /// Troubles of the supply.
    pub power: Vec<String>,
    /// Remarks on the hardware.
    pub remarks: Vec<String>,
    /// What the kernel grants for real time.
    pub real_time: Vec<GrantState>,
    /// Conditions of the sensor; a flight log lists their names alone.
    pub sensor: Value,
}

/// A bend of the status.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Pose {
    /// Bend angle β, degrees.
    pub bend_deg: f64,
    /// Bend direction δ, degrees.
    pub dir_deg: f64,
}

impl Pose {
    /// The bend vector.
    pub fn bend(&self) -> Bend {
        Bend::from_deg(self.bend_deg, self.dir_deg)
    }
}

/// See [`Status::recording`].
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct RecordingState {
    /// Its file.
    pub path: Option<String>,
}

/// See [`Status::flight_log`].
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct FlightLogState {
    /// Why it is not written.
    pub problem: Option<String>,
}

/// See [`Status::memory`].
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct MemoryState {
    /// Why it cannot be written.
    pub error: Option<String>,
}

/// How far a path has come.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct PathState {
    /// Time in the path, s; 0 until its first row is due.
    pub at_s: f64,
    /// Duration of the path, s.
    pub duration_s: f64,
    /// How many times slower than given it is played.
    pub time_scale: f64,
}

/// Limits of pistons and gains.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Limits {
    /// Travel of the pistons either way, mm.
    pub travel_mm: f64,
    /// Least and largest k_ε that the loop may learn.
    pub k_epsilon: [[f64; 2]; 3],
    /// Least and largest k_λ that the loop may learn, mm.
    pub k_lambda_mm: [[f64; 2]; 3],
}

/// What the kernel grants.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GrantState {
    /// What was requested.
    pub what: String,
    /// Whether it was granted.
    pub grant: String,
}

impl Status {
    /// Reads a status; null means that there is nothing to say.
    ///
    /// # Errors
    /// A field of another type, as another version of the service might send.
    pub fn of(value: &Value) -> Result<Self, serde_json::Error> {
        let mut fields = value.as_object().cloned().unwrap_or_default();
        fields.retain(|_, value| !value.is_null());
        Self::deserialize(Value::Object(fields))
    }

    /// Name of the mode.
    pub fn mode_name(&self) -> Option<&'static str> {
        self.mode.map(Mode::name)
    }

    /// What to do about the conditions of the sensor.
    pub fn advice(&self) -> impl Iterator<Item = &str> {
        let advice = self.sensor["advice"].as_array().into_iter().flatten();
        advice.filter_map(Value::as_str)
    }
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
    let tick = &config.tick;
    let bounds = tick.lines.map(|line| tick.refine.bounds(&line));
    let [k_epsilon, k_lambda_mm] = [0, 1].map(|n| bounds.map(|of| of[n].map(round)));
    json!({"travel_mm": tick.limits.travel_mm, "k_epsilon": k_epsilon, "k_lambda_mm": k_lambda_mm})
}

/// A figure of the status, which has four digits.
pub fn round(x: f64) -> f64 {
    (x * 1e4).round() / 1e4
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_and_a_service_that_says_less_are_read() {
        let status = Status::of(
            &json!({"mode": "holding", "recording": null, "sensor": ["mag_disturbed"], "new": 1}),
        );
        let status = status.unwrap();
        assert_eq!(
            (status.mode, status.advice().count()),
            (Some(Mode::Holding), 0)
        );
        assert!(Status::of(&json!({"mode": 3})).is_err());
    }
}
