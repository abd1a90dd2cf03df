//! What the pilot can be told, and why it may refuse.

use crate::control::follow::Pace;
use crate::control::tick::Command;
use crate::model::transmission::Line;
use crate::primitives::units::Steps;
use crate::supervisor::cycle::Supervisor;
use crate::supervisor::machine::Sensed;
use crate::supervisor::mode::{Event, Mode};

/// An order, as small as a message through a wait-free ring must be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// Energise and hold the pose that is.
    Arm,
    /// Take no more motion; released where the pistons are at zero.
    Disarm,
    /// Bend to a target, at a speed of its own if given, rad/s.
    Bend(Command, Option<f64>),
    /// As [`Order::Bend`], one of a stream: when it falls silent the tip stops.
    Stream(Command),
    /// Come to rest smoothly where the set-point is, hold.
    Hold,
    /// Brake now, hold.
    Stop,
    /// Back to rest, slowly, then de-energise.
    Relax,
    /// What is now is the rest.
    Zero,
    /// Forget the fault.
    Reset,
    /// Begin or end an open-loop calibration.
    Calibrate(bool),
    /// Use these gains.
    Lines([Line; 3]),
}

/// Why an order was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The mode does not allow it.
    #[error("not while {0}: {hint}", hint = hint(*.0))]
    Mode(Mode),
    /// A fault is latched.
    #[error("a fault is latched; see `retroflex status`, mend the cause, then `retroflex reset-fault`")]
    Latched,
    /// The cause of the fault is still there.
    #[error("the cause of the fault is still there: release the emergency stop, or mend what `retroflex status` names")]
    StillThere,
    /// A number that is none.
    #[error("bend, direction, length and speed must be numbers")]
    NotANumber,
    /// Further than the tip can bend.
    #[error("the bend must lie within ±135°")]
    TooFar,
    /// A length no bellow has.
    #[error("the length must lie within the bellows' range ([geometry] of the board file)")]
    Length,
    /// A speed outside the sensible.
    #[error("the speed must lie between 0.1 and 720 °/s")]
    Speed,
    /// Pistons are not at zero.
    #[error("the pistons are not at zero: `retroflex relax` first, so that the rest is the true one")]
    NotAtRest,
    /// Gains outside the physical.
    #[error("gains must lie within 0 to 10 (k_ε) and 0 to 3 mm (k_λ)")]
    Gains,
    /// The motion before is not over, or the drivers are not on yet.
    #[error("still braking or energising; try again in a moment")]
    Busy,
}

/// Time that a machine has to take its alarm back, s.
const CLEARING_S: f64 = 0.1;

fn hint(mode: Mode) -> &'static str {
    match mode {
        Mode::Boot => "the devices are being opened",
        Mode::Aligning => "the tip must be still for 2 s first",
        Mode::Disarmed => "`retroflex arm` first",
        Mode::Holding => "nothing moves that could be stopped",
        Mode::Tracking => "`retroflex stop` first",
        Mode::Relaxing => "it is on its way back to rest",
        Mode::Calibrating => "a calibration runs; `retroflex stop` ends it",
        Mode::Faulted => "mend the cause, then `retroflex reset-fault`; `retroflex relax` leads back to rest",
        Mode::Lost => {
            "where the pistons stand is not known; `retroflex relax` to drive back by the remembered steps, or relax the tip by hand and `retroflex zero`"
        }
    }
}

impl Supervisor {
    /// Carries out an order, or says why not.
    pub(super) fn obey(&mut self, order: Order, sensed: &Sensed) -> Result<(), Refusal> {
        match order {
            Order::Arm => self.arm(),
            Order::Disarm => self.take(Event::Disarm),
            Order::Bend(..) | Order::Stream(_) if self.modes.now().moves() && !sensed.energised => Err(Refusal::Busy),
            Order::Bend(command, speed_rad_s) => self.bend(&command, speed_rad_s, None),
            Order::Stream(command) => self.bend(&command, None, Some(sensed.t.0 + self.config.dead_man_s)),
            Order::Hold => self.hold(),
            Order::Stop => self.stop(),
            Order::Relax => self.relax(sensed),
            Order::Zero => self.zero(),
            Order::Reset => self.reset(sensed),
            Order::Calibrate(begin) => self.calibrate(begin),
            Order::Lines(lines) => self.change_lines(lines),
        }
    }

    fn take(&mut self, event: Event) -> Result<(), Refusal> {
        let mode = self.modes.now();
        if self.modes.take(event) { Ok(()) } else { Err(Refusal::Mode(mode)) }
    }

    fn arm(&mut self) -> Result<(), Refusal> {
        if self.gate.latched().is_some() {
            return Err(Refusal::Latched);
        }
        if self.modes.now() == Mode::Holding {
            return Ok(());
        }
        self.take(Event::Arm)?;
        let at = self.state.fusion.estimate().map_or(crate::model::bend::Bend::STRAIGHT, |f| f.bend);
        self.gate.reset(&self.sent);
        self.take_over(at);
        Ok(())
    }

