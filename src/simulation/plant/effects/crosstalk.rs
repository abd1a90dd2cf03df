//! Lumens of one catheter: a pressurised lumen swells into its neighbours; an evacuated one does not.
//!
//! A line whose bellow is elongated by `q` displaces `c q²/(q + 0.8 mm)` worth of elongation in its
//! neighbours (soft at first, then proportional), more in the one that it lies nearer to.

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.crosstalk]`
    Crosstalk at "effects.crosstalk" sized by share {
        /// Elongation given to each neighbour per elongation, c. Default 0 (none); typical 0.01 to 0.3.
        /// A larger value bends less and lengthens more.
        share: f64 = 0.0, "", -0.4..=0.4, "more than that and the lines feed each other";
        /// How much nearer a lumen lies to the next channel than to the one before, −1 to 1. Default
        /// 0.25. A larger value turns the bend more to one side.
        lopsided: f64 = 0.25, "", -1.0..=1.0, "1 reaches one neighbour only";
    }
}

impl PlantEffect for Crosstalk {
    const BACKGROUND: f64 = 0.0015;
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self {
            share: rng.sized(0.05, 0.3, severity),
            lopsided: rng.between(-0.6, 0.6),
        }
    }
}

/// Elongation at which squeezing has half its slope, mm.
const KNEE_MM: f64 = 0.8;

impl Crosstalk {
    /// What is pressed into each line by the others, mm of piston: elongation times what a line needs
    /// for it.
    pub(crate) fn squeezed_mm(
        &self,
        bellow_mm: &Vector3<f64>,
        k_epsilon: &Vector3<f64>,
    ) -> Vector3<f64> {
        let swell = bellow_mm.map(|q| {
            if q > 0.0 {
                self.share * q * q / (q + KNEE_MM)
            } else {
                0.0
            }
        });
        Vector3::from_fn(|i, _| {
            let (before, after) = (swell[(i + 2) % 3], swell[(i + 1) % 3]);
            (before * (1.0 + self.lopsided) + after * (1.0 - self.lopsided)) * (1.0 + k_epsilon[i])
        })
    }
}

/// The couplings of one unit.
#[derive(Debug, Clone)]
pub(crate) struct Squeezing {
    pub(crate) crosstalk: Crosstalk,
    pub(crate) k_epsilon: Vector3<f64>,
}

impl Law for Squeezing {
    fn air(&mut self, air_mm: &mut Vector3<f64>, bellows: &BellowState, _at: &Moment) {
        *air_mm += self
            .crosstalk
            .squeezed_mm(&bellows.bellow_mm, &self.k_epsilon);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pressure_moves_the_neighbours_and_vacuum_does_not() {
        let c = Crosstalk {
            share: 0.1,
            lopsided: 0.0,
        };
        let k = Vector3::repeat(2.0);
        let pushed = c.squeezed_mm(&Vector3::new(5.0, 0.0, 0.0), &k);
        assert!(pushed.x == 0.0 && pushed.y > 1.0 && pushed.y == pushed.z);
        assert_eq!(c.squeezed_mm(&Vector3::new(-5.0, 0.0, 0.0), &k).norm(), 0.0);
        let lop = Crosstalk { lopsided: 1.0, ..c };
        assert_eq!(lop.squeezed_mm(&Vector3::new(5.0, 0.0, 0.0), &k).z, 0.0);
    }
}
