//! Hypotheses about gyroscope and base: a Kalman filter for each, around common nominal values.
//!
//! An interacting multiple model estimator (Blom & Bar-Shalom 1988). The filters differ in their noise alone. A reading
//! multiplies the probability of a hypothesis by the likelihood of its innovation. An error that stays the same for
//! longer than a window must not count anew in each, so the likelihood is raised to the share of an independent reading
//! that the window contains.

use super::kalman::{BASE, Covariance, KalmanState, N, Row, StateVector, dot};
use nalgebra::{Matrix3, Vector3};

/// Number of hypotheses.
pub(super) const M: usize = 4;
/// The gyroscope is steady and the base stands.
const STEADY: usize = 0;
/// The bias of the gyroscope drifts.
pub(super) const DRIFTS: usize = 1;
/// The rate is wrong while the tip turns.
pub(super) const WRONG_RATE: usize = 2;
/// The base sways.
pub(super) const SWAYS: usize = 3;

/// Probability of each hypothesis but the first at the start.
const START: f64 = 0.02;
/// Largest normalised innovation squared of one reading: limits what a single outlier proves.
const NIS_MAX: f64 = 50.0;
/// Share of another hypothesis below which it is not mixed in.
const NEGLIGIBLE: f64 = 1e-4;

/// Noise of a reading per axis, as variances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// Of one reading.
    pub single: Vector3<f64>,
    /// White noise of the same effect over the time for which the error stays the same; infinite if the reading only weighs.
    pub correlated: Vector3<f64>,
}

/// A reading of up to three axes.
pub(super) struct Reading {
    /// Rows of ∂(reading)/∂x.
    pub rows: [Row; 3],
    /// Number of rows.
    pub n: usize,
    /// Reading less what the nominal values predict.
    pub innovation: Vector3<f64>,
    /// Noise under each hypothesis.
    pub noise: [Noise; M],
    /// Share of an independent reading.
    pub share: f64,
}

/// The filters and their probabilities.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Bank {
    pub filters: [KalmanState; M],
    pub probability: [f64; M],
    /// Logarithm of the likelihood of the present window.
    log: [f64; M],
}

impl Bank {
    /// All hypotheses with the same standard deviations.
    pub fn new(sigma: &Row) -> Self {
        let mut probability = [START; M];
        probability[STEADY] = 1.0 - START * (M - 1) as f64;
        Self {
            filters: std::array::from_fn(|_| KalmanState::new(sigma)),
            probability,
            log: [0.0; M],
        }
    }

    /// Weighs every hypothesis by a reading, and corrects each with it.
    pub fn correct(&mut self, reading: &Reading) {
        for (j, (filter, log)) in self.filters.iter_mut().zip(&mut self.log).enumerate() {
            let noise = &reading.noise[j];
            *log += reading.share * log_likelihood(filter, reading, &noise.single);
            for axis in (0..reading.n).filter(|&axis| noise.correlated[axis].is_finite()) {
                let (h, r) = (&reading.rows[axis], noise.correlated[axis]);
                filter.correct(h, reading.innovation[axis], r);
            }
        }
    }

    /// Updates the probabilities by the likelihoods of the window.
    pub fn weigh(&mut self) {
        let most = self.log.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for (p, log) in self.probability.iter_mut().zip(&mut self.log) {
            *p *= (std::mem::take(log) - most).exp();
        }
        let sum: f64 = self.probability.iter().sum();
        self.probability.iter_mut().for_each(|p| *p /= sum);
    }

    /// Lets hypotheses begin and end: `change` is the probability that one does so within a window.
    pub fn mix(&mut self, change: f64) {
        let before = self.clone();
        let passes = |i: usize, j: usize| match (i, j) {
            (STEADY, STEADY) => 1.0 - change * (M - 1) as f64,
            (i, j) if i == j => 1.0 - change,
            (STEADY, _) | (_, STEADY) => change,
            _ => 0.0,
        };
        for j in 0..M {
            let joint: [f64; M] = std::array::from_fn(|i| passes(i, j) * before.probability[i]);
            let sum: f64 = joint.iter().sum();
            self.probability[j] = sum;
            let weights = joint.map(|w| w / sum);
            let x = before.mean_by(&weights);
            let p = before.covariance_by(&weights, &x);
            self.filters[j] = KalmanState { x, p };
            if j != SWAYS {
                self.filters[j].reset(BASE, &Matrix3::zeros());
            }
        }
    }

