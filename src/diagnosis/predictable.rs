//! Structure in the gyroscope's residual: how much of it the reading itself predicts.
//!
//! A bin in motion weighs little in a score, because a rate is predicted to a share of itself only. A sensor that
//! distorts rates (scale, cross-axis, sensitivity to acceleration) therefore hardly shows in a score, but its residual
//! depends on the reading. A linear regression of the residual on the reading, fitted on every other block, predicts the
//! remaining blocks.

use crate::diagnosis::holdout::HeldOut;
use crate::diagnosis::observe::Observed;
use crate::diagnosis::quantity::Quantity;
use nalgebra::{Matrix4, Matrix4x3, RowVector3, Vector4};

/// Length of a block, s.
const BLOCK_S: f64 = 12.0;
/// Ridge for axes about which the tip hardly turns, as a share of the mean square of the input.
const RIDGE: f64 = 0.02;

/// RMS of the gyroscope's residual that the reading predicts on blocks outside the regression, °/s.
pub fn predictable_rate_deg_s(log: &Observed, h: &HeldOut) -> f64 {
    let residual = &h.residual[Quantity::Gyro];
    let samples: Vec<(usize, Vector4<f64>, RowVector3<f64>)> = log
        .bins
        .iter()
        .zip(residual)
        .filter(|(b, r)| b.weight[Quantity::Gyro] > 0.0 && r.norm_squared() > 0.0)
        .map(|(b, r)| {
            let predicted = b.gyr - r;
            (((b.t_s - log.start_s()) / BLOCK_S) as usize % 2, predicted.push(1.0), r.transpose())
        })
        .collect();
    let mut gained = 0.0;
    for fold in 0..2 {
        let (mut n, mut s) = (Matrix4::zeros(), Matrix4x3::zeros());
        for (_, x, r) in samples.iter().filter(|(f, _, _)| *f != fold) {
            n += x * x.transpose();
            s += x * r;
        }
        let ridge = RIDGE * (n.trace() - n[(3, 3)]) / 3.0;
        for i in 0..3 {
            n[(i, i)] += ridge;
        }
        let Some(inverse) = n.try_inverse() else { continue };
        let law = inverse * s;
        let explained = |(_, x, r): &(usize, Vector4<f64>, RowVector3<f64>)| r.norm_squared() - (r - x.transpose() * law).norm_squared();
        gained += samples.iter().filter(|(f, _, _)| *f == fold).map(explained).sum::<f64>();
    }
    (gained.max(0.0) / samples.len().max(1) as f64).sqrt().to_degrees()
}
