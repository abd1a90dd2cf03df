//! State of the supervisor. Every change of mode goes through [`Supervisor::take`].

use crate::control::{FeedbackConfig, LoopState, Pace, Path, RestartRest, RestartState};
use crate::model::{Bend, Line, Shape};
use crate::primitives::Steps;
use crate::supervisor::cycle::sensor_watch::SensorWatch;
use crate::supervisor::cycle::source::{Recent, Source};
use crate::supervisor::gate::Gate;
use crate::supervisor::mode::Event;
use crate::supervisor::residual_monitor::ResidualMonitor;
use crate::supervisor::{Mode, Refusal, Sensed, SupervisorConfig, TripCause};
use nalgebra::{Vector2, Vector3};

/// What is known about the position of the pistons.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "lives in the state of the loop, which may not allocate"
)]
pub(super) enum Position {
    /// The counts are valid.
    Known,
    /// The counts were remembered over a restart and have not been checked yet.
    Unchecked(RestartState),
    /// The drivers were released away from zero, or the check failed: the counts are invalid. Only `zero` ends it.
    Adrift,
}

/// Messages for the next tick and for the machine.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pending {
    pub(super) target: Option<Shape>,
    pub(super) clear: bool,
    pub(super) recount: Option<Steps>,
}

/// The supervised loop.
#[derive(Debug, Clone)]
pub struct Supervisor {
    pub(super) config: SupervisorConfig,
    pub(super) state: LoopState,
    pub(super) mode: Mode,
    /// While tracking: the instant by which a stream must deliver its next set-point, s.
    pub(super) stream_until_s: Option<f64>,
    /// While relaxing: the gate has sent the last step, and the machine has not counted it yet.
    pub(super) arriving: bool,
    /// While calibrating: the settings of the feedback, without which a calibration runs, and the gains in use before it.
    pub(super) set_aside: Option<(Option<FeedbackConfig>, [Line; 3])>,
    pub(super) position: Position,
    pub(super) gate: Gate,
    pub(super) residual: ResidualMonitor,
    pub(super) sensors: SensorWatch,
    pub(super) last: Option<Sensed>,
    /// Counts sent in the last cycle.
    pub(super) sent: Steps,
    /// Set-point of the last tick.
    pub(super) setpoint: Shape,
    /// Configured pace of the set-point; an order may replace its speed for one motion.
    pub(super) pace: Pace,
    /// Time that the machine still has to clear its alarm, s.
    pub(super) clearing_s: f64,
    pub(super) pending: Pending,
    /// Where the set-point comes from.
    pub(super) source: Source,
    /// The path that was loaded.
    pub(super) path: Option<Box<Path>>,
    /// Set-points that came with a time.
    pub(super) recent: Recent,
    /// A stop is latched: nothing starts a motion until the next accepted `arm`, and the gate keeps standing.
    pub(super) stopped: bool,
    /// Attitude of the straight tip at the last zero, also after a restart.
    pub(super) straight: Option<RestartRest>,
    /// The operator stated that the tip was straight, and no measurement confirmed it.
    pub(super) unverified: bool,
}

impl Supervisor {
    /// A disarmed supervisor for pistons at zero, or for the state remembered over a restart.
    pub fn new(config: SupervisorConfig, remembered: Option<RestartState>) -> Self {
        let mut state = LoopState::new(&config.tick);
        let mut pending = Pending::default();
        let mut sent = Steps::default();
        if let Some(remembered) = &remembered {
            state.take_up(&config.tick, remembered);
            sent = remembered.steps;
            pending.recount = Some(sent);
        }
        let bent = remembered.filter(|r| r.steps != Steps::default());
        Self {
            state,
            mode: Mode::Boot,
            stream_until_s: None,
            arriving: false,
            set_aside: None,
            position: bent.map_or(Position::Known, Position::Unchecked),
            gate: Gate::new(&config.gate, &sent),
            residual: ResidualMonitor::new(&config.residual, config.tick.geometry.r_mm),
            sensors: SensorWatch::default(),
            last: None,
            sent,
            setpoint: Shape::new(Vector2::zeros(), config.tick.geometry.rest_length_mm),
            pace: config.tick.bend_pace,
            clearing_s: 0.0,
            pending,
            source: Source::Target,
            path: None,
            recent: Recent::default(),
            stopped: false,
            straight: remembered.and_then(|r| r.rest),
            unverified: false,
            config,
        }
    }

    /// The pistons may have moved since this state was remembered: the measured pose decides, also at zero.
    pub fn check(&mut self, remembered: RestartState) {
        self.position = Position::Unchecked(remembered);
    }

    /// The remembered state is unusable: the supervisor asks for `zero` whatever the sensors measure.
    pub fn doubt(&mut self) {
        self.position = Position::Unchecked(RestartState {
            rest: None,
            ..self.state.keep(&self.sent)
        });
    }

    /// Takes over from a supervisor what a fresh one must not forget: the latch of a stop and an unverified zero.
    pub fn inherit(&mut self, from: &Self) {
        (self.stopped, self.unverified) = (from.stopped, from.unverified);
    }

