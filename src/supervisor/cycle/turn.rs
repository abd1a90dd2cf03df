//! One cycle: order, tick, sensor supervision, alignment, gate, residual monitor.

use crate::control::CauseSet;
use crate::control::tick::{Frame, Input, TickPhase, tick};
use crate::model::{Bend, Shape};
use crate::primitives::{Seconds, Steps};
use crate::supervisor::cycle::restart_check;
use crate::supervisor::cycle::source::Source;
use crate::supervisor::cycle::state::Position;
use crate::supervisor::gate::{Following, GateInput};
use crate::supervisor::mode::Event;
use crate::supervisor::residual_monitor::ResidualInput;
use crate::supervisor::{
    Alarm, CycleOutput, Mode, Order, SafeState, Sensed, Supervisor, TripCause,
};
use nalgebra::{Vector2, Vector3};

impl Supervisor {
    /// One cycle.
    pub fn turn(&mut self, sensed: &Sensed, order: Option<Order>) -> CycleOutput {
        let last = self.last.replace(*sensed);
        let dt_s = last.map_or(self.config.gate.tick_s, |last| sensed.t.0 - last.t.0);
        if self.mode == Mode::Boot {
            self.occur(Event::Opened);
        }
        let answer = order.map(|o| self.obey(o, sensed));
        let stream_ended = self.end_silent_stream(sensed.t);
        let input = self.tick_input(sensed, dt_s);
        let frame = tick(&self.config.tick, &mut self.state, &input);
        self.setpoint = frame.setpoint;
        let raised = self.sensors.step(&self.state, &frame, dt_s, input.dt_s);
        self.follow_alignment(&frame);
        let tripped = self.pass_gate(&frame, sensed, dt_s);
        self.follow_motion(&frame);
        let suspects = self.monitor_residual(&frame, sensed, input.dt_s);
        let fusion = &self.state.fusion;
        let base = fusion.base_health();
        CycleOutput {
            frame,
            input,
            sensed: *sensed,
            order,
            answer,
            mode: self.mode,
            steps: self.sent,
            counted: sensed.counted,
            energise: self.energise(),
            clear: std::mem::take(&mut self.pending.clear),
            recount: self.pending.recount.take(),
            tripped,
            latched: self.gate.latched(),
            suspicion: self.residual.suspicion().copied(),
            suspects,
            raised,
            base_imu: base.map(|(in_force, _)| (fusion.tracks_base(), in_force)),
            base_raised: base.map_or(CauseSet::EMPTY, |(_, raised)| raised),
            bias_moved: self.sensors.bias_moved(&self.state),
            stream_ended,
            source: self.source,
            stopped: self.stopped,
            unverified: self.unverified,
            dt_s,
            first: last.is_none(),
        }
    }

    /// Takes an event that the table may ignore in the present mode; true if it did not.
    fn occur(&mut self, event: Event) -> bool {
        self.take(event).is_ok()
    }

    fn tick_input(&mut self, sensed: &Sensed, dt_s: f64) -> Input {
        // a late cycle does not let the set-point jump
        let dt_s = dt_s.max(0.0).min(2.0 * self.config.gate.tick_s);
        let reference = self.reference(sensed.t.0, dt_s);
        Input {
            reference,
            t: sensed.t,
            dt_s,
            imu: sensed.imu,
            base_imu: sensed.base_imu,
            command: self.pending.target.take(),
            steps: sensed.counted,
            idle: !self.leads(),
            suspected: self.residual.suspicion().is_some(),
        }
    }

    /// Stops the tip if its stream of set-points has fallen silent.
    fn end_silent_stream(&mut self, now: Seconds) -> bool {
        let silent = self.stream_until_s.is_some_and(|until_s| now.0 > until_s);
        if silent && self.occur(Event::Stop) {
            self.gate.brake();
        }
        silent
    }

    /// Leaves `aligning` once the rest pose is known and, after a restart, the remembered pose has been checked.
    fn follow_alignment(&mut self, frame: &Frame) {
        if self.mode != Mode::Aligning || frame.estimate.is_none() {
            return;
        }
        match self.position {
            Position::Known => {
                self.state
                    .stand(&self.config.tick, &self.sent, Bend::STRAIGHT);
                self.straight = self.state.keep(&self.sent).rest;
                self.occur(Event::Aligned);
            }
            Position::Unchecked(remembered)
                if restart_check::agrees(&self.config.restart_check, &remembered, &self.state) =>
            {
                restart_check::resume(&self.config.tick, &mut self.state, &remembered);
                self.position = Position::Known;
                self.occur(Event::Aligned);
            }
            Position::Unchecked(_) | Position::Adrift => {
                self.position = Position::Adrift;
                self.occur(Event::Doubted);
            }
        }
    }

    /// Passes the requested counts through the gate; returns the cause of a trip.
    fn pass_gate(&mut self, frame: &Frame, sensed: &Sensed, dt_s: f64) -> Option<TripCause> {
        self.clearing_s = (self.clearing_s - dt_s).max(0.0);
        let input = self.gate_input(frame, sensed, dt_s);
        if (input.armed && !sensed.energised) || (self.stopped && self.mode.moves()) {
            // drivers that are not energised yet lose steps, and after a stop the gate stands: the controller waits
            let at = frame.estimate.map_or(Bend::STRAIGHT, |e| e.bend);
            self.state.stand(&self.config.tick, &self.sent, at);
        }
        if self.stopped && self.gate.is_returning() {
            self.gate.stand();
        }
        let output = self.gate.pass(&input);
        self.sent = output.steps;
        if let Some(cause) = output.tripped {
            self.occur(Event::Trip);
            if cause == TripCause::StepGenerator && self.gate.is_returning() {
                self.clear_alarm(sensed);
            }
        }
        if !output.energise && !output.rested && self.sent != Steps::default() {
            self.position = Position::Adrift;
        }
        self.follow_return(output.rested, sensed);
        output.tripped
    }

