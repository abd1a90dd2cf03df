//! Calibrated values with their uncertainty and origin.

use super::ellipsoid::VectorFit;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// A calibrated quantity with its uncertainty and origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry<T> {
    /// Best estimate.
    pub value: T,
    /// One standard deviation of each number of `value`.
    pub sigma: T,
    /// Day of the recording, `2025-01-31`.
    pub date: String,
    /// File or procedure it came from.
    pub source: String,
}

/// Date and source of a calibration.
#[derive(Debug, Clone, Copy)]
pub struct Pedigree<'a> {
    /// Day of the recording.
    pub date: &'a str,
    /// File or procedure.
    pub source: &'a str,
}

impl Pedigree<'_> {
    /// An entry with this pedigree.
    pub(super) fn entry<T>(self, value: T, sigma: T) -> Entry<T> {
        Entry {
            value,
            sigma,
            date: self.date.to_owned(),
            source: self.source.to_owned(),
        }
    }

    /// Entries of bias and matrix.
    pub(super) fn entries(self, fit: &VectorFit) -> (Option<Entry<[f64; 3]>>, Option<Entry<Rows>>) {
        let rows = |m: &Matrix3<f64>| [0, 1, 2].map(|i| [m[(i, 0)], m[(i, 1)], m[(i, 2)]]);
        (
            Some(self.entry(fit.bias.into(), fit.bias_sigma.into())),
            Some(self.entry(rows(&fit.matrix), rows(&fit.matrix_sigma))),
        )
    }
}

/// Rows of a 3 × 3 matrix, as written in files.
pub type Rows = [[f64; 3]; 3];
