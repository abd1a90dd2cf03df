//! What must survive a restart: checkpoints of the position, and orders that wait for the disk.

use super::{Hub, Pending};
use crate::control::RestartState;
use crate::service::{Caller, Failure};
use crate::supervisor::{Mode, Order};
use std::time::{Duration, Instant};

/// Longest time between two checkpoints.
const CHECKPOINT_MAX: Duration = Duration::from_secs(60);

impl Hub {
    /// Writes that drivers may be armed, once for all who wait for it; the order goes out when that is on the disk.
    pub(super) fn arm_ahead(&mut self, caller: Caller) {
        self.memory.armed = true;
        let under_way = self.persistence.arming;
        self.persistence.arming = self.write_ahead(Order::Arm, caller, under_way);
    }

    /// Writes the memory unless a write that holds the same is under way; the order goes out once it is on the disk. Returns
    /// the id of the write.
    pub(super) fn write_ahead(
        &mut self,
        order: Order,
        caller: Caller,
        under_way: Option<u64>,
    ) -> Option<u64> {
        let id = self.next_id();
        let writer = &mut self.io.state_writer;
        let write = under_way.or_else(|| writer.write(&self.memory, Some(id)).then_some(id));
        let pending = Pending {
            caller,
            order,
            held: write,
        };
        if write.is_some() {
            self.pending.insert(id, pending);
        } else {
            let why = "the disk is busy; try again in a moment";
            self.fail(&pending, Failure::refused(why));
        }
        write
    }

    /// Passes the latest position to the state writer when a checkpoint is due, and reads its results.
    pub(super) fn persist(&mut self) {
        if let Some(last) = self.last {
            let (memory, state) = (&self.memory, last.restart);
            let moved = |r: RestartState| r.steps != state.steps || r.rest != state.rest;
            let beliefs = memory.lost != last.lost || memory.unverified != last.output.unverified;
            let changed = beliefs || memory.restart.is_none_or(moved);
            let still = !self.mode().moves() && self.mode() != Mode::Relaxing;
            // an `arm` that is under way, or was carried out in a cycle that is not known yet, energises the drivers
            let arms = last.number < self.persistence.armed_cycle
                || (self.pending.values()).any(|p| p.order == Order::Arm || p.held.is_some());
            let at_rest = last.at_rest && still && !arms;
            let disarms = self.persistence.armed_on_disk && at_rest;
            self.memory.restart = Some(state);
            (self.memory.armed, self.memory.lost, self.memory.unverified) =
                (!at_rest, last.lost, last.output.unverified);
            let checkpoint = Duration::from_secs_f64(self.config.service.checkpoint_s);
            let due = (changed || disarms) && self.persistence.is_older_than(checkpoint);
            // a checkpoint that waits for a slow disk does not take the place of what an `arm` waits for
            let free = self.io.state_writer.is_idle();
            if free && (due || self.persistence.is_older_than(CHECKPOINT_MAX)) {
                self.persistence.last_checkpoint = Some(Instant::now());
                if self.io.state_writer.write(&self.memory, None) && disarms {
                    self.persistence.armed_on_disk = false;
                }
            }
        }
        while let Some((id, result)) = self.io.state_writer.completed() {
            self.process_write(id, result.err().map(|e| e.to_string()));
        }
    }

    fn process_write(&mut self, id: Option<u64>, error: Option<String>) {
        if let Some(error) = &error
            && self.persistence.error.as_ref() != Some(error)
        {
            tracing::error!(event = "memory", config = %self.config.config_hash, "{error}");
        }
        self.persistence.error.clone_from(&error);
        let Some(write) = id else { return };
        if self.persistence.arming == Some(write) {
            self.persistence.arming = None;
        }
        let held = self.pending.extract_if(.., |_, p| p.held == Some(write));
        let held: Vec<_> = held.collect();
        for (_, pending) in held {
            match &error {
                None => {
                    self.persistence.armed_on_disk |= pending.order == Order::Arm;
                    if let Order::Lines(lines) = pending.order {
                        self.config.supervisor.tick.lines = lines;
                    }
                    self.order(pending.order, pending.caller);
                }
                Some(error) => {
                    let why = "refused because the state could not be written first";
                    self.fail(&pending, Failure::refused(format!("{why}: {error}")));
                }
            }
        }
    }
}
