//! Error state and covariance of one hypothesis, and its Kalman corrections.

use nalgebra::{Matrix3, SVector, Vector3};

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
pub(super) type StateVector = SVector<f64, N>;
/// A row of ∂(reading)/∂x, or of a covariance.
pub(super) type Row = [f64; N];

/// Three entries of a state vector from `at` on.
pub(super) fn block(x: &StateVector, at: usize) -> Vector3<f64> {
    x.fixed_rows::<3>(at).into_owned()
}

/// Difference from the nominal values, and its covariance.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct KalmanState {
    /// Estimate.
    pub x: StateVector,
    /// Covariance, symmetric. Sums over rows instead of single entries are worked on several entries at a time.
    pub p: [Row; N],
}

/// What a filter predicts of a reading of R axes.
pub(super) struct Predicted<const R: usize> {
    /// P Hᵀ, an entry an axis.
    ph: [Row; R],
    /// H P Hᵀ.
    s: [[f64; R]; R],
    /// Innovation that the estimate does not explain.
    left: [f64; R],
}

/// Independent axes: `H P Hᵀ + R = L D Lᵀ` with innovations `L⁻¹ ν`.
struct Whitened<const R: usize> {
    l: [[f64; R]; R],
    d: [f64; R],
    innovation: [f64; R],
}

impl<const R: usize> Predicted<R> {
    fn whiten(&self, noise: &[f64]) -> Whitened<R> {
        let (mut s, mut l) = (self.s, [[0.0; R]; R]);
        let (mut d, mut innovation) = ([0.0; R], self.left);
        for a in 0..R {
            d[a] = s[a][a] + noise[a];
            for b in a + 1..R {
                l[b][a] = s[b][a] / d[a];
                innovation[b] -= l[b][a] * innovation[a];
                let (factor, rows) = (l[b][a] * d[a], &l[a + 1..=b]);
                for (s, row) in s[b][a + 1..=b].iter_mut().zip(rows) {
                    *s -= factor * row[a];
                }
            }
        }
        Whitened { l, d, innovation }
    }

    /// Logarithm of the density of the reading but for a constant, where its NIS counts as `nis_max` at most.
    pub fn log_likelihood(&self, noise: &[f64], nis_max: f64) -> f64 {
        let Whitened { d, innovation, .. } = self.whiten(noise);
        let nis: f64 = innovation.iter().zip(&d).map(|(v, d)| v * v / d).sum();
        let size: f64 = d.iter().product();
        -0.5 * (nis.min(nis_max) + size.max(f64::MIN_POSITIVE).ln())
    }
}

impl KalmanState {
    /// A zero estimate with the given standard deviations.
    pub fn new(sigma: &Row) -> Self {
        let mut state = Self::default();
        for (i, sigma) in sigma.iter().enumerate() {
            state.p[i][i] = sigma * sigma;
        }
        state
    }

    /// Sets three entries from `at` on to zero with the given covariance, uncorrelated with all others.
    pub fn reset(&mut self, at: usize, covariance: &Matrix3<f64>) {
        for i in 0..3 {
            self.x[at + i] = 0.0;
            self.p[at + i] = [0.0; N];
            self.p.iter_mut().for_each(|row| row[at + i] = 0.0);
        }
        for i in 0..3 {
            for j in 0..3 {
                self.p[at + i][at + j] = covariance[(i, j)];
            }
        }
    }

    /// Multiplies three entries from `at` on by `keep`.
    pub fn fade(&mut self, at: usize, keep: f64) {
        for i in at..at + 3 {
            self.x[i] *= keep;
            self.p[i].iter_mut().for_each(|p| *p *= keep);
        }
        for row in &mut self.p {
            row[at..at + 3].iter_mut().for_each(|p| *p *= keep);
        }
    }

    /// Adds a variance to each of three entries from `at` on.
    pub fn widen(&mut self, at: usize, variance: f64) {
        for i in at..at + 3 {
            self.p[i][i] += variance;
        }
    }

