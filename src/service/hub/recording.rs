//! Recordings, and the status of the service.

use super::{Hub, Reply, refuse};
use crate::service::calibrate::Session;
use crate::service::flight::file::zero_unix_ns;
use crate::service::flight::log::FlightLog;
use crate::service::flight::start::Event;
use crate::service::paths::Paths;
use crate::service::record::{Progress, Recording};
use crate::service::{Belief, Caller, Change, Failure, RecordAction, Start, Watched, status};
use crate::supervisor::{Mode, Source, TripCause};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

/// Longest name of a recording, bytes.
const NAME_MAX: usize = 80;
/// Longest wait for the disk at the end of the service.
const END_MAX: Duration = Duration::from_secs(10);
/// Faults of the history that the status lists.
const FAULTS_SHOWN: usize = 8;

impl Hub {
    /// `record start` and `record stop`; both are answered when the disk has accepted them.
    pub(super) fn record(
        &mut self,
        action: RecordAction,
        name: Option<&str>,
        owned: bool,
        caller: &Caller,
    ) -> Reply {
        match (action, &mut self.recording) {
            (RecordAction::Stop, None) => refuse("no recording is in progress"),
            (RecordAction::Stop, Some(recording)) => {
                recording.finish();
                recording.ending.push(caller.clone());
                Ok(None)
            }
            (RecordAction::Start, Some(recording)) => refuse(format!(
                "{} is being recorded; stop that recording first",
                recording.path.display()
            )),
            (RecordAction::Start, None) => {
                let folder = Paths::of(&self.config.service).state.join("recordings");
                let name = name.map_or_else(|| next_name(&folder), str::to_owned);
                let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
                if name.is_empty()
                    || name.starts_with('.')
                    || name.len() > NAME_MAX
                    || !name.chars().all(allowed)
                {
                    return Err(Failure::bad(format!(
                        "`{name}` is not a valid name: use letters, digits, - _ . and no folder"
                    )));
                }
                let path = folder.join(name + ".csv.gz");
                let failed = |e| Failure::refused(format!("{}: {e}", path.display()));
                let recording = self.start_recording(&path, false).map_err(failed)?;
                recording.owner = owned.then_some(caller.client);
                recording.starting = Some(caller.clone());
                Ok(None)
            }
        }
    }

    /// Starts the flight log of this run. Without a thread for it, the service runs without one.
    pub(super) fn start_flight(&mut self) {
        let start = Start::new(&self.config, &self.memory, self.facts.belief);
        let header = start.header(&self.config, self.machine());
        self.changes.push_back((0, Arc::new(Event::Start(header))));
        if self.config.service.flight_max_mib > 0.0 {
            let folder = Paths::of(&self.config.service).state.join("flights");
            match FlightLog::start(&folder, &self.config.service) {
                Ok(flight) => self.flight = Some(flight),
                Err(e) => tracing::error!(event = "flight_log", "there is no flight log: {e}"),
            }
        }
    }

    fn machine(&self) -> &str {
        self.facts.remarks.first().map_or("", String::as_str)
    }

    /// Starts a recording. It can be replayed if the supervisor is in its first cycle (`at_boot`), or if it is idle now and when
    /// the loop replaces it by a freshly reset one.
    pub(super) fn start_recording(
        &mut self,
        path: &Path,
        at_boot: bool,
    ) -> io::Result<&mut Recording> {
        let idle = self.last.is_some_and(|last| last.idle);
        let t_s = self.output().map_or(0.0, |last| last.sensed.t.0);
        let zero = (at_boot || idle).then(|| zero_unix_ns(t_s));
        let step_mm = self.config.supervisor.gate.step_mm;
        let mut recording = Recording::start(path, step_mm, zero, &self.config.service)?;
        tracing::info!(event = "record", path = %path.display(), replayable = recording.is_replayable(), "recording started");
        if !at_boot && idle {
            self.memory.restart = self.last.map(|last| last.restart);
            let start = Start::new(&self.config, &self.memory, Belief::Certain);
            let header = start.header(&self.config, self.machine());
            let change = Change::Supervisor(Box::new(start.supervisor()));
            if self.change(change, Event::Start(header)).is_err() {
                recording.give_up_replay();
            }
        }
        self.recording_ended = None;
        Ok(self.recording.insert(recording))
    }

