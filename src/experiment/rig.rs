//! A loop and a world in lockstep. The pistons follow the loop's targets as those of the hardware do ([`Lockstep`]).

use crate::control::tick::{Frame, Input, LoopConfig, LoopState, Reference, tick};
use crate::model::Shape;
use crate::primitives::Seconds;
use crate::simulation::lockstep::Lockstep;
use crate::simulation::world::World;
use crate::supervisor::{Machine, MachineError, Sensed};
use thiserror::Error;

/// Longest duration of the alignment, s.
const ALIGN_MAX_S: f64 = 20.0;

/// Why an experiment failed.
#[derive(Debug, Error)]
pub enum RigError {
    /// The world failed.
    #[error(transparent)]
    World(#[from] MachineError),
    /// The tip did not come to rest.
    #[error(
        "the tip was not still within {0} s of the start ({1}); the alignment needs 2 s of rest with the pistons at zero"
    )]
    NotStill(f64, String),
    /// The world has no reference for the score.
    #[error(
        "the plant gives no `ref`, the true orientation of its tip, which it is judged by; it must answer with \"ref\":{{\"quat\":[w,x,y,z]}}"
    )]
    NoReference,
}

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
    pub fn advance(&mut self, command: Option<Shape>) -> Result<(Frame, Sensed), RigError> {
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
    /// [`RigError::NotStill`] after 20 s, or those of the world.
    pub fn align(&mut self) -> Result<(), RigError> {
        while self.state.fusion.estimate().is_none() {
            let (frame, _) = self.advance(None)?;
            if frame.t.0 > ALIGN_MAX_S {
                let waiting_for = self.state.fusion.waiting_for();
                return Err(RigError::NotStill(ALIGN_MAX_S, waiting_for));
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
