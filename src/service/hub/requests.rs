//! What clients ask for.

use super::{Hub, Subscription, Waiting};
use crate::config::gains::Gains;
use crate::config::source;
use crate::control::tick::Command;
use crate::model::bend::Bend;
use crate::primitives::units::Mm;
use crate::service::calibrate::{Found, Session};
use crate::service::protocol::{CalibrateAction, Failure, RecordAction, Request, parse};
use crate::service::record::Recording;
use crate::service::rt_loop::Message;
use crate::service::server::Line;
use crate::service::tape;
use crate::supervisor::cycle::Supervisor;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::mode::Mode;
use serde_json::{Value, json};
use std::io;
use std::path::Path;
use std::time::Instant;

impl Hub {
    /// One line of a client.
    pub(super) fn hear(&mut self, line: Line) {
        let text = match line.text {
            Ok(text) => text,
            Err(why) => {
                self.parts.server.send(line.client, &crate::service::protocol::answer_line(&Value::Null, &Err(Failure::bad(why))));
                self.parts.server.close(line.client);
                return;
            }
        };
        let (id, request) = parse(&text);
        let request = match request {
            Ok(request) if line.commands || request.only_reads() => request,
            Ok(_) => {
                self.reply(line.client, &id, &Err(Failure::refused("this socket only reads; commands go to the control socket")));
                return;
            }
            Err(failure) => {
                if let Some(hidden) = self.hush("garbage") {
                    tracing::warn!(event = "not_understood", client = line.client, hidden, "{}", failure.words);
                }
                self.reply(line.client, &id, &Err(failure));
                return;
            }
        };
        let quiet = matches!(request, Request::Status {} | Request::Stream { .. });
        if !quiet && let Some(hidden) = self.hush("command") {
            tracing::info!(event = "command", command = request.name(), client = line.client, hidden, config = %self.parts.config_hash);
        }
        if self.ending.is_some() && !request.only_reads() {
            self.reply(line.client, &id, &Err(Failure::refused("the service is ending")));
            return;
        }
        if let Some(answer) = self.serve(line.client, &id, &request) {
            self.reply(line.client, &id, &answer);
        }
    }

    /// Carries a request out; `None` where the answer comes later.
    fn serve(&mut self, client: u64, id: &Value, request: &Request) -> Option<Result<Value, Failure>> {
        let wait = |result: Value| Waiting { client, id: id.clone(), what: request.name(), since: Instant::now(), result };
        let plain = match *request {
            Request::Status {} => return Some(Ok(self.status())),
            Request::Subscribe { rate_hz } => return Some(self.subscribe(client, rate_hz)),
            Request::Record { action, ref name } => return Some(self.record(action, name.as_deref())),
            Request::Reload {} => return Some(self.reload()),
            Request::Calibrate { action } => return self.calibrate(action, wait(json!({}))),
            Request::Bend { bend_deg, dir_deg, length_mm, speed_deg_s } => {
                Order::Bend(self.command(bend_deg, dir_deg, length_mm), speed_deg_s.map(f64::to_radians))
            }
            Request::Stream { bend_deg, dir_deg, length_mm } => Order::Stream(self.command(bend_deg, dir_deg, length_mm)),
            Request::Arm {} => Order::Arm,
            Request::Disarm {} => Order::Disarm,
            Request::Hold {} => Order::Hold,
            Request::Stop {} => Order::Stop,
            Request::Relax {} => Order::Relax,
            Request::Zero {} => Order::Zero,
            Request::ResetFault {} => Order::Reset,
        };
        if matches!(plain, Order::Arm | Order::Relax) && !self.armed_on_disk {
            self.parts.memory.armed = true;
            self.write_ahead(plain, wait(json!({})));
        } else {
            self.order(plain, Some(wait(json!({}))));
        }
        None
    }

    fn command(&self, bend_deg: f64, dir_deg: f64, length_mm: Option<f64>) -> Command {
        let length = Mm(length_mm.unwrap_or(self.parts.supervisor.tick.geometry.rest_length_mm));
        Command { bend: Bend::from_deg(bend_deg, dir_deg), length }
    }

    fn subscribe(&mut self, client: u64, rate_hz: f64) -> Result<Value, Failure> {
        if !(0.1..=1000.0).contains(&rate_hz) {
            return Err(Failure::bad(format!("rate_hz {rate_hz} is outside 0.1 to 1000")));
        }
        self.subscriptions.retain(|s| s.client != client);
        self.subscriptions.push(Subscription { client, every_s: 1.0 / rate_hz, next_s: f64::NEG_INFINITY });
        Ok(json!({}))
    }

