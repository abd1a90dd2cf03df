//! VQF (Laidig & Seel, Information Fusion 91, 2023) behind the common seam, on the `vqf-rs` crate.
//!
//! VQF integrates the gyroscope, levels it with an accelerometer low-passed in an almost inertial
//! frame, and turns the heading δ towards the magnetometer's with time constant τ_mag; gyroscope bias
//! comes from a Kalman filter over rest and levelling, and a disturbed field is refused.
//!
//! The crate is a faithful port and trusts its input. What it cannot take is kept from it here:
//! non-finite numbers (they stay in its state for ever), a first sample exactly upside down (90° wrong),
//! lost samples and gaps. Integration uses the true step; its low-passes use the nominal period, which
//! is right as long as the clock only jitters.
//!
//! `vqf-long` differs in one number. τ_mag is where gyroscope drift and field error meet: the field
//! of a room with steel in it points 3 to 5° off for seconds at a time, while a gyroscope whose bias is
//! known to 0.03 °/s needs a minute or two to drift as far. The authors' 9 s suit many sensors; how
//! [`TAU_MAG_LONG_S`] was chosen is told in `docs/fusion.md`.

use super::intake::{self, Step};
use super::limits::{self, OutOfRange};
use super::{Flags, OrientationFilter, Periods};
use crate::primitives::frames::{Rotation, Sensor, World};
use crate::primitives::sample::ImuSample;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Magnetometer time constant of `vqf-long`, seconds.
pub const TAU_MAG_LONG_S: f64 = 20.0;
/// Tilt by which a first sample that is exactly upside down is nudged, as a share of its length.
const NUDGE_SHARE: f64 = 1e-3;

/// What may be set of VQF; everything else is as its authors publish it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VqfConfig {
    /// Time constant of the accelerometer low-pass, seconds. Default 3. Bigger: hand motion tilts the
    /// orientation less, gyroscope drift tilts it more.
    pub tau_acc_s: f64,
    /// Time constant of the heading correction, seconds. Default 9. Bigger: a bent field turns the
    /// heading less, gyroscope drift turns it more.
    pub tau_mag_s: f64,
}

impl Default for VqfConfig {
    fn default() -> Self {
        Self { tau_acc_s: 3.0, tau_mag_s: 9.0 }
    }
}

impl VqfConfig {
    /// Refuses settings that are not finite or far from anything sensible.
    ///
    /// # Errors
    /// The first setting that is out of range, with its range.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        let d = Self::default();
        let rows = [("tau_acc_s", self.tau_acc_s, d.tau_acc_s, 0.01, 1000.0), ("tau_mag_s", self.tau_mag_s, d.tau_mag_s, 0.01, 10_000.0)];
        limits::check(&rows)
    }
}

impl VqfConfig {
    /// The configuration called `vqf-long`.
    #[must_use]
    pub fn long() -> Self {
        Self { tau_mag_s: TAU_MAG_LONG_S, ..Self::default() }
    }
}

/// The filter.
pub struct Vqf {
    inner: vqf_rs::VQF,
    periods: Periods,
    config: VqfConfig,
    last_gyro: Vector3<f64>,
    levelled: bool,
    north_found: bool,
}

impl Vqf {
    /// A filter for samples of the given nominal periods.
    #[must_use]
    pub fn new(periods: Periods, config: VqfConfig) -> Self {
        let params =
            vqf_rs::Params { tau_acc: config.tau_acc_s.max(1e-3), tau_mag: config.tau_mag_s.max(0.0), ..vqf_rs::Params::default() };
        let imu_s = period_or(periods.imu_s, 0.005);
        let mag_s = period_or(periods.mag_s, imu_s);
        Self {
            inner: vqf_rs::VQF::new(imu_s, None, Some(mag_s), Some(params)),
            periods,
            config,
            last_gyro: Vector3::zeros(),
            levelled: false,
            north_found: false,
        }
    }

    /// Tells what the undisturbed field looks like (µT, dip in rad, + when it points down), which VQF
    /// would else take five seconds of turning to find.
    pub fn know_field(&mut self, strength_ut: f64, dip_rad: f64) {
        self.inner.set_mag_ref(strength_ut, dip_rad);
    }

    /// Forgets the attitude, keeps the bias and how well it is known.
    fn restart(&mut self) {
        let (bias, sigma) = self.inner.bias_estimate();
        self.inner.reset_state();
        self.inner.set_bias_estimate(bias, Some(sigma));
        self.levelled = false;
        self.north_found = false;
    }

    fn accept_acc(&mut self, acc: &Vector3<f64>) {
        let mut acc = *acc;
        if !self.levelled {
            let up = self.orientation_6d() * acc;
            if up.xy().norm() < NUDGE_SHARE * acc.norm() && up.z < 0.0 {
                let aside = self.orientation_6d().inverse() * Vector3::x();
                acc += aside * (NUDGE_SHARE * acc.norm());
            }
            self.levelled = true;
        }
        self.inner.update_acc(acc.into());
    }

    fn orientation_6d(&self) -> UnitQuaternion<f64> {
        unit(self.inner.quat_6d())
    }
}

impl Clone for Vqf {
    /// The crate's filter cannot be cloned, its state can.
    fn clone(&self) -> Self {
        let mut copy = Self::new(self.periods, self.config);
        *copy.inner.state_mut() = *self.inner.state();
        (copy.last_gyro, copy.levelled, copy.north_found) = (self.last_gyro, self.levelled, self.north_found);
        copy
    }
}

impl std::fmt::Debug for Vqf {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Vqf").field("config", &self.config).field("orientation", &self.orientation()).finish_non_exhaustive()
    }
}

impl OrientationFilter for Vqf {
    fn update(&mut self, sample: &ImuSample, dt_s: f64) {
        let seen = intake::usable(sample);
        let dt_s = match intake::step(dt_s) {
            Step::Go(dt_s) => dt_s,
            Step::Gap => {
                self.restart();
                self.inner.coeffs().gyr_ts
            }
            Step::Ignore => return,
        };
        self.last_gyro = seen.gyro_rad_s.unwrap_or(self.last_gyro);
        self.inner.update_gyr_with_ts(self.last_gyro.into(), dt_s);
        if let Some(acc) = seen.acc_m_s2 {
            self.accept_acc(&acc);
        }
        if let (Some(mag), true) = (seen.mag_ut, self.levelled) {
            self.inner.update_mag(mag.into());
            self.north_found = true;
        }
    }

    /// VQF's own frame has y to the north; ours has x there.
    fn orientation(&self) -> Rotation<World, Sensor> {
        let r_world_enu = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -std::f64::consts::FRAC_PI_2);
        if self.levelled { Rotation::assert_frames(r_world_enu * unit(self.inner.quat_9d())) } else { Rotation::identity() }
    }

    fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        self.inner.bias_estimate().0.into()
    }

    fn flags(&self) -> Flags {
        Flags {
            levelled: self.levelled,
            north_found: self.north_found,
            at_rest: self.inner.rest_detected(),
            field_disturbed: self.north_found && self.inner.mag_dist_detected(),
        }
    }
}

/// The crate asserts positive periods; a period that is none is replaced.
fn period_or(period_s: f64, fallback_s: f64) -> f64 {
    if period_s.is_finite() && period_s > 0.0 { period_s } else { fallback_s }
}

fn unit(q: vqf_rs::Quaternion) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(q.0, q.1, q.2, q.3))
}
