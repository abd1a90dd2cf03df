//! Madgwick's gradient-descent filter (Madgwick 2010) on the `ahrs` crate, made fit for a real sensor.
//!
//! The bare filter turns the gyroscope-integrated orientation at a constant rate β down the gradient
//! of the misfit to gravity and field. Around it stand here:
//!
//! * **seed**: the first accelerometer and magnetometer samples (a start at identity needs 36 s for
//!   half a turn at β = 0.05);
//! * **bias**: at rest the gyroscope's slow mean; in motion the part of the levelling that keeps
//!   pointing one way is bias too, learnt slowly (about the vertical it cannot be seen);
//! * **levelled inputs**: force and field are low-passed in sensor axes that the gyroscope keeps
//!   turning along, `v ← exp(−ω dt) v + k (measured − v)`, so that hand motion averages out and turning does not;
//! * **two gains**: one descent on gravity alone, one with the field at a much smaller β, so that a bent
//!   field turns the heading no faster than `beta_field` and hardly tilts anything;
//! * **gate**: a disturbed field is refused ([`FieldGate`]).
//!
//! The crate's traps stay outside: it is rebuilt from its quaternion for every step (a copy, no
//! allocation), so any step length will do, and it never sees a zero or non-finite vector. Its Earth
//! frame is north-west-up, which is our world.

use super::gate::{FieldConfig, FieldGate};
use super::intake::{self, Step};
use super::limits::{self, OutOfRange};
use super::rest::{RestConfig, RestDetector};
use super::{Flags, OrientationFilter, level};
use crate::primitives::frames::{Rotation, Sensor, World};
use crate::primitives::sample::ImuSample;
use ahrs::Ahrs;
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Largest bias that is believed, rad/s on one axis (5 °/s).
const BIAS_MAX_RAD_S: f64 = 0.0873;
/// Time after the seed in which levelling says nothing of the bias, nor the dip of the field's worth, s.
const SEED_S: f64 = 10.0;

/// Settings of the Madgwick filter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MadgwickConfig {
    /// Rate at which gravity may level the orientation, as Madgwick's β (half the angular rate), rad/s.
    /// Default 0.02. Bigger: faster recovery from a wrong tilt, more tilt from what is left of hand motion.
    pub beta_gravity: f64,
    /// Rate at which the field may turn the heading, likewise, rad/s. Default 0.008. Bigger: gyroscope
    /// drift is followed sooner, and so is a bent field.
    pub beta_field: f64,
    /// Time constant of the force and field low-passes, seconds. Default 2. Bigger: hand motion averages out
    /// better, errors of the gyroscope less.
    pub input_tau_s: f64,
    /// Time constant of bias learning at rest, seconds. Default 1. Bigger: a smoother bias, later.
    pub bias_rest_tau_s: f64,
    /// Share of the levelling rate that is taken for bias, 1/s. Default 0.001. Bigger: drift of the bias in
    /// motion is followed sooner, and hand motion leaks into the bias.
    pub bias_motion_per_s: f64,
    /// Turn that both descents may spend after the seed, rad: their rates are at least this over the time
    /// since. Default 0.3. Bigger: a start in motion, whose seed is wrong, is mended sooner.
    pub seed_turn_rad: f64,
    /// When the sensor counts as still.
    pub rest: RestConfig,
    /// When the magnetic field counts as the Earth's.
    pub field: FieldConfig,
}

impl Default for MadgwickConfig {
    fn default() -> Self {
        Self {
            beta_gravity: 0.02,
            beta_field: 0.008,
            input_tau_s: 2.0,
            bias_rest_tau_s: 1.0,
            bias_motion_per_s: 0.001,
            seed_turn_rad: 0.3,
            rest: RestConfig::default(),
            field: FieldConfig::default(),
        }
    }
}

impl MadgwickConfig {
    /// Refuses settings that are not finite or far from anything sensible.
    ///
    /// # Errors
    /// The first setting that is out of range, with its range.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        let d = Self::default();
        let rows = [
            ("beta_gravity", self.beta_gravity, d.beta_gravity, 0.0, 10.0),
            ("beta_field", self.beta_field, d.beta_field, 0.0, 10.0),
            ("input_tau_s", self.input_tau_s, d.input_tau_s, 0.001, 100.0),
            ("bias_rest_tau_s", self.bias_rest_tau_s, d.bias_rest_tau_s, 0.001, 1000.0),
            ("bias_motion_per_s", self.bias_motion_per_s, d.bias_motion_per_s, 0.0, 1.0),
            ("seed_turn_rad", self.seed_turn_rad, d.seed_turn_rad, 0.0, 10.0),
        ];
        limits::check(&rows)?;
        self.rest.validate()?;
        self.field.validate()
    }
}

/// The filter.
#[derive(Debug, Clone)]
pub struct Madgwick {
    config: MadgwickConfig,
    quat: Option<UnitQuaternion<f64>>,
    bias: Vector3<f64>,
    rate: Vector3<f64>,
    force: Option<Vector3<f64>>,
    field: Option<Vector3<f64>>,
    field_age_s: f64,
    /// Time since the seed, s.
    age_s: f64,
    rest: RestDetector,
    gate: FieldGate,
}

impl Madgwick {
    /// A filter that levels itself on the first sample.
    #[must_use]
    pub fn new(config: MadgwickConfig) -> Self {
        Self {
            config,
            quat: None,
            bias: Vector3::zeros(),
            rate: Vector3::zeros(),
            force: None,
            field: None,
            field_age_s: 0.0,
            age_s: 0.0,
            rest: RestDetector::new(config.rest),
            gate: FieldGate::new(config.field),
        }
    }

