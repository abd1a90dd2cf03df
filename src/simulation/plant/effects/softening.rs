//! Rubber that its first stretches soften (Mullins effect), as damage by stored energy.
//!
//! The largest strain so far, `m = max(q, −0.7 q)`, breaks bonds and leaves the share
//! `D = 1 − d (1 − e^(−(m/s)²))` of the stiffness. Below the largest strain nothing changes (Simo 1987, with
//! energy taken as quadratic).

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.softening]`
    Softening at "effects.softening" sized by share {
        /// Share d of the wall's stiffness that can be lost. Default 0 (none); typical 0.05 to 0.6.
        /// A larger value bends more after the first large stretch.
        share: f64 = 0.0, "", 0.0..=0.9, "a wall that loses all its stiffness is a burst";
        /// Stretch s at which 63 % of it is lost, mm. Default 3. A larger value needs larger stretches.
        stretch_mm: f64 = 3.0, "", 0.1..=50.0, "a bellow stretches by 5 mm or so";
    }
}

impl PlantEffect for Softening {
    const BACKGROUND: f64 = 0.003;
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self {
            share: rng.sized(0.1, 0.5, severity),
            stretch_mm: rng.between(2.0, 4.0),
        }
    }
}

/// How much a contraction strains the wall compared with an elongation.
const CONTRACTION: f64 = 0.7;

/// What each wall has been through.
#[derive(Debug, Clone)]
pub(crate) struct Damage {
    config: Softening,
    worst_mm: Vector3<f64>,
    left: Vector3<f64>,
}

impl Damage {
    pub(crate) fn new(config: Softening) -> Self {
        Self {
            config,
            worst_mm: Vector3::zeros(),
            left: Vector3::repeat(1.0),
        }
    }
    /// The walls have been stretched to `bellow_mm`.
    pub(crate) fn stretch(&mut self, bellow_mm: &Vector3<f64>) {
        for i in 0..3 {
            let strain = bellow_mm[i].max(-CONTRACTION * bellow_mm[i]);
            if strain > self.worst_mm[i] {
                self.worst_mm[i] = strain;
                self.left[i] =
                    1.0 + self.config.share * (-(strain / self.config.stretch_mm).powi(2)).exp_m1();
            }
        }
    }
}

impl Law for Damage {
    fn softening(&mut self, stiffness: &mut Vector3<f64>, bellow_mm: &Vector3<f64>) {
        self.stretch(bellow_mm);
        stiffness.component_mul_assign(&self.left);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stiffness_falls_only_beyond_the_past_maximum() {
        let mut d = Damage::new(Softening {
            share: 0.4,
            ..Softening::default()
        });
        d.stretch(&Vector3::new(3.0, -3.0, 0.0));
        let once = d.left;
        assert!(once.x < 0.76 && once.y > once.x && once.y < 1.0 && once.z == 1.0);
        for q in [0.0, 2.9, -4.0, 3.0] {
            d.stretch(&Vector3::new(q, 0.0, 0.0));
        }
        assert_eq!(d.left.x, once.x);
        d.stretch(&Vector3::new(5.0, 0.0, 0.0));
        assert!(d.left.x < once.x && d.left.x > 0.6);
    }
}
