//! Sums over a block of samples, as the covariance and the observations need them.
//!
//! The orientation is integrated sample by sample. The covariance is propagated and corrected once per block (about
//! 35 ms) from these sums, which is exact to first order in the errors and keeps the cost per sample close to that
//! of a filter without a covariance.

use super::covariance::{ATTITUDE, FIELD, IRON, LATENCY, SCALE_AXES};
use crate::estimation::fusion::intake::GRAVITY_M_S2;
use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector2, Vector3};

/// Sums over a block, all zero at its start.
#[derive(Debug, Clone, Copy, Default)]
pub struct Block {
    /// Length, s.
    pub length_s: f64,
    /// Change of the horizontal velocity, m/s.
    pub gained_m_s: Vector2<f64>,
    /// Angle variance of lost gyroscope samples, rad².
    pub missed_turn_rad2: f64,
    /// Angle measured while the gyroscope was at the end of its range, rad.
    pub saturated_rad: f64,
    /// Velocity variance of lost accelerometer samples, m²/s².
    pub missed_velocity_m2_s2: f64,
    /// ∫ R dt, s.
    pub rotated: Matrix3<f64>,
    /// ∫ R ∂ω/∂s dt, rad.
    pub skewed: SMatrix<f64, 3, 6>,
    turning_sq: f64,
    force_sq: f64,
    readings: f64,
    /// Sum over the readings.
    field: FieldMean,
}

/// Mean of the magnetometer readings of a block, each turned into the world by the orientation at its own time.
#[derive(Debug, Clone, Copy, Default)]
pub struct FieldMean {
    /// Field in the world frame, µT.
    pub world_ut: Vector3<f64>,
    /// Its derivative with respect to the age of the readings, µT/s.
    pub by_age_ut_s: Vector3<f64>,
    /// Mean of the rotations from sensor to world axes.
    pub to_world: Matrix3<f64>,
}

/// Gains of one axis of a field residual: pairs of error index and derivative.
pub type Row = [(usize, f64); 8];

impl FieldMean {
    /// Rows of a field residual (reading minus model, world axes): `−φ × y − ∂y/∂τ δτ + (δh, 0, δz) + R δm`.
    pub fn rows(&self) -> [Row; 3] {
        let turn = self.world_ut.cross_matrix();
        let earth = [(FIELD, 1.0), (FIELD, 0.0), (FIELD + 1, 1.0)];
        std::array::from_fn(|axis| {
            [
                (ATTITUDE, turn[(axis, 0)]),
                (ATTITUDE + 1, turn[(axis, 1)]),
                (ATTITUDE + 2, turn[(axis, 2)]),
                (IRON, self.to_world[(axis, 0)]),
                (IRON + 1, self.to_world[(axis, 1)]),
                (IRON + 2, self.to_world[(axis, 2)]),
                (LATENCY, -self.by_age_ut_s[axis]),
                earth[axis],
            ]
        })
    }
}

impl Block {
    /// Adds `dt_s` of rotation at `rate` (rad/s, corrected); `rotation` is the orientation at the end.
    pub fn add_turning(&mut self, rotation: &Matrix3<f64>, rate: &Vector3<f64>, dt_s: f64) {
        self.length_s += dt_s;
        self.rotated += rotation * dt_s;
        self.turning_sq += rate.norm_squared() * dt_s;
        let step = rotation * dt_s;
        let turned = |axis: usize, by: usize| step.column(axis) * rate[by];
        for (mut sum, (i, j)) in self.skewed.column_iter_mut().zip(SCALE_AXES) {
            sum += if i == j {
                turned(i, i)
            } else {
                turned(i, j) + turned(j, i)
            };
        }
    }

    /// Adds a specific force in the world frame, m/s².
    pub fn add_force(&mut self, force_world: &Vector3<f64>, dt_s: f64) {
        self.gained_m_s += force_world.xy() * dt_s;
        let off_gravity = force_world.norm() - GRAVITY_M_S2;
        self.force_sq += (off_gravity * off_gravity + force_world.xy().norm_squared()) * dt_s;
    }

    /// Adds a magnetometer reading (µT, sensor axes) that was taken at orientation `rotation` and angular rate
    /// `rate` (rad/s, sensor axes).
    pub fn add_field(
        &mut self,
        mag: &Vector3<f64>,
        rotation: &UnitQuaternion<f64>,
        rate: &Vector3<f64>,
    ) {
        let world = rotation * mag;
        self.readings += 1.0;
        self.field.world_ut += world;
        self.field.by_age_ut_s -= (rotation * rate).cross(&world);
        self.field.to_world += rotation.to_rotation_matrix().into_inner();
    }

    /// Mean square angular rate, rad²/s².
    pub fn turning_sq(&self) -> f64 {
        self.turning_sq / self.length_s
    }
    /// Mean square of the specific force other than gravity, m²/s⁴.
    pub fn force_sq(&self) -> f64 {
        self.force_sq / self.length_s
    }
    /// Mean of the magnetometer readings, if there were any.
    pub fn field(&self) -> Option<FieldMean> {
        let n = self.readings;
        (n > 0.0).then(|| FieldMean {
            world_ut: self.field.world_ut / n,
            by_age_ut_s: self.field.by_age_ut_s / n,
            to_world: self.field.to_world / n,
        })
    }
}
