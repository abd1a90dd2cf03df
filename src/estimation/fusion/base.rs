//! The IMU on the base: the rotation of the base since alignment, which is subtracted from that of the tip.
//!
//! A complementary attitude filter (Mahony, Hamel & Pflimlin 2008, explicit form). The rotation `T` (base now → base during
//! alignment) follows the gyroscope. A vector that read `v₀` then is predicted to read `Tᵀ v₀`, and the difference corrects `T`:
//!
//! `ω̂ = ω − b_g − δb + k_a e_a + k_m e_m`, `e_a = (a × Tᵀ a₀)/|a||a₀|`, `e_m = (m × Tᵀ m₀)/|m||m₀|` about the vertical,
//!
//! where b_g comes from the alignment and `δḃ = −(e_a + e_m)/T_b²`. The estimator of the tip gets the rate ω − b_g, whose bias is
//! a part of its own, and what accelerometer and magnetometer read here since alignment: gravity and field at the tip are compared
//! with those at the base. The axes of the base IMU are
//! those of the tip's IMU during alignment, up to a configured mount. If the two disagree about the vertical, the
//! smallest rotation that makes them agree is added. What is left of the mount, a few degrees about the vertical above all,
//! shows when the base turns while the pistons stand: then both gyroscopes measure the same rate ([`BaseTracker::compare`]).
//!
//! An IMU that is silent, stuck or only spikes is lost after `fuse.health.blind_max_s`. The last rotation is then kept,
//! and the base is supervised as without an IMU. Once its readings are good again, gravity and field give the rotation anew.

use crate::estimation::fusion::align::{AlignConfig, AlignState, Alignment};
use crate::estimation::fusion::intake::{self, Step};
use crate::parameters;
use crate::primitives::ImuSample;
use nalgebra::{UnitQuaternion, Vector3};

/// Rotation of the base since alignment; the default is a base that has not moved.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BaseTurn {
    /// Base now to base during alignment.
    pub r_rest_now: UnitQuaternion<f64>,
    /// Angular rate of the base in its present axes, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Change of the specific force since alignment in the present axes, m/s², as measured.
    pub acc_change_m_s2: Option<Vector3<f64>>,
    /// Change of the field since alignment in the present axes, µT, where a reading has just arrived.
    pub mag_change_ut: Option<Vector3<f64>>,
}

parameters! {
    /// The IMU on the base, where there is one.
    pub struct BaseConfig: Copy {
        /// Rotation vector from the axes of the base IMU to those of the tip IMU at rest. The default is mounted alike. An
        /// error tilts the correction of the tip by as much, in proportion to the turn of the base.
        mount_deg: [f64; 3] = [0.0; 3], "deg", -180.0..=180.0, "[0, 0, 0] is mounted like the tip's IMU";
        /// Time constant with which gravity levels the attitude of the base. A larger value resists shaking better and a
        /// gyroscope bias worse.
        gravity_time_s: f64 = 2.0, "s", 0.05..=1000.0, "2 suits a base that is moved by hand";
        /// Time constant with which the field corrects the heading of the base; 0 does not use the field. A larger value is
        /// disturbed less by the motors' fields and drifts longer with the gyroscope.
        field_time_s: f64 = 20.0, "s", 0.0..=10_000.0, "20; 0 does not use the field";
    }
}

/// Alignment and attitude of the base.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum BaseTracker {
    /// No sample of a base IMU has arrived.
    #[default]
    Absent,
    /// The alignment is in progress.
    Aligning(AlignState),
    /// The attitude is tracked.
    Following(Follow),
    /// The attitude was tracked until the IMU failed.
    Lost(Follow),
}

/// Attitude since alignment.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Follow {
    rest: Alignment,
    q_rest_now: UnitQuaternion<f64>,
    bias_rad_s: Vector3<f64>,
    rate_rad_s: Vector3<f64>,
    /// Changes of specific force and field since alignment by the last sample.
    change_m_s2: Option<Vector3<f64>>,
    change_ut: Option<Vector3<f64>>,
    to_tip: UnitQuaternion<f64>,
    last_t_s: f64,
    /// Variance of the mount about each axis, rad².
    mount_variance: f64,
}

