//! Rubber that its first stretches soften (Mullins effect), as damage by stored energy.
//!
//! The largest strain so far, `m = max(q, −0.7 q)`, breaks bonds and leaves the share
//! `D = 1 − d (1 − e^(−(m/s)²))` of the stiffness. Below the largest strain nothing changes (Simo 1987, with
//! energy taken as quadratic).

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.softening]`
    Softening at "effects.softening" sized by share; background 0.003; drawn by rng, severity {
        /// Share d of the wall's stiffness that can be lost. Default 0 (none); typical 0.05 to 0.6.
        /// A larger value bends more after the first large stretch.
        share: f64 = 0.0, 0.0..=0.9, "a wall that loses all its stiffness is a burst", draw rng.sized(0.1, 0.5, severity);
        /// Stretch s at which 63 % of it is lost, mm. Default 3. A larger value needs larger stretches.
        stretch_mm: f64 = 3.0, 0.1..=50.0, "a bellow stretches by 5 mm or so", draw rng.between(2.0, 4.0);
    }
    /// What each wall has been through.
    Damage runs config {
        worst_mm: Vector3<f64> = Vector3::zeros();
        left: Vector3<f64> = Vector3::repeat(1.0);
    }
}

/// How much a contraction strains the wall compared with an elongation.
const CONTRACTION: f64 = 0.7;

impl Law for Damage {
    fn softening(&mut self, stiffness: &mut Vector3<f64>, bellow_mm: &Vector3<f64>) {
        let c = &self.config;
        for i in 0..3 {
            let strain = bellow_mm[i].max(-CONTRACTION * bellow_mm[i]);
            if strain > self.worst_mm[i] {
                self.worst_mm[i] = strain;
                self.left[i] = 1.0 + c.share * (-(strain / c.stretch_mm).powi(2)).exp_m1();
            }
        }
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
        let mut left = |x, y| {
            let mut stiffness = Vector3::repeat(1.0);
            d.softening(&mut stiffness, &Vector3::new(x, y, 0.0));
            stiffness
        };
        let once = left(3.0, -3.0);
        assert!(once.x < 0.76 && once.y > once.x && once.y < 1.0 && once.z == 1.0);
        for q in [0.0, 2.9, -4.0, 3.0] {
            assert_eq!(left(q, 0.0).x, once.x);
        }
        let far = left(5.0, 0.0).x;
        assert!(far < once.x && far > 0.6);
    }
}
