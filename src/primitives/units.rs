//! Quantities that cross a room's border, as types.
//!
//! Inside a formula plain `f64` with the unit as the last word of the name (`travel_max_mm`) reads
//! better; between rooms a newtype stops a degree from being handed over as a radian.

use serde::{Deserialize, Serialize};

/// An angle in radians.
#[derive(Debug, Clone, Copy, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Rad(pub f64);

/// A length in millimetres: piston displacement, bellow length, backlash.
#[derive(Debug, Clone, Copy, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Mm(pub f64);

/// A time or a duration in seconds. Time is always handed in, never fetched, below the edges.
#[derive(Debug, Clone, Copy, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Seconds(pub f64);

impl Rad {
    /// The angle given in degrees, as files and the command line do.
    pub fn from_deg(deg: f64) -> Self {
        Self(deg.to_radians())
    }
}

/// For how long a condition has held, s, one tick of `dt_s` after it had held for `so_far_s`.
pub fn lasting(holds: bool, so_far_s: f64, dt_s: f64) -> f64 {
    if holds { so_far_s + dt_s } else { 0.0 }
}

/// Absolute microstep counts of the three drive channels since the pistons were at zero.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Steps(pub [i32; 3]);
