//! Covariance of the error state.
//!
//! Order of the 20 error states (true = estimate ⊕ error):
//!
//! | rows | symbol | unit | error of |
//! |---|---|---|---|
//! | 0..3 | φ | rad, world axes | attitude, `R = exp(φ) R̂` |
//! | 3..6 | b | rad/s, sensor axes | gyroscope bias |
//! | 6..12 | s | – (xx, yy, zz, xy, xz, yz) | gyroscope scale and skew, symmetric |
//! | 12..14 | v | m/s, world x and y | horizontal velocity |
//! | 14, 15 | h, z | µT | horizontal (north) and vertical part of the Earth's field |
//! | 16..19 | m | µT, sensor axes | hard iron |
//! | 19 | τ | s | age of a magnetometer reading |
//!
//! Observations are processed one scalar at a time (Bierman 1977), so that no matrix is inverted.

use nalgebra::{Matrix3, SMatrix, SVector};

/// Number of error states.
pub const DIM: usize = 20;
/// First attitude error; the third one is the heading.
pub const ATTITUDE: usize = 0;
/// First gyroscope bias error.
pub const BIAS: usize = 3;
/// First gyroscope scale error.
pub const SCALE: usize = 6;
/// Axes of the scale and skew errors.
pub const SCALE_AXES: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
/// First horizontal velocity error.
pub const VELOCITY: usize = 12;
/// Errors of the north and vertical part of the field.
pub const FIELD: usize = 14;
/// First hard-iron error.
pub const IRON: usize = 16;
/// Error of the magnetometer's latency.
pub const LATENCY: usize = 19;

/// The error state itself.
pub type Errors = SVector<f64, DIM>;

/// A symmetric 20 x 20 covariance.
#[derive(Debug, Clone, Copy, Default)]
pub struct Covariance(SMatrix<f64, DIM, DIM>);

impl Covariance {
    /// Independent errors with these standard deviations.
    pub fn from_sigmas(sigmas: &Errors) -> Self {
        Self(SMatrix::from_diagonal(&sigmas.map(|s| s * s)))
    }
    /// Standard deviation of one error.
    pub fn sigma(&self, k: usize) -> f64 {
        self.0[(k, k)].max(0.0).sqrt()
    }
    /// False if a variance is negative or not finite.
    pub fn is_sane(&self) -> bool {
        self.0.diagonal().iter().all(|v| v.is_finite() && *v >= 0.0)
    }
    /// Adds `variance` to `count` errors, starting at `first`.
    pub fn grow(&mut self, first: usize, count: usize, variance: f64) {
        for k in first..first + count {
            self.0[(k, k)] += variance;
        }
    }
    /// Makes an error independent of all others, with standard deviation `sigma`.
    pub fn isolate(&mut self, k: usize, sigma: f64) {
        self.0.row_mut(k).fill(0.0);
        self.0.column_mut(k).fill(0.0);
        self.0[(k, k)] = sigma * sigma;
    }

    /// P ← F P Fᵀ over a block of samples: first the velocity, by the attitude error at the start of the block, then the attitude.
    ///
    /// `turned_s` is the integral of R, `skewed` the integral of R ∂ω/∂s, rad, and `pull` gravity times the block's length, m/s.
    pub fn flow(&mut self, turned_s: &Matrix3<f64>, skewed: &SMatrix<f64, 3, 6>, pull: f64) {
        self.couple(&[
            (VELOCITY, ATTITUDE + 1, pull),
            (VELOCITY + 1, ATTITUDE, -pull),
        ]);
        // per axis of the attitude: three errors of the bias, and six of scale and skew
        let links: [_; 27] = std::array::from_fn(|n| match (n / 9, n % 9) {
            (row, k @ 0..3) => (ATTITUDE + row, BIAS + k, -turned_s[(row, k)]),
            (row, k) => (ATTITUDE + row, SCALE + k - 3, skewed[(row, k - 3)]),
        });
        self.couple(&links);
    }

