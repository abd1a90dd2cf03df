//! Structure in what a set leaves: can a flexible regressor foretell it?
//!
//! While the tip turns, rates are predicted by a share of the rate only, so bins in motion weigh little in
//! a score. A sensor that distorts rates (scale, cross-axis, a feeling for gravity) hides there. Its
//! trace is a residual that depends on the reading itself: a linear regression of one on the other, fitted
//! on one half of the blocks, foretells the other half.

use crate::diagnosis::observe::Observed;
use crate::diagnosis::search::HeldOut;
use nalgebra::{Matrix4, Matrix4x3, RowVector3, Vector4};

/// Length of a block, s.
const BLOCK_S: f64 = 12.0;
/// Ridge against directions that the tip never turns in, as a share of the mean square of the input.
const RIDGE: f64 = 0.02;

/// RMS of the gyroscope's residual that the reading itself foretells on blocks not regressed on, °/s.
#[must_use]
pub fn rates_foretold_deg_s(log: &Observed, h: &HeldOut) -> f64 {
    let seen: Vec<(usize, Vector4<f64>, RowVector3<f64>)> = log
        .bins
        .iter()
        .enumerate()
        .filter(|(k, b)| b.weight[3] > 0.0 && h.residual[3].get(*k).is_some_and(|r| r.norm_squared() > 0.0))
        .map(|(k, b)| {
            let r = h.residual[3][k];
            let told = b.gyr - r;
            (((b.t_s - log.start_s()) / BLOCK_S) as usize % 2, Vector4::new(told.x, told.y, told.z, 1.0), r.transpose())
        })
        .collect();
    let mut gained = 0.0;
    for fold in 0..2 {
        let (mut n, mut s) = (Matrix4::zeros(), Matrix4x3::zeros());
        for (_, x, r) in seen.iter().filter(|(f, _, _)| *f != fold) {
            n += x * x.transpose();
            s += x * r;
        }
        let ridge = RIDGE * (n.trace() - n[(3, 3)]) / 3.0;
        for i in 0..3 {
            n[(i, i)] += ridge;
        }
        let Some(inverse) = n.try_inverse() else { continue };
        let law = inverse * s;
        gained += seen
            .iter()
            .filter(|(f, _, _)| *f == fold)
            .map(|(_, x, r)| r.norm_squared() - (r - x.transpose() * law).norm_squared())
            .sum::<f64>();
    }
    (gained.max(0.0) / seen.len().max(1) as f64).sqrt().to_degrees()
}