    /// Mean over the hypotheses.
    pub fn mean(&self) -> StateVector {
        self.mean_by(&self.probability)
    }
    /// Variances over the hypotheses around their `mean`.
    pub fn variances(&self, mean: &StateVector) -> StateVector {
        StateVector::from_fn(|i, _| self.weighted(|f| f.p[(i, i)] + (f.x[i] - mean[i]).powi(2)))
    }
    /// Covariance of the rotation of the tip relative to the base, which is that of θ + φ, around their `mean`.
    pub fn turn_covariance(&self, mean: &StateVector) -> Matrix3<f64> {
        let turn = |x: &StateVector, i: usize| x[i] + x[BASE + i];
        Matrix3::from_fn(|i, j| {
            self.weighted(|f| {
                let p = |i: usize, j: usize| f.p[(i, j)];
                let off = |i: usize| turn(&f.x, i) - turn(mean, i);
                p(i, j) + p(BASE + i, BASE + j) + p(i, BASE + j) + p(BASE + i, j) + off(i) * off(j)
            })
        })
    }
    /// Sum over the rows of the variance of a prediction.
    pub fn variance(&self, rows: &[Row]) -> f64 {
        let of = |f: &KalmanState| rows.iter().map(|h| f.variance(h)).sum::<f64>();
        self.weighted(of)
    }
    /// Mean variance of three entries from `at` on.
    pub fn mean_variance(&self, at: usize) -> f64 {
        self.weighted(|f| (at..at + 3).map(|i| f.p[(i, i)]).sum::<f64>() / 3.0)
    }

    fn weighted(&self, of: impl Fn(&KalmanState) -> f64) -> f64 {
        let pairs = self.filters.iter().zip(self.probability);
        pairs.map(|(f, p)| p * of(f)).sum()
    }
    fn mean_by(&self, weights: &[f64; M]) -> StateVector {
        let mut x = StateVector::zeros();
        for (f, w) in self.filters.iter().zip(weights) {
            x += f.x * *w;
        }
        x
    }
    fn covariance_by(&self, weights: &[f64; M], mean: &StateVector) -> Covariance {
        let mut c = Covariance::zeros();
        for (f, &w) in self.filters.iter().zip(weights) {
            if w > NEGLIGIBLE {
                let d = f.x - mean;
                let columns = c.as_mut_slice().chunks_exact_mut(N);
                for (j, (c, p)) in columns.zip(f.p.as_slice().chunks_exact(N)).enumerate() {
                    for ((c, p), di) in c.iter_mut().zip(p).zip(d.as_slice()) {
                        *c += w * (p + di * d[j]);
                    }
                }
            }
        }
        c
    }
}

/// Logarithm of the density of a reading, but for a constant.
fn log_likelihood(filter: &KalmanState, reading: &Reading, noise: &Vector3<f64>) -> f64 {
    let mut s = Matrix3::identity();
    let mut left = Vector3::zeros();
    for a in 0..reading.n {
        let ph = filter.p_times(&reading.rows[a]);
        for b in 0..reading.n {
            s[(a, b)] = dot(&reading.rows[b], &ph);
        }
        s[(a, a)] += noise[a];
        left[a] = reading.innovation[a] - dot(&reading.rows[a], filter.x.as_slice());
    }
    let Some(inverse) = s.try_inverse() else {
        return 0.0;
    };
    let nis = left.dot(&(inverse * left));
    -0.5 * (nis.min(NIS_MAX) + s.determinant().max(f64::MIN_POSITIVE).ln())
}