    fn reload(&mut self) -> Result<Value, Failure> {
        let Some(path) = self.parts.gains.clone() else {
            return Err(Failure::refused("no gains file was given: start with `retroflex run --gains FILE` to reload it"));
        };
        let gains: Gains = source::read(&path).map_err(|e| Failure::bad(format!("{e}; the gains in use stay")))?;
        let mut next = self.parts.supervisor.clone();
        let whole = crate::config::assemble(&self.parts.board, &self.parts.calibration, &gains);
        // what the machine and the calibration said stays; what the gains file says is new
        next.tick = crate::control::tick::LoopConfig {
            geometry: next.tick.geometry,
            drive: next.tick.drive,
            lines: next.tick.lines,
            dynamics: next.tick.dynamics,
            ..whole
        };
        if self.parts.other_end.orders.push(Message::Reload(Box::new(next.clone()))).is_err() {
            return Err(Failure::refused("too many commands at once; try again in a moment"));
        }
        self.parts.supervisor = next;
        self.parts.texts[1] = crate::config::show::compact(&gains);
        self.parts.gains_now = gains;
        if let Some(r) = &mut self.recording {
            r.cut_tape();
        }
        Ok(json!({"gains": path}))
    }

    fn record(&mut self, action: RecordAction, name: Option<&str>) -> Result<Value, Failure> {
        match action {
            RecordAction::Stop => match self.recording.as_ref().map(|r| (r.path().to_owned(), r.rows, r.has_tape())) {
                None => Err(Failure::refused("nothing is being recorded")),
                Some((path, rows, replayable)) => {
                    self.end_recording();
                    Ok(json!({"path": path, "rows": rows, "replayable": replayable}))
                }
            },
            RecordAction::Start => {
                if let Some(r) = &self.recording {
                    return Err(Failure::refused(format!("{} is being recorded; stop it first", r.path().display())));
                }
                let name = name.map_or_else(|| format!("bend-{:.0}", unix_s()), str::to_owned);
                let sound = !name.is_empty() && name.len() <= 80 && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
                if !sound || name.starts_with('.') {
                    return Err(Failure::bad(format!("`{name}` is no name of a recording: letters, digits, - _ . and no folder")));
                }
                let folder = self.parts.service.state.join("recordings");
                let path = folder.join(name + ".csv");
                let begin = std::fs::create_dir_all(&folder).and_then(|()| self.begin_recording(&path, false));
                begin.map_err(|e| Failure::refused(format!("{}: {e}", path.display())))?;
                let replayable = self.recording.as_ref().is_some_and(Recording::has_tape);
                Ok(json!({"path": path, "replayable": replayable}))
            }
        }
    }

    /// Begins a recording; with a tape when the pilot is told to begin again, at rest, or begins now.
    pub(super) fn begin_recording(&mut self, path: &Path, at_boot: bool) -> io::Result<()> {
        let at_rest = self.mode() == Mode::Disarmed && self.last.as_ref().is_some_and(|t| t.counted.0 == [0; 3] && t.latched.is_none());
        let fresh = at_boot || at_rest;
        let p = &self.parts.supervisor;
        let header = tape::Header {
            tape: 1,
            program: env!("CARGO_PKG_VERSION").to_owned(),
            texts: self.parts.texts.clone(),
            machine: self.parts.remarks.first().cloned().unwrap_or_default(),
            period_s: p.gate.tick_s,
            step_mm: p.gate.step_mm,
            rest_length_mm: p.tick.geometry.rest_length_mm,
            lines: self.first_lines(),
            dynamics: self.first_dynamics(),
            kept: self.first_kept(at_boot),
            doubted: at_boot && self.parts.doubted,
        };
        let recording = Recording::begin(path, p.gate.step_mm, fresh.then_some(&header))?;
        tracing::info!(event = "record", path = %path.display(), replayable = recording.has_tape(), "recording begins");
        self.recording = Some(recording);
        if !at_boot && fresh {
            self.relieve(header.kept);
        }
        Ok(())
    }

    /// A pilot that remembers nothing but what the header of the tape says takes over, at rest.
    fn relieve(&mut self, kept: Option<crate::control::tick::RestartState>) {
        let mut config = self.parts.supervisor.clone();
        config.tick.lines = self.first_lines().map(|[k_epsilon, k_lambda_mm]| crate::model::transmission::Line { k_epsilon, k_lambda_mm });
        let [lag_s, delay_s] = self.first_dynamics();
        config.tick.dynamics = crate::control::pi::Dynamics { lag_s, delay_s };
        let supervisor = Supervisor::new(config, kept);
        if self.parts.other_end.orders.push(Message::Relieve(Box::new(supervisor))).is_err()
            && let Some(r) = &mut self.recording
        {
            r.go_without_tape();
        }
    }

