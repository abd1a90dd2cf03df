//! The pilot: one turn of the supervised loop, on any machine.
//!
//! ```text
//!  Sensed ─▶ tick ─▶ wanted counts ─▶ gate ─▶ counts to send
//!             │  ╲                     │ trip
//!   order ────┘   explain: in words    └──────▶ modes
//! ```
//!
//! The service, the drills and the soak run this same turn; only the machine behind it and whoever
//! gives the orders differ. A turn allocates nothing, locks nothing and asks nobody for the time.

pub mod order;
pub mod proof;
pub mod runner;

use crate::control::follow::Pace;
use crate::control::tick::{self, Command, FeedbackConfig, Frame, Input, LoopConfig, LoopState, RestartState, tick};
use crate::estimation::fusion::health::CauseSet;
use crate::model::arc::Shape;
use crate::model::bend::Bend;
use crate::model::transmission::Line;
use crate::primitives::units::{Mm, Seconds, Steps};
use crate::supervisor::cycle::order::{Order, Refusal};
use crate::supervisor::cycle::proof::RestartCheckConfig;
use crate::supervisor::gate::{self, Following, Gate, GateInput};
use crate::supervisor::machine::Sensed;
use crate::supervisor::mode::{Event, Mode, Modes};
use crate::supervisor::residual_monitor::{self, ResidualConfig, ResidualInput, ResidualMonitor, Suspicion};
use nalgebra::{Vector2, Vector3};

/// Everything that does not change while the pilot flies, but by `reload`.
#[derive(Debug, Clone, PartialEq)]
pub struct SupervisorConfig {
    /// The loop.
    pub tick: LoopConfig,
    /// The gate.
    pub gate: gate::GateLimits,
    /// The words.
    pub explain: ResidualConfig,
    /// When a restart counts as proved.
    pub proof: RestartCheckConfig,
    /// A stream of set-points that is silent for longer has ended, s.
    pub dead_man_s: f64,
}

/// Change of the gyroscope's bias since the rest that is worth a word, rad/s (0.9 °/s).
const BIAS_MOVED_RAD_S: f64 = 0.016;

/// Smoothing of the rate of a resting tip, s, and what of it is held against the sensor, rad/s (0.7 °/s).
const RESTING_S: f64 = 0.5;
const RESTING_RAD_S: f64 = 0.012;

/// What one turn came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleOutput {
    /// Every intermediate of the tick.
    pub frame: Frame,
    /// What the tick was told.
    pub input: Input,
    /// What the pilot was told, bit for bit: for the tape.
    pub sensed: Sensed,
    /// What it was ordered.
    pub order: Option<Order>,
    /// Mode after the turn.
    pub mode: Mode,
    /// Counts to send.
    pub steps: Steps,
    /// Counts as the machine has them.
    pub counted: Steps,
    /// The drivers shall be on.
    pub energise: bool,
    /// The machine shall take back its alarm.
    pub clear: bool,
    /// The machine shall call where it stands by these counts.
    pub recount: Option<Steps>,
    /// The gate tripped in this turn.
    pub tripped: Option<gate::TripCause>,
    /// Latched since.
    pub latched: Option<gate::TripCause>,
    /// Suspected since.
    pub suspicion: Option<Suspicion>,
    /// Suspected in this turn for the first time.
    pub suspects: bool,
    /// Causes that came into force against the sensor in this turn.
    pub raised: CauseSet,
    /// The gyroscope's bias is far from what it was at rest.
    pub bias_moved: bool,
    /// The dead-man of a stream stopped the tip in this turn.
    pub stream_ended: bool,
    /// Answer to the order of this turn.
    pub answer: Option<Result<(), Refusal>>,
    /// Time since the last turn, s.
    pub dt_s: f64,
    /// The first turn of this pilot.
    pub first: bool,
}

