//! The hub: everything around the loop that may wait. One round: clients in, orders out, frames in,
//! answers out, and what has to be kept to the keeper.

mod follow;
mod requests;

use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::service::ServiceSection;
use crate::hardware::rt::RtStatus;
use crate::service::ServiceError;
use crate::service::calibrate::Session;
use crate::service::memory::Memory;
use crate::service::notify::Notifier;
use crate::service::protocol::{Failure, answer_line};
use crate::service::record::Recording;
use crate::service::rt_loop::{Message, OtherEnd, Shared};
use crate::service::server::Server;
use crate::service::state_writer::StateWriter;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::cycle::{CycleOutput, SupervisorConfig};
use crate::supervisor::mode::Mode;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// What a hub is made of.
pub struct Parts {
    /// The sockets.
    pub server: Server,
    /// systemd.
    pub notifier: Notifier,
    /// The disk.
    pub state_writer: StateWriter,
    /// The rings.
    pub other_end: OtherEnd,
    /// Counters.
    pub shared: Arc<Shared>,
    /// What is remembered.
    pub memory: Memory,
    /// For a reload.
    pub board: Board,
    /// For a reload.
    pub gains: Option<PathBuf>,
    /// In use.
    pub gains_now: Gains,
    /// In use.
    pub calibration: Calibration,
    /// Mounted.
    pub tip: String,
    /// Of board, gains, calibration.
    pub config_hash: String,
    /// Of board, gains, calibration.
    pub texts: [String; 3],
    /// The daemon's table.
    pub service: ServiceSection,
    /// What the machine says of itself.
    pub remarks: Vec<String>,
    /// What the kernel granted the loop.
    pub grants: RtStatus,
    /// Damaged memory.
    pub set_aside: Vec<String>,
    /// Nothing that was remembered could be believed when the first pilot took off.
    pub doubted: bool,
    /// What the pilot began with.
    pub supervisor: SupervisorConfig,
    /// The clock is not waited for.
    pub fast: bool,
}

/// Who waits for the answer to an order.
struct Waiting {
    client: u64,
    id: Value,
    what: &'static str,
    since: Instant,
    /// What the answer says when the order is taken.
    result: Value,
}

/// A subscription.
struct Subscription {
    client: u64,
    every_s: f64,
    next_s: f64,
}

/// The hub.
pub struct Hub {
    parts: Parts,
    begun: Instant,
    next_order: u64,
    waiting: HashMap<u64, Waiting>,
    /// Orders that wait for the disk first.
    ahead: HashMap<u64, Order>,
    subscriptions: Vec<Subscription>,
    last: Option<CycleOutput>,
    recording: Option<Recording>,
    calibration: Option<Session>,
    /// Why the last calibration found nothing.
    calibration_failed: Option<String>,
    /// What was accepted before the calibration that is being put on the disk.
    accepted_before: Option<crate::service::memory::LearnedGains>,
    memory_error: Option<String>,
    /// What the disk has for certain: drivers may be armed.
    armed_on_disk: bool,
    last_checkpoint: Instant,
    last_status: (String, Instant),
    ending: Option<Instant>,
    hushed: HashMap<&'static str, (Instant, u32)>,
}

/// Longest wait in a round.
const ROUND: Duration = Duration::from_millis(5);
/// Longest way back to rest at the end of the service, s.
const END_MAX_S: f64 = 30.0;
/// The loop must answer within this time, s.
const ANSWER_MAX_S: f64 = 2.0;

impl Hub {
    /// A hub that has done nothing yet.
    #[must_use]
    pub fn new(parts: Parts) -> Self {
        let now = Instant::now();
        Self {
            parts,
            begun: now,
            next_order: 1,
            waiting: HashMap::new(),
            ahead: HashMap::new(),
            subscriptions: Vec::new(),
            last: None,
            recording: None,
            calibration: None,
            calibration_failed: None,
            accepted_before: None,
            memory_error: None,
            armed_on_disk: false,
            last_checkpoint: now,
            last_status: (String::new(), now),
            ending: None,
            hushed: HashMap::new(),
        }
    }

