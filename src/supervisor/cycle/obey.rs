//! How the supervisor carries out each order.

use crate::control::Pace;
use crate::model::{Bend, Line, Shape};
use crate::primitives::Steps;
use crate::supervisor::cycle::source::Source;
use crate::supervisor::cycle::state::Position;
use crate::supervisor::mode::Event;
use crate::supervisor::{BEND_MAX_RAD, Mode, Order, Refusal, Sensed, Supervisor};
use std::f64::consts::PI;

/// Time that a machine has to clear its alarm, s.
const CLEARING_S: f64 = 0.1;
/// Range of the speed that may be ordered, rad/s: 0.1 to 720 °/s, with a margin for rounding.
const SPEED_RAD_S: std::ops::RangeInclusive<f64> = 0.1 * PI / 180.0 - 1e-9..=4.0 * PI + 1e-9;

impl Supervisor {
    /// Carries out an order, or returns the reason for refusing it.
    pub(super) fn obey(&mut self, order: Order, sensed: &Sensed) -> Result<(), Refusal> {
        match order {
            Order::Arm => self.arm(),
            _ if self.stopped && order.starts_motion() => Err(Refusal::Stopped),
            Order::Disarm => self.disarm(),
            _ if order.leads_setpoint() && self.mode.moves() && !sensed.energised => {
                Err(Refusal::Busy)
            }
            Order::Bend(to, speed_rad_s) => self.bend(Source::Target, &to, speed_rad_s, None),
            Order::Stream(_) | Order::Timed(..) | Order::Play | Order::World(..)
                if self.mode == Mode::Calibrating =>
            {
                Err(Refusal::Mode(Mode::Calibrating))
            }
            Order::Stream(to) => {
                let until_s = sensed.t.0 + self.config.dead_man_s;
                self.bend(Source::Target, &to, None, Some(until_s))
            }
            Order::Timed(to, t_s) => self.stream(&to, t_s, sensed.t.0),
            Order::Play => self.play(sensed.t.0),
            Order::World(to, speed_rad_s) => self.point(&to, speed_rad_s),
            Order::Hold => self.hold(),
            Order::Stop => self.stop(),
            Order::Relax => self.relax(sensed),
            Order::Zero => self.zero(false),
            Order::AssertStraight => self.zero(true),
            Order::Reset => self.reset(sensed),
            Order::Calibrate(true) => self.begin_calibration(),
            Order::Calibrate(false) => self.take(Event::Settled).map(|()| self.gate.brake()),
            Order::Lines(lines) => self.change_lines(lines),
        }
    }

    fn arm(&mut self) -> Result<(), Refusal> {
        if self.gate.latched().is_some() {
            return Err(Refusal::Latched);
        }
        match self.mode {
            Mode::Holding => {}
            Mode::Disarmed if self.gate.is_busy() => return Err(Refusal::Busy),
            _ => {
                self.take(Event::Arm)?;
                self.gate.reset(&self.sent);
                let estimate = self.state.fusion.estimate();
                self.take_over(estimate.map_or(Bend::STRAIGHT, |e| e.bend));
            }
        }
        self.stopped = false;
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), Refusal> {
        // a correction of a held pose is a motion too
        let in_motion = self.mode != Mode::Holding || !self.gate.rests();
        self.take(Event::Disarm)?;
        if in_motion {
            self.gate.brake();
        }
        Ok(())
    }

    /// Bends to `to`, or from there on as the source leads. A stream must go on by `stream_until_s`.
    pub(super) fn bend(
        &mut self,
        source: Source,
        to: &Shape,
        speed_rad_s: Option<f64>,
        stream_until_s: Option<f64>,
    ) -> Result<(), Refusal> {
        self.check_target(to)?;
        if self.gate.is_braking() {
            return Err(Refusal::Busy);
        }
        let speed = speed_rad_s.unwrap_or(self.pace.speed);
        if !SPEED_RAD_S.contains(&speed) {
            return Err(Refusal::Speed);
        }
        if !matches!(self.mode, Mode::Tracking | Mode::Calibrating) {
            self.take(Event::Bend)?;
        }
        self.stream_until_s = stream_until_s;
        // no client leads the tip faster than the board permits
        let speed = speed.min(self.pace.speed);
        self.config.tick.bend_pace = Pace { speed, ..self.pace };
        self.pending.target = (source == Source::Target).then_some(*to);
        self.source = source;
        Ok(())
    }

    /// Refuses what the tip cannot reach; the tick limits a valid target further.
    fn check_target(&self, to: &Shape) -> Result<(), Refusal> {
        let (bend, length_mm) = (to.bend.0, to.length.0);
        let (limits, geometry) = (&self.config.tick.limits, &self.config.tick.geometry);
        if !bend.iter().all(|x| x.is_finite()) || !length_mm.is_finite() {
            return Err(Refusal::NotANumber);
        }
        if bend.norm() > BEND_MAX_RAD {
            return Err(Refusal::TooFar);
        }
        if !(limits.bellow_min_mm..=limits.bellow_max_mm).contains(&length_mm) {
            return Err(Refusal::Length);
        }
        let share = limits.largest_share(geometry, self.state.lines(), to);
        if share < 1.0 {
            let most_deg = bend.norm().to_degrees() * share;
            return Err(Refusal::Unreachable((most_deg * 10.0) as u16));
        }
        Ok(())
    }

