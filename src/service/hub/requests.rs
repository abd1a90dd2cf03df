//! The requests of clients.

use super::{Hub, Reply, Subscription, done, may_command, refuse};
use crate::config::Gains;
use crate::config::source;
use crate::control::Path;
use crate::control::learning::identify::Algorithm1;
use crate::control::learning::schedule;
use crate::model::{Bend, Line, Shape};
use crate::primitives::Checker;
use crate::primitives::file::is_irregular;
use crate::service::calibrate::Session;
use crate::service::flight::start::Event;
use crate::service::protocol::{
    CalibrateAction, DIR_DEG, Frame, PATH_MAX_S, PATH_ROWS, PATH_STEP_S, POSES, PathRow,
};
use crate::service::start::with_gains;
use crate::service::{Caller, Change, Failure, Request};
use crate::supervisor::{BEND_MAX_RAD, Mode, Order};
use serde_json::{Value, json};
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::time::Instant;

impl Hub {
    /// Handles one line of a client.
    pub(super) fn handle(&mut self, mut caller: Caller, request: Result<Request, Failure>) {
        let client = caller.client;
        caller.then.since = Instant::now();
        caller.command = request.as_ref().map(Request::name).unwrap_or_default();
        let reply = match request {
            Err(failure) => {
                if let Some(hidden) = self.log_limit.admit("invalid") {
                    let why = &failure.message;
                    tracing::warn!(event = "invalid_request", client, hidden, "{why}");
                }
                Err(failure)
            }
            Ok(request) if request.only_reads() => self.obey(&caller, &request),
            Ok(_) if !may_command(client) => {
                refuse("this socket is read-only; use the control socket for commands")
            }
            Ok(_) if self.ending.is_some() => refuse("the service is ending"),
            Ok(request) => {
                if !matches!(request, Request::Stream { .. } | Request::Path { .. })
                    && let Some(hidden) = self.log_limit.admit("command")
                {
                    tracing::info!(event = "command", command = caller.command, client, hidden, config = %self.config.config_hash, "{request:?}");
                }
                self.obey(&caller, &request)
            }
        };
        if let Some(reply) = reply.transpose() {
            self.reply(&caller, &reply);
        }
    }

    fn subscribe(&mut self, rate_hz: f64, caller: &Caller) -> Reply {
        if !(0.1..=1000.0).contains(&rate_hz) {
            let why = format!("rate_hz {rate_hz} is outside 0.1 to 1000");
            return Err(Failure::bad(why));
        }
        // the reply precedes the first frame
        self.reply(caller, &Ok(json!({})));
        self.subscriptions.retain(|s| s.client != caller.client);
        self.subscriptions.push(Subscription {
            client: caller.client,
            period_s: 1.0 / rate_hz,
            next_s: f64::NEG_INFINITY,
        });
        Ok(None)
    }

    fn obey(&mut self, caller: &Caller, request: &Request) -> Reply {
        let order = match *request {
            Request::Status {} => return Ok(Some(self.cached_status())),
            Request::Reach {} => return Ok(Some(self.reach())),
            Request::Subscribe { rate_hz } => return self.subscribe(rate_hz, caller),
            Request::Record {
                action,
                ref name,
                owned,
            } => return self.record(action, name.as_deref(), owned, caller),
            Request::Reload {} => return self.reload(),
            Request::Calibrate { action, poses } => return self.calibrate(action, poses, caller),
            Request::Path { ref rows, more } => {
                if !self.path(rows, more, caller.client)? {
                    return done();
                }
                Order::Play
            }
            Request::Bend {
                bend_deg,
                dir_deg,
                length_mm,
                speed_deg_s,
                frame,
            } => {
                let target = self.asked(bend_deg, dir_deg, length_mm)?;
                let speed_rad_s = speed_deg_s.map(f64::to_radians);
                match frame {
                    Frame::World => Order::World(target, speed_rad_s),
                    Frame::Base => Order::Bend(target, speed_rad_s),
                }
            }
            Request::Stream {
                bend_deg,
                dir_deg,
                length_mm,
                t_s,
            } => {
                let target = self.asked(bend_deg, dir_deg, length_mm)?;
                if t_s.is_some() && self.streamer != caller.client {
                    // a set-point without a time ends the clock of another client
                    self.streamer = caller.client;
                    let id = self.next_id();
                    self.push_order(id, Order::Stream(target), caller.then);
                }
                t_s.map_or(Order::Stream(target), |t_s| Order::Timed(target, t_s))
            }
            Request::Arm {} => Order::Arm,
            Request::Disarm {} => Order::Disarm,
            Request::Hold {} => Order::Hold,
            Request::Stop {} => Order::Stop,
            Request::Relax {} => Order::Relax,
            Request::Zero { straight: false } => Order::Zero,
            Request::Zero { straight: true } => Order::AssertStraight,
            Request::ResetFault {} => Order::Reset,
        };
        // a return to rest waits for no disk: away from zero, the disk already says that drivers may be armed
        if order == Order::Arm && !self.persistence.armed_on_disk {
            self.arm_ahead(caller.clone());
        } else {
            self.order(order, caller.clone());
        }
        Ok(None)
    }

