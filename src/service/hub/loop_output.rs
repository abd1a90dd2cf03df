//! What comes from the loop: frames and answers.

use super::{Hub, Pending, unix_s};
use crate::control::learning::identify::{Identified, Next};
use crate::service::flight::start::{Event, Logged};
use crate::service::memory::RecordedFault;
use crate::service::rt_loop::{ANSWER_MAX_S, Answer};
use crate::service::{Failure, LearnedGains, status};
use crate::supervisor::{CycleOutput, Mode, Order};
use serde_json::json;
use std::time::{Duration, Instant};

/// With more frames than this in one round the hub is late, and subscribers receive none of them.
const FRAMES_SENT_MAX: usize = 40;

impl Hub {
    /// Reads everything that has come since the last round.
    pub(super) fn take_loop_output(&mut self) {
        // first the answers: the frames up to them are there by then
        let answers: Vec<Answer> =
            std::iter::from_fn(|| self.io.rings.answers.pop().ok()).collect();
        // no more than are there now: a hub that is late still answers commands
        let waiting = self.io.rings.frames.slots();
        for _ in 0..waiting {
            let Ok(frame) = self.io.rings.frames.pop() else {
                break;
            };
            let (number, output) = (frame.number, frame.output);
            let due = |&(change, _): &(u64, _)| change <= frame.changes;
            let due = self.changes.partition_point(due);
            let mut events: Vec<_> = self.changes.drain(..due).collect();
            // a supervisor that was not idle any more has stayed
            events.retain(|(change, event)| {
                let stayed = *change > 0 && !output.first && matches!(**event, Event::Start(_));
                if stayed && let Some(recording) = &mut self.recording {
                    recording.give_up_replay();
                }
                !stayed
            });
            let logged = Logged {
                number,
                events: events.into_iter().map(|(_, event)| event).collect(),
                output,
            };
            self.process(&logged, waiting <= FRAMES_SENT_MAX);
            self.last = Some(frame);
        }
        for (id, cycle, result) in answers {
            let Some(pending) = self.pending.remove(&id) else {
                continue;
            };
            match result {
                Ok(()) => self.carried_out(&pending, cycle),
                Err(why) if why.is_invalid_order() => {
                    self.fail(&pending, Failure::bad(why.to_string()));
                }
                Err(why) => self.fail(&pending, Failure::refused(why.to_string())),
            }
        }
        while self.io.rings.retired.pop().is_ok() {}
        let stops = self.io.shared.stop.completed();
        if stops != self.stops_logged {
            self.stops_logged = stops;
            tracing::info!(event = "command", command = "stop", config = %self.config.config_hash);
        }
        self.give_up_late_answers();
    }

    /// Answers an order, and remembers whose command moves the tip.
    fn carried_out(&mut self, pending: &Pending, cycle: u64) {
        let mut result = json!({});
        let order = pending.order;
        match order {
            Order::Arm => self.persistence.armed_cycle = cycle,
            Order::Play => result = self.path.clone(),
            Order::Hold | Order::Disarm | Order::Relax => self.motion_owner = None,
            _ => {}
        }
        if order.leads_setpoint() || order == Order::Calibrate(true) {
            self.motion_owner = Some((pending.caller.client, Instant::now()));
        }
        self.reply(&pending.caller, &Ok(result));
    }

    fn give_up_late_answers(&mut self) {
        let late = |p: &Pending| p.caller.then.since.elapsed().as_secs_f64() > ANSWER_MAX_S;
        let late: Vec<_> = self.pending.extract_if(.., |_, p| late(p)).collect();
        for (_, pending) in late {
            let failure = match pending.held {
                Some(_) => Failure::refused("the disk does not respond; try again in a moment"),
                None => Failure::unreachable("the loop does not respond"),
            };
            self.fail(&pending, failure);
        }
    }

    /// `sends`: subscribers receive the frame.
    fn process(&mut self, logged: &Logged, sends: bool) {
        let output = &logged.output;
        self.log(output);
        if let Some(recording) = &mut self.recording {
            recording.write(logged);
        }
        if let Some(flight) = &mut self.flight {
            flight.push(logged);
        }
        if sends {
            self.send_frames(output);
        }
        self.advance_calibration(output);
        self.end_long_hold(output, sends);
    }

    /// Returns a tip to rest that has held its pose for `service.hold_max_s`, unless the hub is late.
    fn end_long_hold(&mut self, output: &CycleOutput, in_time: bool) {
        let holds = output.mode == Mode::Holding && !output.stopped && output.order.is_none();
        let t = output.sensed.t.0;
        self.held_since_s = holds.then(|| self.held_since_s.unwrap_or(t));
        if let (Some(since), Some(most)) = (self.held_since_s, self.config.service.hold_max_s)
            && t - since > most
            && in_time
        {
            tracing::warn!(event = "hold_max", config = %self.config.config_hash, "the tip has held its pose for {most} s: returning to rest");
            self.held_since_s = None;
            self.own_order(Order::Relax, Some(Mode::Holding));
        }
    }

