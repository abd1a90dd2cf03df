//! Any [`World`] as a [`Machine`].

use crate::estimation::fusion::health::ImuReading;
use crate::motion::lines::Inputs;
use crate::primitives::units::{Seconds, Steps};
use crate::simulation::world::World;
use crate::supervisor::machine::{Machine, MachineError, MachineInfo, Sensed};

/// Largest number of periods that the world advances in one cycle of a late loop.
const CATCH_UP_MAX: u32 = 2000;

/// Any [`World`] as a machine: with its drivers off it holds its counts, and during a late cycle of the loop it
/// advances with the counts of the cycle before.
#[derive(Debug, Clone)]
pub struct Lockstep<W> {
    /// The world.
    pub world: W,
    /// Time that the world has reached, s.
    reached_s: f64,
    /// Counts last sent to the world, from its own zero.
    held: Steps,
    /// Counts of the world at the zero of the loop.
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
        let mut sensed = Sensed {
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
            // the new counts apply to the last of several periods only
            if k + 1 == periods && self.energised {
                self.held = Steps([0, 1, 2].map(|i| wanted.0[i].wrapping_add(self.zero.0[i])));
            }
            let reply = self.world.step(&self.held)?;
            if let Some(sample) = reply.imu {
                sensed.imu = ImuReading::from_world(Some(sample));
            }
            sensed.truth = reply.truth;
        }
        self.reached_s += f64::from(periods) * period_s;
        sensed.counted = Steps([0, 1, 2].map(|i| self.held.0[i].wrapping_sub(self.zero.0[i])));
        Ok(sensed)
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
