//! What the monitor shows: the last status, the error of the last minute, and the last events.

use crate::service::flight::channels::Changes;
use crate::service::status::Status;
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
    /// The same as it is read.
    pub status: Status,
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
        match Status::of(&self.now) {
            Ok(status) => self.status = status,
            Err(e) => self.note(&format!("a status that cannot be read: {e}")),
        }
        let t_s = self.status.t;
        // a service that has started anew has another clock
        let shown_s = t_s - CHART_S..t_s;
        self.errors.retain(|(at_s, _)| shown_s.contains(at_s));
        let error = self.error_deg().map(|error| (t_s, error));
        self.errors.extend(error);
        changes.iter().for_each(|change| self.note(change));
    }

    /// Adds an event.
    pub fn note(&mut self, event: &str) {
        let t_s = self.status.t;
        self.events.push_back(format!("{t_s:9.1} s  {event}"));
        if self.events.len() > EVENTS_MAX {
            self.events.pop_front();
        }
    }

    /// The mode, and what else holds.
    pub fn mode(&self) -> String {
        let s = &self.status;
        let mut words = vec![s.mode_name().unwrap_or("no data")];
        words.extend(s.energised.then_some("energised"));
        words.extend(s.stopped.then_some("stopped"));
        words.extend(s.blocked.then_some("blocked"));
        words.join(", ")
    }

    /// Length of the desired minus the estimated bend vector, degrees, while the tip is commanded.
    pub fn error_deg(&self) -> Option<f64> {
        let (desired, estimate) = (self.status.target?, self.status.estimate?);
        Some((desired.bend().0 - estimate.bend().0).norm().to_degrees())
    }
}