crate::constants! {
    /// Bias and mount of the IMU on the base.
    const BASE: BaseConstants;
    /// Time constant of the bias, s.
    bias_time_s = 40.0;
    /// Standard deviation of the mount beyond its configuration, rad (1.7°).
    mount_sigma_rad = 0.03;
    /// Variance of a comparison of the rates times its duration, (rad/s)² s: the tip moves by 0.02 rad/s for 0.1 s.
    rate_variance = 0.02 * 0.02 * 0.1;
    /// Rate below which the rates are not compared, rad/s.
    compared_rad_s = 0.1;
}

impl BaseTracker {
    /// Processes a sample. `tip_up` is the mean specific force of the tip during its alignment, once complete.
    pub fn update(
        &mut self,
        config: &BaseConfig,
        align: &AlignConfig,
        sample: &ImuSample,
        tip_up: Option<&Vector3<f64>>,
    ) {
        if !sample.is_finite() {
            return;
        }
        match self {
            Self::Absent => *self = Self::Aligning(AlignState::default()),
            Self::Aligning(state) => {
                if let (Some(rest), Some(up)) = (state.add(align, sample), tip_up) {
                    *self = Self::Following(Follow::new(config, &rest, up, sample.t.0));
                }
            }
            Self::Following(follow) => follow.update(config, sample),
            Self::Lost(follow) => {
                follow.reacquire(sample);
                *self = Self::Following(*follow);
            }
        }
    }

    /// The IMU has given no usable sample for too long.
    pub fn lose(&mut self) {
        if let Self::Following(follow) = self {
            follow.rate_rad_s = Vector3::zeros();
            (follow.change_m_s2, follow.change_ut) = (None, None);
            *self = Self::Lost(*follow);
        }
    }

    /// Compares the rate of the tip with that of the base, while the pistons stand: both in base axes, rad/s. What differs
    /// across the rate is an error of the mount.
    pub fn compare(&mut self, tip_rate_rad_s: &Vector3<f64>, dt_s: f64) {
        let Self::Following(f) = self else { return };
        let rate = f.to_tip * f.rate_rad_s;
        if rate.norm() < BASE.compared_rad_s {
            return;
        }
        // recursive least squares for a small rotation m of the mount: the tip's rate is ω + m × ω
        let information = f.mount_variance * dt_s
            / (f.mount_variance * rate.norm_squared() * dt_s + BASE.rate_variance);
        let found = rate.cross(&(tip_rate_rad_s - rate)) * information;
        let turn = UnitQuaternion::from_scaled_axis(found.cap_magnitude(BASE.mount_sigma_rad));
        f.to_tip = turn * f.to_tip;
        // two of the three axes have been seen
        f.mount_variance *= 1.0 - 2.0 / 3.0 * information * rate.norm_squared();
    }

    /// The rotation since alignment, in the axes of the tip's IMU during alignment.
    pub fn turn(&self) -> BaseTurn {
        let (Self::Following(f) | Self::Lost(f)) = self else {
            return BaseTurn::default();
        };
        BaseTurn {
            r_rest_now: f.to_tip * f.q_rest_now * f.to_tip.inverse(),
            rate_rad_s: f.to_tip * f.rate_rad_s,
            acc_change_m_s2: f.change_m_s2.map(|v| f.to_tip * v),
            mag_change_ut: f.change_ut.map(|v| f.to_tip * v),
        }
    }

    /// The alignment, once complete.
    pub fn rest(&self) -> Option<&Alignment> {
        match self {
            Self::Following(f) | Self::Lost(f) => Some(&f.rest),
            Self::Absent | Self::Aligning(_) => None,
        }
    }

    /// True while a base IMU is present and aligned.
    pub fn follows(&self) -> bool {
        matches!(self, Self::Following(_))
    }

    /// The IMU had noise during its alignment, so identical readings mean that it is stuck.
    pub fn noisy(&self) -> bool {
        self.rest().is_some_and(Alignment::noisy)
    }
}

