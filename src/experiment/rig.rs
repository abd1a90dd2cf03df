//! A loop and a world in lockstep. The pistons follow the loop's targets as those of the hardware do ([`Lockstep`]).

use crate::control::tick::{Frame, Input, LoopConfig, LoopState, Reference, tick};
use crate::experiment::error::ExperimentError;
use crate::model::Shape;
use crate::primitives::Seconds;
use crate::simulation::lockstep::Lockstep;
use crate::simulation::world::World;
use crate::simulation::{Machine, Sensed};

/// Longest duration of the alignment, s.
const ALIGN_MAX_S: f64 = 20.0;

/// A loop and its world.
pub struct Rig<'w> {
    /// Configuration of the loop.
    pub config: LoopConfig,
    /// State of the loop.
    pub state: LoopState,
    /// Moving reference of the next tick.
    pub reference: Option<Reference>,
    machine: Lockstep<&'w mut dyn World>,
    input: Input,
    ticks: u64,
}

impl<'w> Rig<'w> {
    /// A fresh loop at rest, with energised drivers.
    pub fn new(config: LoopConfig, world: &'w mut dyn World) -> Self {
        let input = Input {
            dt_s: world.info().period_s,
            ..Input::default()
        };
        let mut machine = Lockstep::new(world, &config.motion);
        machine.energise(true);
        Self {
            state: LoopState::new(&config),
            config,
            reference: None,
            machine,
            input,
            ticks: 0,
        }
    }

    /// One tick and one period of the world. The true orientation is in [`Sensed::truth`], for scoring.
    ///
    /// # Errors
    /// Those of the world.
    pub fn advance(&mut self, command: Option<Shape>) -> Result<(Frame, Sensed), ExperimentError> {
        self.input.command = command;
        self.input.reference = self.reference.take();
        let frame = tick(&self.config, &mut self.state, &self.input);
        self.ticks += 1;
        let now = Seconds(self.ticks as f64 * self.input.dt_s);
        let sensed = self.machine.turn(now, &frame.steps)?;
        self.input = Input {
            t: now,
            imu: sensed.imu,
            base_imu: sensed.base_imu,
            steps: sensed.counted,
            command: None,
            ..self.input
        };
        Ok((frame, sensed))
    }

    /// Waits for the alignment.
    ///
    /// # Errors
    /// [`ExperimentError::NotStill`] after 20 s, or those of the world.
    pub fn align(&mut self) -> Result<(), ExperimentError> {
        while self.state.fusion.estimate().is_none() {
            let (frame, _) = self.advance(None)?;
            if frame.t.0 > ALIGN_MAX_S {
                let waiting_for = self.state.fusion.waiting_for();
                return Err(ExperimentError::NotStill(ALIGN_MAX_S, waiting_for));
            }
        }
        Ok(())
    }

    /// Continues with other transmission gains; the pistons stay where they are.
    pub fn relearn(&mut self, lines: [crate::model::transmission::Line; 3]) {
        self.config.lines = lines;
        self.state.set_lines(&self.config, lines);
    }

    /// Time of the next tick.
    pub fn now(&self) -> Seconds {
        self.input.t
    }

    /// Period of the world, s.
    pub fn period_s(&self) -> f64 {
        self.input.dt_s
    }
}