/// The supervised loop.
#[derive(Debug, Clone)]
pub struct Supervisor {
    config: SupervisorConfig,
    state: LoopState,
    modes: Modes,
    gate: Gate,
    explain: ResidualMonitor,
    last: Option<Sensed>,
    sent: Steps,
    setpoint: Shape,
    /// What is to be proved before it is believed.
    kept: Option<RestartState>,
    /// The drivers were released away from zero: the counts mean nothing any more.
    adrift: bool,
    /// The gate moved by itself; the controller takes over once it stands.
    handing_over: bool,
    /// A way back has ended, and its last steps are on their way.
    arriving: bool,
    /// The feedback that a calibration has put aside.
    aside: Option<FeedbackConfig>,
    pace: Pace,
    stream_until: Option<f64>,
    blind_s: f64,
    /// The machine is still taking its alarm back, s.
    clearing_s: f64,
    /// Rate of the tip without bias, smoothed, rad/s, and for how long the set-point has rested, s.
    resting_rate_rad_s: Vector3<f64>,
    resting_s: f64,
    pending: Pending,
}

/// What the next tick and the machine are to be told.
#[derive(Debug, Clone, Copy, Default)]
struct Pending {
    command: Option<Command>,
    clear: bool,
    recount: Option<Steps>,
}

impl Supervisor {
    /// A pilot for pistons at zero, or for what was kept over a restart. It boots disarmed.
    #[must_use]
    pub fn new(config: SupervisorConfig, kept: Option<RestartState>) -> Self {
        let mut state = LoopState::new(&config.tick);
        let mut pending = Pending::default();
        let mut sent = Steps::default();
        if let Some(kept) = &kept {
            state.take_up(&config.tick, kept);
            sent = kept.steps;
            pending.recount = Some(sent);
        }
        let r_mm = config.tick.geometry.r_mm;
        Self {
            state,
            modes: Modes::default(),
            gate: Gate::new(&config.gate, &sent),
            explain: ResidualMonitor::new(&config.explain, r_mm),
            last: None,
            sent,
            setpoint: Shape { bend: Bend::STRAIGHT, length: Mm(config.tick.geometry.rest_length_mm) },
            kept: kept.filter(|k| k.steps != Steps::default()),
            adrift: false,
            handing_over: false,
            arriving: false,
            aside: None,
            pace: config.tick.bend_pace,
            stream_until: None,
            blind_s: 0.0,
            clearing_s: 0.0,
            resting_rate_rad_s: Vector3::zeros(),
            resting_s: 0.0,
            pending,
            config,
        }
    }

    /// There was a memory and it cannot be believed: whatever the rest says, `zero` is asked for.
    pub fn doubt(&mut self) {
        self.kept = Some(RestartState { rest: None, ..self.state.keep(&self.sent) });
    }

    /// What it runs on.
    #[must_use]
    pub fn config(&self) -> &SupervisorConfig {
        &self.config
    }

    /// The loop's memory.
    #[must_use]
    pub fn state(&self) -> &LoopState {
        &self.state
    }

