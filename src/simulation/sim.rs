//! The built-in plant as a [`World`].

use crate::motion::{MachineError, MachineInfo};
use crate::primitives::Steps;
use crate::simulation::plant::{Output, Plant, PlantConfig, PlantError};
use crate::simulation::world::{Reply, World};

/// A running built-in plant.
#[derive(Debug)]
pub struct Sim {
    /// The plant, for fault injection.
    pub plant: Plant,
    /// The last output with the true state, for scoring only.
    pub last: Option<Output>,
    info: MachineInfo,
}

impl Sim {
    /// The unit that `unit_seed` draws from the spread of `make` (0 is the make itself), with the noise of
    /// `noise_seed`, stepped once per `period_s`.
    ///
    /// # Errors
    /// [`PlantError`] for a parameter that the physics does not support.
    pub fn new(
        make: &PlantConfig,
        unit_seed: u64,
        noise_seed: u64,
        period_s: f64,
    ) -> Result<Self, PlantError> {
        let unit = match unit_seed {
            0 => make.clone(),
            _ => make.drawn(unit_seed),
        };
        let info = MachineInfo {
            name: "built-in".to_owned(),
            period_s,
            step_mm: unit.drive.step_mm,
            rest_length_mm: unit.shape.rest_length_mm,
        };
        // the noise differs from unit to unit: the multiplier (2⁶⁴ over the golden ratio) spreads the seeds
        let seed = unit_seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        Ok(Self {
            plant: Plant::new(&unit, seed.wrapping_add(noise_seed))?,
            info,
            last: None,
        })
    }
}

impl World for Sim {
    fn info(&self) -> &MachineInfo {
        &self.info
    }

    fn step(&mut self, steps: &Steps) -> Result<Reply, MachineError> {
        let out = self.plant.step(steps, self.info.period_s);
        self.last = Some(out);
        Ok(Reply {
            imu: out.imu,
            base_imu: out.base_imu,
            truth: Some(out.truth.r_base_tip),
        })
    }
}