    /// Propagates over `θ ← θ + Σ F b`, where each b starts at the entry given with its F.
    pub fn propagate_turn<const B: usize>(&mut self, by: &[(usize, Matrix3<f64>); B]) {
        let mut rows = [self.p[0], self.p[1], self.p[2]];
        for (at, f) in by {
            for i in 0..3 {
                for k in 0..3 {
                    self.x[i] += f[(i, k)] * self.x[at + k];
                    add(&mut rows[i], f[(i, k)], &self.p[at + k]);
                }
            }
        }
        for row in &mut rows {
            for (at, f) in by {
                for i in 0..3 {
                    row[i] += (0..3).map(|k| f[(i, k)] * row[at + k]).sum::<f64>();
                }
            }
        }
        for (i, row) in rows.iter().enumerate() {
            self.p[i] = *row;
            for (j, &p) in row.iter().enumerate() {
                self.p[j][i] = p;
            }
        }
    }

    /// Prediction of a reading with rows `h` that differs by `innovation` from what the nominal values predict.
    pub fn predict<const R: usize>(&self, h: &[Row; R], innovation: &[f64; R]) -> Predicted<R> {
        let ph = std::array::from_fn(|a| self.p_times(&h[a]));
        Predicted {
            s: std::array::from_fn(|a| std::array::from_fn(|b| dot(&h[a], &ph[b]))),
            left: std::array::from_fn(|a| innovation[a] - dot(&h[a], self.x.as_slice())),
            ph,
        }
    }

    /// Corrects by a reading with the given variances per axis.
    pub fn correct<const R: usize>(&mut self, predicted: &Predicted<R>, noise: &[f64]) {
        let Whitened { l, d, innovation } = predicted.whiten(noise);
        let mut ph = predicted.ph;
        for (a, l) in l.iter().enumerate() {
            let (before, here) = ph.split_at_mut(a);
            for (l, before) in l.iter().zip(before) {
                add(&mut here[0], -l, before);
            }
        }
        for (j, row) in self.p.iter_mut().enumerate() {
            for a in 0..R {
                let gain = ph[a][j] / d[a];
                self.x[j] += gain * innovation[a];
                add(row, -gain, &ph[a]);
            }
        }
    }

    /// Mixes in other filters, each with its share of the whole.
    pub fn mix<'a>(&mut self, others: impl Iterator<Item = (f64, &'a Self)> + Clone) {
        let mut whole = 1.0 - others.clone().map(|(w, _)| w).sum::<f64>();
        for (w, other) in others {
            whole += w;
            let share = w / whole;
            let off = other.x - self.x;
            self.x += off * share;
            for (j, (row, p)) in self.p.iter_mut().zip(&other.p).enumerate() {
                let spread = (1.0 - share) * off[j];
                for ((to, p), off) in row.iter_mut().zip(p).zip(off.as_slice()) {
                    *to += share * (p - *to + spread * off);
                }
            }
        }
    }

    /// Variance of a prediction with row `h`, without the noise of the reading.
    pub fn variance(&self, h: &Row) -> f64 {
        dot(h, &self.p_times(h))
    }

    /// P hᵀ.
    fn p_times(&self, h: &Row) -> Row {
        let mut ph = [0.0; N];
        for (row, &hj) in self.p.iter().zip(h) {
            if hj != 0.0 {
                add(&mut ph, hj, row);
            }
        }
        ph
    }
}

/// Adds a multiple of a row to another.
fn add(to: &mut Row, factor: f64, row: &Row) {
    for (to, row) in to.iter_mut().zip(row) {
        *to += factor * row;
    }
}

/// Scalar product of a row, most of which is zero, with a vector.
fn dot(h: &Row, v: &[f64]) -> f64 {
    h.iter().zip(v).map(|(h, v)| h * v).sum()
}
