//! Bend-constrained orientation estimator: an error-state Kalman filter that knows the mechanism.
//!
//! A generic attitude filter estimates three free angles and needs the magnetometer for one of them.
//! The tip has no such freedom: from the base frame found at rest it can only bend (Eq. 7), so
//! gravity alone fixes it in almost every attitude and the field becomes a helper. In the directions
//! that gravity cannot see (bending about the vertical) the filter leans on gyroscope and field and
//! says so in its covariance.
//!
//! State, 14 entries, all in the frame of the sensor at rest:
//!
//! | entry | symbol | unit |
//! |---|---|---|
//! | 0-1 | b, bend vector | rad |
//! | 2-4 | b_g, gyroscope bias | rad/s |
//! | 5-7 | b_a, accelerometer bias | m/s² |
//! | 8-10 | b_m, field of the tip's own iron | µT |
//! | 11 | c, twist per bend (torsion) | rad/rad |
//! | 12-13 | μ, tilt of the sensor against the tip about x and y | rad |
//!
//! With `R` the tip in the base (bend then twist `c β` about its own axis), `M = Exp(μ)` the mount and
//! `S = Mᵀ R M` what the sensor itself turns through, the rest reading of a world-fixed vector is
//! `v₀ = v + b` and any later reading is `Sᵀ (v₀ − b) + b`: gravity and field enter by the same
//! function, and each bias is seen as soon as the tip has been to a few poses. The gyroscope carries
//! the state between samples through the inverse right Jacobian of SO(3) (Chirikjian 2012, eq. 10.86).
//! Innovations are averaged between corrections, so that the correction may run at a lower rate than
//! the sensor without losing what the samples in between say.

use crate::frames::{Base, Rotation, Tip};
use crate::fuse::align::Alignment;
use crate::fuse::base::BaseTurn;
use crate::model::bend::Bend;
use crate::sample::ImuSample;
use nalgebra::{Matrix2, Matrix3, SMatrix, UnitQuaternion, Vector2, Vector3};
use serde::Deserialize;

const N: usize = 14;
const GYRO: usize = 2;
const ACC: usize = 5;
const MAG: usize = 8;
const TWIST: usize = 11;
const MOUNT: usize = 12;

/// Priors and noise of the estimator.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BendFilterConfig {
    /// Least time between two corrections by gravity and field, s. Default 0.01. Larger costs less
    /// time per tick and reacts later to a disturbed sensor.
    pub correction_period_s: f64,
    /// Expected accelerometer bias, m/s², 1 σ. Default 0.25 (25 mg). Larger trusts gravity less until
    /// a few poses have shown the bias.
    pub acc_bias_sigma_m_s2: f64,
    /// Expected field of the tip's own iron, µT, 1 σ. Default 6. Larger trusts the field less at first.
    pub mag_bias_sigma_ut: f64,
    /// Expected twist per bend, rad/rad, 1 σ. Default 0.05 (4° at 75°). Larger lets the gyroscope's
    /// z axis bend the constraint further.
    pub twist_sigma: f64,
    /// Expected tilt of the IMU against the tip plate, rad, 1 σ. Default 0.03 (1.7°).
    pub mount_sigma_rad: f64,
    /// Wander of the gyroscope bias, rad/s per √s. Default 5e-4. Larger follows a warming part sooner
    /// and forgets the rest's mean sooner.
    pub gyro_walk_rad_s_rts: f64,
    /// Wander of the accelerometer bias, m/s² per √s. Default 0.002.
    pub acc_walk_m_s2_rts: f64,
    /// Wander of the tip's own field, µT per √s. Default 0.05.
    pub mag_walk_ut_rts: f64,
    /// Error of gravity as a direction while the tip turns, m/s² per rad/s. Default 0.15. Larger lets
    /// the gyroscope alone carry fast motion.
    pub acc_motion_m_s2_per_rad_s: f64,
    /// What no noise figure holds: scale, axes, a field that is not uniform, as a fraction of the
    /// vector, 1 σ. Default 0.004. Larger leans on the gyroscope for longer.
    pub direction_error: f64,
    /// How long such an error stays the same, s: it does not average out within that time. Default 1.
    pub direction_time_s: f64,
    /// Wander of the twist per radian of bending motion, rad/rad per √rad. Default 0.02. Larger lets
    /// torsion that is not proportional to bend be followed.
    pub twist_walk: f64,
    /// Rate that a still tip may really have (creep, leak), rad/s, 1 σ over a second of rest.
    /// Default 0.005. Smaller trusts stillness more as a gyroscope calibration.
    pub still_rate_sigma_rad_s: f64,
    /// Use the magnetometer at all. Default true.
    pub use_mag: bool,
}

