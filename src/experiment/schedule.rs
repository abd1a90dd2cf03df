//! Which poses are held, in which order.
//!
//! The paper says 12 directions, 5 angles, 120 states. Read here as: in every direction out through
//! 15, 30, 45, 60, 75° and back through the same five, so that each angle is met from below and from
//! above; then straight on to the next direction.

use crate::model::bend::Bend;

/// A pose that is held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Bend angle β, degrees.
    pub bend_deg: f64,
    /// Bend direction δ, degrees.
    pub dir_deg: f64,
    /// Approached from smaller bends.
    pub outward: bool,
}

impl Pose {
    /// The pose as a bend vector.
    #[must_use]
    pub fn bend(&self) -> Bend {
        Bend::from_deg(self.bend_deg, self.dir_deg)
    }
}

/// Seconds a pose is held.
pub const HOLD_S: f64 = 1.5;
/// Seconds at the end of a hold that are scored.
pub const SCORED_S: f64 = 0.3;
/// Angles of the paper, degrees.
pub const ANGLES_DEG: [f64; 5] = [15.0, 30.0, 45.0, 60.0, 75.0];
/// Directions of the paper.
pub const DIRECTIONS: usize = 12;

/// The 120 states.
#[must_use]
pub fn paper() -> Vec<Pose> {
    let pose = |bend_deg: f64, d: usize, outward| Pose { bend_deg, dir_deg: d as f64 * 360.0 / DIRECTIONS as f64, outward };
    (0..DIRECTIONS)
        .flat_map(|d| {
            let out = ANGLES_DEG.iter().map(move |&a| pose(a, d, true));
            let back = ANGLES_DEG.iter().rev().map(move |&a| pose(a, d, false));
            out.chain(back)
        })
        .collect()
}

/// Twenty-four poses for a calibration with a prior: in every direction out to 70° and back to 40°, so that
/// each bellow is met strained on both sides of its backlash (poses met from one side alone would let
/// the extension pass for backlash). Opposite directions follow each other: what grows with time does
/// not pass for a gain.
#[must_use]
pub fn short() -> Vec<Pose> {
    (0..24)
        .map(|n| {
            let (turn, outward) = (n / 2, n % 2 == 0);
            let dir_deg = f64::from((turn / 2) * 30 + (turn % 2) * 180);
            Pose { bend_deg: if outward { 70.0 } else { 40.0 }, dir_deg, outward }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hundred_and_twenty_states_each_angle_from_both_sides() {
        let all = paper();
        assert_eq!(all.len(), 120);
        for a in ANGLES_DEG {
            assert_eq!(all.iter().filter(|p| p.bend_deg == a && p.outward).count(), 12);
            assert_eq!(all.iter().filter(|p| p.bend_deg == a && !p.outward).count(), 12);
        }
    }

    #[test]
    fn the_short_form_is_twenty_four_different_poses() {
        let all = short();
        assert_eq!(all.len(), 24);
        for (i, a) in all.iter().enumerate() {
            assert!(all[i + 1..].iter().all(|b| a.bend_deg != b.bend_deg || a.dir_deg != b.dir_deg));
        }
    }
}
