//! What the monitor shows: the last status, the error of the last minute, and the last events.

use crate::model::Bend;
use crate::service::flight::channels::Changes;
use serde_json::Value;
use std::collections::VecDeque;

/// Time that the error is shown for, s.
pub const CHART_S: f64 = 60.0;
/// Events that are kept.
const EVENTS_MAX: usize = 100;

/// What the monitor shows.
#[derive(Debug, Default)]
pub struct View {
    /// Where it comes from.
    pub source: String,
    /// The keys, as the last line names them.
    pub keys: &'static str,
    /// The last status, with the fields of later frames.
    pub now: Value,
    /// Time since a service that is lost was last heard, s.
    pub silent_s: Option<f64>,
    /// Time in s and error of the bend in degrees, oldest first.
    pub errors: VecDeque<(f64, f64)>,
    /// The last events, newest last.
    pub events: VecDeque<String>,
    /// What the last status held, to tell events.
    pub changes: Changes,
}

impl View {
    /// Takes a status or a frame.
    pub fn take(&mut self, value: Value) {
        let changes = self.changes.of(&value);
        match (&mut self.now, value) {
            (Value::Object(now), Value::Object(new)) => now.extend(new),
            (now, new) => *now = new,
        }
        let t_s = self.t_s();
        // a service that has started anew has another clock
        self.errors
            .retain(|(at_s, _)| (t_s - CHART_S..t_s).contains(at_s));
        self.errors
            .extend(self.error_deg().map(|error| (t_s, error)));
        changes.iter().for_each(|change| self.note(change));
    }

    /// Adds an event.
    pub fn note(&mut self, event: &str) {
        self.events
            .push_back(format!("{:9.1} s  {event}", self.t_s()));
        if self.events.len() > EVENTS_MAX {
            self.events.pop_front();
        }
    }

    /// Time of the loop, s.
    pub fn t_s(&self) -> f64 {
        self.now["t"].as_f64().unwrap_or(0.0)
    }

    /// The mode, and what else holds.
    pub fn mode(&self) -> String {
        let mode = self.now["mode"].as_str().unwrap_or("no data");
        let mut words = vec![mode, "energised", "stopped", "blocked"];
        words.retain(|word| *word == mode || self.now[*word] == true);
        words.join(", ")
    }

    /// A bend of the status: `target`, `setpoint` or `estimate`.
    pub fn bend(&self, key: &str) -> Option<Bend> {
        let at = &self.now[key];
        Some(Bend::from_deg(
            at["bend_deg"].as_f64()?,
            at["dir_deg"].as_f64()?,
        ))
    }

    /// Length of the desired minus the estimated bend vector, degrees, while the tip is commanded.
    pub fn error_deg(&self) -> Option<f64> {
        let (desired, estimate) = (self.bend("target")?, self.bend("estimate")?);
        Some((desired.0 - estimate.0).norm().to_degrees())
    }
}