impl Default for BendFilterConfig {
    fn default() -> Self {
        Self {
            correction_period_s: 0.01,
            acc_bias_sigma_m_s2: 0.25,
            mag_bias_sigma_ut: 6.0,
            twist_sigma: 0.05,
            mount_sigma_rad: 0.03,
            gyro_walk_rad_s_rts: 5e-4,
            acc_walk_m_s2_rts: 0.002,
            mag_walk_ut_rts: 0.05,
            acc_motion_m_s2_per_rad_s: 0.15,
            direction_error: 0.004,
            direction_time_s: 1.0,
            twist_walk: 0.02,
            still_rate_sigma_rad_s: 0.005,
            use_mag: true,
        }
    }
}

/// Averages the innovations of one vector between corrections, and remembers how large they were.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Innovation {
    sum: Vector3<f64>,
    n: u32,
    /// Running mean of the normalised innovation squared; 1 when the noise model is right.
    surprise: f64,
}

impl Innovation {
    const NEW: Self = Self { sum: Vector3::new(0.0, 0.0, 0.0), n: 0, surprise: 1.0 };
    fn add(&mut self, v: &Vector3<f64>) {
        self.sum += v;
        self.n += 1;
    }
    fn mean(&self) -> Vector3<f64> {
        self.sum / f64::from(self.n.max(1))
    }
}

/// Gravity is never doubted by more than this many times its direction variance: when it contradicts
/// the gyroscope for long, it is the gyroscope that has drifted. The field may lie without bound.
const GRAVITY_EXCESS_MAX: f64 = 8.0;

/// Noise of one averaged reading: variances, and for how many corrections the direction error stays.
struct Noise {
    white: f64,
    direction: f64,
    repeats: f64,
}

/// The filter: what it believes and how firmly.
#[derive(Debug, Clone, PartialEq)]
pub struct BendFilter {
    config: BendFilterConfig,
    rest: Alignment,
    x: SMatrix<f64, N, 1>,
    p: SMatrix<f64, N, N>,
    acc: Innovation,
    mag: Innovation,
    rate: Innovation,
    since_correction_s: f64,
    turning_rad_s: f64,
    corrected: Vector2<f64>,
}

/// Which parts of a sample may be believed, and whether the pistons rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heed {
    /// Correct with the accelerometer.
    pub acc: bool,
    /// Correct with the magnetometer.
    pub mag: bool,
    /// The pistons have not moved for a while.
    pub still: bool,
}

impl BendFilter {
    /// A filter that starts straight, at the rest that `rest` was taken from.
    #[must_use]
    pub fn new(config: &BendFilterConfig, rest: &Alignment) -> Self {
        let mut x = SMatrix::<f64, N, 1>::zeros();
        x.fixed_rows_mut::<3>(GYRO).copy_from(&rest.gyro_bias_rad_s);
        let mut sigma = [0.0; N];
        let bias_sigma = rest.gyro_sigma_rad_s / f64::from(rest.samples.max(1)).sqrt() + 2e-4;
        sigma[..GYRO].fill(1e-3);
        sigma[GYRO..ACC].fill(bias_sigma);
        sigma[ACC..MAG].fill(config.acc_bias_sigma_m_s2);
        sigma[MAG..TWIST].fill(config.mag_bias_sigma_ut);
        sigma[TWIST] = config.twist_sigma;
        sigma[MOUNT..].fill(config.mount_sigma_rad);
        Self {
            config: *config,
            rest: *rest,
            x,
            p: SMatrix::from_fn(|i, j| if i == j { sigma[i] * sigma[i] } else { 0.0 }),
            acc: Innovation::NEW,
            mag: Innovation::NEW,
            rate: Innovation::NEW,
            since_correction_s: 0.0,
            turning_rad_s: 0.0,
            corrected: Vector2::zeros(),
        }
    }

