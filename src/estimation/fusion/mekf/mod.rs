//! Error-state Kalman filter that estimates sensor errors along with the orientation.
//!
//! A multiplicative extended Kalman filter (Lefferts, Markley & Shuster 1982) in the world frame. It estimates the
//! sensor errors that dominate 9-DoF recordings with an optical reference:
//!
//! * **gyroscope scale and skew** s: `ω = (1 + s)(measured − b)`. At 400 °/s a few tenths of a percent, not the
//!   bias, make the heading drift;
//! * **age τ of a magnetometer reading**, about 14 ms for a part that is read through an auxiliary bus: at 400 °/s
//!   the field is 5° late. It is observable through `∂(R m)/∂τ = −ω × R m`;
//! * **hard iron** m that was added after calibration, such as a magnet or a phone on the body. It is constant in
//!   sensor axes and separates from the field of the room as soon as the sensor turns.
//!
//! Gravity enters through the velocity. A body that stays within reach has a mean velocity near zero over seconds,
//! so the integral of specific force minus gravity must return to zero; a tilt error φ makes it grow by g φ. The
//! heading does not enter (an invariant error, after Barrau & Bonnabel 2017), so shaking cannot turn it. At
//! standstill the gyroscope measures b and the velocity is zero.
//!
//! The field model is `R(t − τ) measured = (h, 0, z) + R m + noise`. The field error in a room lasts for seconds at
//! one place and is modelled as white noise of the same power over `field_memory_s`. When the misfit exceeds the
//! error of a room, readings lose weight in proportion and the uncertainty of the hard iron grows: a magnet on the
//! body is then estimated and subtracted, one in the room stays rejected.
//!
//! [`covariance`] holds the error states, [`block`] the sums between corrections, `correct` the observations.
//! `docs/fusion.md` describes the settings and their cross-validation.

pub mod block;
mod config;
mod correct;
pub mod covariance;
pub mod saturation;

pub use config::MekfConfig;

use super::filter::{FilterStatus, OrientationFilter, level};
use super::intake::{self, GRAVITY_M_S2, Step, Usable};
use super::standstill::StandstillDetector;
use crate::primitives::{ImuSample, Rotation, Sensor, World};
use block::Block;
use covariance::{ATTITUDE, BIAS, Covariance, DIM, Errors, FIELD, IRON, LATENCY, SCALE, VELOCITY};
use nalgebra::{SVector, UnitQuaternion, Vector2, Vector3};
use saturation::Saturation;

/// The estimate to which the error states refer.
#[derive(Debug, Clone, Copy, Default)]
pub struct Estimate {
    r_world_sensor: UnitQuaternion<f64>,
    bias_rad_s: Vector3<f64>,
    /// Gyroscope scale and skew errors xx, yy, zz, xy, xz, yz: true = (1 + s)(measured − bias).
    pub scale: SVector<f64, 6>,
    velocity_m_s: Vector2<f64>,
    /// North and up components of the Earth's field, µT, once north is found.
    field_ut: Option<Vector2<f64>>,
    /// Hard iron in sensor axes, µT.
    pub iron_ut: Vector3<f64>,
    /// Age of a magnetometer reading when it is handed in, s.
    pub latency_s: f64,
    /// Direction of the last field reading, rad, by which the output is turned until north is found.
    provisional_rad: f64,
}

/// The filter and its state.
#[derive(Debug, Clone, Default)]
pub struct Mekf {
    config: MekfConfig,
    estimate: Estimate,
    covariance: Covariance,
    block: Block,
    standstill: StandstillDetector,
    saturation: Saturation,
    rate: Vector3<f64>,
    last_mag: Option<Vector3<f64>>,
    /// Running mean square of the field's misfit per axis, µT².
    misfit_ut2: f64,
    levelled: bool,
    disturbed: bool,
}

impl Mekf {
    /// A filter that levels itself with the first sample.
    pub fn new(config: MekfConfig) -> Self {
        Self {
            config,
            estimate: Estimate {
                latency_s: config.latency_ms * 1e-3,
                ..Estimate::default()
            },
            covariance: Covariance::from_sigmas(&first_sigmas(&config)),
            ..Self::default()
        }
    }

    /// What is estimated.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// Levels the orientation from a specific force and keeps the estimated sensor errors. Motion makes the levelling
    /// less certain.
    fn level_on(&mut self, acc: &Vector3<f64>, gyro: Option<Vector3<f64>>) {
        self.estimate.r_world_sensor = level(acc, None).quat();
        self.estimate.velocity_m_s = Vector2::zeros();
        self.estimate.field_ut = None;
        self.estimate.provisional_rad = 0.0;
        self.last_mag = None;
        self.block = Block::default();
        let moving = gyro.is_some_and(|w| w.norm() > self.config.moving_rad_s);
        let tilt = self.config.first_tilt_deg.to_radians()
            + (acc.norm() / GRAVITY_M_S2 - 1.0).abs().min(1.0)
            + if moving {
                self.config.moving_tilt_rad
            } else {
                0.0
            };
        let mut fresh = first_sigmas(&self.config);
        fresh.rows_mut(ATTITUDE, 2).fill(tilt);
        let velocity_and_field = (VELOCITY..VELOCITY + 2).chain(FIELD..FIELD + 2);
        for k in (ATTITUDE..BIAS).chain(velocity_and_field) {
            self.covariance.isolate(k, fresh[k]);
        }
        self.levelled = true;
    }

