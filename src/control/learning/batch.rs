//! Weighted least squares for the transmission gains (paper, Eq. 18-26), optionally with a prior.
//!
//! A measurement j of channel i states `q̃ − q = q k_ε + s k_λ` (Eq. 18-21), where `s = sgn(q̇)` is the side of the
//! backlash. `Γ` (Eq. 22-23) is block diagonal by channel, so Eq. 25 separates into three systems of two unknowns. A row
//! with an unknown side, because the piston has not yet crossed the backlash since its last reversal, has weight 0
//! (Eq. 26). Huber's rule (1964), iterated, reduces the weight of outliers, such as poses against an obstacle. A prior
//! from earlier units adds one more pair of rows per channel.

use crate::model::Line;
use nalgebra::{Matrix2, Vector2, Vector3, Vector6};
use thiserror::Error;

/// Measurement of one held pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Piston displacement q̃, mm.
    pub piston_mm: Vector3<f64>,
    /// Bellow length change q from the measured bend, mm.
    pub bellow_mm: Vector3<f64>,
    /// Side of the backlash, −1 or 1, per channel.
    pub side: Vector3<f64>,
    /// Weight w of the row of each channel (Eq. 26); 0 omits it.
    pub weight: Vector3<f64>,
}

/// Prior of one channel: mean and standard deviation of both gains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Expected gains.
    pub line: Line,
    /// 1 σ of k_ε.
    pub k_epsilon_sigma: f64,
    /// 1 σ of k_λ, mm.
    pub k_lambda_sigma_mm: f64,
}

/// Estimated gains of one channel with their uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The gains.
    pub line: Line,
    /// Covariance of (k_ε, k_λ in mm).
    pub covariance: Matrix2<f64>,
    /// Condition number of the channel's normal matrix, columns scaled to unit length.
    pub condition: f64,
    /// Root mean square of the weighted residual, mm.
    pub residual_mm: f64,
}

/// Why the data do not determine the gains.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Unidentifiable {
    /// Too few rows.
    #[error(
        "channel {channel}: {rows} usable poses, at least {ROWS_MIN} are required; hold more poses whose last motion crosses the backlash"
    )]
    TooFew {
        /// Channel, 1 to 3.
        channel: usize,
        /// Number of rows with a weight.
        rows: usize,
    },
    /// Extension and backlash cannot be distinguished.
    #[error(
        "channel {channel}: extension and backlash cannot be distinguished (condition number {condition:.0}, at most {CONDITION_MAX:.0}); hold poses of different size, approached from both sides"
    )]
    Condition {
        /// Channel, 1 to 3.
        channel: usize,
        /// Condition number.
        condition: f64,
    },
    /// A gain is outside the physical range.
    #[error(
        "channel {channel} yields k_ε = {k_epsilon:.2}, k_λ = {k_lambda_mm:.2} mm; k_ε must lie in 0 to 10 and k_λ in 0 to 3 mm. Check that line {channel} reaches bellow {channel} and that the motor turns the right way"
    )]
    Unphysical {
        /// Channel, 1 to 3.
        channel: usize,
        /// Estimate.
        k_epsilon: f64,
        /// Estimate, mm.
        k_lambda_mm: f64,
    },
}

/// Fewest rows of a channel without a prior.
const ROWS_MIN: usize = 8;
/// Largest accepted condition number of the scaled normal matrix.
const CONDITION_MAX: f64 = 100.0;
/// Assumed standard deviation of one row, which scales a prior, mm of piston.
const ROW_SIGMA_MM: f64 = 0.6;

/// Solves Eq. 25 for the three channels, each with its prior if one is given.
///
/// # Errors
/// Without a prior, [`Unidentifiable`] when a channel has too few rows or an ill-conditioned system.
pub fn solve(
    data: &[Measurement],
    prior: Option<&[Prior; 3]>,
) -> Result<[Estimate; 3], Unidentifiable> {
    let channel = |i: usize| solve_channel(data, i, prior.map(|p| &p[i]));
    Ok([channel(0)?, channel(1)?, channel(2)?])
}

/// Eq. 21 for one channel: row of A, entry of b, weight.
type Row = (Vector2<f64>, f64, f64);

/// Number of robust standard deviations above which Huber's rule reduces the weight of a row.
const HUBER: f64 = 1.5;
/// Iterations of the reweighting.
const ROUNDS: usize = 8;

