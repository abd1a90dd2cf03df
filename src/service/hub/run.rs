//! The rounds of the hub, and the end of the service.

use super::state::Hub;
use crate::service::control_port::Incoming;
use crate::service::error::ServiceError;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::mode::Mode;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// Longest wait of a round. Requests end it early.
const ROUND: Duration = Duration::from_millis(5);
/// Longest way back to rest when the service ends, s.
const END_MAX_S: f64 = 30.0;
/// A faulted or stopped tip is given this long to brake before the service ends.
const BRAKE_MAX: Duration = Duration::from_secs(1);

impl Hub {
    /// Runs until a signal ends the service, then returns the tip to rest.
    ///
    /// # Errors
    /// [`ServiceError`].
    pub fn run(mut self, record: Option<PathBuf>) -> Result<(), ServiceError> {
        let signalled = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&signalled)).map_err(ServiceError::system("a signal handler"))?;
        }
        if let Some(path) = record {
            self.start_recording(&path, true).map_err(ServiceError::system(path.display()))?;
        }
        self.mount_tip();
        tracing::info!(event = "start", config = %self.config.config_hash, tip = %self.config.tip, "ready, disarmed");
        self.io.notifier.notify("READY=1\nSTATUS=aligning: the tip must be still for 2 s");
        while !self.is_over() {
            self.io.shared.hub_rounds.fetch_add(1, Relaxed);
            if signalled.load(Relaxed) && self.ending.is_none() {
                self.start_ending();
            }
            self.take_requests();
            self.persist();
            self.notify_manager();
            self.forget_dropped_clients();
            if self.io.rings.frames.is_abandoned() {
                // the loop has ended by itself; its result tells why
                break;
            }
        }
        self.end();
        Ok(())
    }

    /// Discards what was learned on another tip.
    fn mount_tip(&mut self) {
        let memory = &mut self.memory;
        if memory.tip != self.config.tip {
            tracing::info!(event = "tip", before = %memory.tip, now = %self.config.tip, "another tip is mounted");
            memory.proposed = None;
            memory.tip.clone_from(&self.config.tip);
        }
        memory.config_hash.clone_from(&self.config.config_hash);
    }

    /// Requests of both sockets. Those of the status socket come second, so that readers delay no command.
    fn take_requests(&mut self) {
        let lines = self.io.status.round(ROUND);
        // a status that follows an answer reports what was answered
        self.take_loop_output();
        while let Ok(incoming) = self.io.control.incoming.try_recv() {
            self.handle(incoming, true);
        }
        for line in lines {
            self.handle(Incoming::new(line, 0), false);
        }
    }

    fn forget_dropped_clients(&mut self) {
        let dropped: Vec<_> = self.io.control.dropped.try_iter().chain(self.io.status.dropped.drain(..)).collect();
        for (client, reason) in dropped {
            self.subscriptions.retain(|s| s.client != client);
            if reason != "disconnected"
                && let Some(hidden) = self.log_limit.admit("dropped")
            {
                tracing::warn!(event = "client_dropped", client, hidden, "a client was disconnected: {reason}");
            }
        }
    }

    /// SIGTERM or SIGINT: returns to rest; after a stop the tip stays where it is.
    fn start_ending(&mut self) {
        self.ending = Some(Instant::now());
        self.io.notifier.notify("STOPPING=1\nSTATUS=relaxing");
        tracing::info!(event = "end", config = %self.config.config_hash, mode = %self.mode(), "ending on a signal");
        let away = self.last.is_some() && !self.is_at_zero();
        let stopped = self.last.as_ref().is_some_and(|last| last.stopped);
        if away && !stopped && self.mode() != Mode::Lost {
            self.own_order(Order::Relax);
        }
    }

    fn is_over(&self) -> bool {
        let (Some(since), Some(last)) = (self.ending, &self.last) else { return self.ending.is_some() };
        let rested = self.is_at_zero() || matches!(last.mode, Mode::Lost | Mode::Boot);
        let settled = since.elapsed() > Duration::from_millis(100) && last.mode != Mode::Relaxing;
        let stays = last.mode == Mode::Faulted || last.stopped;
        (stays && since.elapsed() > BRAKE_MAX) || (rested && settled) || since.elapsed().as_secs_f64() > END_MAX_S
    }

    fn end(mut self) {
        self.finish_recording();
        let at_rest = self.is_at_zero();
        self.memory.armed = !at_rest;
        if let (Some(restart), Some(last)) = (&mut self.memory.restart, &self.last) {
            // the last restart note may be older than the last step
            restart.steps = last.counted;
        }
        if let Some(Err(e)) = self.io.state_writer.finish(&self.memory).map(|c| c.result) {
            tracing::error!(event = "memory", "the last state could not be written: {e}");
        }
        tracing::info!(event = "ended", config = %self.config.config_hash, at_rest, "ended");
    }
}
