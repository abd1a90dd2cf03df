//! Madgwick's gradient-descent filter (Madgwick 2010) on the `ahrs` crate, extended for a real sensor.
//!
//! The bare filter turns the integrated orientation at a constant rate β down the gradient of the misfit to
//! gravity and field. This module adds
//!
//! * **initial levelling** from the first samples: a start at the identity needs 36 s for half a turn at β = 0.05;
//! * **bias**: at standstill the slow mean of the gyroscope. In motion, a levelling correction that keeps its
//!   direction is bias too and is integrated slowly; about the vertical it is not observable;
//! * **levelled inputs**: force and field pass low-passes in sensor axes that turn along with the gyroscope,
//!   `v ← exp(−ω dt) v + k (measured − v)`, so that hand motion averages out and rotation does not;
//! * **two gains**: one descent on gravity alone and one that includes the field at a much smaller β, so that a
//!   distorted field turns the heading no faster than `beta_field` and hardly affects the tilt;
//! * **a gate** that rejects a disturbed field ([`FieldGate`]).
//!
//! The crate's filter is rebuilt from its quaternion for every step (a copy, no allocation), which permits any step
//! length, and never receives a zero or non-finite vector. Its Earth frame is north-west-up, as is the world frame.

use super::field_gate::FieldGate;
use super::filter::{FilterStatus, OrientationFilter, level};
use super::intake::{self, Step};
use super::standstill::StandstillDetector;
use crate::parameters;
use crate::primitives::{ImuSample, Rotation, Sensor, World};
use ahrs::Ahrs;
use nalgebra::{UnitQuaternion, Vector3};

parameters! {
    /// Settings of the Madgwick filter.
    pub struct MadgwickConfig: Copy {
        /// Gain β of the descent on gravity (half the angular rate), rad/s. A larger value corrects a wrong tilt faster and lets
        /// more hand motion into the tilt.
        beta_gravity: f64 = 0.02;
        /// Gain β of the descent on the magnetic field, rad/s. A larger value follows gyroscope drift faster, and a distorted
        /// field too.
        beta_field: f64 = 0.008;
        /// Time constant of the force and field low-passes, s. A larger value averages hand motion better and gyroscope errors
        /// worse.
        input_tau_s: f64 = 2.0;
        /// Largest plausible bias, rad/s on one axis (5 °/s). A larger value serves worse gyroscopes.
        bias_max_rad_s: f64 = 0.0873;
        /// Time constant of the bias at standstill, s. A larger value needs a longer rest and averages more noise.
        bias_still_tau_s: f64 = 1.0;
        /// Part of the levelling correction that is integrated as bias, 1/s. A larger value follows bias drift faster and
        /// lets hand motion into the bias.
        bias_motion_per_s: f64 = 0.001;
        /// Time after levelling in which neither the levelling correction nor the dip of the field is used, s: the error of a
        /// start in motion decays during it. A larger value uses both later.
        settling_s: f64 = 10.0;
        /// Rotation that both descents may make after levelling, rad: their gains are at least this over the time since. A
        /// larger value removes more of the error of a start in motion.
        settling_turn_rad: f64 = 0.3;
    }
}

/// The filter and its state.
#[derive(Debug, Clone, Default)]
pub struct Madgwick {
    config: MadgwickConfig,
    quat: Option<UnitQuaternion<f64>>,
    bias: Vector3<f64>,
    rate: Vector3<f64>,
    force: Option<Vector3<f64>>,
    field: Option<Vector3<f64>>,
    field_age_s: f64,
    /// Time since levelling, s.
    age_s: f64,
    standstill: StandstillDetector,
    gate: FieldGate,
}

impl Madgwick {
    /// A filter that levels itself with the first sample.
    pub fn new(config: MadgwickConfig) -> Self {
        Self {
            config,
            ..Self::default()
        }
    }

    /// Updates the bias at standstill, and the rate without it.
    fn update_rate(&mut self, gyro: Option<Vector3<f64>>, acc: Option<Vector3<f64>>, dt_s: f64) {
        let Some(gyro) = gyro else {
            self.standstill.miss(dt_s);
            return;
        };
        match acc {
            Some(acc) if self.standstill.update(&gyro, &acc, dt_s) => {
                let off = self.standstill.gyro_mean_rad_s() - self.bias;
                self.bias += intake::share(dt_s, self.config.bias_still_tau_s) * off;
            }
            Some(_) => {}
            None => self.standstill.miss(dt_s),
        }
        self.rate = gyro - self.bias;
    }

    /// Levels the orientation; the heading follows the field if there is one.
    fn level(&mut self) {
        if let Some(force) = self.force {
            self.quat = Some(level(&force, self.field.as_ref()).quat());
        }
    }