    /// Remembers over a restart that no measurement has confirmed the last zero.
    pub fn set_unverified(&mut self) {
        self.unverified = true;
    }

    /// True if the position of the pistons is unknown, now or pending the check after a restart that cannot pass.
    pub fn is_lost(&self) -> bool {
        match self.position {
            Position::Known => false,
            Position::Unchecked(remembered) => remembered.rest.is_none(),
            Position::Adrift => true,
        }
    }

    /// True from a stop until the next accepted `arm`.
    pub fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// True if no measurement has confirmed the last zero.
    pub fn is_unverified(&self) -> bool {
        self.unverified
    }

    /// The configuration in use.
    pub fn config(&self) -> &SupervisorConfig {
        &self.config
    }

    /// State of the control loop.
    pub fn state(&self) -> &LoopState {
        &self.state
    }

    /// The mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The cause that is latched.
    pub fn latched(&self) -> Option<TripCause> {
        self.gate.latched()
    }

    /// State to be remembered for a restart. It contains the counted steps, not the sent ones: some may be queued, and
    /// the step generator may stop short of them.
    pub fn keep(&self) -> RestartState {
        let counted = self.last.map_or(self.sent, |sensed| sensed.counted);
        match self.position {
            Position::Known => self.state.keep(&counted),
            Position::Unchecked(remembered) => RestartState {
                rest: self.straight,
                ..remembered
            },
            // the alignment of a tip at an unknown position does not replace that of the straight tip
            Position::Adrift => RestartState {
                rest: self.straight,
                ..self.state.keep(&counted)
            },
        }
    }

    /// True if the pistons are known to be at zero, so that a restart has nothing to check.
    pub fn is_at_rest(&self) -> bool {
        let there = self.last.is_none() || self.gate.rests();
        self.sent == Steps::default() && there && self.position == Position::Known
    }

    /// True if a freshly reset supervisor may take the place of this one: nothing moves, nothing is latched, and the tip is
    /// straight by what it measures.
    pub fn is_idle(&self) -> bool {
        let straight_rad = self.config.restart_check.straight_deg.to_radians();
        self.mode == Mode::Disarmed
            && self.is_at_rest()
            && !self.stopped
            && self.gate.latched().is_none()
            && !self.gate.is_busy()
            && self
                .off_straight_rad()
                .is_some_and(|rad| rad <= straight_rad)
    }

    /// Angle of the tip from straight, rad: by the estimate while the position is known, otherwise between measured and
    /// remembered gravity. `None` if nothing tells.
    pub(super) fn off_straight_rad(&self) -> Option<f64> {
        if self.is_located() {
            return self.state.fusion.estimate().map(|e| e.bend.beta());
        }
        let (now, then) = (self.state.fusion.alignment()?, self.straight?);
        Some(now.acc_rest_m_s2.angle(&Vector3::from(then.acc_m_s2)))
    }

    /// Exchanges the configuration without a jump of the pistons. The caller drops the old one, which it gets back in
    /// `new`, outside the real-time loop.
    pub fn reload(&mut self, new: &mut SupervisorConfig) {
        std::mem::swap(&mut self.config, new);
        if let Some((feedback, _)) = &mut self.set_aside {
            *feedback = self.config.tick.feedback.take();
        }
        self.pace = self.config.tick.bend_pace;
    }

    /// Takes an event. What a mode has set aside goes back to where it came from when the mode is left.
    ///
    /// # Errors
    /// [`Refusal::Mode`] if the table has no transition; nothing changes then.
    pub(super) fn take(&mut self, event: Event) -> Result<(), Refusal> {
        let next = self.mode.after(event).ok_or(Refusal::Mode(self.mode))?;
        (self.mode, self.stream_until_s, self.arriving) = (next, None, false);
        if let Some((feedback, lines)) = self.set_aside.take() {
            (self.config.tick.feedback, self.config.tick.lines) = (feedback, lines);
            self.state.set_lines(&self.config.tick, lines);
        }
        if next == Mode::Calibrating {
            let feedback = self.config.tick.feedback.take();
            self.set_aside = Some((feedback, *self.state.lines()));
        }
        Ok(())
    }

    /// True if both the rest pose and the position of the pistons are known.
    pub(super) fn is_located(&self) -> bool {
        self.position == Position::Known && self.state.fusion.estimate().is_some()
    }

    /// The controller continues from the present position of the pistons and holds the tip at `at`.
    pub(super) fn take_over(&mut self, at: Bend) {
        self.state.stand(&self.config.tick, &self.sent, at);
        self.residual.forget();
    }

    /// Forgets alignment and position: the present pose is the new rest. The gains stay.
    pub(super) fn start_over(&mut self) {
        let lines = *self.state.lines();
        self.state = LoopState::new(&self.config.tick);
        self.state.set_lines(&self.config.tick, lines);
        self.position = Position::Known;
        self.sent = Steps::default();
        self.pending.recount = Some(self.sent);
        if self.gate.latched().is_none() {
            self.gate.reset(&self.sent);
        }
        self.residual.forget();
    }
}
