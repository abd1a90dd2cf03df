//! The source of the set-point: a target, a path, set-points with times, or an orientation in the world.

use crate::control::path::expected;
use crate::control::{Pace, Reference};
use crate::model::Shape;
use crate::primitives::{Mm, Rotation, Tip, World};
use nalgebra::Vector3;

/// Set-points that are remembered.
const ROWS: usize = 128;

/// Where the set-point comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Source {
    /// A target, or nothing.
    Target,
    /// The loaded path.
    Path {
        /// Time of its beginning, s.
        began_s: f64,
    },
    /// Set-points with times.
    Stream {
        /// By how much their clock is behind that of the loop, s.
        offset_s: f64,
    },
    /// An orientation in the world, which is the base at the alignment.
    World {
        /// The orientation.
        aim: Rotation<World, Tip>,
        /// Length of the tip.
        length: Mm,
        /// The tip can bend that far now; otherwise it bends towards the orientation as far as it can.
        reached: bool,
    },
    /// The last bend towards an orientation in the world, since the IMU on the base failed.
    WorldLost,
}

/// The last set-points, oldest first: times in s, bend vectors in rad, lengths in mm.
#[derive(Debug, Clone)]
pub(super) struct Recent {
    t_s: [f64; ROWS],
    rows: [Vector3<f64>; ROWS],
    pub(super) count: usize,
}

impl Default for Recent {
    fn default() -> Self {
        Self {
            t_s: [0.0; ROWS],
            rows: [Vector3::zeros(); ROWS],
            count: 0,
        }
    }
}

impl Recent {
    pub(super) fn newest_s(&self) -> Option<f64> {
        self.count.checked_sub(1).map(|k| self.t_s[k])
    }

    pub(super) fn push(&mut self, t_s: f64, shape: &Shape) {
        if self.count == ROWS {
            self.t_s.copy_within(1.., 0);
            self.rows.copy_within(1.., 0);
            self.count -= 1;
        }
        self.t_s[self.count] = t_s;
        self.rows[self.count] = shape.bend.0.push(shape.length.0);
        self.count += 1;
    }

    /// What is expected at `wanted_s` from the set-points up to then.
    pub(super) fn expected(&self, wanted_s: f64, pace: &Pace) -> Option<Reference> {
        let due = self.t_s[..self.count].partition_point(|t| *t <= wanted_s);
        let due = due.max(1);
        (self.count > 0).then(|| expected(&self.t_s[..due], &self.rows[..due], wanted_s, pace))
    }
}
