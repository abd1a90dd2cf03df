//! The four observed quantities, and values for each of them.

use crate::named;
use serde::Serialize;
use std::ops::{Index, IndexMut};

named! {
    /// A quantity that a log observes. The quantities are predicted and compared separately and never fused.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Quantity {
        /// Tip orientation from the tracker, compared as an angle.
        Reference = "reference",
        /// Accelerometer, compared as a direction.
        Acc = "accelerometer",
        /// Magnetometer, compared as a direction.
        Mag = "magnetometer",
        /// Gyroscope, compared as a rate.
        Gyro = "gyroscope",
    }
}

impl Quantity {
    /// Quantities whose residual is an angle.
    pub const ANGLES: [Self; 3] = [Self::Reference, Self::Acc, Self::Mag];
}

/// One value per quantity.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[serde(transparent)]
pub struct PerQuantity<T>(pub [T; 4]);

impl<T> PerQuantity<T> {
    /// The values that `f` gives for each quantity.
    pub fn from_fn(mut f: impl FnMut(Quantity) -> T) -> Self {
        Self(Quantity::ALL.map(&mut f))
    }
}

impl<T> Index<Quantity> for PerQuantity<T> {
    type Output = T;
    fn index(&self, q: Quantity) -> &T {
        &self.0[q as usize]
    }
}

impl<T> IndexMut<Quantity> for PerQuantity<T> {
    fn index_mut(&mut self, q: Quantity) -> &mut T {
        &mut self.0[q as usize]
    }
}
