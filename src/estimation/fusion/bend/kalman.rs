//! Estimate and covariance of the bend filter, with scalar Kalman corrections.

use nalgebra::{Matrix3, SMatrix, Vector3};

/// Number of states.
pub(super) const N: usize = 15;
/// First entry of the gyroscope bias, after the orientation error.
pub(super) const GYRO: usize = 3;
/// First entry of the accelerometer bias.
pub(super) const ACC: usize = 6;
/// First entry of the field of the tip's own iron.
pub(super) const MAG: usize = 9;
/// Twist per bend.
pub(super) const TWIST: usize = 12;
/// First entry of the tilt of the axis.
pub(super) const MOUNT: usize = 13;

/// NIS beyond which the noise model does not explain an innovation: four standard deviations.
pub(super) const NIS_GATE: f64 = 16.0;

/// Average of the innovations of one vector between two corrections.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Innovation {
    sum: Vector3<f64>,
    /// Number of innovations.
    pub n: u32,
}

impl Innovation {
    pub fn add(&mut self, v: &Vector3<f64>) {
        self.sum += v;
        self.n += 1;
    }
    pub fn mean(&self) -> Vector3<f64> {
        self.sum / f64::from(self.n.max(1))
    }
}

/// The state vector.
pub(super) type StateVector = SMatrix<f64, N, 1>;

/// Estimate and covariance. The first three entries are an error that is zero between corrections.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct KalmanState {
    /// Estimate.
    pub x: StateVector,
    /// Covariance.
    pub p: SMatrix<f64, N, N>,
}

impl KalmanState {
    /// A zero estimate with the given standard deviations.
    pub fn new(sigma: &[f64; N]) -> Self {
        Self {
            x: SMatrix::zeros(),
            p: SMatrix::from_fn(|i, j| if i == j { sigma[i] * sigma[i] } else { 0.0 }),
        }
    }
    /// Three entries from `at` on.
    pub fn block(&self, at: usize) -> Vector3<f64> {
        Vector3::new(self.x[at], self.x[at + 1], self.x[at + 2])
    }
    /// Replaces three entries from `at` on.
    pub fn set(&mut self, at: usize, v: &Vector3<f64>) {
        for j in 0..3 {
            self.x[at + j] = v[j];
        }
    }
    /// Largest 1 σ of the three entries from `at` on.
    pub fn sigma_of(&self, at: usize) -> f64 {
        (at..at + 3)
            .map(|i| self.p[(i, i)])
            .fold(0.0, f64::max)
            .sqrt()
    }
    /// Sets the orientation error to `sigma_rad`, uncorrelated with all other states.
    pub fn reset_turn(&mut self, sigma_rad: f64) {
        for i in 0..GYRO {
            for j in 0..N {
                (self.p[(i, j)], self.p[(j, i)]) = (0.0, 0.0);
            }
            self.p[(i, i)] = sigma_rad * sigma_rad;
        }
    }
    /// Returns the estimated orientation error and sets it to zero.
    pub fn take_turn(&mut self) -> Vector3<f64> {
        let theta = self.block(0);
        self.set(0, &Vector3::zeros());
        theta
    }

    /// Propagates the covariance over `δθ ← δθ + F δb_g`.
    pub fn propagate_turn(&mut self, f: &Matrix3<f64>) {
        for i in 0..3 {
            for j in 0..N {
                let add = f[(i, 0)] * self.p[(GYRO, j)]
                    + f[(i, 1)] * self.p[(GYRO + 1, j)]
                    + f[(i, 2)] * self.p[(GYRO + 2, j)];
                self.p[(i, j)] += add;
            }
        }
        for i in 0..3 {
            for j in 0..N {
                let add = f[(i, 0)] * self.p[(j, GYRO)]
                    + f[(i, 1)] * self.p[(j, GYRO + 1)]
                    + f[(i, 2)] * self.p[(j, GYRO + 2)];
                self.p[(j, i)] += add;
            }
        }
    }

    /// Rows of ∂(reading)/∂x for a vector whose bias starts at `at`, from its derivatives by orientation and bias.
    pub fn rows(at: usize, (by_theta, by_bias): &(Matrix3<f64>, Matrix3<f64>)) -> [[f64; N]; 3] {
        let mut h = [[0.0; N]; 3];
        for (axis, row) in h.iter_mut().enumerate() {
            for j in 0..3 {
                (row[j], row[at + j]) = (by_theta[(axis, j)], by_bias[(axis, j)]);
            }
        }
        h
    }

    /// Sum over the axes of the variance of an innovation whose reading has variance `r`.
    pub fn innovation_variance(&self, h: &[[f64; N]; 3], r: f64) -> f64 {
        h.iter().map(|row| self.variance(row) + r).sum()
    }
    /// Normalised innovation squared (NIS), 1 on average.
    pub fn nis(&self, h: &[[f64; N]; 3], innovation: &Vector3<f64>, r: f64) -> f64 {
        innovation.norm_squared() / self.innovation_variance(h, r)
    }

    /// Three scalar corrections by one vector, each with variance `r`. Innovation and rows refer to the estimate
    /// `before`, so the effect of corrections since is subtracted.
    pub fn correct_vector(
        &mut self,
        h: &[[f64; N]; 3],
        innovation: &Vector3<f64>,
        r: f64,
        before: &StateVector,
    ) {
        for axis in 0..3 {
            let moved: f64 = (0..N).map(|i| h[axis][i] * (self.x[i] - before[i])).sum();
            self.correct_scalar(&h[axis], innovation[axis] - moved, r);
        }
    }

    /// One scalar Kalman correction.
    pub fn correct_scalar(&mut self, h: &[f64; N], innovation: f64, r: f64) {
        let ph = self.p_times(h);
        let s: f64 = (0..N).map(|i| h[i] * ph[i]).sum::<f64>() + r;
        let inv = 1.0 / s;
        for j in 0..N {
            let k = ph[j] * inv;
            self.x[j] += k * innovation;
            for (i, ph) in ph.iter().enumerate() {
                self.p[(i, j)] -= ph * k;
            }
        }
    }

    /// Variance of a prediction with row `h`, without the noise of the reading.
    pub fn variance(&self, h: &[f64; N]) -> f64 {
        let ph = self.p_times(h);
        (0..N).map(|i| h[i] * ph[i]).sum()
    }

    fn p_times(&self, h: &[f64; N]) -> [f64; N] {
        let mut ph = [0.0; N];
        for (j, &hj) in h.iter().enumerate() {
            if hj != 0.0 {
                let column = self.p.column(j);
                for (out, p) in ph.iter_mut().zip(column.iter()) {
                    *out += p * hj;
                }
            }
        }
        ph
    }
}
