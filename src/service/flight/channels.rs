//! The channels of a flight log that people look at: JSON, with a schema that is taken from the first message.

use crate::model::{Geometry, Shape};
use crate::service::status;
use crate::supervisor::CycleOutput;
use serde_json::{Map, Value, json};
use std::collections::HashMap;

/// Topics, the names of their schemas, and the fields of the status that they show, at most [`RATE_HZ`] times a second and only
/// when one has changed.
const SHOWN: [(&str, &str, &str); 5] = [
    (
        "/angles",
        "retroflex.Angles",
        "target setpoint estimate sigma_deg belief belief_sigma_deg residual_deg length_mm",
    ),
    ("/pistons", "retroflex.Pistons", "piston_mm pressure_kpa"),
    (
        "/gains",
        "retroflex.Gains",
        "k_epsilon k_epsilon_sigma k_lambda_mm k_lambda_sigma_mm lag_s delay_s response_error_s periodic_hz",
    ),
    ("/mode", "retroflex.Mode", MODE),
    ("/faults", "retroflex.Faults", FAULTS),
];
const MODE: &str = "mode energised at_rest blocked shortfall";
const FAULTS: &str = "latched fault suspicion sensor alarm emergency_stop base unverified";

/// Highest rate of a channel.
pub const RATE_HZ: f64 = 200.0;

/// What the channels have shown last.
#[derive(Debug, Default)]
pub struct Channels {
    shown: [Value; SHOWN.len()],
    calls: u64,
}

impl Channels {
    /// The messages of a cycle as topic, name of the schema and value. `unix_ns` is its time.
    pub fn messages(
        &mut self,
        output: &CycleOutput,
        unix_ns: u64,
        step_mm: f64,
    ) -> Vec<(&'static str, &'static str, Value)> {
        let mut status = status::cycle(output, step_mm);
        // the action changes between two samples
        status["sensor"] = status["sensor"]["active"].take();
        let mut all = Vec::new();
        for ((topic, schema, keys), shown) in SHOWN.iter().zip(&mut self.shown) {
            let fields = keys
                .split(' ')
                .map(|key| (key.to_owned(), status[key].clone()));
            let value = Value::Object(fields.collect());
            if *shown != value {
                shown.clone_from(&value);
                all.push((*topic, *schema, value));
            }
        }
        self.calls += 1;
        // 50 poses a second are enough to see the tip move
        let pose = output.frame.estimate.filter(|_| self.calls.is_multiple_of(4)).map(|e| {
            let shape = Shape { bend: e.bend, length: output.frame.setpoint.length };
            let m = (Geometry::default().position(&shape) * 1e3).map(|um| um.round() * 1e-6);
            let q = e.r_base_tip.quat().coords.map(|x| (x * 1e5).round() * 1e-5);
            json!({
                "timestamp": {"sec": unix_ns / 1_000_000_000, "nsec": unix_ns % 1_000_000_000},
                "parent_frame_id": "base", "child_frame_id": "tip",
                "translation": {"x": m.x, "y": m.y, "z": m.z}, "rotation": {"x": q.x, "y": q.y, "z": q.z, "w": q.w},
            })
        });
        all.extend(pose.map(|pose| ("/tf", "foxglove.FrameTransform", pose)));
        all
    }
}

/// The fields of the status whose changes are events.
const NOTED: &str = "mode stopped fault suspicion alarm base shortfall sensor";

/// The last values of what counts as an event when it changes.
#[derive(Debug, Default)]
pub struct Changes(HashMap<&'static str, Value>);

impl Changes {
    /// The changes that a message of a channel, or a status, brings.
    pub fn of(&mut self, value: &Value) -> Vec<String> {
        let mut notes = Vec::new();
        for key in NOTED.split(' ') {
            let Some(now) = value.get(key).map(|now| now.get("active").unwrap_or(now)) else {
                continue;
            };
            if self.0.insert(key, now.clone()).as_ref() != Some(now) {
                let all = now
                    .as_array()
                    .map_or(std::slice::from_ref(now), Vec::as_slice);
                let words = all
                    .iter()
                    .filter_map(Value::as_str)
                    .map(|word| format!("{key} {word}"));
                notes.extend(words.chain((*now == true).then(|| key.to_owned())));
            }
        }
        notes
    }
}

/// A JSON schema that fits a value.
pub fn schema(value: &Value) -> Value {
    match value {
        Value::Object(fields) => {
            let properties: Map<String, Value> = fields
                .iter()
                .map(|(key, value)| (key.clone(), schema(value)))
                .collect();
            json!({"type": "object", "properties": properties})
        }
        Value::Array(items) => {
            json!({"type": "array", "items": items.first().map_or(json!({}), schema)})
        }
        Value::String(_) => json!({"type": "string"}),
        Value::Number(n) if n.is_f64() => json!({"type": "number"}),
        Value::Number(_) => json!({"type": "integer"}),
        Value::Bool(_) => json!({"type": "boolean"}),
        // it will have another type later
        Value::Null => json!({}),
    }
}
