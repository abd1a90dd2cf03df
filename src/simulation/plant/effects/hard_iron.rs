//! Magnetised parts that turn with the sensor, some of which are magnetised slowly.
//!
//! A constant body-fixed field `b`, plus `v |b|` along the field that the parts have been in over the
//! last 15 s (magnetic viscosity).

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.hard_iron]`
    HardIron at "effects.hard_iron" sized by offset_ut {
        /// Field b of the parts, µT per axis. Default 0 (none); typical 1 to 50. A larger value turns the heading
        /// more.
        offset_ut: [f64; 3] = [0.0; 3], "", -500.0..=500.0, "1 to 50 µT is typical";
        /// Share v that follows slowly. Default 0.1. A larger value remembers attitudes more.
        viscous: f64 = 0.1, "", 0.0..=1.0, "0.1 is typical";
    }
}

impl PlantEffect for HardIron {
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let size = rng.sized(4.0, 40.0, severity);
        Self { offset_ut: (rng.direction() * size).into(), viscous: rng.between(0.02, 0.15) }
    }
    fn background(up_to: &mut dyn FnMut(f64) -> f64) -> Option<Self> {
        Some(Self { offset_ut: [0; 3].map(|_| up_to(0.06)), ..Self::default() })
    }
}

/// Time over which parts are magnetised, s.
const VISCOUS_S: f64 = 15.0;

/// Parts with the field they have acquired.
#[derive(Debug, Clone)]
pub(crate) struct Iron {
    config: HardIron,
    decay: Decay,
    acquired: Option<Vector3<f64>>,
}

impl Iron {
    pub(crate) fn new(config: HardIron) -> Self {
        Self { config, decay: Decay::new(VISCOUS_S), acquired: None }
    }
    /// Field of the parts, µT, `dt_s` later in the outer field `outer`.
    pub(crate) fn field(&mut self, outer: &Vector3<f64>, dt_s: f64) -> Vector3<f64> {
        // before the first sample the parts have been in the same field
        let before = self.acquired.unwrap_or(*outer);
        let acquired = before + (outer - before) * self.decay.share(dt_s);
        self.acquired = Some(acquired);
        let offset = Vector3::from(self.config.offset_ut);
        offset + acquired.try_normalize(1e-9).unwrap_or_default() * (self.config.viscous * offset.norm())
    }
}

impl Law for Iron {
    fn sensor(&mut self, stimulus: &mut Stimulus, at: &Moment) {
        stimulus.field += self.field(&stimulus.field, at.dt_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_is_fixed_to_the_body_except_for_its_viscous_part() {
        let mut iron = Iron::new(HardIron { offset_ut: [10.0, 0.0, 0.0], viscous: 0.1 });
        let first = iron.field(&Vector3::new(0.0, 40.0, 0.0), 0.01);
        assert!((first - Vector3::new(10.0, 1.0, 0.0)).norm() < 1e-9);
        let turned = iron.field(&Vector3::new(0.0, -40.0, 0.0), 0.01);
        assert!((turned - first).norm() < 0.01);
        for _ in 0..20_000 {
            iron.field(&Vector3::new(0.0, -40.0, 0.0), 0.01);
        }
        assert!((iron.field(&Vector3::new(0.0, -40.0, 0.0), 0.01) - Vector3::new(10.0, -1.0, 0.0)).norm() < 1e-3);
    }
}