    fn send_frames(&mut self, output: &CycleOutput) {
        let t = output.sensed.t.0;
        let mut line = None;
        for s in self.subscriptions.iter_mut().filter(|s| t >= s.next_s) {
            // on average the rate is exact even if it does not divide that of the loop
            let next_s = s.next_s + s.period_s;
            s.next_s = if next_s > t { next_s } else { t + s.period_s };
            let step_mm = self.config.supervisor.gate.step_mm;
            let line = line.get_or_insert_with(|| status::frame_line(output, step_mm));
            self.io.port(s.client).send(s.client, line.clone());
        }
        if line.is_some() {
            self.io.control.wake();
            self.io.status.wake();
        }
    }

    /// Logs every change of mode, fault and suspicion as one event.
    fn log(&mut self, output: &CycleOutput) {
        let config = &self.config.config_hash;
        let before = self.last.map(|last| last.output.mode);
        if before != Some(output.mode) {
            let from = before.map_or("boot", Mode::name);
            tracing::info!(event = "mode", from, to = output.mode.name(), config = %config, "{from} → {}", output.mode);
        }
        if let Some(cause) = output.tripped {
            let suspicion = output.suspicion.map(|s| format!("; {s}"));
            let message = cause.advice().to_owned() + &suspicion.unwrap_or_default();
            let cause = cause.name();
            tracing::error!(event = "fault", cause, steps = ?output.steps.0, config = %config, "{message}");
            self.memory.record_fault(RecordedFault {
                unix_s: unix_s(),
                cause: cause.to_owned(),
                message,
            });
            self.persistence.write_soon();
        }
        if output.suspects
            && let Some(s) = &output.suspicion
        {
            tracing::warn!(event = "suspicion", kind = ?s.kind, channel = s.channel, share = s.share, config = %config, "{s}");
        }
        if output.stream_ended {
            tracing::warn!(event = "stream_ended", config = %config, "the stream of set-points paused for too long: stopped");
        }
        if !output.raised.is_empty()
            && let Some(hidden) = self.log_limit.admit("sensor")
        {
            let advice: Vec<&str> = output.raised.iter().map(|c| c.advice()).collect();
            let advice = advice.join("; ");
            tracing::warn!(event = "sensor", causes = %output.raised, hidden, config = %config, "{advice}");
        }
    }

    fn advance_calibration(&mut self, output: &CycleOutput) {
        let calibrating = Some(Mode::Calibrating);
        let Some(session) = &mut self.calibration else {
            return;
        };
        match session.step(output) {
            Ok(Next::Wait) => return,
            Ok(Next::Drive(pose)) => return self.own_order(Order::Bend(pose, None), calibrating),
            Ok(Next::Lines(lines)) => return self.own_order(Order::Lines(lines), calibrating),
            Ok(Next::Done(found)) => self.propose(&found),
            Err(why) => {
                tracing::error!(event = "calibration", config = %self.config.config_hash, "{why}");
                self.calibration_failed = Some(why);
            }
        }
        self.calibration = None;
        self.own_order(Order::Calibrate(false), calibrating);
    }

    fn propose(&mut self, found: &Identified) {
        let lines = found.lines();
        let gains = LearnedGains {
            k_epsilon: lines.map(|l| l.k_epsilon),
            k_lambda_mm: lines.map(|l| l.k_lambda_mm),
            lag_s: found.dynamics.expected.lag_s,
            delay_s: found.dynamics.expected.delay_s,
            tip: self.config.tip.clone(),
            unix_s: unix_s(),
            source: "calibrate transmission".to_owned(),
        };
        tracing::info!(event = "calibration", k_epsilon = ?gains.k_epsilon, k_lambda_mm = ?gains.k_lambda_mm, config = %self.config.config_hash,
            "gains identified; `retroflex calibrate transmission --accept` applies them");
        self.memory.proposed = Some(gains);
        self.persistence.write_soon();
    }

    /// Sends a changed STATUS line to the service manager, at most once a second.
    pub(super) fn notify_manager(&mut self) {
        let Some(last) = self.output() else { return };
        let estimate = last.frame.estimate.map_or_else(String::new, |x| {
            let (bend, dir) = (x.bend.beta().to_degrees(), x.bend.delta().to_degrees());
            format!(", {bend:.1}° at {dir:.0}°")
        });
        let fault = last.latched.map(|cause| format!(": {}", cause.advice()));
        let fault = fault.unwrap_or_default();
        let line = format!("STATUS={}{estimate}{fault}", last.mode);
        let (sent, when) = &self.last_status;
        if *sent != line && when.elapsed() > Duration::from_secs(1) {
            self.io.notifier.notify(&line);
            self.last_status = (line, Instant::now());
        }
    }
}