    /// Starts anew from readings of a rest that was not straight: the tip is at `bend` (1 σ `sigma_rad`)
    /// while the sensor reads `now`. What is known of the sensor is kept.
    pub fn rebase(&mut self, now: &Alignment, bend: Bend, sigma_rad: f64) {
        (self.x[0], self.x[1]) = (bend.0.x, bend.0.y);
        let mount = self.mount();
        let s = mount.transpose() * self.r_base_tip().matrix() * mount;
        let straight = |v: &Vector3<f64>, b: Vector3<f64>| s * (v - b) + b;
        self.rest.acc_rest_m_s2 = straight(&now.acc_rest_m_s2, self.block(ACC));
        self.rest.mag_rest_ut = now.mag_rest_ut.map(|m| straight(&m, self.block(MAG)));
        for i in 0..GYRO {
            for j in 0..N {
                (self.p[(i, j)], self.p[(j, i)]) = (0.0, 0.0);
            }
            self.p[(i, i)] = sigma_rad * sigma_rad;
        }
        for j in 0..3 {
            self.x[GYRO + j] = now.gyro_bias_rad_s[j];
        }
        (self.acc, self.mag, self.rate) = (Innovation::NEW, Innovation::NEW, Innovation::NEW);
    }

    /// The rest that zero bend refers to.
    #[must_use]
    pub fn rest(&self) -> Alignment {
        self.rest
    }

    /// Nothing was seen for a while in which the tip may have turned by `turn_rad` (1 σ).
    pub fn lost(&mut self, turn_rad: f64) {
        for i in 0..GYRO {
            self.p[(i, i)] += turn_rad * turn_rad;
        }
        (self.acc, self.mag, self.rate) = (Innovation::NEW, Innovation::NEW, Innovation::NEW);
    }