    /// Reads what the recording's thread reports, and answers who waits for it.
    pub(super) fn follow_recording(&mut self) {
        // whether it can be replayed is known once the loop has replaced the supervisor or not
        let undecided =
            |(change, event): &(u64, Arc<Event>)| *change > 0 && matches!(**event, Event::Start(_));
        if self.changes.iter().any(undecided) {
            return;
        }
        let hangs_deg = self.hangs_deg();
        while let Some(recording) = &mut self.recording {
            match recording.progress() {
                None => return,
                Some(Progress::Ended(result)) => self.recording_over(result),
                Some(Progress::Started) => {
                    let straight_deg = self.config.supervisor.restart_check.straight_deg;
                    let remark = |deg| format!("the tip hangs {deg:.1}° away from straight");
                    let remark = hangs_deg.filter(|deg| *deg > straight_deg).map(remark);
                    let started = json!({"path": recording.path, "replayable": recording.is_replayable(), "remark": remark});
                    if let Some(caller) = recording.starting.take() {
                        self.reply(&caller, &Ok(started));
                    }
                }
            }
        }
    }

    fn recording_over(&mut self, result: io::Result<Option<&'static str>>) {
        let Some(recording) = self.recording.take() else {
            return;
        };
        let (shown, rows) = (recording.path.display(), recording.rows.count);
        let exists = "a recording of this name exists; give another name, or remove its files (.csv.gz and .mcap)";
        let result = result.map_err(|e| match e.kind() {
            io::ErrorKind::AlreadyExists => exists.to_owned(),
            _ => e.to_string(),
        });
        let (reply, why) = match result {
            Ok(reason) => (Ok(recording_json(&recording)), reason.map(str::to_owned)),
            Err(e) => (Err(Failure::refused(format!("{shown}: {e}"))), Some(e)),
        };
        match &why {
            None => tracing::info!(event = "record", path = %shown, rows, "recording finished"),
            Some(why) => {
                tracing::error!(event = "record", path = %shown, rows, "the recording has ended: {why}")
            }
        }
        for caller in recording.starting.iter().chain(&recording.ending) {
            self.reply(caller, &reply);
        }
        // one that was refused has not begun
        if recording.starting.is_none() {
            self.recording_ended = why.or(self.recording_ended.take());
        }
    }