    /// Bias from rest, and the rate without it.
    fn take_gyro(&mut self, gyro: Option<Vector3<f64>>, acc: Option<Vector3<f64>>, dt_s: f64) {
        let Some(gyro) = gyro else {
            self.rest.miss(dt_s);
            return;
        };
        match acc {
            Some(acc) if self.rest.update(&gyro, &acc, dt_s) => {
                self.bias += intake::share(dt_s, self.config.bias_rest_tau_s) * (self.rest.gyro_mean_rad_s() - self.bias);
            }
            Some(_) => {}
            None => self.rest.miss(dt_s),
        }
        self.rate = gyro - self.bias;
    }

    /// The seed: level, and north where there is one.
    fn seed(&mut self) {
        if let Some(force) = self.force {
            self.quat = Some(level(&force, self.field.as_ref()).quat());
        }
    }

    /// A descent's rate: higher while the seed is fresh.
    fn beta(&self, beta: f64) -> f64 {
        beta.max(self.config.seed_turn_rad / (1.0 + self.age_s))
    }
    /// Share of a new reading in its low-pass: a plain mean until that is older than the low-pass.
    fn input_share(&self, dt_s: f64) -> f64 {
        intake::share(dt_s, self.config.input_tau_s).max(dt_s / (self.age_s + dt_s))
    }

    /// Descent on gravity: the tilt half of the filter, and what it says of the bias.
    fn descend_on_gravity(&mut self, quat: UnitQuaternion<f64>, dt_s: f64) -> UnitQuaternion<f64> {
        let step = |beta| ahrs::Madgwick::new_with_quat(dt_s, beta, quat);
        let by_gyro = *step(0.0).update_gyro(&self.rate);
        let Some(force) = self.force else { return by_gyro };
        let mut filter = step(self.beta(self.config.beta_gravity));
        let Ok(&levelled) = filter.update_imu(&self.rate, &force) else { return by_gyro };
        if !self.rest.at_rest() && self.age_s > SEED_S {
            let turned = (by_gyro.inverse() * levelled).scaled_axis();
            self.bias -= turned * self.config.bias_motion_per_s;
            self.bias = self.bias.map(|b| b.clamp(-BIAS_MAX_RAD_S, BIAS_MAX_RAD_S));
        }
        levelled
    }

    /// Descent on the field: the heading half, as far as the gate lets it.
    fn descend_on_field(&self, quat: UnitQuaternion<f64>, weight: f64, dt_s: f64) -> UnitQuaternion<f64> {
        let (Some(force), Some(field)) = (self.force, self.field) else { return quat };
        let mut filter = ahrs::Madgwick::new_with_quat(dt_s, weight * self.beta(self.config.beta_field), quat);
        filter.update(&Vector3::zeros(), &force, &field).copied().unwrap_or(quat)
    }
}

/// Low-pass in axes that turn with the sensor.
fn follow(state: &mut Option<Vector3<f64>>, new: Option<Vector3<f64>>, turn: &UnitQuaternion<f64>, share: f64) {
    let turned = state.map(|v| turn * v);
    *state = match (turned, new) {
        (Some(v), Some(new)) => Some(v + share * (new - v)),
        (old, new) => old.or(new),
    };
}

impl OrientationFilter for Madgwick {
    fn update(&mut self, sample: &ImuSample, dt_s: f64) {
        let seen = intake::usable(sample);
        let dt_s = match intake::step(dt_s) {
            Step::Go(dt_s) => dt_s,
            Step::Gap => {
                (self.quat, self.force, self.field, self.age_s) = (None, None, None, 0.0);
                self.rest.miss(dt_s);
                return self.update(sample, 1e-3);
            }
            Step::Ignore => return,
        };
        self.take_gyro(seen.gyro_rad_s, seen.acc_m_s2, dt_s);
        let turn = UnitQuaternion::from_scaled_axis(-self.rate * dt_s);
        let had_north = self.field.is_some();
        let (force_share, field_share) = (self.input_share(dt_s), self.input_share(self.field_age_s + dt_s));
        self.age_s += dt_s;
        self.field_age_s += dt_s;
        follow(&mut self.force, seen.acc_m_s2, &turn, force_share);
        follow(&mut self.field, seen.mag_ut, &turn, field_share);
        let Some(quat) = self.quat.filter(|_| had_north || self.field.is_none()) else {
            return self.seed();
        };
        let quat = self.descend_on_gravity(quat, dt_s);
        let quat = match seen.mag_ut {
            Some(mag) => {
                let since_s = std::mem::take(&mut self.field_age_s);
                if self.age_s < SEED_S {
                    self.gate = FieldGate::new(self.config.field);
                }
                let weight = self.gate.update(&(quat * mag), self.rate.norm(), since_s);
                self.descend_on_field(quat, weight, since_s)
            }
            None => quat,
        };
        self.quat = Some(quat);
    }

    fn orientation(&self) -> Rotation<World, Sensor> {
        self.quat.map_or_else(Rotation::identity, Rotation::assert_frames)
    }

    fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        self.bias
    }

    fn flags(&self) -> Flags {
        Flags {
            levelled: self.quat.is_some(),
            north_found: self.quat.is_some() && self.field.is_some(),
            at_rest: self.rest.at_rest(),
            field_disturbed: self.gate.disturbed(),
        }
    }
}