    fn bend(&mut self, command: &Command, speed_rad_s: Option<f64>, until: Option<f64>) -> Result<(), Refusal> {
        let shape = self.target(command)?;
        if self.handing_over {
            return Err(Refusal::Busy);
        }
        let fastest = speed_rad_s.unwrap_or(self.pace.speed);
        if !(0.1f64.to_radians()..=720f64.to_radians() + 1e-9).contains(&fastest) {
            return Err(Refusal::Speed);
        }
        match self.modes.now() {
            Mode::Tracking | Mode::Calibrating => {}
            _ => self.take(Event::Bend)?,
        }
        self.config.tick.bend_pace = Pace { speed: fastest, ..self.pace };
        self.stream_until = until;
        self.pending.command = Some(Command { bend: shape.bend, length: shape.length });
        Ok(())
    }

    fn hold(&mut self) -> Result<(), Refusal> {
        self.stream_until = None;
        match self.modes.now() {
            Mode::Holding => Ok(()),
            Mode::Tracking => {
                self.pending.command = Some(Command { bend: self.setpoint.bend, length: self.setpoint.length });
                Ok(())
            }
            mode => Err(Refusal::Mode(mode)),
        }
    }

    fn stop(&mut self) -> Result<(), Refusal> {
        self.stream_until = None;
        let mode = self.modes.now();
        if mode == Mode::Relaxing {
            self.gate.stand();
            let known = self.state.fusion.estimate().is_some() && !self.adrift && self.kept.is_none();
            let event = match (self.gate.latched(), known) {
                (Some(_), _) => Event::Trip,
                (None, false) => Event::Doubted,
                (None, true) => Event::Stop,
            };
            self.handing_over = event == Event::Stop;
            return self.take(event);
        }
        if !mode.moves() {
            // what does not move is stopped already
            return Ok(());
        }
        self.end_calibration();
        if mode != Mode::Holding {
            self.take(Event::Stop)?;
        }
        self.brake();
        Ok(())
    }

    fn relax(&mut self, sensed: &Sensed) -> Result<(), Refusal> {
        if sensed.inputs.emergency_stop {
            return Err(Refusal::StillThere);
        }
        self.take(Event::Relax)?;
        self.take_alarm_back(sensed);
        self.end_calibration();
        self.stream_until = None;
        self.handing_over = false;
        self.gate.relax();
        Ok(())
    }

    fn zero(&mut self) -> Result<(), Refusal> {
        if self.modes.now() == Mode::Disarmed && self.sent != Steps::default() {
            return Err(Refusal::NotAtRest);
        }
        if self.gate.latched().is_some() {
            return Err(Refusal::Latched);
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
        if self.modes.now() == Mode::Faulted {
            let aligned = self.state.fusion.estimate().is_some();
            let event = if self.adrift {
                Event::Doubted
            } else if aligned && self.kept.is_none() {
                Event::Reset
            } else {
                Event::ResetUnaligned
            };
            self.take(event)?;
        }
        self.pending.clear = true;
        self.clearing_s = CLEARING_S;
        // what the step generator really did counts, not what it was told
        self.sent = sensed.counted;
        self.gate.reset(&self.sent);
        self.explain.forget();
        Ok(())
    }

    /// A step generator that has stopped drives nothing back: for the way to rest its alarm is taken back once,
    /// and the way begins where it stopped. What is latched stays so; an alarm that comes again ends the way.
    pub(super) fn take_alarm_back(&mut self, sensed: &Sensed) {
        if sensed.alarm.is_some() {
            self.pending.clear = true;
            self.clearing_s = CLEARING_S;
            self.sent = sensed.counted;
            self.gate.recount(&self.sent);
        }
    }

    fn calibrate(&mut self, begin: bool) -> Result<(), Refusal> {
        if !begin {
            self.take(Event::Settled)?;
            self.end_calibration();
            self.brake();
            return Ok(());
        }
        if self.handing_over {
            return Err(Refusal::Busy);
        }
        self.take(Event::Calibrate)?;
        self.aside = self.config.tick.feedback.take();
        self.state.forget_feedback();
        Ok(())
    }

    fn change_lines(&mut self, lines: [Line; 3]) -> Result<(), Refusal> {
        if !Self::gains_are_sound(&lines) {
            return Err(Refusal::Gains);
        }
        let mode = self.modes.now();
        if !matches!(mode, Mode::Disarmed | Mode::Calibrating | Mode::Holding) {
            return Err(Refusal::Mode(mode));
        }
        self.config.tick.lines = lines;
        self.state.set_lines(lines);
        let at = self.state.fusion.estimate().map(|f| f.bend);
        if let (Mode::Holding | Mode::Disarmed, Some(at)) = (mode, at) {
            self.take_over(at);
        }
        Ok(())
    }
}
