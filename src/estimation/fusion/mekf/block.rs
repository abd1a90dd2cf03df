//! A block of samples, summed into what the covariance and the observations need.
//!
//! The orientation is integrated sample by sample; the covariance is moved and corrected only once a
//! block (some 35 ms), from these sums. That is exact to first order in the errors, and it is why the
//! filter costs little more per sample than one without a covariance.

use super::GRAVITY_M_S2;
use super::covariance::Flow;
use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector2, Vector3};

/// Sums over a block; all zero at its start.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    /// Length, s.
    pub length_s: f64,
    /// Gain of horizontal velocity, m/s.
    pub gained_m_s: Vector2<f64>,
    /// Angle variance that lost gyroscope samples may hide, rad².
    pub hidden_turn_rad2: f64,
    /// Velocity variance that lost accelerometer samples may hide, m²/s².
    pub hidden_push_m2_s2: f64,
    rotated: Matrix3<f64>,
    skewed: SMatrix<f64, 3, 6>,
    turning_sq: f64,
    pushing_sq: f64,
    readings: f64,
    field: Vector3<f64>,
    field_by_age: Vector3<f64>,
    field_rotation: Matrix3<f64>,
}

/// Mean of a block's magnetometer readings, each turned into the world as of its own time.
#[derive(Debug, Clone, Copy)]
pub struct FieldMean {
    /// Field in the world frame, µT.
    pub world_ut: Vector3<f64>,
    /// Its derivative by the readings' age, µT/s.
    pub by_age_ut_s: Vector3<f64>,
    /// Mean of the rotations that took sensor axes to the world.
    pub to_world: Matrix3<f64>,
}

impl Default for Block {
    fn default() -> Self {
        Self {
            length_s: 0.0,
            gained_m_s: Vector2::zeros(),
            hidden_turn_rad2: 0.0,
            hidden_push_m2_s2: 0.0,
            rotated: Matrix3::zeros(),
            skewed: SMatrix::zeros(),
            turning_sq: 0.0,
            pushing_sq: 0.0,
            readings: 0.0,
            field: Vector3::zeros(),
            field_by_age: Vector3::zeros(),
            field_rotation: Matrix3::zeros(),
        }
    }
}

impl Block {
    /// Adds `dt_s` of turning at `rate` (rad/s, corrected) to the orientation `rotation`, its matrix at the end.
    pub fn add_turning(&mut self, rotation: &Matrix3<f64>, rate: &Vector3<f64>, dt_s: f64) {
        self.length_s += dt_s;
        self.rotated += rotation * dt_s;
        self.turning_sq += rate.norm_squared() * dt_s;
        let step = rotation * dt_s;
        let (x, y, z) = (step.column(0), step.column(1), step.column(2));
        let columns = [x * rate.x, y * rate.y, z * rate.z, x * rate.y + y * rate.x, x * rate.z + z * rate.x];
        for (k, column) in columns.iter().enumerate() {
            let mut sum = self.skewed.column_mut(k);
            sum += column;
        }
        let mut last = self.skewed.column_mut(5);
        last += y * rate.z + z * rate.y;
    }

    /// Adds a specific force in the world frame, m/s².
    pub fn add_force(&mut self, force_world: &Vector3<f64>, dt_s: f64) {
        self.gained_m_s += force_world.xy() * dt_s;
        let off_gravity = force_world.norm() - GRAVITY_M_S2;
        self.pushing_sq += (off_gravity * off_gravity + force_world.xy().norm_squared()) * dt_s;
    }

    /// Adds a magnetometer reading (µT, sensor axes) that was taken when the sensor stood at `rotation`
    /// and turned at `rate` (rad/s, sensor axes).
    pub fn add_field(&mut self, mag: &Vector3<f64>, rotation: &UnitQuaternion<f64>, rate: &Vector3<f64>) {
        let world = rotation * mag;
        self.readings += 1.0;
        self.field += world;
        self.field_by_age -= (rotation * rate).cross(&world);
        self.field_rotation += rotation.to_rotation_matrix().into_inner();
    }

    /// How errors flowed into one another.
    #[must_use]
    pub fn flow(&self) -> Flow {
        Flow { attitude_by_bias: -self.rotated, attitude_by_scale: self.skewed, velocity_by_tilt_m_s: GRAVITY_M_S2 * self.length_s }
    }
    /// Mean square turning rate, rad²/s².
    #[must_use]
    pub fn turning_sq(&self) -> f64 {
        self.turning_sq / self.length_s
    }
    /// Mean square of the force that is not gravity, m²/s⁴.
    #[must_use]
    pub fn pushing_sq(&self) -> f64 {
        self.pushing_sq / self.length_s
    }
    /// Mean of the magnetometer readings, if there were any.
    #[must_use]
    pub fn field(&self) -> Option<FieldMean> {
        let n = self.readings;
        (n > 0.0).then(|| FieldMean { world_ut: self.field / n, by_age_ut_s: self.field_by_age / n, to_world: self.field_rotation / n })
    }
}
