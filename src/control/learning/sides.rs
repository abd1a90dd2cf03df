//! Side of the backlash on which each piston pushes (Eq. 21), from the counted steps.

use nalgebra::Vector3;

/// Travel after a reversal that crosses the widest plausible backlash, mm: twice a half-width of 1.2 mm.
const SIDE_TRAVEL_MM: f64 = 2.4;

/// Direction of each piston, and its travel since the last reversal.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sides {
    last_mm: Vector3<f64>,
    /// Direction of the last motion: −1, 1, or 0 before the first.
    pub side: Vector3<f64>,
    travel_mm: Vector3<f64>,
}

impl Sides {
    /// Follows the pistons, mm.
    pub fn follow(&mut self, piston_mm: &Vector3<f64>) {
        for i in 0..3 {
            let step = piston_mm[i] - self.last_mm[i];
            if step * self.side[i] < 0.0 || (self.side[i] == 0.0 && step != 0.0) {
                (self.side[i], self.travel_mm[i]) = (step.signum(), 0.0);
            }
            self.travel_mm[i] += step.abs();
        }
        self.last_mm = *piston_mm;
    }

    /// Last position of the pistons, mm.
    pub fn piston_mm(&self) -> Vector3<f64> {
        self.last_mm
    }

    /// Weight of the row of each channel (Eq. 26): 1 once the piston has certainly crossed its backlash, else 0.
    pub fn weight(&self) -> Vector3<f64> {
        self.travel_mm
            .map(|t| if t >= SIDE_TRAVEL_MM { 1.0 } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_side_counts_once_the_piston_has_crossed_the_widest_backlash() {
        let mut sides = Sides::default();
        let mut weights = Vec::new();
        for x in [1.0, 3.0, 2.0, 0.5] {
            sides.follow(&Vector3::new(x, 0.0, -x));
            weights.push((sides.side[0], sides.weight()[0]));
        }
        assert_eq!(weights, [(1.0, 0.0), (1.0, 1.0), (-1.0, 0.0), (-1.0, 1.0)]);
        assert_eq!(
            (sides.side[1], sides.weight()[1]),
            (0.0, 0.0),
            "a piston at rest has no side"
        );
    }
}
