//! A loop and a world in lockstep.

use crate::control::tick::{Command, Frame, Input, LoopConfig, LoopState, tick};
use crate::estimation::fusion::health::ImuReading;
use crate::simulation::world::{Reply, World};
use crate::supervisor::machine::MachineError;
use thiserror::Error;

/// Longest wait for a still tip, s.
const ALIGN_MAX_S: f64 = 20.0;

/// What can stop an experiment.
#[derive(Debug, Error)]
pub enum RigError {
    /// The world ended.
    #[error(transparent)]
    World(#[from] MachineError),
    /// The tip never came to rest.
    #[error("the tip was not still within {0} s of the start ({1}); alignment needs 2 s of rest with pistons at zero")]
    NotStill(f64, String),
    /// The judge has nothing to judge by.
    #[error(
        "the plant gives no `ref`; an evaluation is scored against the true orientation, so the plant must answer with \"ref\":{{\"quat\":[w,x,y,z]}}"
    )]
    NoReference,
}

/// One loop living in one world.
pub struct Rig<'w> {
    /// The loop's settings.
    pub config: LoopConfig,
    /// The loop's memory.
    pub state: LoopState,
    world: &'w mut dyn World,
    input: Input,
}

impl<'w> Rig<'w> {
    /// A fresh loop at rest; nothing has moved yet.
    pub fn new(config: LoopConfig, world: &'w mut dyn World) -> Self {
        let state = LoopState::new(&config);
        let dt_s = world.info().period_s;
        let input = Input { dt_s, ..Input::default() };
        Self { config, state, world, input }
    }

    /// One tick and one period of the world.
    ///
    /// # Errors
    /// The world's.
    pub fn advance(&mut self, command: Option<Command>) -> Result<(Frame, Reply), RigError> {
        self.input.command = command;
        let frame = tick(&self.config, &mut self.state, &self.input);
        let reply = self.world.step(&frame.steps)?;
        let imu = ImuReading::from_world(reply.imu);
        self.input = Input { t: reply.t, imu, steps: frame.steps, command: None, ..self.input };
        Ok((frame, reply))
    }

    /// Lets time pass until the rest is found.
    ///
    /// # Errors
    /// [`RigError::NotStill`] after 20 s, or the world's.
    pub fn align(&mut self) -> Result<(), RigError> {
        while self.state.fusion.estimate().is_none() {
            let (frame, _) = self.advance(None)?;
            if frame.t.0 > ALIGN_MAX_S {
                return Err(RigError::NotStill(ALIGN_MAX_S, self.state.fusion.waiting_for()));
            }
        }
        Ok(())
    }

    /// Goes on with other transmission gains; where the pistons stand is kept.
    pub fn relearn(&mut self, lines: [crate::model::transmission::Line; 3]) {
        self.config.lines = lines;
        self.state.set_lines(lines);
    }

    /// Period of the world, s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        self.input.dt_s
    }
}
