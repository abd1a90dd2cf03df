//! Schedules of the poses to be held.
//!
//! The paper states 12 directions, 5 angles and 120 states. This is read as: in every direction out through 15, 30, 45,
//! 60 and 75° and back through the same five, so that each angle is reached from below and from above; then directly on
//! to the next direction.

use crate::model::bend::Bend;

/// A pose to be held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Bend angle β, degrees.
    pub bend_deg: f64,
    /// Bend direction δ, degrees.
    pub dir_deg: f64,
    /// The previous bend is smaller.
    pub outward: bool,
}

impl Pose {
    /// The pose as a bend vector.
    #[must_use]
    pub fn bend(&self) -> Bend {
        Bend::from_deg(self.bend_deg, self.dir_deg)
    }
}

/// Duration of a hold, s.
pub const HOLD_S: f64 = 1.5;
/// Scored time at the end of a hold, s.
pub const SCORED_S: f64 = 0.3;
/// Bend angles of the paper, degrees.
pub const ANGLES_DEG: [f64; 5] = [15.0, 30.0, 45.0, 60.0, 75.0];
/// Number of directions of the paper.
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

/// The 24 poses of a calibration with a prior: in every direction out to 70° and back to 40°, so that each bellow is
/// strained on both sides of its backlash; poses from one side only cannot separate extension from backlash. Opposite
/// directions follow each other, so that a drift does not appear as a gain.
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
    fn the_paper_schedule_has_120_states_with_each_angle_from_both_sides() {
        let all = paper();
        assert_eq!(all.len(), 120);
        for a in ANGLES_DEG {
            assert_eq!(all.iter().filter(|p| p.bend_deg == a && p.outward).count(), 12);
            assert_eq!(all.iter().filter(|p| p.bend_deg == a && !p.outward).count(), 12);
        }
    }

    #[test]
    fn the_short_schedule_has_24_different_poses() {
        let all = short();
        assert_eq!(all.len(), 24);
        for (i, a) in all.iter().enumerate() {
            assert!(all[i + 1..].iter().all(|b| a.bend_deg != b.bend_deg || a.dir_deg != b.dir_deg));
        }
    }
}