    /// Ends the logs with the service, and waits for the disk.
    pub(super) fn end_recording(&mut self) {
        if let Some(flight) = &mut self.flight {
            flight.finish(END_MAX);
        }
        if let Some(recording) = &mut self.recording {
            recording.finish();
        }
        self.changes.clear();
        let since = Instant::now();
        while self.recording.is_some() && since.elapsed() < END_MAX {
            self.follow_recording();
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Estimated bend of a tip whose pistons are at zero, degrees.
    fn hangs_deg(&self) -> Option<f64> {
        let last = self.output().filter(|_| self.is_at_zero())?;
        Some(last.frame.estimate?.bend.beta().to_degrees())
    }

    /// The status, built once per round however many ask for it.
    pub(super) fn cached_status(&mut self) -> Value {
        let status = self.status_cache.take().unwrap_or_else(|| self.status());
        self.status_cache.insert(status).clone()
    }

    /// Why the position of the pistons is unknown, and what ends that.
    fn lost(&self) -> String {
        let why = match (self.facts.damaged.first(), self.facts.belief) {
            (Some(damage), _) => damage,
            (None, Belief::Lost) => "no memory of the position was found at the start",
            (None, Belief::Checked) => {
                "the service ended while the drivers were energised, and the tip is not in the pose of its memory"
            }
            (None, Belief::Certain) => "the drivers have been released since the last zero",
        };
        let attitude = self.last.and_then(|last| last.restart.rest);
        let zero = attitude.map_or("zero --straight", |_| "zero");
        let relax = "; `retroflex relax` drives back by the remembered steps";
        let relax = if self.is_at_zero() { "" } else { relax };
        format!(
            "{why}: the position of the pistons is unknown; relax the tip by hand, then run `retroflex {zero}`{relax}"
        )
    }

    /// The status as a JSON object.
    fn status(&self) -> Value {
        let last = self.output();
        let mut value = last.map_or_else(
            || json!({"mode": Mode::Boot.name()}),
            |t| status::cycle(t, self.config.supervisor.gate.step_mm),
        );
        let (shared, memory) = (&self.io.shared, &self.memory);
        let settled = last.is_some_and(|t| t.mode == Mode::Holding && status::settled(&t.frame));
        let given = &self.config.calibration.transmission.source;
        let model = self.config.feedforward.as_ref();
        let model = model.map(|file| file.display().to_string());
        let accepted = Start::accepted(&self.config, memory).map(|g| &g.source);
        let calibration = model.as_ref().or(accepted).unwrap_or(given);
        let granted = |(name, grant): &(_, crate::hardware::rt::Grant)| json!({"what": name, "grant": grant.to_string()});
        let age_s = |w: &Watched| (w.name(), (shared.age_s(*w) * 1e3).floor() * 1e-3);
        let more = json!({
            "program": env!("CARGO_PKG_VERSION"),
            "config_hash": self.config.config_hash,
            "limits": status::limits(&Start::new(&self.config, memory, self.facts.belief).config),
            "tip": self.config.tip,
            "uptime_s": self.started.elapsed().as_secs_f64(),
            "ready_after_boot_s": self.ready_after_boot_s,
            "power": self.supply.0,
            "settled": settled,
            "stopped": last.is_some_and(|t| t.stopped),
            "stops": shared.stop.completed(),
            "fault": last.and_then(|t| t.latched).map(TripCause::advice),
            "ending": self.ending.is_some(),
            "calibration": calibration,
            "feedforward": model,
            "calibrating": self.calibration.as_ref().map(Session::progress),
            "calibration_failed": self.calibration_failed,
            "proposed": memory.proposed,
            "recording": self.recording.as_ref().map(recording_json),
            "recording_ended": self.recording_ended,
            "flight_log": self.flight.as_ref().map(flight_json),
            "lost": (self.mode() == Mode::Lost).then(|| self.lost()),
            "unverified": memory.unverified,
            "hangs_deg": self.hangs_deg(),
            "thread_age_s": Watched::ALL.iter().map(age_s).collect::<HashMap<_, _>>(),
            "clients": shared.clients.iter().map(|n| n.load(Relaxed)).sum::<usize>(),
            "cycles": shared.cycles.load(Relaxed),
            "late_cycles": shared.late.load(Relaxed),
            "max_lateness_us": shared.max_lateness_us.load(Relaxed),
            "lost_frames": shared.lost.load(Relaxed),
            "real_time": self.facts.grants.iter().map(granted).collect::<Vec<_>>(),
            "remarks": self.facts.remarks,
            "memory": {"error": self.persistence.error, "damaged": self.facts.damaged},
            "faults": memory.faults[memory.faults.len().saturating_sub(FAULTS_SHOWN)..],
        });
        if let Some((t_s, Source::Path { began_s })) = last.map(|t| (t.sensed.t.0, t.source)) {
            value["path"] = self.path.clone();
            value["path"]["at_s"] = json!((t_s - began_s).max(0.0));
        }
        if let (Value::Object(to), Value::Object(from)) = (&mut value, more) {
            to.extend(from);
        }
        value
    }
}

/// The first free name. It does not use the time of day, which a computer without a clock does not know after a start.
fn next_name(folder: &Path) -> String {
    let mut names = (1..).map(|n| format!("bend-{n:04}"));
    let free = |name: &String| !folder.join(format!("{name}.csv.gz")).exists();
    names.find(free).unwrap_or_default()
}

fn recording_json(r: &Recording) -> Value {
    json!({"path": r.path, "rows": r.rows.count, "duration_s": r.rows.last_s, "replayable": r.is_replayable()})
}

fn flight_json(flight: &FlightLog) -> Value {
    let problem = flight.problem();
    json!({"writing": problem.is_none(), "lost": flight.lost, "problem": problem})
}
