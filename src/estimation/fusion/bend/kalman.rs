//! Error state and covariance of one hypothesis, with scalar Kalman corrections.

use nalgebra::{Matrix3, SMatrix, Vector3};

/// Number of error states.
pub(super) const N: usize = 24;
/// First entry of the gyroscope bias, after the orientation.
pub(super) const GYRO: usize = 3;
/// First entry of the accelerometer bias.
pub(super) const ACC: usize = 6;
/// First entry of the field of the tip's own iron.
pub(super) const MAG: usize = 9;
/// Twist per bend.
pub(super) const TWIST: usize = 12;
/// First entry of the tilt of the axis.
pub(super) const MOUNT: usize = 13;
/// First entry of the rotation of the base.
pub(super) const BASE: usize = 15;
/// First entry of the error of the field, axes of the base.
pub(super) const FIELD: usize = 18;
/// First entry of the scale of the gyroscope.
pub(super) const SCALE: usize = 21;

/// The state vector.
pub(super) type StateVector = SMatrix<f64, N, 1>;
/// The covariance.
pub(super) type Covariance = SMatrix<f64, N, N>;
/// A row of ∂(reading)/∂x.
pub(super) type Row = [f64; N];

/// Three entries of a state vector from `at` on.
pub(super) fn block(x: &StateVector, at: usize) -> Vector3<f64> {
    Vector3::new(x[at], x[at + 1], x[at + 2])
}

/// Difference from the nominal values, and its covariance.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct KalmanState {
    /// Estimate.
    pub x: StateVector,
    /// Covariance.
    pub p: Covariance,
}

impl KalmanState {
    /// A zero estimate with the given standard deviations.
    pub fn new(sigma: &Row) -> Self {
        Self {
            x: StateVector::zeros(),
            p: Covariance::from_fn(|i, j| if i == j { sigma[i] * sigma[i] } else { 0.0 }),
        }
    }

    /// Sets three entries from `at` on to zero with the given covariance, uncorrelated with all others.
    pub fn reset(&mut self, at: usize, covariance: &Matrix3<f64>) {
        for i in at..at + 3 {
            self.x[i] = 0.0;
            for j in 0..N {
                (self.p[(i, j)], self.p[(j, i)]) = (0.0, 0.0);
            }
        }
        self.p.fixed_view_mut::<3, 3>(at, at).copy_from(covariance);
    }

    /// Multiplies three entries from `at` on by `keep`.
    pub fn fade(&mut self, at: usize, keep: f64) {
        for i in at..at + 3 {
            self.x[i] *= keep;
            for j in 0..N {
                self.p[(i, j)] *= keep;
            }
            for j in 0..N {
                self.p[(j, i)] *= keep;
            }
        }
    }

    /// Adds a variance to each of three entries from `at` on.
    pub fn widen(&mut self, at: usize, variance: f64) {
        for i in at..at + 3 {
            self.p[(i, i)] += variance;
        }
    }

    /// Propagates over `θ ← θ + F b`, where b starts at `at`.
    pub fn propagate_turn(&mut self, f: &Matrix3<f64>, at: usize) {
        for i in 0..3 {
            self.x[i] += (0..3).map(|k| f[(i, k)] * self.x[at + k]).sum::<f64>();
            for j in 0..N {
                let add: f64 = (0..3).map(|k| f[(i, k)] * self.p[(at + k, j)]).sum();
                self.p[(i, j)] += add;
            }
        }
        for i in 0..3 {
            for j in 0..N {
                let add: f64 = (0..3).map(|k| f[(i, k)] * self.p[(j, at + k)]).sum();
                self.p[(j, i)] += add;
            }
        }
    }

    /// One scalar correction: a reading with row `h` and variance `r` that differs by `innovation` from what the nominal
    /// values predict.
    pub fn correct(&mut self, h: &Row, innovation: f64, r: f64) {
        let ph = self.p_times(h);
        let inv = 1.0 / (dot(h, &ph) + r);
        let left = innovation - dot(h, self.x.as_slice());
        for (j, &phj) in ph.iter().enumerate() {
            let k = phj * inv;
            self.x[j] += k * left;
            // a slice, unlike a column of a matrix, is worked on several entries at a time
            let column = &mut self.p.as_mut_slice()[j * N..(j + 1) * N];
            for (p, ph) in column.iter_mut().zip(&ph) {
                *p -= ph * k;
            }
        }
    }

    /// Variance of a prediction with row `h`, without the noise of the reading.
    pub fn variance(&self, h: &Row) -> f64 {
        dot(h, &self.p_times(h))
    }

    /// P hᵀ.
    pub fn p_times(&self, h: &Row) -> Row {
        let mut ph = [0.0; N];
        for (j, &hj) in h.iter().enumerate() {
            if hj != 0.0 {
                let column = &self.p.as_slice()[j * N..(j + 1) * N];
                for (out, p) in ph.iter_mut().zip(column) {
                    *out += p * hj;
                }
            }
        }
        ph
    }
}

/// Scalar product of a row, most of which is zero, with a vector.
pub(super) fn dot(h: &Row, v: &[f64]) -> f64 {
    h.iter().zip(v).map(|(h, v)| h * v).sum()
}
