//! What comes from the loop: frames, answers, notes for the keeper.

use super::{ANSWER_MAX_S, Hub, Waiting, requests::unix_s};
use crate::service::calibrate::Next;
use crate::service::memory::{LearnedGains, RecordedFault};
use crate::service::protocol::Failure;
use crate::service::status;
use crate::supervisor::cycle::CycleOutput;
use crate::supervisor::cycle::order::Order;
use serde_json::Value;
use std::time::{Duration, Instant};

impl Hub {
    /// Everything that has come since the last round.
    pub(super) fn take_in(&mut self) {
        while let Ok(turned) = self.parts.other_end.frames.pop() {
            self.follow(&turned);
            self.last = Some(turned);
        }
        while let Ok((id, answer)) = self.parts.other_end.answers.pop() {
            let Some(w) = self.waiting.remove(&id) else { continue };
            let Waiting { client, id, what, result, .. } = w;
            let answer: Result<Value, Failure> = match answer {
                Ok(()) => Ok(result),
                Err(why) => {
                    tracing::warn!(event = "refused", command = what, client, config = %self.parts.config_hash, "{why}");
                    if what == "calibrate" {
                        self.calibration = None;
                    }
                    Err(Failure::refused(why.to_string()))
                }
            };
            self.reply(client, &id, &answer);
        }
        while let Ok(old) = self.parts.other_end.spent.pop() {
            drop(old);
        }
        self.give_up_waiting();
    }

    fn give_up_waiting(&mut self) {
        let late: Vec<u64> =
            self.waiting.iter().filter(|(_, w)| w.since.elapsed().as_secs_f64() > ANSWER_MAX_S).map(|(id, _)| *id).collect();
        for id in late {
            if let Some(w) = self.waiting.remove(&id) {
                self.reply(w.client, &w.id, &Err(Failure { code: 3, words: "the loop does not answer".to_owned() }));
            }
        }
    }

    fn follow(&mut self, turned: &CycleOutput) {
        self.log(turned);
        if let Some(recording) = &mut self.recording
            && let Err(e) = recording.turn(turned)
        {
            tracing::error!(event = "record", path = %recording.path().display(), "recording ended: {e}");
            self.recording = None;
        }
        self.stream_frames(turned);
        self.lead_calibration(turned);
    }

    fn stream_frames(&mut self, turned: &CycleOutput) {
        let t = turned.sensed.t.0;
        let mut line = None;
        for s in &mut self.subscriptions {
            if t >= s.next_s {
                // a rate that does not divide the loop's still comes out right on average
                s.next_s = if s.next_s + s.every_s > t { s.next_s + s.every_s } else { t + s.every_s };
                let line = line.get_or_insert_with(|| status::frame_line(turned, self.parts.supervisor.gate.step_mm));
                self.parts.server.send(s.client, line);
            }
        }
    }

    /// Every change of mode, fault and suspicion is one event.
    fn log(&mut self, turned: &CycleOutput) {
        let config = &self.parts.config_hash;
        let before = self.last.as_ref();
        if before.is_none_or(|b| b.mode != turned.mode) {
            let from = before.map_or("boot", |b| b.mode.name());
            tracing::info!(event = "mode", from, to = turned.mode.name(), config = %config, "{from} → {}", turned.mode);
        }
        if let Some(cause) = turned.tripped {
            let words = status::words(cause);
            let suspicion = turned.suspicion.map_or_else(String::new, |s| format!("; {s}"));
            tracing::error!(event = "fault", cause = status::name(cause), steps = ?turned.steps.0, config = %config, "{words}{suspicion}");
            let entry = RecordedFault { unix_s: unix_s(), cause: status::name(cause), words: format!("{words}{suspicion}") };
            self.parts.memory.fault(entry);
            self.last_checkpoint = long_ago();
        }
        if turned.suspects
            && let Some(s) = &turned.suspicion
        {
            tracing::warn!(event = "suspicion", kind = ?s.kind, channel = s.channel, share = s.share, config = %config, "{s}");
        }
        if turned.stream_ended {
            tracing::warn!(event = "stream_ended", config = %config, "the stream of set-points fell silent: stopped");
        }
        if !turned.raised.is_empty()
            && let Some(hidden) = self.hush("senses")
        {
            let advice = turned.raised.iter().map(|c| c.advice()).collect::<Vec<_>>().join("; ");
            tracing::warn!(event = "senses", causes = %turned.raised, hidden, config = %self.parts.config_hash, "{advice}");
        }
    }

