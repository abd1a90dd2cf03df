//! Any [`World`] as a [`Machine`].

use crate::estimation::fusion::health::ImuReading;
use crate::motion::lines::Inputs;
use crate::primitives::units::{Seconds, Steps};
use crate::simulation::world::World;
use crate::supervisor::machine::{Machine, MachineError, MachineInfo, Sensed};

/// Turns of a world that one turn of a late loop may catch up on at most.
const CATCH_UP_MAX: u32 = 2000;

/// Any [`World`] as a machine: with drivers off it stands, and a late loop finds that the world went on
/// without it, on the counts it had.
#[derive(Debug, Clone)]
pub struct Lockstep<W> {
    /// The world.
    pub world: W,
    /// Time the world has reached.
    reached_s: f64,
    /// Counts that the world was told last; it counts from its own zero.
    held: Steps,
    /// World counts that the loop calls zero.
    zero: Steps,
    energised: bool,
}

impl<W: World> Lockstep<W> {
    /// A world at rest with its drivers off.
    pub fn new(world: W) -> Self {
        Self { world, reached_s: 0.0, held: Steps::default(), zero: Steps::default(), energised: false }
    }
}

impl<W: World + Send> Machine for Lockstep<W> {
    fn info(&self) -> &MachineInfo {
        self.world.info()
    }

    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        let period_s = self.world.info().period_s;
        let mut said = Sensed {
            t: now,
            imu: ImuReading::Nothing,
            base_imu: None,
            counted: Steps::default(),
            energised: self.energised,
            inputs: Inputs::default(),
            alarm: None,
            truth: None,
        };
        let periods = (((now.0 - self.reached_s) / period_s).round().max(0.0) as u32).min(CATCH_UP_MAX);
        for k in 0..periods {
            // what is wanted now is only there in the last of several periods
            if k + 1 == periods && self.energised {
                self.held = Steps([0, 1, 2].map(|i| wanted.0[i].wrapping_add(self.zero.0[i])));
            }
            let reply = self.world.step(&self.held)?;
            if let Some(sample) = reply.imu {
                said.imu = ImuReading::from_world(Some(sample));
            }
            said.truth = reply.truth;
        }
        self.reached_s += f64::from(periods) * period_s;
        said.counted = Steps([0, 1, 2].map(|i| self.held.0[i].wrapping_sub(self.zero.0[i])));
        Ok(said)
    }

    fn energise(&mut self, on: bool) {
        self.energised = on;
    }

    fn recount(&mut self, counted: &Steps) {
        self.zero = Steps([0, 1, 2].map(|i| self.held.0[i].wrapping_sub(counted.0[i])));
    }

    fn clear(&mut self) {}

    fn is_simulated(&self) -> bool {
        true
    }

    fn remarks(&self) -> Vec<String> {
        vec![format!("plant {}", self.world.info().name)]
    }
}
