//! Bend-constrained orientation estimator: an error-state Kalman filter that knows the mechanism.
//!
//! A generic attitude filter estimates three free angles and needs the magnetometer for one of them.
//! The tip has no such freedom: from the base frame found at rest it can only bend (Eq. 7) and, a
//! little, twist as it bends, so gravity alone fixes it in almost every attitude and the field becomes
//! a helper. In the directions that gravity cannot see (bending about the vertical) the filter leans on
//! gyroscope and field and says so in its covariance.
//!
//! The orientation is a quaternion `S`, sensor now to sensor at rest; the 15 errors and states are
//!
//! | entry | symbol | unit |
//! |---|---|---|
//! | 0-2 | θ, error of S, `S_true = Exp(θ) S` | rad |
//! | 3-5 | b_g, gyroscope bias | rad/s |
//! | 6-8 | b_a, accelerometer bias | m/s² |
//! | 9-11 | b_m, field of the tip's own iron | µT |
//! | 12 | c, twist per bend (torsion) | rad/rad |
//! | 13-14 | μ, tilt of the axis that bending never turns about, about x and y | rad |
//!
//! * **Gyroscope**: `Ṡ = S [ω − b_g]×`, so `θ̇ = −S δb_g` (an error on the left does not turn with the tip).
//! * **Acceleration**: where the sensor sits on an arc is known, so the gyroscope says how it is being
//!   accelerated, and that is taken off before what is left counts as gravity.
//! * **Gravity and field**: the rest reading of a world-fixed vector is `v₀ = v + b`, any later one
//!   `Sᵀ (v₀ − b) + b`; each bias is seen as soon as the tip has been to a few poses.
//! * **Mechanism**: the twist ψ of S about the axis `a = Exp(−μ) z` is c β, to within what torsion is not
//!   proportional. It binds for long, not at once: within a motion the gyroscope says how the tip twists.
//! * **Stillness**: a tip whose pistons rest reads its gyroscope's bias.
//!
//! A tilted chip makes `S = Mᵀ R M` of a pure bend R; a tip that sags by b₀ at rest makes
//! `R(b₀)ᵀ R(b)`. As quaternions both are the plane through 1 that is orthogonal to a = Mᵀ z, with half of
//! b₀ in place of μ, so one tilt stands for both. What is reported is S, the turn since the rest, which
//! is right whenever the chip is mounted straight or its mount is calibrated.
//!
//! Innovations are averaged between corrections, so that the correction may run at a lower rate than
//! the sensor without losing what the samples in between say.

mod config;
mod kalman;
mod laws;
mod reacquisition;
#[cfg(test)]
mod tests;

pub use config::BendFilterConfig;
pub(crate) use laws::right_jacobian_inverse;

use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::base::BaseTurn;
use crate::model::bend::Bend;
use crate::primitives::frames::{Base, Rotation, Tip};
use crate::primitives::sample::ImuSample;
use kalman::{ACC, Belief, GYRO, Innovation, MAG, MOUNT, N, StateVector, TWIST};
use laws::{Turn, Twist, bend_by_turn, velocity};
use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};
use reacquisition::Reacquisition;

/// Time over which the surprise of gravity decides whether the gyroscope drifts, s.
const DOUBT_S: f64 = 1.0;
/// Time over which the twist's misfit is averaged, s: a few poses.
const MISFIT_S: f64 = 3.0;

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
    s: UnitQuaternion<f64>,
    belief: Belief,
    acc: Innovation,
    mag: Innovation,
    rate: Innovation,
    since_correction_s: f64,
    turning_rad_s: f64,
    /// Running mean of gravity's normalised innovation squared: above 1 the gyroscope drifts.
    doubt: f64,
    /// Velocity of the sensor by the bend's rate, now and at the last correction, m/s, rest axes.
    velocity_m_s: [Vector3<f64>; 2],
    corrected: Vector2<f64>,
    leap: Reacquisition,
    /// Running mean of the twist's normalised misfit squared.
    misfit: f64,
}

