//! The four observed quantities, and values for each of them.

use serde::Serialize;
use std::ops::{Index, IndexMut};

/// A quantity that a log observes. The quantities are predicted and compared separately and never fused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Tip orientation from the tracker, compared as an angle.
    Reference,
    /// Accelerometer, compared as a direction.
    Acc,
    /// Magnetometer, compared as a direction.
    Mag,
    /// Gyroscope, compared as a rate.
    Gyro,
}

impl Quantity {
    /// All quantities, in the order of residuals and documents.
    pub const ALL: [Self; 4] = [Self::Reference, Self::Acc, Self::Mag, Self::Gyro];
    /// Quantities whose residual is an angle.
    pub const ANGLES: [Self; 3] = [Self::Reference, Self::Acc, Self::Mag];

    /// Name in documents and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Acc => "accelerometer",
            Self::Mag => "magnetometer",
            Self::Gyro => "gyroscope",
        }
    }
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
