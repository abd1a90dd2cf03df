//! The hub: everything around the loop that may wait. Each round takes requests, sends orders, reads frames and answers,
//! and hands what must survive to the state writer.

mod loop_output;
mod persist;
mod recording;
mod requests;
mod run;
#[cfg(test)]
mod tests;

use crate::hardware::rt::RtStatus;
use crate::model::Line;
use crate::service::calibrate::Session;
use crate::service::flight::log::FlightLog;
use crate::service::flight::start::Event;
use crate::service::protocol::{PathRow, reply_line};
use crate::service::record::Recording;
use crate::service::rt_loop::{HubRings, LoopFrame, Message, Precondition};
use crate::service::{
    Belief, Caller, Change, Failure, LearnedGains, Memory, Notifier, Port, RunConfig, Shared,
    StateWriter,
};
use crate::supervisor::{CycleOutput, Mode, Order};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant, UNIX_EPOCH};

/// The connections of the hub.
pub struct HubIo {
    /// The thread of the command socket.
    pub control: Port,
    /// The thread of the status socket.
    pub status: Port,
    /// The service manager.
    pub notifier: Notifier,
    /// The thread that writes the memory.
    pub state_writer: StateWriter,
    /// The rings to and from the loop.
    pub rings: HubRings,
    /// Counters of the loop, and the stop signal.
    pub shared: Arc<Shared>,
}

/// True for a client of the command socket: those have odd numbers.
pub(super) fn may_command(client: u64) -> bool {
    client % 2 == 1
}

impl HubIo {
    /// The socket of a client.
    pub(super) fn port(&self, client: u64) -> &Port {
        if may_command(client) {
            &self.control
        } else {
            &self.status
        }
    }
}

/// What is known since the start, for the status.
pub struct Facts {
    /// Remarks of the machine about itself, name first.
    pub remarks: Vec<String>,
    /// What the kernel granted the loop.
    pub grants: RtStatus,
    /// Damaged files of the memory.
    pub damaged: Vec<String>,
    /// Trust in the memory at the start.
    pub belief: Belief,
}

/// A request whose order is on its way.
pub(super) struct Pending {
    pub(super) caller: Caller,
    pub(super) order: Order,
    /// The order waits until this write of the memory is on the disk.
    pub(super) held: Option<u64>,
}

/// The reply to a request; without a value, the loop or the disk has to answer first.
pub(super) type Reply = Result<Option<Value>, Failure>;

pub(super) fn refuse<T>(message: impl Into<String>) -> Result<T, Failure> {
    Err(Failure::refused(message))
}

/// The reply to what was done at once and has nothing to tell.
pub(super) fn done() -> Reply {
    Ok(Some(json!({})))
}

pub(super) struct Subscription {
    pub(super) client: u64,
    pub(super) period_s: f64,
    pub(super) next_s: f64,
}

/// The hub.
pub struct Hub {
    pub(super) io: HubIo,
    pub(super) config: RunConfig,
    pub(super) facts: Facts,
    pub(super) memory: Memory,
    pub(super) started: Instant,
    pub(super) next_id: u64,
    pub(super) pending: BTreeMap<u64, Pending>,
    pub(super) subscriptions: Vec<Subscription>,
    /// Rows of paths of which more will come, by the client that sends them.
    pub(super) path_rows: HashMap<u64, Vec<PathRow>>,
    /// The client whose clock a stream with times is on.
    pub(super) streamer: u64,
    /// Duration of the last path and by how much it was slowed, for the status.
    pub(super) path: Value,
    /// The last cycle that is known.
    pub(super) last: Option<LoopFrame>,
    /// The log of this run, if there is one.
    pub(super) flight: Option<FlightLog>,
    /// Changes that were sent to the loop.
    pub(super) changes_sent: u64,
    /// Those whose first cycle has not come yet, with their numbers.
    pub(super) changes: VecDeque<(u64, Arc<Event>)>,
    pub(super) recording: Option<Recording>,
    /// Why the last recording ended, unless a client ended it.
    pub(super) recording_ended: Option<String>,
    /// The client whose command moves the tip, and when it was accepted.
    pub(super) motion_owner: Option<(u64, Instant)>,
    /// Since when the tip has held its pose without a stop, by the loop's clock, s.
    pub(super) held_since_s: Option<f64>,
    /// The status of this round, once a client has asked for it.
    pub(super) status_cache: Option<Value>,
    pub(super) calibration: Option<Session>,
    /// Why the last calibration failed.
    pub(super) calibration_failed: Option<String>,
    pub(super) persistence: Persistence,
    pub(super) stops_logged: u64,
    pub(super) last_status: (String, Instant),
    /// Since when the service is ending, also by the loop's clock, s.
    pub(super) ending: Option<(Instant, f64)>,
    /// When the service was ready, s since the computer started.
    pub(super) ready_after_boot_s: f64,
    /// What the firmware says about the supply, if there is such a firmware, and when it was asked.
    pub(super) supply: (Option<Vec<&'static str>>, Option<Instant>),
    pub(super) log_limit: LogLimit,
}

/// State of the memory on the disk.
#[derive(Debug, Default)]
pub(super) struct Persistence {
    /// The disk says that drivers may be armed.
    pub(super) armed_on_disk: bool,
    /// The write that will say so.
    pub(super) arming: Option<u64>,
    /// Why the last write failed.
    pub(super) error: Option<String>,
    /// The accepted gains, and those in use, before those that were accepted last.
    pub(super) before: (Option<LearnedGains>, [Line; 3]),
    /// The cycle that carried out the last `arm`: a note from before it says nothing about the drivers.
    pub(super) armed_cycle: u64,
    pub(super) last_checkpoint: Option<Instant>,
}

impl Persistence {
    /// Makes the next round write a checkpoint.
    pub(super) fn write_soon(&mut self) {
        self.last_checkpoint = None;
    }