/// Which parts of a sample may be believed, and whether the pistons rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeasurementMask {
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
        let mut sigma = [0.0; N];
        sigma[..GYRO].fill(1e-3);
        sigma[GYRO..ACC].fill(rest.gyro_sigma_rad_s / f64::from(rest.samples.max(1)).sqrt() + 2e-4);
        sigma[ACC..MAG].fill(config.acc_bias_sigma_m_s2);
        sigma[MAG..TWIST].fill(config.mag_bias_sigma_ut);
        sigma[TWIST] = config.twist_sigma;
        sigma[MOUNT..].fill(config.mount_sigma_rad);
        let mut belief = Belief::new(&sigma);
        belief.set(GYRO, &rest.gyro_bias_rad_s);
        Self {
            config: *config,
            rest: *rest,
            s: UnitQuaternion::identity(),
            belief,
            acc: Innovation::NEW,
            mag: Innovation::NEW,
            rate: Innovation::NEW,
            since_correction_s: 0.0,
            turning_rad_s: 0.0,
            doubt: 1.0,
            velocity_m_s: [Vector3::zeros(); 2],
            corrected: Vector2::zeros(),
            leap: Reacquisition::default(),
            misfit: 0.0,
        }
    }

    /// Starts anew from readings of a rest that was not straight: the tip is at `bend` (1 σ `sigma_rad`)
    /// while the sensor reads `now`. What is known of the sensor is kept.
    pub fn rebase(&mut self, now: &Alignment, bend: Bend, sigma_rad: f64) {
        // half of the twist on either side leaves the bend the nearest one
        let half = UnitQuaternion::from_scaled_axis(Vector3::z() * (self.belief.x[TWIST] * bend.beta() / 2.0));
        self.s = half * bend.rotation().quat() * half;
        let straight = |v: &Vector3<f64>, b: Vector3<f64>| self.s * (v - b) + b;
        self.rest.acc_rest_m_s2 = straight(&now.acc_rest_m_s2, self.belief.block(ACC));
        self.rest.mag_rest_ut = now.mag_rest_ut.map(|m| straight(&m, self.belief.block(MAG)));
        self.belief.forget_turn(sigma_rad);
        self.belief.set(GYRO, &now.gyro_bias_rad_s);
        self.forget_innovations();
    }

    /// The tip may have turned by `turn_rad` (1 σ) more than the gyroscope says.
    pub fn unseen(&mut self, turn_rad: f64) {
        for i in 0..GYRO {
            self.belief.p[(i, i)] += turn_rad * turn_rad;
        }
    }

    /// Nothing was seen for a while in which the tip may have turned by `turn_rad` (1 σ).
    pub fn lost(&mut self, turn_rad: f64) {
        self.unseen(turn_rad);
        (self.mag.surprise, self.doubt) = (1.0, 1.0);
    }

    fn forget_innovations(&mut self) {
        (self.acc, self.mag, self.rate, self.doubt) = (Innovation::NEW, Innovation::NEW, Innovation::NEW, 1.0);
        self.misfit = 0.0;
    }

    /// The rest that zero bend refers to.
    #[must_use]
    pub fn rest(&self) -> Alignment {
        self.rest
    }
    /// Estimated bend: the one nearest to the turn since the rest.
    #[must_use]
    pub fn bend(&self) -> Bend {
        Bend::nearest(&self.r_base_tip())
    }
    /// Covariance of the bend vector, rad².
    #[must_use]
    pub fn covariance(&self) -> Matrix2<f64> {
        let rows = bend_by_turn(&self.bend().0);
        rows * self.belief.p.fixed_view::<3, 3>(0, 0) * rows.transpose()
    }
    /// Tip in the base.
    #[must_use]
    pub fn r_base_tip(&self) -> Rotation<Base, Tip> {
        Rotation::assert_frames(self.s)
    }
    /// Estimated gyroscope bias, rad/s.
    #[must_use]
    pub fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        self.belief.block(GYRO)
    }
    /// Estimated accelerometer bias, m/s², and the largest 1 σ of its axes.
    #[must_use]
    pub fn acc_bias_m_s2(&self) -> (Vector3<f64>, f64) {
        (self.belief.block(ACC), self.belief.sigma_of(ACC))
    }
    /// Estimated field of the tip's own iron, µT.
    #[must_use]
    pub fn mag_bias_ut(&self) -> Vector3<f64> {
        self.belief.block(MAG)
    }
    /// 1 σ of the tip's own field, µT, the largest of its axes.
    #[must_use]
    pub fn mag_bias_sigma_ut(&self) -> f64 {
        self.belief.sigma_of(MAG)
    }
    /// How far the twist that gravity and field say is off the one that the mechanism makes, over the last
    /// seconds, in standard deviations (root mean square).
    #[must_use]
    pub fn twist_misfit(&self) -> f64 {
        self.misfit.sqrt()
    }
    /// Twist per bend that the tip may make by what it has shown, rad/rad: torsion and tilt as estimated, with
    /// three standard deviations of both and of what is not proportional.
    #[must_use]
    pub fn twists(&self) -> f64 {
        let tilt = self.belief.x[MOUNT].hypot(self.belief.x[MOUNT + 1]);
        let open = self.belief.p[(TWIST, TWIST)] + self.belief.p[(MOUNT, MOUNT)] + self.belief.p[(MOUNT + 1, MOUNT + 1)];
        self.belief.x[TWIST].abs() + tilt + 3.0 * (open + self.config.twist_error * self.config.twist_error).sqrt()
    }
    /// Rate of the tip against the base after the last sample, rad/s.
    #[must_use]
    pub fn turning_rad_s(&self) -> f64 {
        self.turning_rad_s
    }
    /// What gravity, field and mechanism moved the bend by at the last sample, rad.
    #[must_use]
    pub fn corrected(&self) -> Vector2<f64> {
        self.corrected
    }
    /// How far the field's readings exceed their noise model: 1 when clean, large when it lies.
    #[must_use]
    pub fn field_surprise(&self) -> f64 {
        self.mag.surprise
    }
    /// How far gravity's readings exceed their noise model: a gyroscope that drifts or a base that turns
    /// shows here.
    #[must_use]
    pub fn gravity_surprise(&self) -> f64 {
        self.doubt
    }

    /// The axis that bending never turns about, `Exp(−μ) z`.
    fn axis(&self) -> Vector3<f64> {
        UnitQuaternion::from_scaled_axis(-Vector3::new(self.belief.x[MOUNT], self.belief.x[MOUNT + 1], 0.0)) * Vector3::z()
    }

    /// One sample, `dt_s` after the last, with the base turned by `base` since the rest.
    pub fn update(&mut self, sample: &ImuSample, dt_s: f64, mask: MeasurementMask, base: &BaseTurn) {
        let carried = self.s.inverse() * base.rate_rad_s;
        self.predict(&(sample.gyro_rad_s - carried), dt_s);
        let base_now = base.r_rest_now.inverse().to_rotation_matrix().into_inner();
        let turn = Turn { s: self.s.to_rotation_matrix().into_inner(), base_now };
        if mask.acc {
            self.acc.add(&(sample.acc_m_s2 - turn.expected(&self.rest.acc_rest_m_s2, &self.belief.block(ACC))));
        }
        if let (true, Some(m), Some(rest)) = (self.config.use_mag && mask.mag, &sample.mag_ut, &self.rest.mag_rest_ut) {
            self.mag.add(&(m - turn.expected(rest, &self.belief.block(MAG))));
        }
        if mask.still {
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

    /// Carries the turn and its covariance through `dt_s` of measured rate.
    fn predict(&mut self, gyro: &Vector3<f64>, dt_s: f64) {
        let rate = gyro - self.gyro_bias_rad_s();
        self.turning_rad_s = rate.norm();
        let half = UnitQuaternion::from_scaled_axis(rate * (dt_s / 2.0));
        let midway = (self.s * half).to_rotation_matrix().into_inner();
        self.s = UnitQuaternion::new_normalize((self.s * half * half).into_inner());
        self.velocity_m_s[0] = velocity(&self.config, &self.bend().0, &(midway * rate), dt_s);
        self.belief.turn_by_bias(&(midway * -dt_s));
        self.add_process_noise(dt_s);
    }

    fn add_process_noise(&mut self, dt_s: f64) {
        let c = &self.config;
        let gyro = self.rest.gyro_sigma_rad_s.max(1e-3) * 1.5;
        // scale error of the gyroscope, about half a percent of the motion
        let scale = 0.005 * self.turning_rad_s;
        let q_turn = (gyro * gyro * dt_s + scale * scale * 0.1) * dt_s;
        let drift = self.doubt.sqrt().clamp(1.0, c.gyro_walk_factor_max);
        let p = &mut self.belief.p;
        for i in 0..GYRO {
            p[(i, i)] += q_turn;
        }
        let walks = [(GYRO, c.gyro_walk_rad_s_rts * drift), (ACC, c.acc_walk_m_s2_rts), (MAG, c.mag_walk_ut_rts)];
        for (at, walk) in walks {
            for i in at..at + 3 {
                p[(i, i)] += walk * walk * dt_s;
            }
        }
        p[(TWIST, TWIST)] += c.twist_walk * c.twist_walk * self.turning_rad_s * dt_s;
    }

    /// Gravity, field, stillness, mechanism; then the error goes into the turn.
    fn correct(&mut self, turn: &Turn) {
        let before = self.belief.x;
        if self.asked(turn) {
            self.used_up();
            return;
        }
        if self.acc.n > 0 {
            self.correct_gravity(turn, &before);
        }
        if let (true, Some(rest)) = (self.mag.n > 0, self.rest.mag_rest_ut) {
            self.correct_field(turn, &rest, &before);
        }
        if self.rate.n > 0 {
            self.correct_stillness(&before);
        }
        self.correct_twist();
        let theta = self.belief.take_turn();
        self.s = UnitQuaternion::from_scaled_axis(theta) * self.s;
        self.used_up();
    }

    /// What was gathered has been heard.
    fn used_up(&mut self) {
        self.velocity_m_s[1] = self.velocity_m_s[0];
        self.acc.empty();
        self.mag.empty();
        self.rate.empty();
    }

    /// What gravity contradicts for long is the gyroscope's drift, so it raises the bias' wander and not
    /// gravity's own noise; what it contradicts for a moment is the tip's acceleration.
    fn correct_gravity(&mut self, turn: &Turn, before: &StateVector) {
        let rest = self.rest.acc_rest_m_s2;
        let motion = self.config.acc_motion_m_s2_per_rad_s * self.turning_rad_s;
        let white = self.rest.acc_sigma_m_s2.max(0.005).powi(2) / f64::from(self.acc.n) + motion * motion;
        let noise = self.noise(white, self.config.direction_error * rest.norm());
        let h = Belief::rows(ACC, &turn.slopes(&rest, &self.belief.block(ACC)));
        let [now, before_m_s] = self.velocity_m_s;
        let mean = self.acc.mean() - turn.s.tr_mul(&(now - before_m_s)) / self.since_correction_s;
        let now = self.belief.normalised(&h, &mean, noise.white + noise.direction);
        let k = (self.config.correction_period_s / DOUBT_S).min(1.0);
        self.doubt += k * (now.min(1e4) - self.doubt);
        self.belief.correct_vector(&h, &mean, noise.white + noise.direction * noise.repeats, before);
    }

    /// While the field's readings keep exceeding their noise, the excess is taken for a direction error,
    /// which lasts, not for white noise: it may lie without bound, and the worse it fits the less is
    /// believed of it.
    fn correct_field(&mut self, turn: &Turn, rest: &Vector3<f64>, before: &StateVector) {
        let white = self.rest.mag_sigma_ut.max(0.05).powi(2) / f64::from(self.mag.n);
        let noise = self.noise(white, self.config.field_error * rest.norm());
        let h = Belief::rows(MAG, &turn.slopes(rest, &self.belief.block(MAG)));
        let single = noise.white + noise.direction;
        let now = self.belief.normalised(&h, &self.mag.mean(), single);
        let surprise = self.mag.surprise;
        // quick to doubt, slow to trust again
        let k = if now > surprise { 0.1 } else { 0.01 };
        let surprise = surprise + k * (now.min(100.0 * surprise) - surprise);
        let expected = self.belief.expected(&h, single) / 3.0;
        let times = (surprise.max(1.0) - 1.0) * (surprise / 4.0).max(1.0);
        let excess = expected * times.max(if now > 16.0 { now / 4.0 } else { 0.0 });
        self.belief.correct_vector(&h, &self.mag.mean(), noise.white + (noise.direction + excess) * noise.repeats, before);
        self.mag.surprise = surprise;
    }

    /// The twist is c β, the same error for as long as the tip stays.
    fn correct_twist(&mut self) {
        // what gravity and field have just moved is not in S yet
        let s = UnitQuaternion::from_scaled_axis(self.belief.block(0)) * self.s;
        let (twist, c) = (Twist::of(&s, &self.axis()), self.belief.x[TWIST]);
        let mut h = [0.0; N];
        let by_theta = twist.psi_by_theta - twist.beta_by_theta * c;
        h[..GYRO].copy_from_slice(by_theta.as_slice());
        h[TWIST] = -twist.beta;
        (h[MOUNT], h[MOUNT + 1]) = (twist.psi_by_tilt.x, twist.psi_by_tilt.y);
        let sigma = TWIST_ALWAYS_RAD + self.config.twist_error * twist.beta;
        let noise = self.noise(0.0, sigma);
        let misfit = c * twist.beta - twist.psi;
        let k = (self.config.correction_period_s / MISFIT_S).min(1.0);
        self.misfit += k * (misfit * misfit / (self.belief.variance(&h) + noise.direction) - self.misfit);
        self.belief.scalar(&h, misfit, noise.direction * noise.repeats);
    }

    /// A tip whose pistons rest reads its bias: the whole second of rest counts once. A rate that neither
    /// creep nor drift can make is a base that turns.
    fn correct_stillness(&mut self, before: &StateVector) {
        let mean = self.rate.mean();
        let n_per_s = 1.0 / self.config.correction_period_s;
        let sigma = self.config.still_rate_sigma_rad_s;
        let noise = self.rest.gyro_sigma_rad_s.max(1e-3);
        let r = sigma * sigma * n_per_s + noise * noise / f64::from(self.rate.n);
        let likely = sigma * sigma + noise * noise / f64::from(self.rate.n) + self.belief.sigma_of(GYRO).powi(2);
        if mean.norm_squared() > STILL_GATE * STILL_GATE * likely {
            return;
        }
        for axis in 0..3 {
            let mut h = [0.0; N];
            h[GYRO + axis] = 1.0;
            let moved = self.belief.x[GYRO + axis] - before[GYRO + axis];
            self.belief.scalar(&h, mean[axis] - moved, r);
        }
    }

    fn noise(&self, white: f64, direction: f64) -> Noise {
        let repeats = (self.config.direction_time_s / self.config.correction_period_s).max(1.0);
        Noise { white, direction: direction * direction, repeats }
    }
}

/// A rate at rest beyond this many standard deviations is motion.
const STILL_GATE: f64 = 5.0;
/// Twist that even a straight tip may have, 1 σ, rad (0.2°).
const TWIST_ALWAYS_RAD: f64 = 0.0035;
