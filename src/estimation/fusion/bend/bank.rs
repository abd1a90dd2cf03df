//! Hypotheses about gyroscope and base: a Kalman filter for each, around common nominal values.
//!
//! An interacting multiple model estimator (Blom & Bar-Shalom 1988). The filters differ in their noise alone. A reading
//! multiplies the probability of a hypothesis by the likelihood of its innovation. An error that stays the same for
//! longer than a window must not count anew in each, so the likelihood is raised to the share of an independent reading
//! that the window contains.

use super::kalman::{BASE, KalmanState, Row, StateVector};
use nalgebra::Matrix3;

/// Number of hypotheses.
pub(super) const M: usize = 5;
/// The gyroscope is steady and the base stands.
const STEADY: usize = 0;
/// The bias of the gyroscope drifts, as fast as configured.
pub(super) const DRIFTS: usize = 1;
/// The same at half that rate.
pub(super) const DRIFTS_SLOWLY: usize = 2;
/// The rate is wrong while the tip turns.
pub(super) const WRONG_RATE: usize = 3;
/// The base sways.
pub(super) const SWAYS: usize = 4;

/// Probability of each hypothesis but the first at the start.
const START: f64 = 0.02;
/// Largest normalised innovation squared of one reading: limits what a single outlier proves.
const NIS_MAX: f64 = 50.0;
/// Share of another hypothesis below which it is not mixed in.
const NEGLIGIBLE: f64 = 1e-4;

/// Noise of a reading per axis, as variances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise<const R: usize> {
    /// Of one reading.
    pub single: [f64; R],
    /// White noise of the same effect over the time for which the error stays the same; none if the reading only weighs.
    pub correlated: Option<[f64; R]>,
}

/// A reading of R axes.
pub(super) struct Reading<const R: usize> {
    /// Rows of ∂(reading)/∂x.
    pub rows: [Row; R],
    /// Reading less what the nominal values predict.
    pub innovation: [f64; R],
    /// Noise under each hypothesis.
    pub noise: [Noise<R>; M],
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
    pub fn correct<const R: usize>(&mut self, reading: &Reading<R>) {
        let each = self.filters.iter_mut().zip(&mut self.log);
        for ((filter, log), noise) in each.zip(&reading.noise) {
            let predicted = filter.predict(&reading.rows, &reading.innovation);
            *log += reading.share * predicted.log_likelihood(&noise.single, NIS_MAX);
            if let Some(noise) = &noise.correlated {
                filter.correct(&predicted, noise);
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

    /// Lets hypotheses begin and end: `change` is the probability that one does so within a window. Only the first passes
    /// into others, and others only into it.
    pub fn mix(&mut self, change: f64) {
        let p = self.probability;
        let stays = 1.0 - change * (M - 1) as f64;
        let ends = |j: usize| change * p[j];
        let ended: f64 = (1..M).map(ends).sum();
        let sum = stays * p[STEADY] + ended;
        let (steady, others) = self.filters.split_at_mut(1);
        let before = steady[0].clone();
        let into = (1..M).map(|j| (ends(j) / sum, &others[j - 1]));
        steady[0].mix(into.filter(|(w, _)| *w > NEGLIGIBLE));
        if ends(SWAYS) / sum > NEGLIGIBLE {
            steady[0].reset(BASE, &Matrix3::zeros());
        }
        self.probability[STEADY] = sum;
        for (j, filter) in (1..M).zip(others) {
            let begins = change * p[STEADY];
            self.probability[j] = begins + (1.0 - change) * p[j];
            filter.mix(std::iter::once((begins / self.probability[j], &before)));
        }
    }

    /// Mean over the hypotheses.
    pub fn mean(&self) -> StateVector {
        let pairs = self.filters.iter().zip(self.probability);
        pairs.map(|(f, p)| f.x * p).sum()
    }
    /// Variances over the hypotheses around their `mean`.
    pub fn variances(&self, mean: &StateVector) -> StateVector {
        StateVector::from_fn(|i, _| self.weighted(|f| f.p[i][i] + (f.x[i] - mean[i]).powi(2)))
    }
    /// Covariance of the rotation of the tip relative to the base, which is that of θ + φ, around their `mean`.
    pub fn turn_covariance(&self, mean: &StateVector) -> Matrix3<f64> {
        let turn = |x: &StateVector, i: usize| x[i] + x[BASE + i];
        Matrix3::from_fn(|i, j| {
            self.weighted(|f| {
                let p = |i: usize, j: usize| f.p[i][j];
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
        self.weighted(|f| (at..at + 3).map(|i| f.p[i][i]).sum::<f64>() / 3.0)
    }

    fn weighted(&self, of: impl Fn(&KalmanState) -> f64) -> f64 {
        let pairs = self.filters.iter().zip(self.probability);
        pairs.map(|(f, p)| p * of(f)).sum()
    }
}
