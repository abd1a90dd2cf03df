//! What the channels of a flight log for people show.

use crate::primitives::{ImuReading, ImuSample, Seconds};
use crate::service::flight::scene;
use crate::service::flight::schema::{STATUS, TOPICS, fields};
use crate::service::status;
use crate::supervisor::{CycleOutput, Sensed};
use serde_json::{Value, json};
use std::collections::HashMap;

/// Highest rate of a channel, and how much rarer the pose is, and what changes slowly or is large.
pub const RATE_HZ: f64 = 100.0;
const POSE_EVERY: u64 = 2;
const SLOW_EVERY: u64 = 10;

/// Topic and fields of a message.
pub type Shown = (&'static str, Value);

/// What the channels have shown last.
#[derive(Debug, Default)]
pub struct Channels {
    shown: [Value; STATUS],
    samples: [Option<ImuSample>; 2],
    lines: Value,
    changes: Changes,
    calls: u64,
}

/// `retroflex.Imu` of a sample.
fn imu(sample: &ImuSample, t: Seconds) -> Value {
    let mag_ut = sample.mag_ut.as_ref().map(|mag| mag.as_slice());
    let age_s = ((t.0 - sample.t.0) * 1e6).round() * 1e-6;
    json!({"gyr_rad_s": sample.gyro_rad_s.as_slice(), "acc_m_s2": sample.acc_m_s2.as_slice(), "mag_ut": mag_ut, "age_s": age_s})
}

impl Channels {
    /// Takes the samples of a cycle for the next messages: the newest, with the newest field since the last messages.
    pub fn take(&mut self, sensed: &Sensed) {
        let tip = match sensed.imu {
            ImuReading::Sample(sample, _) => Some(sample),
            _ => None,
        };
        for (newest, sample) in self.samples.iter_mut().zip([tip, sensed.base_imu]) {
            let Some(sample) = sample else { continue };
            let mag_ut = sample.mag_ut.or(newest.and_then(|before| before.mag_ut));
            *newest = Some(ImuSample { mag_ut, ..sample });
        }
    }

    /// The messages about a cycle, at most at [`RATE_HZ`]. What has not changed is not shown again. `unix_ns` is its time.
    pub fn messages(&mut self, output: &CycleOutput, unix_ns: u64, step_mm: f64) -> Vec<Shown> {
        let mut status = status::cycle(output, step_mm);
        // the action changes between two samples
        status["sensor"] = status["sensor"]["active"].take();
        let (t, slow) = (output.sensed.t, self.calls.is_multiple_of(SLOW_EVERY));
        let samples = ["/imu", "/imu/base"].into_iter().zip(&mut self.samples);
        let mut all: Vec<Shown> = samples
            .filter_map(|(topic, newest)| Some((topic, imu(&newest.take()?, t))))
            .collect();
        for ((topic, _), shown) in TOPICS.iter().zip(&mut self.shown) {
            let mut value = |key: String| (key.clone(), status[&key].take());
            let value = Value::Object(fields(topic).into_iter().map(&mut value).collect());
            if *shown != value && (slow || *topic != "/gains") {
                shown.clone_from(&value);
                let notes = self.changes.of(&value);
                all.extend(notes.iter().map(|note| ("/log", log(note, unix_ns))));
                all.push((*topic, value));
            }
        }
        let frame = &output.frame;
        if self.calls.is_multiple_of(POSE_EVERY) {
            all.extend(scene::pose(frame, unix_ns).map(|pose| ("/tf", pose)));
        }
        if slow {
            let lines = scene::lines(frame, status::commanded(output.mode));
            if let Some(lines) = lines.filter(|lines| *lines != self.lines) {
                all.push(("/scene", scene::update(&lines, unix_ns)));
                self.lines = lines;
            }
        }
        self.calls += 1;
        all
    }
}

/// `foxglove.Log` of a change.
fn log(note: &str, unix_ns: u64) -> Value {
    let level = match note.split(' ').next() {
        Some("fault") => "ERROR",
        Some("mode" | "stopped") => "INFO",
        _ => "WARNING",
    };
    json!({"timestamp": scene::timestamp(unix_ns), "level": level, "message": note, "name": "retroflex"})
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
                let one = std::slice::from_ref(now);
                let all = now.as_array().map_or(one, Vec::as_slice).iter();
                let words = all.filter_map(Value::as_str);
                notes.extend(words.map(|word| format!("{key} {word}")));
                notes.extend((*now == true).then(|| key.to_owned()));
            }
        }
        notes
    }
}