fn solve_channel(
    data: &[Measurement],
    i: usize,
    prior: Option<&Prior>,
) -> Result<Estimate, Unidentifiable> {
    let usable = data.iter().map(|m| row(m, i)).filter(|r| r.2 > 0.0);
    let rows: Vec<Row> = usable.collect();
    let channel = i + 1;
    if prior.is_none() && rows.len() < ROWS_MIN {
        let rows = rows.len();
        return Err(Unidentifiable::TooFew { channel, rows });
    }
    let solved = |weights: &[f64]| {
        let (matrix, right) = normal(&rows, weights, prior);
        let condition = condition(&matrix);
        match matrix.try_inverse() {
            Some(inverse) if condition < CONDITION_MAX => Ok((inverse * right, inverse, condition)),
            _ => Err(Unidentifiable::Condition { channel, condition }),
        }
    };
    let mut weights: Vec<f64> = rows.iter().map(|r| r.2).collect();
    let (mut k, mut inverse, mut condition) = solved(&weights)?;
    for _ in 0..ROUNDS {
        let off: Vec<f64> = rows.iter().map(|(a, b, _)| (b - a.dot(&k)).abs()).collect();
        let bar = HUBER * robust_spread(&off);
        for ((w, r), e) in weights.iter_mut().zip(&rows).zip(&off) {
            *w = r.2 * (bar / e.max(1e-12)).min(1.0);
        }
        (k, inverse, condition) = solved(&weights)?;
    }
    let weighted = rows.iter().zip(&weights);
    let squares: f64 = weighted
        .map(|((a, b, _), w)| w * (b - a.dot(&k)).powi(2))
        .sum();
    let variance = if rows.len() > 2 {
        squares / (rows.len() - 2) as f64
    } else {
        ROW_SIGMA_MM * ROW_SIGMA_MM
    };
    Ok(Estimate {
        line: Line {
            k_epsilon: k.x,
            k_lambda_mm: k.y,
        },
        covariance: inverse * variance,
        condition,
        residual_mm: variance.sqrt(),
    })
}

/// Robust standard deviation from the median absolute value; positive even for exact data.
fn robust_spread(off: &[f64]) -> f64 {
    let mut sorted = off.to_vec();
    sorted.sort_by(f64::total_cmp);
    (1.4826 * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)).max(1e-9)
}