    /// Updates the standstill detector and the rate, with the estimated gyroscope errors removed.
    fn update_rate(&mut self, usable: &Usable, dt_s: f64) {
        match (usable.gyro_rad_s, usable.acc_m_s2) {
            (Some(gyro), Some(acc)) => _ = self.standstill.update(&gyro, &acc, dt_s),
            _ => self.standstill.miss(dt_s),
        }
        let Some(gyro) = usable.gyro_rad_s else {
            self.block.missed_turn_rad2 += squared(self.config.missed_rate_rad_s * dt_s);
            return;
        };
        if let Some(limit_rad_s) = self.saturation.update(&gyro) {
            self.block.saturated_rad += limit_rad_s * dt_s;
        }
        let (w, s) = (gyro - self.estimate.bias_rad_s, &self.estimate.scale);
        self.rate = w + Vector3::new(
            s[0] * w.x + s[3] * w.y + s[4] * w.z,
            s[3] * w.x + s[1] * w.y + s[5] * w.z,
            s[4] * w.x + s[5] * w.y + s[2] * w.z,
        );
    }

    /// Integrates one sample into the estimate and adds it to the block.
    fn integrate(&mut self, usable: &Usable, dt_s: f64) {
        let turn = UnitQuaternion::from_scaled_axis(self.rate * dt_s);
        let rotation = self.estimate.r_world_sensor * turn;
        self.estimate.r_world_sensor = rotation;
        let to_world = rotation.to_rotation_matrix().into_inner();
        self.block.add_turning(&to_world, &self.rate, dt_s);
        match usable.acc_m_s2 {
            Some(acc) => self.block.add_force(&(rotation * acc), dt_s),
            None => {
                self.block.missed_velocity_m2_s2 += squared(self.config.missed_force_m_s2 * dt_s)
            }
        }
        let Some(mag) = usable.mag_ut.filter(|m| self.last_mag != Some(*m)) else {
            return;
        };
        self.last_mag = Some(mag);
        let then =
            rotation * UnitQuaternion::from_scaled_axis(-self.rate * self.estimate.latency_s);
        if self.estimate.field_ut.is_none() {
            self.find_north(&(then * mag));
        } else {
            self.block.add_field(&mag, &then, &self.rate);
        }
    }

    /// The first field reading of a levelled sensor defines north, to within the errors of room and hard iron.
    fn find_north(&mut self, world_ut: &Vector3<f64>) {
        self.estimate.provisional_rad = world_ut.y.atan2(world_ut.x);
        let tilt = |axis: usize| self.covariance.sigma(ATTITUDE + axis);
        if tilt(0).max(tilt(1)) > self.config.level_enough_rad {
            return;
        }
        let turn = about_up(-std::mem::take(&mut self.estimate.provisional_rad));
        let r_world_sensor = turn * self.estimate.r_world_sensor;
        self.estimate.r_world_sensor = r_world_sensor;
        self.estimate.velocity_m_s = (turn * self.estimate.velocity_m_s.push(0.0)).xy();
        self.block = Block::default();
        for k in [ATTITUDE, ATTITUDE + 1, VELOCITY, VELOCITY + 1] {
            self.covariance.isolate(k, self.covariance.sigma(k));
        }
        self.estimate.field_ut = Some(Vector2::new(world_ut.xy().norm(), world_ut.z));
        self.misfit_ut2 = 0.0;
        let reading = block::FieldMean {
            world_ut: Vector3::new(world_ut.xy().norm(), 0.0, world_ut.z),
            by_age_ut_s: Vector3::zeros(),
            to_world: r_world_sensor.to_rotation_matrix().into_inner(),
        };
        let mut errors = Errors::zeros();
        let place_ut2 = self.config.first_field_sigma_ut.powi(2);
        for row in reading.rows() {
            // north is defined by this reading, so its residual is zero
            self.covariance.observe(&mut errors, &row, 0.0, place_ut2);
        }
        self.inject(&errors);
    }

    /// Propagates the covariance over the block, processes its observations and starts the next block.
    fn close_block(&mut self) {
        let block = std::mem::take(&mut self.block);
        self.estimate.velocity_m_s += block.gained_m_s;
        self.predict(&block);
        let mut errors = Errors::zeros();
        self.observe_motion(&mut errors, block.length_s);
        if let Some(reading) = block.field() {
            self.observe_field(&mut errors, &reading, block.length_s);
        }
        self.inject(&errors);
        if !self.is_sane() {
            *self = Self::new(self.config);
        }
    }