    /// `error[to] += gain * error[from]` for every link; no `from` may also be a `to`.
    fn couple(&mut self, links: &[(usize, usize, f64)]) {
        for &(to, from, gain) in links {
            let source = self.0.column(from).into_owned();
            self.0.column_mut(to).axpy(gain, &source, 1.0);
        }
        for &(to, from, gain) in links {
            for k in 0..DIM {
                self.0[(to, k)] += gain * self.0[(from, k)];
            }
        }
    }

    /// Variance of `Σ gain · error`.
    pub fn variance_of(&self, row: &[(usize, f64)]) -> f64 {
        let with = |j: usize, a: f64| row.iter().map(move |&(k, b)| a * b * self.0[(j, k)]);
        row.iter().map(|&(j, a)| with(j, a).sum::<f64>()).sum()
    }

    /// Processes one scalar observation `innovation = Σ gain · error + noise`.
    ///
    /// `row` holds (error, gain) pairs and `variance` is that of the noise. An observation that is not finite, or
    /// whose innovation variance is not positive, is ignored.
    pub fn observe(
        &mut self,
        errors: &mut Errors,
        row: &[(usize, f64)],
        innovation: f64,
        variance: f64,
    ) {
        let mut spread = Errors::zeros();
        let mut expected = 0.0;
        for &(k, gain) in row {
            spread.axpy(gain, &self.0.column(k), 1.0);
            expected += gain * errors[k];
        }
        let total = variance + row.iter().map(|&(k, gain)| gain * spread[k]).sum::<f64>();
        if !(total.is_finite() && total > 0.0 && innovation.is_finite()) {
            return;
        }
        errors.axpy((innovation - expected) / total, &spread, 1.0);
        self.0.ger(-1.0 / total, &spread, &spread, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn correlated() -> Covariance {
        let root = SMatrix::<f64, DIM, DIM>::from_fn(|r, c| {
            ((r * 7 + c * 3) % 11) as f64 / 11.0 + f64::from(r == c)
        });
        Covariance(root * root.transpose())
    }

    #[test]
    fn flow_equals_the_full_matrix_product() {
        let turned = Matrix3::from_fn(|r, c| 0.03 * (1.0 + r as f64 - 0.5 * c as f64));
        let skewed = SMatrix::<f64, 3, 6>::from_fn(|r, c| 0.02 * (c as f64 - r as f64));
        let mut by_tilt = SMatrix::<f64, DIM, DIM>::identity();
        by_tilt[(VELOCITY, 1)] = 0.35;
        by_tilt[(VELOCITY + 1, 0)] = -0.35;
        let mut by_gyro = SMatrix::<f64, DIM, DIM>::identity();
        by_gyro
            .fixed_view_mut::<3, 3>(ATTITUDE, BIAS)
            .copy_from(&-turned);
        by_gyro
            .fixed_view_mut::<3, 6>(ATTITUDE, SCALE)
            .copy_from(&skewed);
        let f = by_gyro * by_tilt;
        let mut p = correlated();
        let want = f * p.0 * f.transpose();
        p.flow(&turned, &skewed, 0.35);
        assert!((p.0 - want).amax() < 1e-9, "{}", (p.0 - want).amax());
    }

    #[test]
    fn an_observation_equals_the_kalman_update() {
        let p0 = correlated();
        let row = [(2, 15.0), (FIELD, 1.0), (IRON + 1, -0.4)];
        let mut h = Errors::zeros();
        for (k, gain) in row {
            h[k] = gain;
        }
        let s = (h.transpose() * p0.0 * h)[0] + 4.0;
        let gain = p0.0 * h / s;
        let (mut p, mut errors) = (p0, Errors::zeros());
        p.observe(&mut errors, &row, 2.5, 4.0);
        assert!((p0.variance_of(&row) + 4.0 - s).abs() < 1e-9);
        assert!((errors - gain * 2.5).amax() < 1e-12);
        assert!((p.0 - (p0.0 - gain * h.transpose() * p0.0)).amax() < 1e-9);
        let before = p.sigma(2);
        p.observe(&mut errors, &row, f64::NAN, 4.0);
        assert_eq!(p.sigma(2), before, "a NaN is ignored");
    }
}