    fn lead_calibration(&mut self, turned: &CycleOutput) {
        let Some(session) = &mut self.calibration else { return };
        match session.step(turned) {
            Next::Wait => {}
            Next::Drive(command) => {
                self.order(Order::Bend(command, None), None);
            }
            Next::Lines(lines) => {
                self.order(Order::Lines(lines), None);
            }
            Next::Done(result) => {
                let before = session.before();
                self.calibration = None;
                self.order(Order::Calibrate(false), None);
                self.order(Order::Lines(before.lines), None);
                match result {
                    Err(why) => {
                        tracing::error!(event = "calibration", config = %self.parts.config_hash, "{why}");
                        self.calibration_failed = Some(why);
                    }
                    Ok(found) => {
                        let gains = LearnedGains {
                            k_epsilon: found.lines.map(|l| l.k_epsilon),
                            k_lambda_mm: found.lines.map(|l| l.k_lambda_mm),
                            lag_s: found.dynamics.lag_s,
                            delay_s: found.dynamics.delay_s,
                            tip: self.parts.tip.clone(),
                            unix_s: unix_s(),
                            source: "calibrate transmission".to_owned(),
                        };
                        tracing::info!(event = "calibration", k_epsilon = ?gains.k_epsilon, k_lambda_mm = ?gains.k_lambda_mm, config = %self.parts.config_hash, "found; `retroflex calibrate transmission --accept` puts it in use");
                        self.parts.memory.proposed = Some(gains);
                        self.last_checkpoint = long_ago();
                    }
                }
            }
        }
    }

    /// Puts the memory on the disk; the order goes out once it is there.
    pub(super) fn write_ahead(&mut self, order: Order, waiting: Waiting) {
        let id = self.next_order;
        self.next_order += 1;
        if self.parts.state_writer.keep(&self.parts.memory, id) {
            self.ahead.insert(id, order);
            self.waiting.insert(id, waiting);
        } else {
            self.not_kept(order, &waiting, "the disk is busy; try again in a moment".to_owned());
        }
    }

    /// An order that is not carried out, because what has to be remembered first could not be kept.
    fn not_kept(&mut self, order: Order, waiting: &Waiting, words: String) {
        if matches!(order, Order::Lines(_)) {
            let memory = &mut self.parts.memory;
            memory.proposed = std::mem::replace(&mut memory.accepted, self.accepted_before.take());
        }
        tracing::warn!(event = "refused", command = waiting.what, client = waiting.client, config = %self.parts.config_hash, "{words}");
        self.reply(waiting.client, &waiting.id, &Err(Failure::refused(words)));
    }

    /// What has to survive goes to the keeper; what the keeper has done comes back.
    pub(super) fn keep(&mut self) {
        let mut newest = None;
        while let Ok(note) = self.parts.other_end.keeps.pop() {
            newest = Some(note);
        }
        if let Some(note) = newest {
            let changed = self.parts.memory.kept.is_none_or(|k| k.steps != note.kept.steps || k.rest.is_some() != note.kept.rest.is_some());
            self.parts.memory.kept = Some(note.kept);
            let at_rest =
                note.at_rest && !self.mode().moves() && self.mode() != crate::supervisor::mode::Mode::Relaxing && self.ahead.is_empty();
            let disarms = self.armed_on_disk && at_rest;
            self.parts.memory.armed = !at_rest;
            let due = self.last_checkpoint.elapsed().as_secs_f64() >= self.parts.service.checkpoint_s;
            if (due && (changed || disarms)) || self.last_checkpoint.elapsed() > Duration::from_secs(60) {
                self.last_checkpoint = Instant::now();
                if self.parts.state_writer.checkpoint(&self.parts.memory) && disarms {
                    self.armed_on_disk = false;
                }
            }
        }
        while let Some(done) = self.parts.state_writer.done() {
            self.kept(done);
        }
    }

    fn kept(&mut self, done: crate::service::state_writer::Done) {
        let error = done.result.err().map(|e| e.to_string());
        if let Some(error) = &error
            && self.memory_error.as_ref() != Some(error)
        {
            tracing::error!(event = "memory", config = %self.parts.config_hash, "{error}");
        }
        self.memory_error.clone_from(&error);
        let Some((id, order)) = done.waiting.and_then(|id| self.ahead.remove(&id).map(|o| (id, o))) else { return };
        let Some(waiting) = self.waiting.remove(&id) else { return };
        match error {
            None => {
                match order {
                    Order::Lines(lines) => self.parts.supervisor.tick.lines = lines,
                    _ => self.armed_on_disk = true,
                }
                self.order(order, Some(waiting));
            }
            // the way back to rest is never denied
            Some(_) if order == Order::Relax => {
                self.order(order, Some(waiting));
            }
            Some(error) => self.not_kept(order, &waiting, format!("refused, because what must be remembered could not be kept: {error}")),
        }
    }

    /// STATUS for the service manager, when it changes.
    pub(super) fn tell_manager(&mut self) {
        let Some(last) = &self.last else { return };
        let estimate = last
            .frame
            .estimate
            .map_or_else(String::new, |f| format!(", {:.1}° at {:.0}°", f.bend.beta().to_degrees(), f.bend.delta().to_degrees()));
        let fault = last.latched.map_or_else(String::new, |c| format!(": {}", status::words(c)));
        let line = format!("STATUS={}{estimate}{fault}", last.mode);
        let (said, when) = &self.last_status;
        if *said != line && when.elapsed() > Duration::from_secs(1) {
            self.parts.notifier.say(&line);
            self.last_status = (line, Instant::now());
        }
    }
}

/// A checkpoint that is due: what is new in the memory goes to the disk in this round.
fn long_ago() -> Instant {
    let now = Instant::now();
    now.checked_sub(Duration::from_secs(3600)).unwrap_or(now)
}
