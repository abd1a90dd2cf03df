//! Lumens of one catheter: a pressurised lumen swells into its neighbours; an evacuated one does not.
//!
//! A line whose bellow is elongated by `q` displaces `c q²/(q + 0.8 mm)` worth of elongation in its
//! neighbours (soft at first, then proportional), more in the one that it lies nearer to.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.crosstalk]`
    Crosstalk at "effects.crosstalk" sized by share; background 0.0015; drawn by rng, severity {
        /// Elongation given to each neighbour per elongation, c. Default 0 (none); typical 0.01 to 0.3.
        /// A larger value bends less and lengthens more.
        share: f64 = 0.0, -0.4..=0.4, "more than that and the lines feed each other", draw rng.sized(0.05, 0.3, severity);
        /// How much nearer a lumen lies to the next channel than to the one before, −1 to 1. Default
        /// 0.25. A larger value turns the bend more to one side.
        lopsided: f64 = 0.25, -1.0..=1.0, "1 reaches one neighbour only", draw rng.between(-0.6, 0.6);
    }
    /// The couplings of one unit.
    Squeezing runs config, unit {
        k_epsilon: Vector3<f64> = unit.k_epsilon;
    }
}

/// Elongation at which squeezing has half its slope, mm.
const KNEE_MM: f64 = 0.8;

impl Law for Squeezing {
    /// What the others press into each line: elongation times what a line needs for it.
    fn air(&mut self, air_mm: &mut Vector3<f64>, bellows: &BellowState, _at: &Moment) {
        let Crosstalk { share, lopsided } = self.config;
        let swell = bellows.bellow_mm.map(|q| {
            if q > 0.0 {
                share * q * q / (q + KNEE_MM)
            } else {
                0.0
            }
        });
        *air_mm += Vector3::from_fn(|i, _| {
            let (before, after) = (swell[(i + 2) % 3], swell[(i + 1) % 3]);
            (before * (1.0 + lopsided) + after * (1.0 - lopsided)) * (1.0 + self.k_epsilon[i])
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pressure_moves_the_neighbours_and_vacuum_does_not() {
        let squeezed_mm = |lopsided: f64, bellow_mm: Vector3<f64>| {
            let config = Crosstalk {
                share: 0.1,
                lopsided,
            };
            let k_epsilon = Vector3::repeat(2.0);
            let (mut law, mut air_mm) = (Squeezing { config, k_epsilon }, Vector3::zeros());
            let bellows = BellowState {
                bellow_mm,
                ..BellowState::default()
            };
            law.air(&mut air_mm, &bellows, &Moment { t: 0.0, dt_s: 0.0 });
            air_mm
        };
        let pushed = squeezed_mm(0.0, Vector3::new(5.0, 0.0, 0.0));
        assert!(pushed.x == 0.0 && pushed.y > 1.0 && pushed.y == pushed.z);
        assert_eq!(squeezed_mm(0.0, Vector3::new(-5.0, 0.0, 0.0)).norm(), 0.0);
        assert_eq!(squeezed_mm(1.0, Vector3::new(5.0, 0.0, 0.0)).z, 0.0);
    }
}