    /// Estimated bend.
    #[must_use]
    pub fn bend(&self) -> Bend {
        Bend(Vector2::new(self.x[0], self.x[1]))
    }
    /// Covariance of the bend vector, rad².
    #[must_use]
    pub fn covariance(&self) -> Matrix2<f64> {
        self.p.fixed_view::<2, 2>(0, 0).into_owned()
    }
    /// Tip in the base: bend, then the twist that torsion adds.
    #[must_use]
    pub fn r_base_tip(&self) -> Rotation<Base, Tip> {
        let twist = UnitQuaternion::from_scaled_axis(Vector3::z() * self.twist_rad());
        Rotation::assert_frames(self.bend().rotation().quat() * twist)
    }
    /// Estimated gyroscope bias, rad/s.
    #[must_use]
    pub fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        self.x.fixed_rows::<3>(GYRO).into_owned()
    }
    /// Estimated accelerometer bias, m/s², and the largest 1 σ of its axes.
    #[must_use]
    pub fn acc_bias_m_s2(&self) -> (Vector3<f64>, f64) {
        (self.block(ACC), self.sigma_of(ACC))
    }
    /// Largest 1 σ of the three entries from `at` on.
    fn sigma_of(&self, at: usize) -> f64 {
        (at..at + 3).map(|i| self.p[(i, i)]).fold(0.0, f64::max).sqrt()
    }
    /// 1 σ of the tip's own field, µT, the largest of its axes.
    #[must_use]
    pub fn mag_bias_sigma_ut(&self) -> f64 {
        self.sigma_of(MAG)
    }
    /// Rate of the tip against the base after the last sample, rad/s.
    #[must_use]
    pub fn turning_rad_s(&self) -> f64 {
        self.turning_rad_s
    }
    /// What gravity and field moved the bend by at the last sample, rad.
    #[must_use]
    pub fn corrected(&self) -> Vector2<f64> {
        self.corrected
    }
    /// Estimated field of the tip's own iron, µT.
    #[must_use]
    pub fn mag_bias_ut(&self) -> Vector3<f64> {
        self.x.fixed_rows::<3>(MAG).into_owned()
    }
    /// How far the field's readings exceed their noise model: 1 when clean, large when it lies.
    #[must_use]
    pub fn field_surprise(&self) -> f64 {
        self.mag.surprise
    }
    /// How far gravity's readings exceed their noise model: a base that turns shows here.
    #[must_use]
    pub fn gravity_surprise(&self) -> f64 {
        self.acc.surprise
    }

    fn twist_rad(&self) -> f64 {
        self.x[TWIST] * self.bend().beta()
    }

    fn mount(&self) -> Matrix3<f64> {
        let tilt = Vector3::new(self.x[MOUNT], self.x[MOUNT + 1], 0.0);
        UnitQuaternion::from_scaled_axis(tilt).to_rotation_matrix().into_inner()
    }

    /// One sample, `dt_s` after the last, with the base turned by `base` since the rest.
    pub fn update(&mut self, sample: &ImuSample, dt_s: f64, heed: Heed, base: &BaseTurn) {
        let mount = self.mount();
        let before = self.r_base_tip().matrix();
        let carried = (mount.transpose() * before * mount).tr_mul(&base.rate_rad_s);
        self.predict(&mount, &(sample.gyro_rad_s - carried), dt_s);
        let r = self.r_base_tip().matrix();
        let base_now = base.r_rest_now.inverse().to_rotation_matrix().into_inner();
        let turn = Turn { r, mount, s: mount.transpose() * r * mount, base_now };
        if heed.acc {
            self.acc.add(&(sample.acc_m_s2 - turn.expected(&self.rest.acc_rest_m_s2, &self.block(ACC))));
        }
        if let (true, Some(m), Some(rest)) = (self.config.use_mag && heed.mag, &sample.mag_ut, &self.rest.mag_rest_ut) {
            self.mag.add(&(m - turn.expected(rest, &self.block(MAG))));
        }
        if heed.still {
            self.rate.add(&(sample.gyro_rad_s - carried - self.gyro_bias_rad_s()));
        }
        self.since_correction_s += dt_s;
        self.corrected = Vector2::zeros();
        if self.since_correction_s >= self.config.correction_period_s - 1e-9 {
            let predicted = self.bend().0;
            self.correct(&turn);
            self.since_correction_s = 0.0;
            self.corrected = self.bend().0 - predicted;
        }
    }

    fn block(&self, at: usize) -> Vector3<f64> {
        self.x.fixed_rows::<3>(at).into_owned()
    }

    /// Carries bend and covariance through `dt_s` of measured rate.
    fn predict(&mut self, mount: &Matrix3<f64>, gyro: &Vector3<f64>, dt_s: f64) {
        let twist = UnitQuaternion::from_scaled_axis(Vector3::z() * self.twist_rad());
        let omega = twist * (mount * (gyro - self.gyro_bias_rad_s()));
        self.turning_rad_s = omega.norm();
        // midpoint rule: the Jacobian half a step ahead
        let half = self.bend().rotation_vector() + right_jacobian_inverse(&self.bend().rotation_vector()) * omega * (dt_s / 2.0);
        let to_phi = right_jacobian_inverse(&half);
        let phi_rate = to_phi * omega;
        self.x[0] += phi_rate.y * dt_s;
        self.x[1] += phi_rate.x * dt_s;
        let m = to_phi * mount;
        // δb = −dt · (rows y, x of J⁻¹ M) δb_g
        let f: [[f64; 3]; 2] =
            [[-dt_s * m[(1, 0)], -dt_s * m[(1, 1)], -dt_s * m[(1, 2)]], [-dt_s * m[(0, 0)], -dt_s * m[(0, 1)], -dt_s * m[(0, 2)]]];
        for (i, row) in f.iter().enumerate() {
            for j in 0..N {
                let add = row[0] * self.p[(GYRO, j)] + row[1] * self.p[(GYRO + 1, j)] + row[2] * self.p[(GYRO + 2, j)];
                self.p[(i, j)] += add;
            }
        }
        for (i, row) in f.iter().enumerate() {
            for j in 0..N {
                let add = row[0] * self.p[(j, GYRO)] + row[1] * self.p[(j, GYRO + 1)] + row[2] * self.p[(j, GYRO + 2)];
                self.p[(j, i)] += add;
            }
        }
        self.add_process_noise(dt_s);
    }

    fn add_process_noise(&mut self, dt_s: f64) {
        let c = &self.config;
        let gyro = self.rest.gyro_sigma_rad_s.max(1e-3) * 1.5;
        // scale error of the gyroscope, about half a percent of the motion
        let scale = 0.005 * self.turning_rad_s;
        let q_bend = (gyro * gyro * dt_s + scale * scale * 0.1) * dt_s;
        let walks = [(GYRO, c.gyro_walk_rad_s_rts), (ACC, c.acc_walk_m_s2_rts), (MAG, c.mag_walk_ut_rts)];
        self.p[(0, 0)] += q_bend;
        self.p[(1, 1)] += q_bend;
        self.p[(TWIST, TWIST)] += c.twist_walk * c.twist_walk * self.turning_rad_s * dt_s;
        for (at, walk) in walks {
            for i in at..at + 3 {
                self.p[(i, i)] += walk * walk * dt_s;
            }
        }
    }

    fn correct(&mut self, turn: &Turn) {
        if self.acc.n > 0 {
            let motion = self.config.acc_motion_m_s2_per_rad_s * self.turning_rad_s;
            let white = (self.rest.acc_sigma_m_s2.max(0.005).powi(2)) / f64::from(self.acc.n) + motion * motion;
            let h = turn.rows(self, ACC, &self.rest.acc_rest_m_s2);
            let noise = self.noise(white, self.rest.acc_rest_m_s2.norm());
            self.acc.surprise = self.correct_vector(&h, &self.acc.mean(), &noise, self.acc.surprise, GRAVITY_EXCESS_MAX);
        }
        if let (true, Some(rest)) = (self.mag.n > 0, self.rest.mag_rest_ut) {
            let white = self.rest.mag_sigma_ut.max(0.05).powi(2) / f64::from(self.mag.n);
            let h = turn.rows(self, MAG, &rest);
            let noise = self.noise(white, rest.norm());
            self.mag.surprise = self.correct_vector(&h, &self.mag.mean(), &noise, self.mag.surprise, f64::INFINITY);
        }
        if self.rate.n > 0 {
            self.correct_stillness();
        }
        (self.acc.sum, self.acc.n) = (Vector3::zeros(), 0);
        (self.mag.sum, self.mag.n) = (Vector3::zeros(), 0);
        (self.rate.sum, self.rate.n) = (Vector3::zeros(), 0);
    }

    fn noise(&self, white: f64, size: f64) -> Noise {
        let direction = (self.config.direction_error * size).powi(2);
        Noise { white, direction, repeats: (self.config.direction_time_s / self.config.correction_period_s).max(1.0) }
    }

    /// A tip whose pistons rest reads its bias: the whole second of rest counts once.
    fn correct_stillness(&mut self) {
        let mean = self.rate.sum / f64::from(self.rate.n);
        let n_per_s = 1.0 / self.config.correction_period_s;
        let sigma = self.config.still_rate_sigma_rad_s;
        let noise = self.rest.gyro_sigma_rad_s.max(1e-3);
        let r = sigma * sigma * n_per_s + noise * noise / f64::from(self.rate.n);
        for axis in 0..3 {
            let mut h = [0.0; N];
            h[GYRO + axis] = 1.0;
            self.scalar(&h, mean[axis], r);
        }
    }

    /// Three scalar corrections; returns the new running surprise. While readings keep exceeding their
    /// noise, the excess is taken for a direction error, which lasts, not for white noise.
    fn correct_vector(&mut self, h: &[[f64; N]; 3], mean: &Vector3<f64>, noise: &Noise, surprise: f64, excess_max: f64) -> f64 {
        let single = noise.white + noise.direction;
        let expected: f64 = h.iter().map(|row| self.variance(row) + single).sum();
        let now = mean.norm_squared() / expected;
        // quick to doubt, slow to trust again
        let k = if now > surprise { 0.1 } else { 0.01 };
        let surprise = surprise + k * (now.min(100.0 * surprise) - surprise);
        let excess = expected / 3.0 * (surprise.max(1.0) - 1.0).max(if now > 16.0 { now / 4.0 } else { 0.0 });
        let excess = excess.min(excess_max * noise.direction);
        let r = noise.white + (noise.direction + excess) * noise.repeats;
        let before = self.x;
        for axis in 0..3 {
            // rows were linearised at `before`: what earlier axes already moved is taken off
            let moved: f64 = (0..N).map(|i| h[axis][i] * (self.x[i] - before[i])).sum();
            self.scalar(&h[axis], mean[axis] - moved, r);
        }
        surprise
    }

    fn variance(&self, h: &[f64; N]) -> f64 {
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

    /// One scalar Kalman correction.
    fn scalar(&mut self, h: &[f64; N], innovation: f64, r: f64) {
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
}

/// The turn of the tip at one instant, shared by all vectors measured then.
struct Turn {
    r: Matrix3<f64>,
    mount: Matrix3<f64>,
    s: Matrix3<f64>,
    /// Base at rest to base now.
    base_now: Matrix3<f64>,
}

impl Turn {
    /// Reading of a world-fixed vector whose reading at rest was `rest`, given the sensor's bias.
    fn expected(&self, rest: &Vector3<f64>, bias: &Vector3<f64>) -> Vector3<f64> {
        self.s.tr_mul(&(self.base_now * (rest - bias))) + bias
    }

    /// Rows of ∂(reading)/∂x for the vector whose bias starts at `at`.
    fn rows(&self, filter: &BendFilter, at: usize, rest: &Vector3<f64>) -> [[f64; N]; 3] {
        let bend = filter.bend();
        let (b, beta) = (bend.0, bend.beta());
        let w = self.mount * (self.base_now * (rest - filter.block(at)));
        let u = self.r.tr_mul(&w);
        let cross_u = u.cross_matrix();
        let twist = UnitQuaternion::from_scaled_axis(Vector3::z() * -filter.twist_rad()).to_rotation_matrix().into_inner();
        let by_phi = self.mount.transpose() * cross_u * twist * right_jacobian(&bend.rotation_vector());
        let by_twist = self.mount.transpose() * u.cross(&Vector3::z());
        let by_mount = self.mount.transpose() * (cross_u - self.r.transpose() * w.cross_matrix());
        let by_bias = Matrix3::identity() - self.s.transpose() * self.base_now;
        let toward = if beta > 1e-9 { b / beta } else { Vector2::zeros() };
        let mut h = [[0.0; N]; 3];
        for (axis, row) in h.iter_mut().enumerate() {
            // φ = (b_y, b_x, 0)
            row[0] = by_phi[(axis, 1)] + by_twist[axis] * filter.x[TWIST] * toward.x;
            row[1] = by_phi[(axis, 0)] + by_twist[axis] * filter.x[TWIST] * toward.y;
            for j in 0..3 {
                row[at + j] = by_bias[(axis, j)];
            }
            row[TWIST] = by_twist[axis] * beta;
            row[MOUNT] = by_mount[(axis, 0)];
            row[MOUNT + 1] = by_mount[(axis, 1)];
        }
        h
    }
}

/// Right Jacobian of SO(3): body-frame turn per change of the rotation vector.
fn right_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let a = phi.norm();
    let k = phi.cross_matrix();
    let (c1, c2) = if a < 1e-4 { (0.5, 1.0 / 6.0) } else { ((1.0 - a.cos()) / (a * a), (a - a.sin()) / (a * a * a)) };
    Matrix3::identity() - k * c1 + k * k * c2
}

/// Inverse of [`right_jacobian`].
pub(super) fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let a = phi.norm();
    let k = phi.cross_matrix();
    let c = if a < 1e-3 { 1.0 / 12.0 } else { 1.0 / (a * a) - (1.0 + a.cos()) / (2.0 * a * a.sin()) };
    Matrix3::identity() + k * 0.5 + k * k * c
}

#[cfg(test)]
mod tests;