    /// Gain of a descent: higher shortly after levelling.
    fn gain(&self, beta: f64) -> f64 {
        beta.max(self.config.settling_turn_rad / (1.0 + self.age_s))
    }
    /// Fraction of a new reading in its low-pass: that of a plain mean until the time constant has passed.
    fn input_share(&self, dt_s: f64) -> f64 {
        intake::share(dt_s, self.config.input_tau_s).max(dt_s / (self.age_s + dt_s))
    }

    /// Descent on gravity, which corrects the tilt and the bias.
    fn descend_on_gravity(&mut self, quat: UnitQuaternion<f64>, dt_s: f64) -> UnitQuaternion<f64> {
        let step = |beta| ahrs::Madgwick::new_with_quat(dt_s, beta, quat);
        let by_gyro = *step(0.0).update_gyro(&self.rate);
        let Some(force) = self.force else {
            return by_gyro;
        };
        let mut filter = step(self.gain(self.config.beta_gravity));
        let Ok(&levelled) = filter.update_imu(&self.rate, &force) else {
            return by_gyro;
        };
        if !self.standstill.standstill() && self.age_s > self.config.settling_s {
            let turned = (by_gyro.inverse() * levelled).scaled_axis();
            self.bias -= turned * self.config.bias_motion_per_s;
            let most = self.config.bias_max_rad_s;
            self.bias = self.bias.map(|b| b.clamp(-most, most));
        }
        levelled
    }

    /// Descent on the field, which corrects the heading, scaled by the weight of the gate.
    fn descend_on_field(
        &self,
        quat: UnitQuaternion<f64>,
        weight: f64,
        dt_s: f64,
    ) -> UnitQuaternion<f64> {
        let (Some(force), Some(field)) = (self.force, self.field) else {
            return quat;
        };
        let beta = weight * self.gain(self.config.beta_field);
        let mut filter = ahrs::Madgwick::new_with_quat(dt_s, beta, quat);
        let turned = filter.update(&Vector3::zeros(), &force, &field);
        turned.copied().unwrap_or(quat)
    }
}

/// Low-pass in axes that turn with the sensor.
fn low_pass(
    state: &mut Option<Vector3<f64>>,
    new: Option<Vector3<f64>>,
    turn: &UnitQuaternion<f64>,
    share: f64,
) {
    let turned = state.map(|v| turn * v);
    *state = match (turned, new) {
        (Some(v), Some(new)) => Some(v + share * (new - v)),
        (old, new) => old.or(new),
    };
}

impl OrientationFilter for Madgwick {
    fn update(&mut self, sample: &ImuSample, dt_s: f64) {
        let usable = intake::usable(sample);
        let dt_s = match intake::step(dt_s) {
            Step::Go(dt_s) => dt_s,
            Step::Gap => {
                (self.quat, self.force, self.field, self.age_s) = (None, None, None, 0.0);
                self.standstill.miss(dt_s);
                return self.update(sample, 1e-3);
            }
            Step::Ignore => return,
        };
        self.update_rate(usable.gyro_rad_s, usable.acc_m_s2, dt_s);
        let turn = UnitQuaternion::from_scaled_axis(-self.rate * dt_s);
        let had_north = self.field.is_some();
        let force_share = self.input_share(dt_s);
        let field_share = self.input_share(self.field_age_s + dt_s);
        self.age_s += dt_s;
        self.field_age_s += dt_s;
        low_pass(&mut self.force, usable.acc_m_s2, &turn, force_share);
        low_pass(&mut self.field, usable.mag_ut, &turn, field_share);
        let Some(quat) = self.quat.filter(|_| had_north || self.field.is_none()) else {
            return self.level();
        };
        let quat = self.descend_on_gravity(quat, dt_s);
        self.quat = Some(quat);
        if let Some(mag) = usable.mag_ut {
            let since_s = std::mem::take(&mut self.field_age_s);
            if self.age_s < self.config.settling_s {
                self.gate = FieldGate::default();
            }
            let weight = self.gate.update(&(quat * mag), self.rate.norm(), since_s);
            self.quat = Some(self.descend_on_field(quat, weight, since_s));
        }
    }

    fn orientation(&self) -> Rotation<World, Sensor> {
        Rotation::assert_frames(self.quat.unwrap_or_default())
    }

    fn status(&self) -> FilterStatus {
        FilterStatus {
            gyro_bias_rad_s: self.bias,
            levelled: self.quat.is_some(),
            north_found: self.quat.is_some() && self.field.is_some(),
            standstill: self.standstill.standstill(),
            field_disturbed: self.gate.disturbed,
        }
    }
}