    fn hold(&mut self) -> Result<(), Refusal> {
        match self.mode {
            Mode::Holding => {}
            Mode::Tracking => {
                self.stream_until_s = None;
                self.rest_at(self.setpoint);
            }
            other => return Err(Refusal::Mode(other)),
        }
        Ok(())
    }

    /// Engages the latch in every mode. [`Supervisor::pass_gate`] ends a return of the gate's own.
    fn stop(&mut self) -> Result<(), Refusal> {
        self.stopped = true;
        match self.mode {
            Mode::Relaxing => return self.stop_return(),
            Mode::Holding => {}
            Mode::Tracking | Mode::Calibrating => self.take(Event::Stop)?,
            _ => return Ok(()),
        }
        self.gate.brake();
        Ok(())
    }

    /// Stops a return to rest. The controller continues from there only if it can: not with a latched fault, and not
    /// without a known position.
    fn stop_return(&mut self) -> Result<(), Refusal> {
        let event = match (self.gate.latched(), self.is_located()) {
            (Some(_), _) => Event::Trip,
            (None, false) => {
                self.position = Position::Adrift;
                Event::Doubted
            }
            (None, true) => {
                self.gate.brake();
                return self.take(Event::Stop);
            }
        };
        self.gate.stand();
        self.take(event)
    }

    fn relax(&mut self, sensed: &Sensed) -> Result<(), Refusal> {
        if sensed.inputs.emergency_stop {
            return Err(Refusal::StillThere);
        }
        if self.mode == Mode::Lost && self.sent == Steps::default() {
            return Err(Refusal::NoSteps);
        }
        self.take(Event::Relax)?;
        self.clear_alarm(sensed);
        self.gate.relax();
        Ok(())
    }

    /// Defines the present pose as rest. Only the operator's word (`asserted`) replaces an attitude that confirms it.
    fn zero(&mut self, asserted: bool) -> Result<(), Refusal> {
        let mode = self.mode;
        // a step that is still on its way counts too
        if mode == Mode::Disarmed && !(self.gate.rests() && self.sent == Steps::default()) {
            return Err(Refusal::NotAtRest);
        }
        if self.gate.latched().is_some() {
            return Err(Refusal::Latched);
        }
        if mode.after(Event::Zero).is_none() {
            return Err(Refusal::Mode(mode));
        }
        let confirmed = match self.off_straight_rad() {
            Some(rad) if rad.to_degrees() <= self.config.restart_check.straight_deg => Ok(()),
            Some(rad) => Err(Refusal::NotStraight(
                (rad.to_degrees() * 10.0).round() as u16
            )),
            None => Err(Refusal::Unmeasured),
        };
        if asserted {
            self.unverified |= confirmed.is_err();
        } else {
            confirmed?;
        }
        self.take(Event::Zero)?;
        self.start_over();
        Ok(())
    }

    fn reset(&mut self, sensed: &Sensed) -> Result<(), Refusal> {
        if sensed.inputs.emergency_stop {
            return Err(Refusal::StillThere);
        }
        if self.gate.is_busy() {
            return Err(Refusal::Busy);
        }
        if self.leads() {
            // nothing is latched, and the pistons may be moving
            self.residual.forget();
            return Ok(());
        }
        if self.mode == Mode::Faulted {
            self.take(match self.position {
                Position::Adrift => Event::Doubted,
                _ if self.is_located() => Event::Reset,
                _ => Event::ResetUnaligned,
            })?;
        }
        self.request_clear(sensed);
        self.gate.reset(&self.sent);
        self.residual.forget();
        Ok(())
    }

    /// Clears an alarm once, so that the step generator can return to rest from where it stopped. A latched cause stays
    /// latched, and an alarm that recurs ends the return.
    pub(super) fn clear_alarm(&mut self, sensed: &Sensed) {
        if sensed.alarm.is_some() {
            self.request_clear(sensed);
            self.gate.recount(&self.sent);
        }
    }

    /// Asks the machine to clear its alarm, and continues from the steps that it really made.
    fn request_clear(&mut self, sensed: &Sensed) {
        self.pending.clear = true;
        self.clearing_s = CLEARING_S;
        self.sent = sensed.counted;
    }

    fn begin_calibration(&mut self) -> Result<(), Refusal> {
        if self.gate.is_braking() {
            return Err(Refusal::Busy);
        }
        self.take(Event::Calibrate)?;
        self.state.forget_feedback();
        Ok(())
    }

    fn change_lines(&mut self, lines: [Line; 3]) -> Result<(), Refusal> {
        let is_physical =
            |l: &Line| (0.0..=10.0).contains(&l.k_epsilon) && (0.0..=3.0).contains(&l.k_lambda_mm);
        if !lines.iter().all(is_physical) {
            return Err(Refusal::Gains);
        }
        let mode = self.mode;
        if !matches!(mode, Mode::Disarmed | Mode::Calibrating | Mode::Holding) {
            return Err(Refusal::Mode(mode));
        }
        self.config.tick.lines = lines;
        self.state.set_lines(&self.config.tick, lines);
        let at = self.state.fusion.estimate().map(|e| e.bend);
        if let (Mode::Holding | Mode::Disarmed, Some(at)) = (mode, at) {
            self.take_over(at);
        }
        Ok(())
    }
}