    /// The largest bend at the rest length every 5° from direction 0 on, degrees, and the dimensions of the bending section.
    fn reach(&self) -> Value {
        let (tick, lines) = (&self.config.supervisor.tick, self.in_use());
        let largest = |k: u32| {
            let shape = self.target(BEND_MAX_RAD.to_degrees(), f64::from(k) * 5.0, None);
            shape.bend.beta().to_degrees()
                * tick.limits.largest_share(&tick.geometry, &lines, &shape)
        };
        let bend_deg: Vec<f64> = (0..72).map(largest).collect();
        json!({"bend_deg": bend_deg, "r_mm": tick.geometry.r_mm, "rest_length_mm": tick.geometry.rest_length_mm})
    }

    /// The target of a request whose direction and length are in range.
    fn asked(&self, bend_deg: f64, dir_deg: f64, length_mm: Option<f64>) -> Result<Shape, Failure> {
        let target = self.target(bend_deg, dir_deg, length_mm);
        let mut to = Checker::default();
        to.at("dir_deg")
            .range(dir_deg, DIR_DEG, "degrees")
            .hint("leave out whole turns");
        to.at("length_mm")
            .range(target.length.0, self.lengths_mm(), "mm")
            .hint("that is the range of the bellows ([geometry] of the board file)");
        to.done().map_err(|e| Failure::bad(e.to_string()))?;
        Ok(target)
    }

    /// Lengths that may be asked for, mm.
    fn lengths_mm(&self) -> RangeInclusive<f64> {
        let limits = &self.config.supervisor.tick.limits;
        limits.bellow_min_mm..=limits.bellow_max_mm
    }

    /// Refuses a row of a path that is not in range by itself, or in time after the first one and the one before.
    fn check_row(&self, rows: &[PathRow], k: usize) -> Result<(), Failure> {
        let (t_s, _, dir_deg, length_mm) = rows[k];
        let before = rows[..k].last();
        let from_s = before.map_or(t_s, |before| before.0 + PATH_STEP_S);
        let lengths_mm = self.lengths_mm();
        let length_mm = length_mm.unwrap_or(*lengths_mm.start());
        let checks = [
            ("t_s", t_s, from_s..=rows[0].0 + PATH_MAX_S, "s"),
            ("dir_deg", dir_deg, DIR_DEG, "degrees"),
            ("length_mm", length_mm, lengths_mm, "mm"),
        ];
        for (column, value, allowed, unit) in checks {
            if !allowed.contains(&value) {
                let (row, least, most) = (k + 1, allowed.start(), allowed.end());
                let why = format!(
                    "row {row}, {column} {value:?}: expected a number from {least} to {most} {unit}"
                );
                return Err(Failure::bad(why));
            }
        }
        Ok(())
    }

    fn target(&self, bend_deg: f64, dir_deg: f64, length_mm: Option<f64>) -> Shape {
        let rest_length_mm = self.config.supervisor.tick.geometry.rest_length_mm;
        let bend = Bend::from_deg(bend_deg, dir_deg);
        Shape::new(bend.0, length_mm.unwrap_or(rest_length_mm))
    }

    /// Collects the rows of a path and checks them; with the last ones, hands it to the loop, slowed down so that the pistons can
    /// follow it and it is no faster than a bend. True once that is done.
    fn path(&mut self, rows: &[PathRow], more: bool, client: u64) -> Result<bool, Failure> {
        let mut all = self.path_rows.remove(&client).unwrap_or_default();
        let from = if more { all.len().saturating_sub(1) } else { 0 };
        all.extend_from_slice(rows);
        if all.len() > PATH_ROWS {
            return Err(Failure::bad(format!("a path has at most {PATH_ROWS} rows")));
        }
        (from..all.len()).try_for_each(|k| self.check_row(&all, k))?;
        let checked = &all[from..];
        if more && checked.len() < 2 {
            self.path_rows.insert(client, all);
            return Ok(false);
        }
        let shapes = checked.iter().map(|&(_, bend_deg, dir_deg, length_mm)| {
            let Shape { bend, length } = self.target(bend_deg, dir_deg, length_mm);
            bend.0.push(length.0)
        });
        let path = Path::new(checked.iter().map(|row| row.0).collect(), shapes.collect())
            .filter(|path| path.duration_s() <= PATH_MAX_S);
        let rule = "a path has two or more rows with times that increase by at most";
        let expected = || Failure::bad(format!("{rule} {PATH_MAX_S} s in all"));
        let (path, tick) = (path.ok_or_else(expected)?, &self.config.supervisor.tick);
        let lines = self.in_use();
        if let Some((k, expected)) = path.out_of_reach(&tick.limits, &tick.geometry, &lines) {
            let (row, bend_deg) = (from + k + 1, checked[k].1);
            let why = format!("row {row}, bend_deg {bend_deg}: expected {expected}");
            return Err(Failure::bad(why));
        }
        if more {
            self.path_rows.insert(client, all);
            return Ok(false);
        }
        let time_scale = path
            .demand(&tick.geometry, &lines, &tick.motion.limits)
            .max(path.speed_max() / tick.bend_pace.speed)
            .max(1.0);
        let path = path.slowed(time_scale);
        let (t_s, rows) = path.rows();
        let event = Event::Path(t_s.to_vec(), rows.to_vec());
        self.path = json!({"duration_s": path.duration_s(), "time_scale": time_scale});
        let path = Path::new(t_s.to_vec(), rows.to_vec()).ok_or_else(expected)?;
        self.change(Change::Path(Some(Box::new(path))), event)?;
        Ok(true)
    }