    /// True if the last checkpoint is at least this old.
    pub(super) fn is_older_than(&self, age: Duration) -> bool {
        self.last_checkpoint.is_none_or(|t| t.elapsed() >= age)
    }
}

impl Hub {
    /// A hub before its first round.
    pub fn new(io: HubIo, config: RunConfig, memory: Memory, facts: Facts) -> Self {
        let now = Instant::now();
        Self {
            persistence: Persistence {
                armed_on_disk: memory.armed,
                last_checkpoint: Some(now),
                ..Persistence::default()
            },
            io,
            config,
            facts,
            memory,
            started: now,
            next_id: 1,
            pending: BTreeMap::new(),
            subscriptions: Vec::new(),
            path_rows: HashMap::new(),
            streamer: 0,
            path: Value::Null,
            last: None,
            flight: None,
            changes_sent: 0,
            changes: VecDeque::new(),
            recording: None,
            recording_ended: None,
            motion_owner: None,
            held_since_s: None,
            status_cache: None,
            calibration: None,
            calibration_failed: None,
            stops_logged: 0,
            last_status: (String::new(), now),
            ending: None,
            ready_after_boot_s: 0.0,
            supply: (None, None),
            log_limit: LogLimit::default(),
        }
    }

    /// Sends an order of a client.
    pub(super) fn order(&mut self, order: Order, caller: Caller) {
        let (id, then, held) = (self.next_id(), caller.then, None);
        let pending = Pending {
            caller,
            order,
            held,
        };
        self.pending.insert(id, pending);
        self.push_order(id, order, then);
    }

    /// Sends an order of the hub itself, which is carried out only in `mode` if there is one.
    pub(super) fn own_order(&mut self, order: Order, mode: Option<Mode>) {
        let (stops, since) = (self.io.shared.stop.requested(), Instant::now());
        let id = self.next_id();
        self.push_order(id, order, Precondition { stops, since, mode });
    }

    pub(super) fn push_order(&mut self, id: u64, order: Order, precondition: Precondition) {
        let rings = &mut self.io.rings;
        let ring = if order.leads_setpoint() && order != Order::Play {
            &mut rings.setpoints
        } else {
            &mut rings.orders
        };
        let message = Message::Order {
            id,
            order,
            precondition,
        };
        if ring.push(message).is_err()
            && let Some(pending) = self.pending.remove(&id)
        {
            self.fail(&pending, too_many());
        }
    }

    /// Sends a change to the loop, and remembers what it means for a replay until its first cycle has come.
    pub(super) fn change(&mut self, change: Change, event: Event) -> Result<(), Failure> {
        let sent = self.io.rings.orders.push(Message::Change(change));
        sent.map_err(|_| too_many())?;
        self.changes_sent += 1;
        self.changes.push_back((self.changes_sent, Arc::new(event)));
        Ok(())
    }

    /// Answers an order that was not carried out, and takes back what was prepared for it.
    pub(super) fn fail(&mut self, pending: &Pending, failure: Failure) {
        match pending.order {
            Order::Calibrate(true) => self.calibration = None,
            Order::Lines(_) => {
                let (accepted, lines) = std::mem::take(&mut self.persistence.before);
                self.memory.proposed = std::mem::replace(&mut self.memory.accepted, accepted);
                self.config.supervisor.tick.lines = lines;
                self.persistence.write_soon();
            }
            _ => {}
        }
        if let Some(hidden) = self.log_limit.admit("refused") {
            let (why, caller) = (&failure.message, &pending.caller);
            tracing::warn!(event = "refused", command = caller.command, client = caller.client, hidden, config = %self.config.config_hash, "{why}");
        }
        self.reply(&pending.caller, &Err(failure));
    }

    pub(super) fn next_id(&mut self) -> u64 {
        self.next_id += 1;
        self.next_id
    }

    pub(super) fn reply(&mut self, to: &Caller, reply: &Result<Value, Failure>) {
        let line = reply_line(&to.id, reply);
        self.io.port(to.client).reply(to.client, line);
    }

    /// Output of the last cycle.
    pub(super) fn output(&self) -> Option<&CycleOutput> {
        self.last.as_ref().map(|last| &last.output)
    }

    pub(super) fn mode(&self) -> Mode {
        self.output().map_or(Mode::Boot, |t| t.mode)
    }

    pub(super) fn is_at_zero(&self) -> bool {
        self.output().is_some_and(|t| t.counted.0 == [0; 3])
    }
}

fn too_many() -> Failure {
    Failure::refused("too many commands at once; try again in a moment")
}

/// Seconds since 1970.
pub(super) fn unix_s() -> f64 {
    UNIX_EPOCH.elapsed().map_or(0.0, |d| d.as_secs_f64())
}

/// Limits log lines that a client or a sensor can cause to one per second and kind.
#[derive(Debug, Default)]
pub(super) struct LogLimit(HashMap<&'static str, (Option<Instant>, u32)>);

impl LogLimit {
    /// The number of lines suppressed since the last one; `None` if this one must be suppressed too.
    pub(super) fn admit(&mut self, kind: &'static str) -> Option<u32> {
        let (last, hidden) = self.0.entry(kind).or_default();
        if last.is_some_and(|t| t.elapsed() < Duration::from_secs(1)) {
            *hidden += 1;
            return None;
        }
        *last = Some(Instant::now());
        Some(std::mem::take(hidden))
    }
}
