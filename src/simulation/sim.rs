//! The built-in plant as a world: one tick of the loop is one step of the truth.

use crate::primitives::units::Steps;
use crate::simulation::plant::{Output, Plant, PlantConfig, PlantError};
use crate::simulation::world::{Reply, World};
use crate::supervisor::machine::{MachineError, MachineInfo};

/// A running built-in plant.
#[derive(Debug, Clone)]
pub struct Sim {
    plant: Plant,
    info: MachineInfo,
    last: Option<Output>,
}

impl Sim {
    /// The unit that `unit_seed` draws from the make's spread (0 is the make itself), with noise of its own
    /// for every `noise_seed`, stepped once per `period_s`.
    ///
    /// # Errors
    /// [`PlantError`] for a parameter that the physics cannot run with.
    pub fn new(make: &PlantConfig, unit_seed: u64, noise_seed: u64, period_s: f64) -> Result<Self, PlantError> {
        let unit = if unit_seed == 0 { make.clone() } else { make.drawn(unit_seed) };
        let info =
            MachineInfo { name: "built-in".to_owned(), period_s, step_mm: unit.drive.step_mm, rest_length_mm: unit.shape.rest_length_mm };
        // noise of one unit is not the noise of the next
        let seed = unit_seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(noise_seed);
        Ok(Self { plant: Plant::new(&unit, seed)?, info, last: None })
    }

    /// The truth behind the last answer, for judges.
    #[must_use]
    pub fn last(&self) -> Option<&Output> {
        self.last.as_ref()
    }

    /// The truth itself, to break something in it.
    pub fn plant_mut(&mut self) -> &mut Plant {
        &mut self.plant
    }

    /// The unit.
    #[must_use]
    pub fn unit(&self) -> &PlantConfig {
        self.plant.config()
    }
}

impl World for Sim {
    fn info(&self) -> &MachineInfo {
        &self.info
    }

    fn step(&mut self, steps: &Steps) -> Result<Reply, MachineError> {
        let out = self.plant.step(steps, self.info.period_s);
        self.last = Some(out);
        Ok(Reply { t: out.t, imu: out.imu, truth: Some(out.truth.r_base_tip) })
    }
}