    /// What a pilot of now would begin with.
    fn first_kept(&self, at_boot: bool) -> Option<crate::control::tick::RestartState> {
        let kept = self.parts.memory.kept?;
        if at_boot && self.parts.memory.tip != self.parts.tip {
            let lines = self.first_lines();
            return Some(crate::control::tick::RestartState {
                k_epsilon: lines.map(|l| l[0]),
                k_lambda_mm: lines.map(|l| l[1]),
                rest: None,
                ..kept
            });
        }
        Some(kept)
    }

    fn first_lines(&self) -> [[f64; 2]; 3] {
        let accepted = self.parts.memory.accepted.as_ref().filter(|g| g.tip == self.parts.tip);
        let lines = &self.parts.supervisor.tick.lines;
        std::array::from_fn(|i| accepted.map_or([lines[i].k_epsilon, lines[i].k_lambda_mm], |g| [g.k_epsilon[i], g.k_lambda_mm[i]]))
    }

    fn first_dynamics(&self) -> [f64; 2] {
        let accepted = self.parts.memory.accepted.as_ref().filter(|g| g.tip == self.parts.tip);
        let d = &self.parts.supervisor.tick.dynamics;
        accepted.map_or([d.lag_s, d.delay_s], |g| [g.lag_s, g.delay_s])
    }

    pub(super) fn end_recording(&mut self) {
        let Some(recording) = self.recording.take() else { return };
        let path = recording.path().to_owned();
        match recording.end() {
            Ok(rows) => tracing::info!(event = "record", path = %path.display(), rows, "recording ended"),
            Err(e) => tracing::error!(event = "record", path = %path.display(), "the recording is incomplete: {e}"),
        }
    }

    fn calibrate(&mut self, action: CalibrateAction, waiting: Waiting) -> Option<Result<Value, Failure>> {
        let session = match action {
            CalibrateAction::Discard => {
                let there = self.parts.memory.proposed.take().is_some();
                return Some(if there { Ok(json!({})) } else { Err(Failure::refused("there is no calibration to discard")) });
            }
            CalibrateAction::Accept => return self.accept(waiting),
            CalibrateAction::Full | CalibrateAction::Short if self.calibration.is_some() => {
                return Some(Err(Failure::refused("a calibration runs already")));
            }
            CalibrateAction::Full => Session::full(self.parts.supervisor.tick.geometry, self.parts.supervisor.gate.step_mm, self.in_use()),
            CalibrateAction::Short => {
                let (geometry, step_mm) = (self.parts.supervisor.tick.geometry, self.parts.supervisor.gate.step_mm);
                Session::short(geometry, step_mm, self.parts.calibration.prior(), self.in_use())
            }
        };
        if self.mode() != Mode::Holding {
            return Some(Err(Failure::refused(format!("not while {}: `retroflex arm` and let the tip come to rest first", self.mode()))));
        }
        self.calibration = Some(session);
        self.calibration_failed = None;
        self.order(Order::Calibrate(true), Some(waiting));
        None
    }

    fn in_use(&self) -> Found {
        let lines = self.parts.supervisor.tick.lines;
        let k = self.last.as_ref().map_or(lines.map(|l| l.k_epsilon), |t| t.frame.k_epsilon);
        let lines = std::array::from_fn(|i| crate::model::transmission::Line { k_epsilon: k[i], ..lines[i] });
        Found { lines, dynamics: self.parts.supervisor.tick.dynamics }
    }

    fn accept(&mut self, waiting: Waiting) -> Option<Result<Value, Failure>> {
        let Some(gains) = self.parts.memory.proposed.clone() else {
            return Some(Err(Failure::refused("there is no calibration to accept; `retroflex calibrate transmission` makes one")));
        };
        if gains.tip != self.parts.tip {
            return Some(Err(Failure::refused(format!("it was made on tip `{}`, mounted is `{}`", gains.tip, self.parts.tip))));
        }
        let lines =
            std::array::from_fn(|i| crate::model::transmission::Line { k_epsilon: gains.k_epsilon[i], k_lambda_mm: gains.k_lambda_mm[i] });
        if !matches!(self.mode(), Mode::Disarmed | Mode::Holding) {
            return Some(Err(Failure::refused(format!("not while {}", self.mode()))));
        }
        self.accepted_before = self.parts.memory.accepted.replace(gains);
        self.parts.memory.proposed = None;
        self.write_ahead(Order::Lines(lines), waiting);
        None
    }
}

/// Seconds since 1970.
pub(super) fn unix_s() -> f64 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}
