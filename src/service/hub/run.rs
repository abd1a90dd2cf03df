//! The rounds of the hub, and the end of the service.

use super::Hub;
use crate::hardware::{rt, supply};
use crate::service::port::FromPort;
use crate::service::{Port, ServiceError, Watched};
use crate::supervisor::{CycleOutput, Mode, Order, TripCause};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// Requests of each socket that are taken in one round.
const REQUESTS_PER_ROUND: usize = 256;
/// Longest wait of a round. Commands end it early.
const ROUND: Duration = Duration::from_millis(5);
/// Longest way back to rest when the service ends, s.
const END_MAX_S: f64 = 30.0;
/// Time between two questions about the supply.
const SUPPLY_EVERY: Duration = Duration::from_secs(5);
/// Where less than this share of the time passes, a plant is too slow to be waited for.
const SLOW: f64 = 0.1;
/// A faulted or stopped tip is given this long to brake before the service ends.
const BRAKE_MAX: Duration = Duration::from_secs(1);

/// True after a fault of the step generator. A late step alone is no reason to leave a tip bent when the service ends, so the
/// return to rest is begun again once.
fn is_late(last: &CycleOutput) -> bool {
    last.mode == Mode::Faulted && last.latched == Some(TripCause::StepGenerator)
}

impl Hub {
    /// Runs until a signal ends the service, then returns the tip to rest. Hands back the threads of the sockets.
    ///
    /// # Errors
    /// [`ServiceError`].
    pub fn run(mut self, record: Option<PathBuf>) -> Result<[Port; 2], ServiceError> {
        let signalled = Arc::new(AtomicBool::new(false));
        for signal in rt::ending_signals() {
            let handler = signal_hook::flag::register(signal, Arc::clone(&signalled));
            handler.map_err(ServiceError::system("a signal handler"))?;
        }
        self.start_flight();
        if let Some(path) = record {
            let started = self.start_recording(&path, true);
            started.map_err(ServiceError::system(path.display()))?;
        }
        self.mount_tip();
        self.ready_after_boot_s = rt::monotonic_ns() as f64 * 1e-9;
        tracing::info!(event = "start", after_boot_s = self.ready_after_boot_s, config = %self.config.config_hash, tip = %self.config.tip, "ready, disarmed");
        let ready = "READY=1\nSTATUS=aligning: the tip must be still for 2 s";
        self.io.notifier.notify(ready);
        let mut again = true;
        while !self.is_over() {
            self.io.shared.progress(Watched::Hub);
            if signalled.load(Relaxed) && self.ending.is_none() {
                self.start_ending();
            }
            self.take_requests();
            if again && self.ending.is_some() && self.output().is_some_and(is_late) {
                again = false;
                self.ending = self.ending.map(|(_, from_s)| (Instant::now(), from_s));
                self.own_order(Order::Relax, None);
            }
            self.follow_recording();
            self.persist();
            self.notify_manager();
            self.watch_supply();
            if self.io.rings.frames.is_abandoned() {
                // the loop has ended by itself; its result tells why
                break;
            }
        }
        Ok(self.end())
    }

    /// Discards what was learned on another tip.
    fn mount_tip(&mut self) {
        let memory = &mut self.memory;
        if memory.tip != self.config.tip {
            // an empty name is that of no tip: the memory is new, or none was named
            if !memory.tip.is_empty() {
                tracing::info!(event = "tip", before = %memory.tip, now = %self.config.tip, "another tip is mounted");
            }
            memory.proposed = None;
            memory.tip.clone_from(&self.config.tip);
        }
        memory.config_hash.clone_from(&self.config.config_hash);
    }

    /// Asks the firmware now and then about the supply, and logs what is new.
    fn watch_supply(&mut self) {
        let (known, asked) = &mut self.supply;
        if asked.is_some_and(|asked| asked.elapsed() < SUPPLY_EVERY) {
            return;
        }
        *asked = Some(Instant::now());
        let troubles = supply::troubles(Path::new("/"));
        let is_new = |new: &&&str| !known.iter().flatten().any(|known| known == *new);
        for new in troubles.iter().flatten().filter(is_new) {
            tracing::warn!(event = "supply", "{new}: {}", supply::REMEDY);
        }
        *known = troubles;
    }