    /// The mode.
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.modes.now()
    }

    /// What has tripped and was not reset.
    #[must_use]
    pub fn latched(&self) -> Option<gate::TripCause> {
        self.gate.latched()
    }

    /// What a restart needs to know.
    #[must_use]
    pub fn keep(&self) -> RestartState {
        // before the proof, what was kept is still the best there is; then what was pulsed, which is less
        // than what was sent while steps are queued, and for good after they stopped short
        let pulsed = self.last.map_or(self.sent, |sensed| sensed.counted);
        self.kept.unwrap_or_else(|| self.state.keep(&pulsed))
    }

    /// True when the next restart has nothing to prove: the pistons are at zero.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let there = self.last.is_none_or(|sensed| sensed.counted == self.sent);
        self.sent == Steps::default() && there && !self.adrift
    }

    /// Puts another configuration in place, bumpless, and gives back the old one: the pistons stay, the
    /// loop goes on with the new gains. The caller disposes of the old one outside the loop.
    pub fn reload(&mut self, new: &mut SupervisorConfig) {
        std::mem::swap(&mut self.config, new);
        if self.aside.is_some() {
            self.aside = self.config.tick.feedback.take();
        }
        self.pace = self.config.tick.bend_pace;
    }

    /// One turn.
    pub fn turn(&mut self, sensed: &Sensed, order: Option<Order>) -> CycleOutput {
        let first = self.last.is_none();
        let dt_s = self.last.map_or(self.config.gate.tick_s, |last| sensed.t.0 - last.t.0);
        self.last = Some(*sensed);
        if self.modes.now() == Mode::Boot {
            self.modes.take(Event::Opened);
        }
        let answer = order.map(|o| self.obey(o, sensed));
        let stream_ended = self.watch_stream(sensed.t);
        // a late turn is no reason for a leap of the set-point
        let paced_s = dt_s.max(0.0).min(2.0 * self.config.gate.tick_s);
        let input = Input {
            t: sensed.t,
            dt_s: paced_s,
            imu: sensed.imu,
            base_imu: sensed.base_imu,
            command: self.pending.command.take(),
            steps: sensed.counted,
            realign: false,
        };
        let frame = tick(&self.config.tick, &mut self.state, &input);
        self.setpoint = frame.setpoint;
        let raised = self.watch_senses(dt_s);
        self.watch_bias(&frame, paced_s);
        self.follow_alignment(&frame);
        let tripped = self.pass(&frame, sensed, dt_s);
        self.follow_motion(&frame, sensed);
        let fresh = self.watch_motion(&frame, sensed, paced_s);
        let mode = self.modes.now();
        CycleOutput {
            frame,
            input,
            sensed: *sensed,
            order,
            mode,
            steps: self.sent,
            counted: sensed.counted,
            energise: self.energise(),
            clear: std::mem::take(&mut self.pending.clear),
            recount: self.pending.recount.take(),
            tripped,
            latched: self.gate.latched(),
            suspicion: self.explain.suspicion().copied(),
            suspects: fresh,
            raised,
            bias_moved: self.bias_moved(),
            stream_ended,
            answer,
            dt_s,
            first,
        }
    }

    /// Alignment found, and where something was remembered, proved or doubted.
    fn follow_alignment(&mut self, frame: &Frame) {
        if self.modes.now() != Mode::Aligning || frame.estimate.is_none() || self.state.fusion.realigning() {
            return;
        }
        let Some(kept) = self.kept.take() else {
            self.state.stand(&self.config.tick, &self.sent, Bend::STRAIGHT);
            self.modes.take(Event::Aligned);
            return;
        };
        if proof::holds(&self.config.proof, &kept, &self.state) {
            proof::believe(&self.config.tick, &mut self.state, &kept);
            self.modes.take(Event::Aligned);
        } else {
            self.adrift = true;
            self.modes.take(Event::Doubted);
        }
    }

    fn watch_senses(&mut self, dt_s: f64) -> CauseSet {
        let Some(verdict) = self.state.fusion.verdict() else { return CauseSet::EMPTY };
        self.blind_s = if verdict.gyro { 0.0 } else { self.blind_s + dt_s };
        verdict.raised
    }

    /// A tip whose set-point rests does not turn for long: a mean rate that stays is the sensor's, or the
    /// base's. (What feedback corrects of it in the felt bend is no turn either.)
    fn watch_bias(&mut self, frame: &Frame, dt_s: f64) {
        let rests = frame.estimate.is_some() && frame.mode == tick::TickPhase::Holding;
        self.resting_s = if rests { self.resting_s + dt_s } else { 0.0 };
        if let Some(rate) = self.state.fusion.rate_rad_s() {
            let keep = (-dt_s / RESTING_S).exp();
            self.resting_rate_rad_s = rate + (self.resting_rate_rad_s - rate) * keep;
        }
    }

    fn bias_moved(&self) -> bool {
        if self.resting_s > 3.0 * RESTING_S && self.resting_rate_rad_s.norm() > RESTING_RAD_S {
            return true;
        }
        let fusion = &self.state.fusion;
        let now = fusion.estimator().and_then(|e| e.as_bend()).map(|f| f.gyro_bias_rad_s());
        let (Some(now), Some(rest)) = (now, fusion.rest()) else { return false };
        (now - rest.gyro_bias_rad_s).norm() > BIAS_MOVED_RAD_S
    }

    /// A stream that falls silent stops the tip.
    fn watch_stream(&mut self, now: Seconds) -> bool {
        let ended = self.stream_until.is_some_and(|until| now.0 > until);
        if ended {
            self.stream_until = None;
            // in any other mode the stream was ended by something harsher
            if self.modes.take(Event::Stop) {
                self.brake();
            }
        }
        ended
    }

    /// The gate: what goes out, and what a trip makes of the mode.
    fn pass(&mut self, frame: &Frame, sensed: &Sensed, dt_s: f64) -> Option<gate::TripCause> {
        let armed = self.modes.now().moves() && !self.handing_over;
        self.clearing_s = (self.clearing_s - dt_s).max(0.0);
        let geometry = &self.config.tick.geometry;
        let estimate = frame.estimate;
        let stretch_mm = frame.setpoint.length.0 - geometry.rest_length_mm;
        let led = armed && self.aside.is_none() && !frame.senses.held;
        if armed && !sensed.energised {
            // drivers that are not on yet take no steps: the controller waits where it is
            self.state.stand(&self.config.tick, &self.sent, estimate.map_or(Bend::STRAIGHT, |f| f.bend));
        }
        let wanted = if armed && sensed.energised { frame.steps } else { self.sent };
        let told = GateInput {
            dt_s,
            wanted,
            armed,
            estimated_bellow_mm: estimate.map(|f| residual_monitor::bellows(geometry, &f.bend.0, stretch_mm).into()),
            following: estimate.filter(|_| led).map(|f| Following { setpoint: frame.setpoint.bend.0.into(), estimate: f.bend.0.into() }),
            stale_s: self.blind_s,
            disagree: frame.senses.disagrees,
            emergency_stop: sensed.inputs.emergency_stop,
            alarm: sensed.alarm.is_some() && self.clearing_s <= 0.0,
        };
        let passed = self.gate.pass(&told);
        self.sent = passed.steps;
        if passed.tripped.is_some() {
            self.end_calibration();
            self.stream_until = None;
            self.modes.take(Event::Trip);
            if passed.tripped == Some(gate::TripCause::StepGenerator) && self.gate.is_returning() {
                self.take_alarm_back(sensed);
            }
        }
        if !passed.energise && !passed.rested && self.sent != Steps::default() {
            self.adrift = true;
        }
        // the last step must be out before the drivers are let go
        self.arriving = (self.arriving || passed.rested) && self.modes.now() == Mode::Relaxing;
        if self.arriving && sensed.counted == self.sent {
            self.arriving = false;
            self.come_to_rest();
        }
        passed.tripped
    }

    fn come_to_rest(&mut self) {
        let known = !self.adrift && self.kept.is_none() && self.state.fusion.estimate().is_some();
        if self.gate.latched().is_none() {
            self.gate.reset(&self.sent);
        }
        if known {
            self.modes.take(Event::Rested);
        } else {
            self.start_over();
            self.modes.take(Event::RestedUnaligned);
        }
    }

    /// After a move of the gate's own the controller takes over where it stands.
    fn follow_motion(&mut self, frame: &Frame, sensed: &Sensed) {
        if self.handing_over && !self.gate.is_busy() && sensed.counted == self.sent {
            self.handing_over = false;
            self.gate.reset(&self.sent);
            self.take_over(frame.estimate.map_or(Bend::STRAIGHT, |f| f.bend));
        }
        if self.modes.now() == Mode::Tracking && !self.handing_over && frame.mode == tick::TickPhase::Holding && self.stream_until.is_none()
        {
            self.modes.take(Event::Settled);
        }
    }

    fn watch_motion(&mut self, frame: &Frame, sensed: &Sensed, dt_s: f64) -> bool {
        let Some(estimate) = frame.estimate.filter(|_| self.modes.now().moves() && !self.handing_over) else {
            return false;
        };
        if frame.base_moved {
            // it is the base that is to blame, and no line can be judged until the rest is found again
            self.explain.forget();
            return false;
        }
        let seen = ResidualInput {
            dt_s,
            given: frame.bend_from_pistons.0,
            gapless: self.gapless(sensed),
            estimate: estimate.bend.0,
            answer_s: frame.dynamics.lag_s + frame.dynamics.delay_s,
            moving: frame.mode == tick::TickPhase::Tracking,
            blocked: frame.blocked,
        };
        self.explain.step(&seen).is_some()
    }

    /// Bend that the pistons would give if there were no play, rad.
    fn gapless(&self, sensed: &Sensed) -> Vector2<f64> {
        let (config, lines) = (&self.config.tick, self.state.lines());
        let piston_mm = config.drive.piston_mm(&sensed.counted);
        config.geometry.shape(&Vector3::from_fn(|i, _| lines[i].bellow_mm(piston_mm[i]))).bend.0
    }

    /// Held torque keeps a bent tip where it is; at zero, and before anything is known, none is needed.
    fn energise(&self) -> bool {
        match self.modes.now() {
            Mode::Boot | Mode::Aligning => self.finds_held(),
            Mode::Lost => false,
            Mode::Holding | Mode::Tracking | Mode::Calibrating => true,
            Mode::Relaxing => true,
            Mode::Disarmed => !self.is_at_rest() && !self.adrift,
            Mode::Faulted => !self.adrift && !self.is_at_rest(),
        }
    }

    /// Drivers that a program before this one left energised, with something remembered that is still to be
    /// proved: a bent tip is held until it is known, unless a loop that hangs is to lead elsewhere.
    fn finds_held(&self) -> bool {
        let held = self.last.is_some_and(|sensed| sensed.energised);
        held && self.kept.is_some() && self.config.gate.on.late == gate::SafeState::Hold
    }

    fn brake(&mut self) {
        self.gate.stand();
        self.handing_over = true;
    }

    fn take_over(&mut self, at: Bend) {
        self.state.stand(&self.config.tick, &self.sent, at);
        self.explain.forget();
    }

    fn end_calibration(&mut self) {
        if let Some(feedback) = self.aside.take() {
            self.config.tick.feedback = Some(feedback);
        }
    }

    /// Forgets rest and pistons: what is now is the beginning. Gains stay.
    fn start_over(&mut self) {
        let lines = *self.state.lines();
        self.state = LoopState::new(&self.config.tick);
        self.state.set_lines(lines);
        self.kept = None;
        self.adrift = false;
        self.sent = Steps::default();
        self.pending.recount = Some(self.sent);
        if self.gate.latched().is_none() {
            self.gate.reset(&self.sent);
        }
        self.explain.forget();
    }

    fn gains_are_sound(lines: &[Line; 3]) -> bool {
        lines.iter().all(|l| (0.0..=10.0).contains(&l.k_epsilon) && (0.0..=3.0).contains(&l.k_lambda_mm))
    }

    /// A set-point within what the geometry can be; the tick cuts it further.
    fn target(&self, command: &Command) -> Result<Shape, Refusal> {
        let (bend, length) = (command.bend.0, command.length.0);
        if !bend.iter().all(|x| x.is_finite()) || !length.is_finite() {
            return Err(Refusal::NotANumber);
        }
        let most = std::f64::consts::PI * 0.75;
        if bend.norm() > most {
            return Err(Refusal::TooFar);
        }
        let limits = &self.config.tick.limits;
        if !(limits.bellow_min_mm..=limits.bellow_max_mm).contains(&length) {
            return Err(Refusal::Length);
        }
        Ok(Shape { bend: Bend(bend), length: Mm(length) })
    }
}