impl Follow {
    fn new(config: &BaseConfig, rest: &Alignment, tip_up: &Vector3<f64>, t_s: f64) -> Self {
        let mount_rad = Vector3::from(config.mount_deg).map(f64::to_radians);
        let mount = UnitQuaternion::from_scaled_axis(mount_rad);
        let level = UnitQuaternion::rotation_between(&(mount * rest.acc_rest_m_s2), tip_up)
            .unwrap_or_default();
        Self {
            rest: *rest,
            to_tip: level * mount,
            last_t_s: t_s,
            mount_variance: BASE.mount_sigma_rad * BASE.mount_sigma_rad,
            ..Self::default()
        }
    }

    /// The rotation from gravity and field alone, after a gap in which the base may have turned.
    fn reacquire(&mut self, sample: &ImuSample) {
        self.last_t_s = sample.t.0;
        let usable = intake::usable(sample);
        let between = |from: &Vector3<f64>, to: &Vector3<f64>| {
            UnitQuaternion::rotation_between(from, to).unwrap_or_default()
        };
        if let Some(acc) = usable.acc_m_s2 {
            let predicted = self.q_rest_now.inverse() * self.rest.acc_rest_m_s2;
            self.q_rest_now *= between(&acc, &predicted);
        }
        if let (Some(mag), Some(rest)) = (usable.mag_ut, self.rest.mag_rest_ut) {
            let up = self.q_rest_now.inverse() * self.rest.acc_rest_m_s2.normalize();
            let across = |v: Vector3<f64>| v - up * v.dot(&up);
            let (is, was) = (across(mag), across(self.q_rest_now.inverse() * rest));
            self.q_rest_now *= between(&is, &was);
        }
    }

    fn update(&mut self, config: &BaseConfig, sample: &ImuSample) {
        let Step::Go(dt_s) = intake::step(sample.t.0 - self.last_t_s) else {
            self.last_t_s = sample.t.0;
            return;
        };
        self.last_t_s = sample.t.0;
        let usable = intake::usable(sample);
        self.change_m_s2 = usable.acc_m_s2.map(|v| v - self.rest.acc_rest_m_s2);
        let rest_ut = self.rest.mag_rest_ut;
        self.change_ut = usable.mag_ut.zip(rest_ut).map(|(v, rest)| v - rest);
        let Some(gyro) = usable.gyro_rad_s else {
            return;
        };
        self.rate_rad_s = gyro - self.rest.gyro_bias_rad_s;
        let (mut correction, mut misfit) = (Vector3::zeros(), Vector3::zeros());
        if let Some(acc) = usable.acc_m_s2 {
            misfit = self.misfit(&acc, &self.rest.acc_rest_m_s2);
            correction = misfit / config.gravity_time_s;
        }
        let field = usable.mag_ut.zip(rest_ut);
        if let Some((mag, rest)) = field.filter(|_| config.field_time_s > 0.0) {
            // only the component about the vertical: the field must not change the tilt
            let up = self.q_rest_now.inverse() * self.rest.acc_rest_m_s2.normalize();
            let heading = up * self.misfit(&mag, &rest).dot(&up);
            correction += heading / config.field_time_s;
            misfit += heading;
        }
        let rate = self.rate_rad_s - self.bias_rad_s + correction;
        self.q_rest_now *= UnitQuaternion::from_scaled_axis(rate * dt_s);
        self.bias_rad_s -= misfit * (dt_s / (BASE.bias_time_s * BASE.bias_time_s));
        self.q_rest_now.renormalize_fast();
    }