    /// Requests of both sockets. Those of the status socket come second, so that readers delay no command.
    fn take_requests(&mut self) {
        let first = self.io.control.messages.recv_timeout(ROUND).ok();
        // a status that follows an answer reports what was answered
        self.take_loop_output();
        self.status_cache = None;
        let (commands, reads) = (&self.io.control.messages, &self.io.status.messages);
        let commands = first.into_iter().chain(commands.try_iter());
        let reads = reads.try_iter().take(REQUESTS_PER_ROUND);
        let messages: Vec<FromPort> = commands.take(REQUESTS_PER_ROUND).chain(reads).collect();
        for message in messages {
            match message {
                FromPort::Incoming(caller, request) => self.handle(caller, request),
                FromPort::Gone(client, reason) => self.forget(client, reason),
            }
        }
    }

    /// A client was disconnected: its recording ends, and the motion that it attended.
    pub(super) fn forget(&mut self, client: u64, reason: &'static str) {
        self.subscriptions.retain(|s| s.client != client);
        self.path_rows.remove(&client);
        if reason != "disconnected"
            && let Some(hidden) = self.log_limit.admit("dropped")
        {
            let why = format!("a client was disconnected: {reason}");
            tracing::warn!(event = "client_dropped", client, hidden, "{why}");
        }
        if let Some(recording) = &mut self.recording
            && recording.owner == Some(client)
        {
            self.recording_ended = Some("the client that asked for it disconnected".to_owned());
            recording.finish();
        }
        let attended = |(owner, since): (u64, Instant)| {
            owner == client && since.elapsed().as_secs_f64() > self.config.service.attended_s
        };
        if self.motion_owner.is_some_and(attended) {
            self.motion_owner = None;
            let order = match self.mode() {
                Mode::Tracking => Order::Hold,
                Mode::Calibrating => Order::Calibrate(false),
                _ => return,
            };
            tracing::warn!(event = "abandoned", client, config = %self.config.config_hash, "the client that moved the tip disconnected: holding");
            self.own_order(order, Some(self.mode()));
        }
    }

    /// A signal that ends a process: returns to rest; after a stop the tip stays where it is.
    fn start_ending(&mut self) {
        let t_s = self.output().map_or(0.0, |last| last.sensed.t.0);
        self.ending = Some((Instant::now(), t_s));
        self.io.notifier.notify("STOPPING=1\nSTATUS=relaxing");
        tracing::info!(event = "end", config = %self.config.config_hash, mode = %self.mode(), "ending on a signal");
        let away = self.last.is_some() && (!self.is_at_zero() || self.mode().moves());
        let stopped = self.output().is_some_and(|last| last.stopped);
        if away && !stopped && self.mode() != Mode::Lost {
            self.own_order(Order::Relax, None);
        }
    }

    fn is_over(&self) -> bool {
        let (Some((since, from_s)), Some(last)) = (self.ending, self.output()) else {
            return self.ending.is_some();
        };
        let rested = self.is_at_zero() || matches!(last.mode, Mode::Lost | Mode::Boot);
        let settled = since.elapsed() > Duration::from_millis(100) && last.mode != Mode::Relaxing;
        let passed_s = last.sensed.t.0 - from_s;
        let slow = passed_s < SLOW * since.elapsed().as_secs_f64();
        let stays = last.mode == Mode::Faulted || last.stopped || slow;
        (stays && since.elapsed() > BRAKE_MAX)
            || (rested && settled)
            || since.elapsed().as_secs_f64() > END_MAX_S
    }

    fn end(mut self) -> [Port; 2] {
        self.end_recording();
        let at_rest = self.is_at_zero() && !self.mode().moves();
        self.memory.armed = !at_rest;
        if let (Some(restart), Some(last)) = (&mut self.memory.restart, &self.last) {
            // the last restart note may be older than the last step
            restart.steps = last.output.counted;
        }
        if let Some((_, Err(e))) = self.io.state_writer.finish(&self.memory) {
            tracing::error!(event = "memory", "the last state could not be written: {e}");
        }
        tracing::info!(event = "ended", config = %self.config.config_hash, at_rest, "ended");
        [self.io.control, self.io.status]
    }
}