    fn predict(&mut self, block: &Block) {
        let c = &self.config;
        let dt_s = block.length_s;
        let pull = GRAVITY_M_S2 * dt_s;
        self.covariance.flow(&block.rotated, &block.skewed, pull);
        let still = self.standstill.standstill();
        let wander = c.gyro_wander_deg_rt_s.to_radians() * if still { 0.1 } else { 1.0 };
        let turn =
            (squared(wander) + squared(c.gyro_nonlinearity_rt_s) * block.turning_sq()) * dt_s;
        let saturated = squared(c.saturated_excess * block.saturated_rad);
        let push =
            (squared(c.acc_floor_m_s_rt_s) + squared(c.acc_fault_rt_s) * block.force_sq()) * dt_s;
        let bias = squared(c.bias_wander_deg_s_rt_s.to_radians()) * dt_s;
        for (first, count, variance) in [
            (ATTITUDE, 3, turn + block.missed_turn_rad2 + saturated),
            (BIAS, 3, bias),
            (VELOCITY, 2, push + block.missed_velocity_m2_s2),
            (FIELD, 2, squared(c.field_wander_ut_rt_s) * dt_s),
            (IRON, 3, squared(c.iron_wander_ut_rt_s) * dt_s),
        ] {
            self.covariance.grow(first, count, variance);
        }
    }

    /// Adds the estimated errors to the estimate.
    fn inject(&mut self, errors: &Errors) {
        let e = &mut self.estimate;
        let turn: Vector3<f64> = errors.fixed_rows::<3>(ATTITUDE).into_owned();
        e.r_world_sensor = UnitQuaternion::from_scaled_axis(turn) * e.r_world_sensor;
        e.r_world_sensor.renormalize();
        e.bias_rad_s += errors.fixed_rows::<3>(BIAS);
        e.scale += errors.fixed_rows::<6>(SCALE);
        e.velocity_m_s += errors.fixed_rows::<2>(VELOCITY);
        if let Some(field) = &mut e.field_ut {
            *field += errors.fixed_rows::<2>(FIELD);
            field.x = field.x.max(self.config.horizontal_field_min_ut);
        }
        e.iron_ut += errors.fixed_rows::<3>(IRON);
        let scale_max = self.config.scale_max;
        e.scale = e.scale.map(|s| s.clamp(-scale_max, scale_max));
        e.latency_s = (e.latency_s + errors[LATENCY]).clamp(0.0, self.config.latency_max_ms * 1e-3);
    }

    fn is_sane(&self) -> bool {
        let e = &self.estimate;
        let vectors = e.bias_rad_s.iter().chain(&e.iron_ut);
        let mut numbers = e.r_world_sensor.coords.iter().chain(vectors);
        numbers.all(|x| x.is_finite()) && self.covariance.is_sane()
    }
}

fn squared(sigma: f64) -> f64 {
    sigma * sigma
}

fn about_up(angle_rad: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle_rad)
}

/// Standard deviations before the first sample.
fn first_sigmas(c: &MekfConfig) -> Errors {
    let mut s = Errors::zeros();
    let mut set = |first: usize, count: usize, sigma: f64| s.rows_mut(first, count).fill(sigma);
    set(ATTITUDE, 2, c.first_tilt_deg.to_radians());
    set(ATTITUDE + 2, 1, c.heading_unknown_rad);
    set(BIAS, 3, c.bias_sigma_deg_s.to_radians());
    set(SCALE, 3, c.scale_sigma);
    set(SCALE + 3, 3, 0.5 * c.scale_sigma);
    set(VELOCITY, 2, c.velocity_sigma_m_s);
    set(FIELD, 2, c.field_unknown_ut);
    set(IRON, 3, c.iron_sigma_ut);
    set(LATENCY, 1, c.latency_sigma_ms * 1e-3);
    debug_assert_eq!(LATENCY + 1, DIM);
    s
}

impl OrientationFilter for Mekf {
    fn update(&mut self, sample: &ImuSample, dt_s: f64) {
        let usable = intake::usable(sample);
        let dt_s = match intake::step(dt_s) {
            Step::Go(dt_s) => dt_s,
            Step::Gap => {
                self.levelled = false;
                self.standstill.miss(dt_s);
                1e-3
            }
            Step::Ignore => return,
        };
        if !self.levelled {
            let Some(acc) = usable.acc_m_s2 else { return };
            self.level_on(&acc, usable.gyro_rad_s);
        }
        self.update_rate(&usable, dt_s);
        self.integrate(&usable, dt_s);
        if self.block.length_s >= self.config.block_s {
            self.close_block();
        }
    }

    fn orientation(&self) -> Rotation<World, Sensor> {
        let e = &self.estimate;
        Rotation::assert_frames(about_up(-e.provisional_rad) * e.r_world_sensor)
    }

    fn status(&self) -> FilterStatus {
        FilterStatus {
            gyro_bias_rad_s: self.estimate.bias_rad_s,
            levelled: self.levelled,
            north_found: self.estimate.field_ut.is_some(),
            standstill: self.standstill.standstill(),
            field_disturbed: self.disturbed,
        }
    }
}
