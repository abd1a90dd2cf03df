//! Recordings, and the status of the service.

use super::state::Hub;
use crate::service::calibrate::Session;
use crate::service::protocol::{Failure, RecordAction};
use crate::service::record::Recording;
use crate::service::rt_loop::Message;
use crate::service::start::Start;
use crate::service::status;
use crate::supervisor::mode::Mode;
use serde_json::{Value, json};
use std::io;
use std::path::Path;
use std::sync::atomic::Ordering::Relaxed;

/// Longest name of a recording, bytes.
const NAME_MAX: usize = 80;
/// Faults of the history that the status lists.
const FAULTS_SHOWN: usize = 8;

impl Hub {
    pub(super) fn record(&mut self, action: RecordAction, name: Option<&str>) -> Result<Value, Failure> {
        match (action, &self.recording) {
            (RecordAction::Stop, None) => Err(Failure::refused("no recording is in progress")),
            (RecordAction::Stop, Some(r)) => {
                let reply = recording_json(r);
                self.finish_recording();
                Ok(reply)
            }
            (RecordAction::Start, Some(r)) => {
                Err(Failure::refused(format!("{} is being recorded; stop that recording first", r.path().display())))
            }
            (RecordAction::Start, None) => {
                let folder = self.config.service.state.join("recordings");
                let name = name.map_or_else(|| next_name(&folder), str::to_owned);
                let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
                if name.is_empty() || name.starts_with('.') || name.len() > NAME_MAX || !name.chars().all(allowed) {
                    return Err(Failure::bad(format!("`{name}` is not a valid name: use letters, digits, - _ . and no folder")));
                }
                let path = folder.join(name + ".csv");
                let started = std::fs::create_dir_all(&folder).and_then(|()| self.start_recording(&path, false));
                started.map_err(|e| Failure::refused(format!("{}: {e}", path.display())))?;
                Ok(json!({"path": path, "replayable": self.recording.as_ref().is_some_and(Recording::has_tape)}))
            }
        }
    }

    /// Starts a recording. It has a tape if the supervisor is in its first cycle (`at_boot`) or can be replaced by a
    /// freshly reset one because the machine is disarmed at zero.
    pub(super) fn start_recording(&mut self, path: &Path, at_boot: bool) -> io::Result<()> {
        let idle =
            self.mode() == Mode::Disarmed && self.is_at_zero() && self.last.as_ref().is_some_and(|t| t.latched.is_none() && !t.stopped);
        let start = Start::new(&self.config, &self.memory, at_boot && self.facts.unreadable);
        let machine = self.facts.remarks.first().map_or("", String::as_str);
        let header = (at_boot || idle).then(|| start.header(&self.config.texts, machine));
        let mut recording = Recording::start(path, self.config.supervisor.gate.step_mm, header.as_ref())?;
        tracing::info!(event = "record", path = %path.display(), replayable = recording.has_tape(), "recording started");
        if !at_boot && idle && self.io.rings.orders.push(Message::ReplaceSupervisor(Box::new(start.supervisor()))).is_err() {
            recording.end_tape();
        }
        self.recording = Some(recording);
        Ok(())
    }

    pub(super) fn finish_recording(&mut self) {
        let Some(recording) = self.recording.take() else { return };
        let path = recording.path().to_owned();
        match recording.finish() {
            Ok(rows) => tracing::info!(event = "record", path = %path.display(), rows, "recording finished"),
            Err(e) => tracing::error!(event = "record", path = %path.display(), "the recording is incomplete: {e}"),
        }
    }

    /// The status as a JSON object.
    pub(super) fn status(&self) -> Value {
        let last = self.last.as_ref();
        let mut value = last.map_or_else(|| json!({"mode": Mode::Boot.name()}), |t| status::cycle(t, self.config.supervisor.gate.step_mm));
        let (shared, memory) = (&self.io.shared, &self.memory);
        let settled = last.is_some_and(|t| t.mode == Mode::Holding && (t.frame.at_rest || status::blocked(&t.frame)));
        let calibration = memory.accepted.as_ref().map_or(&self.config.calibration.transmission.source, |g| &g.source);
        let granted = |(name, grant): &(_, crate::hardware::rt::Grant)| json!({"what": name, "grant": grant.to_string()});
        let more = json!({
            "program": env!("CARGO_PKG_VERSION"),
            "config_hash": self.config.config_hash,
            "tip": self.config.tip,
            "uptime_s": self.started.elapsed().as_secs_f64(),
            "settled": settled,
            "stopped": last.is_some_and(|t| t.stopped),
            "fault": last.and_then(|t| t.latched).map(status::trip_message),
            "calibration": calibration,
            "calibrating": self.calibration.as_ref().map(Session::progress),
            "calibration_failed": self.calibration_failed,
            "proposed": memory.proposed,
            "recording": self.recording.as_ref().map(recording_json),
            "clients": self.io.control.clients() + self.io.status.clients(),
            "cycles": shared.cycles.load(Relaxed),
            "late_cycles": shared.late.load(Relaxed),
            "max_lateness_us": shared.max_lateness_us.load(Relaxed),
            "lost_frames": shared.lost.load(Relaxed),
            "real_time": self.facts.grants.iter().map(granted).collect::<Vec<_>>(),
            "remarks": self.facts.remarks,
            "memory": {"error": self.persistence.error, "damaged": self.facts.damaged},
            "faults": memory.faults[memory.faults.len().saturating_sub(FAULTS_SHOWN)..],
        });
        if let (Value::Object(to), Value::Object(from)) = (&mut value, more) {
            to.extend(from);
        }
        value
    }
}

/// The first free name. It does not use the time of day, which a computer without a clock does not know after a start.
fn next_name(folder: &Path) -> String {
    let mut names = (1..).map(|n| format!("bend-{n:04}"));
    names.find(|name| !folder.join(format!("{name}.csv")).exists()).unwrap_or_default()
}

fn recording_json(r: &Recording) -> Value {
    json!({"path": r.path(), "rows": r.rows, "replayable": r.has_tape()})
}
