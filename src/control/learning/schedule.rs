//! Schedules of the poses to be held.
//!
//! The paper states 12 directions, 5 angles and 120 states. This is read as: in every direction out through 15, 30, 45,
//! 60 and 75° and back through the same five, so that each angle is reached from below and from above; then directly on
//! to the next direction. The arms visit 80° between the two states at 75°, without a score: otherwise the second one would
//! be no arrival.

use crate::model::Bend;

/// A pose to be held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Bend angle β, degrees.
    pub bend_deg: f64,
    /// Bend direction δ, degrees.
    pub dir_deg: f64,
    /// The previous bend is smaller.
    pub outward: bool,
    /// Scored; a visit is not.
    pub scored: bool,
}

impl Pose {
    /// The pose as a bend vector.
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
/// Bend angle of the visit between the way out and the way back, degrees.
const VISIT_DEG: f64 = 80.0;

/// The 120 states, as Algorithm 1 measures them.
pub fn paper() -> Vec<Pose> {
    let mut poses = arrivals(DIRECTIONS);
    poses.retain(|pose| pose.scored);
    poses
}

/// A pose to be scored.
fn pose(bend_deg: f64, dir_deg: f64, outward: bool) -> Pose {
    Pose {
        bend_deg,
        dir_deg,
        outward,
        scored: true,
    }
}

/// Ten states and a visit in each of `directions`, which are evenly spaced from 0°: the schedule of an arm.
pub fn arrivals(directions: usize) -> Vec<Pose> {
    let mut poses = Vec::new();
    for d in 0..directions {
        let dir_deg = d as f64 * 360.0 / directions as f64;
        poses.extend(ANGLES_DEG.map(|a| pose(a, dir_deg, true)));
        poses.push(Pose {
            scored: false,
            ..pose(VISIT_DEG, dir_deg, true)
        });
        poses.extend(ANGLES_DEG.iter().rev().map(|&a| pose(a, dir_deg, false)));
    }
    poses
}

/// The poses of a calibration with a prior, at most 24: in a direction out to 75° and back to 50°, so that each bellow is
/// strained on both sides of its backlash; poses from one side only cannot separate extension from backlash. Opposite
/// directions follow each other, so that a drift does not appear as a gain. The first 12 poses already go around.
pub fn short(poses: usize) -> Vec<Pose> {
    let directions = [0.0, 180.0, 60.0, 240.0, 120.0, 300.0];
    let between = directions.map(|d| d + 30.0);
    let all = directions.into_iter().chain(between);
    let both = |dir_deg| [pose(75.0, dir_deg, true), pose(50.0, dir_deg, false)];
    all.flat_map(both).take(poses).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_schedule_has_120_states_with_each_angle_from_both_sides() {
        let all = paper();
        assert_eq!((all.len(), arrivals(DIRECTIONS).len()), (120, 132));
        for a in ANGLES_DEG {
            assert_eq!(
                all.iter().filter(|p| p.bend_deg == a && p.outward).count(),
                12
            );
            assert_eq!(
                all.iter().filter(|p| p.bend_deg == a && !p.outward).count(),
                12
            );
        }
    }

    #[test]
    fn every_scored_state_is_an_arrival() {
        for all in [arrivals(DIRECTIONS), arrivals(4)] {
            let resting = std::iter::once(Bend::STRAIGHT).chain(all.iter().map(Pose::bend));
            for (before, pose) in resting.zip(&all).filter(|(_, p)| p.scored) {
                assert!(
                    (pose.bend().0 - before.0).norm().to_degrees() > 4.9,
                    "{pose:?} does not move"
                );
            }
        }
    }

    #[test]
    fn the_short_schedule_has_24_different_poses() {
        let all = short(24);
        assert_eq!(all.len(), 24);
        for (i, a) in all.iter().enumerate() {
            assert!(
                all[i + 1..]
                    .iter()
                    .all(|b| a.bend_deg != b.bend_deg || a.dir_deg != b.dir_deg)
            );
        }
    }
}