    fn reload(&mut self) -> Reply {
        let why = "no gains file was given; start the service with `retroflex run --gains FILE`";
        let path = self.config.gains.clone();
        let path = path.ok_or_else(|| Failure::refused(why))?;
        let stay = |e: &dyn Display| Failure::bad(format!("{e}; the present gains stay in use"));
        // the end of anything else may never come, and the hub does not wait
        if is_irregular(&path) {
            let shown = path.display();
            let why = format!("{shown}: this is no regular file; put the gains file in its place");
            return Err(stay(&why));
        }
        let gains: Gains = source::read(&path).map_err(|e| stay(&e))?;
        let now = &self.config;
        let next = with_gains(&now.supervisor, &now.board, &now.calibration, &gains);
        let (text, lines) = (crate::config::show::compact(&gains), next.tick.lines);
        let gains = text.clone();
        let change = Change::Config(Box::new(next.clone()));
        self.change(change, Event::Reload { gains, lines })?;
        self.config.supervisor = next;
        self.config.texts[1] = text;
        Ok(Some(json!({"gains": path})))
    }

    fn calibrate(&mut self, action: CalibrateAction, poses: usize, caller: &Caller) -> Reply {
        let (poses, prior) = match action {
            CalibrateAction::Discard => {
                return match self.memory.proposed.take() {
                    Some(_) => done(),
                    None => refuse("there is no proposed calibration to discard"),
                };
            }
            CalibrateAction::Accept => return self.accept(caller),
            _ if self.calibration.is_some() => return refuse("a calibration is already running"),
            CalibrateAction::Full => (schedule::paper(), None),
            CalibrateAction::Short if !POSES.contains(&poses) => {
                let (least, most) = (POSES.start(), POSES.end());
                return refuse(format!(
                    "`poses` is {poses}; a short calibration has {least} to {most}"
                ));
            }
            CalibrateAction::Short => (
                schedule::short(poses),
                Some(self.config.calibration.prior()),
            ),
        };
        if self.mode() != Mode::Holding {
            let mode = self.mode();
            return refuse(format!(
                "not while {mode}: `retroflex arm` first and wait until the tip holds"
            ));
        }
        let tick = &self.config.supervisor.tick;
        let from_zero = [Line::default(); 3];
        let algorithm = Algorithm1::new(tick.geometry, poses, from_zero, prior, tick.dynamics);
        self.calibration = Some(Session::new(algorithm, tick.drive));
        self.calibration_failed = None;
        self.order(Order::Calibrate(true), caller.clone());
        Ok(None)
    }

    /// The transmission gains in use.
    fn in_use(&self) -> [Line; 3] {
        let mut lines = self.config.supervisor.tick.lines;
        if let Some(last) = self.output() {
            for (line, k_epsilon) in lines.iter_mut().zip(last.frame.k_epsilon) {
                line.k_epsilon = k_epsilon;
            }
        }
        lines
    }

    fn accept(&mut self, caller: &Caller) -> Reply {
        let why = "there is no proposed calibration to accept; run `retroflex calibrate transmission` first";
        let gains = self.memory.proposed.clone();
        let gains = gains.ok_or_else(|| Failure::refused(why))?;
        if self.config.feedforward.is_some() {
            return refuse(
                "the gains of the feedforward model are in use, which were identified together with it: start the service without the model to accept the calibration",
            );
        }
        if gains.tip != self.config.tip {
            return refuse(format!(
                "the calibration was made on tip `{}`, but tip `{}` is mounted",
                gains.tip, self.config.tip
            ));
        }
        if !matches!(self.mode(), Mode::Disarmed | Mode::Holding) {
            return refuse(format!("not while {}", self.mode()));
        }
        // they are applied once they are on the disk
        let order = Order::Lines(gains.lines());
        let before = self.memory.accepted.replace(gains);
        self.persistence.before = (before, self.config.supervisor.tick.lines);
        self.memory.proposed = None;
        self.write_ahead(order, caller.clone(), None);
        Ok(None)
    }
}