    fn gate_input(&self, frame: &Frame, sensed: &Sensed, dt_s: f64) -> GateInput {
        let armed = self.leads();
        let open_loop = matches!(self.set_aside, Some((Some(_), _)));
        let must_follow = armed && !open_loop && !frame.senses.held;
        let (geometry, length) = (&self.config.tick.geometry, frame.setpoint.length);
        let bellow_mm = |bend| geometry.lengths(&Shape { bend, length }).into();
        let setpoint = frame.setpoint.bend.0.into();
        let passes = armed && sensed.energised;
        GateInput {
            dt_s,
            wanted: if passes { frame.steps } else { self.sent },
            counted: sensed.counted,
            counted_age_s: sensed.counted_age_s,
            armed,
            estimated_bellow_mm: frame.estimate.map(|e| bellow_mm(e.bend)),
            following: frame.estimate.filter(|_| must_follow).map(|e| Following {
                setpoint,
                estimate: e.bend.0.into(),
            }),
            stale_s: self.sensors.blind_s,
            disagree: frame.senses.disagrees,
            emergency_stop: sensed.inputs.emergency_stop,
            alarm: sensed.alarm.is_some_and(|a| a.is_of_steps()) && self.clearing_s <= 0.0,
            overpressure: matches!(sensed.alarm, Some(Alarm::Pressure { .. })),
            hot: matches!(sensed.alarm, Some(Alarm::Hot { .. })),
        }
    }

    /// True while the controller, not the gate, moves the pistons.
    pub(super) fn leads(&self) -> bool {
        self.mode.moves() && !self.gate.is_braking()
    }

    /// Ends `relaxing` once the machine has counted the last step of the return.
    fn follow_return(&mut self, rested: bool, sensed: &Sensed) {
        if self.mode != Mode::Relaxing {
            return;
        }
        self.arriving |= rested;
        if !self.arriving || sensed.counted != self.sent {
            return;
        }
        if self.gate.latched().is_none() {
            self.gate.reset(&self.sent);
        }
        let event = if self.position != Position::Known {
            // the counts are zero, but they counted from an unknown position
            self.position = Position::Adrift;
            Event::Doubted
        } else if self.is_located() {
            Event::Rested
        } else {
            self.start_over();
            Event::RestedUnaligned
        };
        self.occur(event);
    }

    /// The controller takes over after braking; `tracking` ends when the set-point has arrived.
    fn follow_motion(&mut self, frame: &Frame) {
        // after a stop the gate stands until `arm`, so that feedback makes no step either
        if !(self.stopped && self.mode.moves()) && self.gate.hand_over() {
            self.take_over(frame.estimate.map_or(Bend::STRAIGHT, |e| e.bend));
        }
        let goes_on = self.stream_until_s.is_some() || matches!(self.source, Source::Path { .. });
        if self.mode == Mode::Tracking && !goes_on && frame.phase == TickPhase::Holding {
            self.occur(Event::Settled);
        }
    }

    /// Steps the residual monitor; true if it has a new suspicion.
    fn monitor_residual(&mut self, frame: &Frame, sensed: &Sensed, dt_s: f64) -> bool {
        let Some(estimate) = frame.estimate.filter(|_| self.leads()) else {
            return false;
        };
        if frame.base_moved {
            // the base explains the residual until the next alignment
            self.residual.forget();
            return false;
        }
        let input = ResidualInput {
            dt_s,
            predicted: frame.bend_from_pistons.0,
            gapless: self.bend_without_play(sensed),
            estimate: estimate.bend.0,
            answer_s: frame.dynamics.response_s(),
            moving: frame.phase == TickPhase::Tracking,
            blocked: frame.blocked,
        };
        self.residual.step(&input).is_some()
    }

    /// Bend that the counted steps would cause without play, rad.
    fn bend_without_play(&self, sensed: &Sensed) -> Vector2<f64> {
        let (config, lines) = (&self.config.tick, self.state.lines());
        let piston_mm = config.drive.piston_mm(&sensed.counted);
        let bellow_mm = Vector3::from_fn(|i, _| lines[i].bellow_mm(piston_mm[i]));
        config.geometry.shape(&bellow_mm).bend.0
    }

    /// Whether the drivers shall be energised: holding torque keeps a bent tip in place, and at zero none is needed.
    fn energise(&self) -> bool {
        match self.mode {
            Mode::Boot | Mode::Aligning => self.finds_energised(),
            // a return by unknown counts that was stopped keeps its pressure
            Mode::Lost => self.stopped && self.last.is_some_and(|sensed| sensed.energised),
            Mode::Holding | Mode::Tracking | Mode::Calibrating | Mode::Relaxing => true,
            Mode::Disarmed | Mode::Faulted => {
                (!self.is_at_rest() || self.gate.is_busy()) && self.position != Position::Adrift
            }
        }
    }

    /// A previous program left the drivers energised and the remembered pose is not checked yet: the tip stays held,
    /// unless the board file prefers another reaction to a loop that hangs.
    fn finds_energised(&self) -> bool {
        let energised = self.last.is_some_and(|sensed| sensed.energised);
        energised
            && matches!(self.position, Position::Unchecked(_))
            && self.config.gate.on.late == SafeState::Hold
    }
}