    /// Rotation, rad, from the predicted vector to the measured one, for small angles.
    fn misfit(&self, measured: &Vector3<f64>, rest: &Vector3<f64>) -> Vector3<f64> {
        let predicted = self.q_rest_now.inverse() * rest;
        measured.cross(&predicted) / (measured.norm() * rest.norm()).max(1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::units::Seconds;

    fn sample(t: f64, q: &UnitQuaternion<f64>, rate: Vector3<f64>) -> ImuSample {
        let back = q.inverse();
        let wiggle = 0.002 * (t * 300.0).sin();
        ImuSample {
            t: Seconds(t),
            gyro_rad_s: rate + Vector3::new(0.01 + wiggle, -0.02, 0.005),
            acc_m_s2: back * Vector3::new(2.0, 1.0, 9.5),
            mag_ut: Some(back * Vector3::new(20.0, 0.0, -40.0)),
        }
    }

    #[test]
    fn a_rotation_is_tracked_in_the_axes_of_the_tip() {
        // mounted a quarter turn about the vertical away from the tip IMU
        let config = BaseConfig {
            mount_deg: [0.0, 0.0, 90.0],
            ..BaseConfig::default()
        };
        let tip_up = UnitQuaternion::from_scaled_axis(Vector3::z() * std::f64::consts::FRAC_PI_2)
            * Vector3::new(2.0, 1.0, 9.5);
        let (mut base, axis) = (BaseTracker::default(), Vector3::new(0.6, 0.0, 0.8));
        assert!(!base.follows());
        let (mut q, dt) = (UnitQuaternion::identity(), 0.002);
        for k in 0..10_000 {
            let t = f64::from(k) * dt;
            let rate = if (5.0..6.0).contains(&t) {
                axis * 10f64.to_radians()
            } else {
                Vector3::zeros()
            };
            q *= UnitQuaternion::from_scaled_axis(rate * dt);
            base.update(
                &config,
                &AlignConfig::default(),
                &sample(t, &q, rate),
                Some(&tip_up),
            );
            if k == 2000 {
                assert!(base.follows() && base.turn().r_rest_now.angle().to_degrees() < 0.05);
            }
        }
        let truth = Vector3::new(0.0, 0.6, 0.8) * 10f64.to_radians();
        assert!(
            (base.turn().r_rest_now.scaled_axis() - truth)
                .norm()
                .to_degrees()
                < 0.1,
            "{base:?}"
        );
    }

    /// A base that stands for 5 s and then swings about two axes, with the tip's IMU alike; the tracker at the end.
    fn swung(
        mount: &UnitQuaternion<f64>,
        lost: impl Fn(f64) -> bool,
        compares: bool,
    ) -> (BaseTracker, UnitQuaternion<f64>) {
        let (config, mut base, mut q, dt) = (
            BaseConfig::default(),
            BaseTracker::default(),
            UnitQuaternion::identity(),
            0.002,
        );
        for k in 0..10_000 {
            let t = f64::from(k) * dt;
            let swing = if t > 5.0 {
                Vector3::new(0.5 * t.cos(), 0.3 * (1.7 * t).sin(), 0.4 * (0.6 * t).cos())
            } else {
                Vector3::zeros()
            };
            q *= UnitQuaternion::from_scaled_axis(swing * dt);
            if lost(t) {
                base.lose();
                continue;
            }
            let seen = sample(t, &(q * mount), mount.inverse() * swing);
            base.update(
                &config,
                &AlignConfig::default(),
                &seen,
                Some(&Vector3::new(2.0, 1.0, 9.5)),
            );
            if compares && t > 5.0 {
                base.compare(&swing, dt);
            }
        }
        (base, q)
    }

    #[test]
    fn the_mount_is_found_while_the_base_turns() {
        let mount = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.05));
        let error = |compares| {
            let (base, q) = swung(&mount, |_| false, compares);
            base.turn().r_rest_now.angle_to(&q).to_degrees()
        };
        assert!(
            error(true) < 0.5 && error(true) < error(false),
            "{} {}",
            error(true),
            error(false)
        );
    }

    #[test]
    fn a_lost_imu_keeps_its_turn_and_comes_back_by_gravity_and_field() {
        let none = UnitQuaternion::identity();
        let (base, _) = swung(&none, |t| t > 10.0, false);
        assert!(
            !base.follows()
                && base.turn().rate_rad_s == Vector3::zeros()
                && base.turn().r_rest_now != none
        );
        let (base, q) = swung(&none, |t| (10.0..15.0).contains(&t), false);
        assert!(base.follows() && base.turn().r_rest_now.angle_to(&q).to_degrees() < 1.0);
    }
}
