//! VQF (Laidig & Seel, Information Fusion 91, 2023) on the `vqf-rs` crate.
//!
//! VQF integrates the gyroscope, levels the result with an accelerometer that is low-passed in an almost inertial
//! frame, and turns the heading δ towards the magnetometer's with time constant τ_mag. The gyroscope bias comes
//! from a Kalman filter over standstill and levelling. A disturbed field is rejected.
//!
//! The crate is a faithful port without input checks. This module keeps from it what it cannot process: non-finite
//! numbers, which stay in its state for ever, a first sample exactly upside down, which gives an error of 90°, lost
//! samples and gaps. The integration uses the true step. The low-passes use the nominal period, which is adequate
//! as long as the clock only jitters.
//!
//! `vqf-long` differs in τ_mag, the balance between gyroscope drift and field error. The field of a room with steel
//! in it deviates by 3 to 5° for seconds at a time, while a gyroscope whose bias is known to 0.03 °/s needs a
//! minute or two to drift as far. The authors' 9 s suit many sensors. `docs/fusion.md` explains the choice of
//! [`TAU_MAG_LONG_S`].

use super::filter::{FilterStatus, OrientationFilter, Periods};
use super::intake::{self, Step};
use crate::primitives::{ImuSample, Rotation, Sensor, World};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Time constant of the heading correction as published, s. A larger value reduces the heading error by a distorted field and
/// increases that by gyroscope drift.
pub const TAU_MAG_S: f64 = 9.0;
/// That of `vqf-long`, s.
pub const TAU_MAG_LONG_S: f64 = 20.0;
/// Sideways share added to a first sample that is exactly upside down, where the levelling rotation is undefined.
const UPSIDE_DOWN_OFFSET: f64 = 1e-3;

/// The filter and its state.
pub struct Vqf {
    inner: vqf_rs::VQF,
    last_gyro: Vector3<f64>,
    levelled: bool,
    north_found: bool,
}

impl Vqf {
    /// A filter for samples of the given nominal periods. Its time constant of the heading is `tau_mag_s`, all other settings are as
    /// published.
    pub fn new(periods: Periods, tau_mag_s: f64) -> Self {
        let params = vqf_rs::Params {
            tau_mag: tau_mag_s.max(0.0),
            ..vqf_rs::Params::default()
        };
        let imu_s = period_or(periods.imu_s, 0.005);
        let mag_s = period_or(periods.mag_s, imu_s);
        Self {
            inner: vqf_rs::VQF::new(imu_s, None, Some(mag_s), Some(params)),
            last_gyro: Vector3::zeros(),
            levelled: false,
            north_found: false,
        }
    }

    /// Resets the attitude; the bias and its uncertainty are kept.
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
            if up.xy().norm() < UPSIDE_DOWN_OFFSET * acc.norm() && up.z < 0.0 {
                let aside = self.orientation_6d().inverse() * Vector3::x();
                acc += aside * (UPSIDE_DOWN_OFFSET * acc.norm());
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
    /// Copies the state, since the filter of the crate does not implement `Clone`.
    fn clone(&self) -> Self {
        let (params, periods) = (*self.inner.params(), self.inner.coeffs());
        let (imu_s, mag_s) = (periods.gyr_ts, periods.mag_ts);
        let mut inner = vqf_rs::VQF::new(imu_s, None, Some(mag_s), Some(params));
        *inner.state_mut() = *self.inner.state();
        Self { inner, ..*self }
    }
}

impl std::fmt::Debug for Vqf {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut shown = f.debug_struct("Vqf");
        shown.field("tau_mag_s", &self.inner.params().tau_mag);
        shown.finish_non_exhaustive()
    }
}

impl OrientationFilter for Vqf {
    fn update(&mut self, sample: &ImuSample, dt_s: f64) {
        let usable = intake::usable(sample);
        let dt_s = match intake::step(dt_s) {
            Step::Go(dt_s) => dt_s,
            Step::Gap => {
                self.restart();
                self.inner.coeffs().gyr_ts
            }
            Step::Ignore => return,
        };
        self.last_gyro = usable.gyro_rad_s.unwrap_or(self.last_gyro);
        self.inner.update_gyr_with_ts(self.last_gyro.into(), dt_s);
        if let Some(acc) = usable.acc_m_s2 {
            self.accept_acc(&acc);
        }
        if let (Some(mag), true) = (usable.mag_ut, self.levelled) {
            self.inner.update_mag(mag.into());
            self.north_found = true;
        }
    }

    /// The world frame of VQF has y to the north, this crate's has x there.
    fn orientation(&self) -> Rotation<World, Sensor> {
        if !self.levelled {
            return Rotation::identity();
        }
        Rotation::from_enu(unit(self.inner.quat_9d()))
    }

    fn status(&self) -> FilterStatus {
        FilterStatus {
            gyro_bias_rad_s: self.inner.bias_estimate().0.into(),
            levelled: self.levelled,
            north_found: self.north_found,
            standstill: self.inner.rest_detected(),
            field_disturbed: self.north_found && self.inner.mag_dist_detected(),
        }
    }

    /// Without a reference VQF needs five seconds of turning to find the field.
    fn set_field_reference(&mut self, strength_ut: f64, dip_rad: f64) {
        self.inner.set_mag_ref(strength_ut, dip_rad);
    }
}

/// The crate asserts positive periods, so an invalid one is replaced.
fn period_or(period_s: f64, fallback_s: f64) -> f64 {
    let valid = period_s.is_finite() && period_s > 0.0;
    if valid { period_s } else { fallback_s }
}

fn unit(q: vqf_rs::Quaternion) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(q.0, q.1, q.2, q.3))
}