    /// Goes round until told to end, then leads the tip back to rest.
    ///
    /// # Errors
    /// [`ServiceError`].
    pub fn run(mut self, record: Option<PathBuf>) -> Result<(), ServiceError> {
        let told = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&told))
                .map_err(|source| ServiceError::System { what: "a signal handler".to_owned(), source })?;
        }
        if let Some(path) = record {
            self.begin_recording(&path, true).map_err(|source| ServiceError::System { what: path.display().to_string(), source })?;
        }
        self.mount_tip();
        tracing::info!(event = "start", config = %self.parts.config_hash, tip = %self.parts.tip, "ready, disarmed");
        self.parts.notifier.say("READY=1\nSTATUS=aligning: the tip must be still for 2 s");
        while !self.is_over() {
            self.parts.shared.hub_rounds.fetch_add(1, Relaxed);
            if told.load(Relaxed) && self.ending.is_none() {
                self.begin_to_end();
            }
            for line in self.parts.server.round(ROUND) {
                self.hear(line);
            }
            self.take_in();
            self.keep();
            self.tell_manager();
            self.report_dropped();
            if self.parts.other_end.frames.is_abandoned() {
                // the loop has ended by itself: whoever joins it will know why
                break;
            }
        }
        self.end()
    }

    /// A tip of another identity: what was learnt on the last one is not for it.
    fn mount_tip(&mut self) {
        let memory = &mut self.parts.memory;
        if memory.tip != self.parts.tip {
            tracing::info!(event = "tip", was = %memory.tip, is = %self.parts.tip, "another tip is mounted");
            memory.proposed = None;
            memory.tip.clone_from(&self.parts.tip);
        }
        memory.config_hash.clone_from(&self.parts.config_hash);
    }

    /// Sends an order; what comes back goes to the client that asked.
    fn order(&mut self, order: Order, waiting: Option<Waiting>) -> bool {
        let id = self.next_order;
        self.next_order += 1;
        if let Err(rtrb::PushError::Full(_)) = self.parts.other_end.orders.push(Message::Order(id, order)) {
            if let Some(w) = waiting {
                self.reply(w.client, &w.id, &Err(Failure::refused("too many commands at once; try again in a moment")));
            }
            return false;
        }
        if let Some(w) = waiting {
            self.waiting.insert(id, w);
        }
        true
    }

    fn reply(&mut self, client: u64, id: &Value, answer: &Result<Value, Failure>) {
        self.parts.server.send(client, &answer_line(id, answer));
    }

    fn mode(&self) -> Mode {
        self.last.as_ref().map_or(Mode::Boot, |t| t.mode)
    }

    /// One line in the log for many of a kind: at most one a second, with how many were not shown.
    fn hush(&mut self, kind: &'static str) -> Option<u32> {
        let now = Instant::now();
        match self.hushed.get_mut(kind) {
            Some((last, count)) if now.duration_since(*last) < Duration::from_secs(1) => {
                *count += 1;
                None
            }
            Some(entry) => {
                let count = entry.1;
                *entry = (now, 0);
                Some(count)
            }
            None => {
                self.hushed.insert(kind, (now, 0));
                Some(0)
            }
        }
    }

    fn report_dropped(&mut self) {
        for (client, why) in std::mem::take(&mut self.parts.server.dropped) {
            self.subscriptions.retain(|s| s.client != client);
            if why != "gone"
                && let Some(hidden) = self.hush("dropped")
            {
                tracing::warn!(event = "client_dropped", client, hidden, "a client was dropped: {why}");
            }
        }
    }

    /// SIGTERM: back to rest if there is anything to bring back.
    fn begin_to_end(&mut self) {
        self.ending = Some(Instant::now());
        self.parts.notifier.say("STOPPING=1\nSTATUS=relaxing");
        tracing::info!(event = "end", config = %self.parts.config_hash, mode = %self.mode(), "told to end");
        let away = self.last.as_ref().is_some_and(|t| t.counted.0 != [0; 3]);
        if away && self.mode() != Mode::Lost {
            self.order(Order::Relax, None);
        }
    }

    fn is_over(&self) -> bool {
        let Some(since) = self.ending else { return false };
        let Some(last) = &self.last else { return true };
        let resting = last.counted.0 == [0; 3] || matches!(last.mode, Mode::Lost | Mode::Boot);
        let settled = since.elapsed() > Duration::from_millis(100) && !matches!(last.mode, Mode::Relaxing);
        // what cannot be brought back is not waited for
        let stuck = since.elapsed() > Duration::from_secs(1) && last.mode == Mode::Faulted;
        stuck || (resting && settled) || since.elapsed().as_secs_f64() > END_MAX_S
    }

    fn end(mut self) -> Result<(), ServiceError> {
        self.end_recording();
        let at_rest = self.last.as_ref().is_some_and(|t| t.counted.0 == [0; 3]);
        self.parts.memory.armed = !at_rest;
        if let (Some(kept), Some(last)) = (&mut self.parts.memory.kept, &self.last) {
            // the last note of the loop may be older than its last step
            kept.steps = last.counted;
        }
        let memory = self.parts.memory.clone();
        let kept = self.parts.state_writer.finish(&memory);
        if let Some(Err(e)) = kept.map(|k| k.result) {
            tracing::error!(event = "memory", "the last state could not be kept: {e}");
        }
        tracing::info!(event = "ended", config = %self.parts.config_hash, at_rest, "ended");
        Ok(())
    }

    fn status(&self) -> Value {
        let mut value = match &self.last {
            Some(turned) => super::status::turn(turned, self.parts.supervisor.gate.step_mm),
            None => json!({"mode": Mode::Boot.name()}),
        };
        let shared = &self.parts.shared;
        let rt: Vec<Value> = self.parts.grants.iter().map(|(name, grant)| json!({"what": name, "grant": grant.to_string()})).collect();
        let memory = &self.parts.memory;
        let last = memory.faults.len().saturating_sub(8);
        let more = json!({
            "program": env!("CARGO_PKG_VERSION"),
            "config_hash": self.parts.config_hash,
            "tip": self.parts.tip,
            "uptime_s": self.begun.elapsed().as_secs_f64(),
            "settled": self.is_settled(),
            "fault": self.last.as_ref().and_then(|t| t.latched).map(super::status::words),
            "calibration": memory.accepted.as_ref().map_or_else(|| self.parts.calibration.transmission.source.clone(), |g| g.source.clone()),
            "calibrating": self.calibration.as_ref().map(Session::progress),
            "calibration_failed": self.calibration_failed,
            "proposed": memory.proposed,
            "recording": self.recording.as_ref().map(|r| json!({"path": r.path(), "rows": r.rows, "replayable": r.has_tape()})),
            "clients": self.parts.server.clients(),
            "turns": shared.turns.load(Relaxed),
            "late_turns": shared.late.load(Relaxed),
            "latest_us": shared.latest_us.load(Relaxed),
            "lost_frames": shared.lost.load(Relaxed),
            "real_time": rt,
            "remarks": self.parts.remarks,
            "memory": {"error": self.memory_error, "set_aside": self.parts.set_aside},
            "faults": memory.faults[last..],
        });
        if let (Value::Object(to), Value::Object(from)) = (&mut value, more) {
            to.extend(from);
        }
        value
    }

    /// The tip is where it was told, or will not get any nearer.
    fn is_settled(&self) -> bool {
        self.last.as_ref().is_some_and(|t| t.mode == Mode::Holding && (t.frame.at_rest || super::status::blocked(&t.frame)))
    }
}
