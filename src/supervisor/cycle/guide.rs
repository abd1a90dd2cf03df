//! What leads the set-point in place of a target: a path, set-points with times, or an orientation in the world.

use crate::control::path::expected;
use crate::control::{Pace, Reference};
use crate::model::Shape;
use crate::primitives::{Mm, Rotation, Tip, World};
use nalgebra::Vector3;

/// Set-points that are remembered.
const ROWS: usize = 128;

/// What leads the set-point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Guide {
    /// A target, or nothing.
    Target,
    /// The loaded path, since this time.
    Path { began_s: f64 },
    /// Set-points whose clock is behind that of the loop by `offset_s`.
    Stream { offset_s: f64 },
    /// An orientation in the world, which is the base at the alignment. `reached`: the tip can bend that far now.
    World {
        aim: Rotation<World, Tip>,
        length: Mm,
        reached: bool,
    },
    /// An orientation in the world until the IMU on the base failed; now the last bend is a target.
    Lost,
}

/// The last set-points, oldest first: times in s, bend vectors in rad, lengths in mm.
#[derive(Debug, Clone)]
pub(super) struct Recent {
    t_s: [f64; ROWS],
    rows: [Vector3<f64>; ROWS],
    count: usize,
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
    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    pub(super) fn newest_s(&self) -> Option<f64> {
        self.count.checked_sub(1).map(|k| self.t_s[k])
    }

    pub(super) fn push(&mut self, t_s: f64, shape: &Shape) {
        if self.count == ROWS {
            self.t_s.copy_within(1.., 0);
            self.rows.copy_within(1.., 0);
            self.count -= 1;
        }
        (self.t_s[self.count], self.rows[self.count]) = (
            t_s,
            Vector3::new(shape.bend.0.x, shape.bend.0.y, shape.length.0),
        );
        self.count += 1;
    }

    /// What is expected at `wanted_s` from the set-points up to then.
    pub(super) fn expected(&self, wanted_s: f64, pace: &Pace) -> Option<Reference> {
        let due = self.t_s[..self.count]
            .partition_point(|t| *t <= wanted_s)
            .max(1);
        (self.count > 0).then(|| expected(&self.t_s[..due], &self.rows[..due], wanted_s, pace))
    }
}