/// Normal equations of one channel.
fn normal(rows: &[Row], weights: &[f64], prior: Option<&Prior>) -> (Matrix2<f64>, Vector2<f64>) {
    let (mut matrix, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for ((a, b, _), w) in rows.iter().zip(weights) {
        matrix += a * a.transpose() * *w;
        right += a * (b * w);
    }
    if let Some(p) = prior {
        let variance = ROW_SIGMA_MM * ROW_SIGMA_MM;
        let information = Matrix2::from_diagonal(&Vector2::new(
            variance / (p.k_epsilon_sigma * p.k_epsilon_sigma),
            variance / (p.k_lambda_sigma_mm * p.k_lambda_sigma_mm),
        ));
        matrix += information;
        right += information * Vector2::new(p.line.k_epsilon, p.line.k_lambda_mm);
    }
    (matrix, right)
}

fn row(m: &Measurement, i: usize) -> Row {
    let a = Vector2::new(m.bellow_mm[i], m.side[i]);
    (a, m.piston_mm[i] - m.bellow_mm[i], m.weight[i])
}

/// Condition number after both columns are scaled to unit length.
fn condition(normal: &Matrix2<f64>) -> f64 {
    let scale = (normal[(0, 0)] * normal[(1, 1)]).sqrt();
    if scale <= 0.0 {
        return f64::INFINITY;
    }
    let correlation = (normal[(0, 1)] / scale).abs().min(1.0);
    (1.0 + correlation) / (1.0 - correlation)
}

/// Relative step of Algorithm 1, line 2: ‖k_i − k_{i−1}‖ / ‖k_{i−1}‖ over all six gains. It is infinite for gains of zero,
/// so that the first pass never ends the iteration.
pub fn relative_step(new: &[Line; 3], old: &[Line; 3]) -> f64 {
    let six = |l: &[Line; 3]| {
        let (k_epsilon, k_lambda_mm) = (l.map(|l| l.k_epsilon), l.map(|l| l.k_lambda_mm));
        Vector6::from_iterator(k_epsilon.into_iter().chain(k_lambda_mm))
    };
    let size = six(old).norm();
    if size == 0.0 {
        f64::INFINITY
    } else {
        (six(new) - six(old)).norm() / size
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn poses(line: Line, qs: &[(f64, bool)], noise: f64) -> Vec<Measurement> {
        qs.iter()
            .enumerate()
            .map(|(n, &(q, up))| {
                let side = if up { 1.0 } else { -1.0 };
                let wiggle = noise * ((n as f64 * 12.9898).sin() * 43758.5453).fract();
                Measurement {
                    piston_mm: Vector3::repeat(line.piston_mm(q, side) + wiggle),
                    bellow_mm: Vector3::repeat(q),
                    side: Vector3::repeat(side),
                    weight: Vector3::repeat(1.0),
                }
            })
            .collect()
    }

    proptest! {
        #[test]
        fn exact_data_recover_the_gains(k_epsilon in 0.5..4.0f64, k_lambda_mm in 0.1..1.5f64, seed in prop::collection::vec((-5.0..5.0f64, any::<bool>()), 12..40)) {
            let line = Line { k_epsilon, k_lambda_mm };
            match solve(&poses(line, &seed, 0.0), None) {
                Ok(e) => for x in e {
                    prop_assert!((x.line.k_epsilon - k_epsilon).abs() < 1e-9 && (x.line.k_lambda_mm - k_lambda_mm).abs() < 1e-9);
                },
                Err(why) => { let refused = matches!(why, Unidentifiable::Condition { .. }); prop_assert!(refused) }
            }
        }
    }

    #[test]
    fn the_covariance_covers_the_error() {
        let line = Line {
            k_epsilon: 2.2,
            k_lambda_mm: 0.9,
        };
        let qs: Vec<_> = (0..60)
            .map(|i| (f64::from(i % 11) - 5.0, i % 3 != 0))
            .collect();
        let e = solve(&poses(line, &qs, 0.1), None).unwrap()[0];
        assert!((e.line.k_epsilon - 2.2).abs() < 4.0 * e.covariance[(0, 0)].sqrt());
        assert!(e.covariance[(0, 0)].sqrt() < 0.02, "{}", e.covariance);
    }

    #[test]
    fn a_few_obstructed_poses_hardly_change_the_gains() {
        let line = Line {
            k_epsilon: 2.2,
            k_lambda_mm: 0.9,
        };
        let qs: Vec<_> = (0..60)
            .map(|i| (f64::from(i % 11) - 5.0, i % 3 != 0))
            .collect();
        let mut data = poses(line, &qs, 0.1);
        for m in data.iter_mut().filter(|m| m.bellow_mm.x > 4.5) {
            m.bellow_mm = Vector3::repeat(3.0);
        }
        let e = solve(&data, None).unwrap()[0];
        assert!((e.line.k_epsilon - 2.2).abs() < 0.05, "{e:?}");
    }

    #[test]
    fn one_sided_poses_of_one_size_are_refused() {
        let line = Line {
            k_epsilon: 2.2,
            k_lambda_mm: 0.9,
        };
        let qs = vec![(3.0, true); 20];
        let why = solve(&poses(line, &qs, 0.0), None).unwrap_err();
        assert!(
            matches!(why, Unidentifiable::Condition { channel: 1, .. }),
            "{why}"
        );
        let few = solve(&poses(line, &qs[..3], 0.0), None).unwrap_err();
        assert!(few.to_string().contains("3 usable poses"));
    }

    #[test]
    fn a_prior_determines_what_the_data_do_not() {
        let line = Line {
            k_epsilon: 2.2,
            k_lambda_mm: 0.9,
        };
        let prior = Prior {
            line,
            k_epsilon_sigma: 0.2,
            k_lambda_sigma_mm: 0.05,
        };
        let e = solve(&poses(line, &[(3.0, true)], 0.0), Some(&[prior; 3])).unwrap();
        assert!((e[1].line.k_lambda_mm - 0.9).abs() < 1e-9);
    }

    #[test]
    fn the_first_pass_never_ends_the_iteration() {
        let zero = [Line {
            k_epsilon: 0.0,
            k_lambda_mm: 0.0,
        }; 3];
        assert!(relative_step(&zero, &zero).is_infinite());
    }
}
