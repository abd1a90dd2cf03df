//! Interfaces of the generic orientation filters and of the estimators in the loop.

use crate::estimation::fusion::base::BaseTurn;
use crate::model::Bend;
use crate::primitives::{Base, ImuSample, Rotation, Sensor, Tip, World};
use nalgebra::{Matrix2, Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};

/// Status of an orientation filter after the last sample.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FilterStatus {
    /// Estimated gyroscope bias in the sensor frame, rad/s.
    pub gyro_bias_rad_s: Vector3<f64>,
    /// A usable accelerometer sample has levelled the filter. Until then the orientation is the identity.
    pub levelled: bool,
    /// A usable magnetometer sample has set the heading. Until then the heading is arbitrary.
    pub north_found: bool,
    /// The sensor stands still, so that the gyroscope measures its bias.
    pub standstill: bool,
    /// The magnetic field differs from the reference; the heading depends on the gyroscope alone.
    pub field_disturbed: bool,
}

/// A filter that turns samples into an orientation, one sample at a time.
pub trait OrientationFilter {
    /// Processes one sample, `dt_s` seconds after the previous one.
    ///
    /// `dt_s` may vary. A step that is not positive and finite is ignored. A step longer than
    /// [`super::intake::GAP_MAX_S`] levels the filter again from the sample; the estimated sensor errors are kept.
    fn update(&mut self, sample: &ImuSample, dt_s: f64);
    /// Orientation of the sensor after the last sample (world: z up, x to magnetic north).
    fn orientation(&self) -> Rotation<World, Sensor>;
    /// Status after the last sample.
    fn status(&self) -> FilterStatus;
    /// Sets the undisturbed field: strength in µT and dip in rad, positive below the horizon. Filters that find
    /// the field themselves ignore it.
    fn set_field_reference(&mut self, _strength_ut: f64, _dip_rad: f64) {}
}

/// Sampling periods that a filter is built for, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Periods {
    /// Between gyroscope and accelerometer samples.
    pub imu_s: f64,
    /// Between magnetometer samples, repeated ones included.
    pub mag_s: f64,
}

/// One sample for an estimator of the loop, and what of it may correct the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipSample {
    /// The readings.
    pub imu: ImuSample,
    /// Time since the previous usable sample, s.
    pub dt_s: f64,
    /// Correct with the accelerometer.
    pub acc: bool,
    /// Correct with the magnetometer.
    pub mag: bool,
    /// The pistons have not moved for a while.
    pub still: bool,
    /// Turn of the base since alignment.
    pub base: BaseTurn,
}

/// An estimator of the tip's orientation in the base frame, as the loop uses it.
pub trait TipEstimator {
    /// Processes one sample.
    fn update(&mut self, sample: &TipSample);
    /// Processes the first sample after a gap that is too long to integrate.
    fn recover(&mut self, sample: &TipSample);
    /// Tip in the base.
    fn r_base_tip(&self) -> Rotation<Base, Tip>;
    /// True unless the estimator considers the magnetic field disturbed.
    fn trusts_field(&self) -> bool;

    /// Estimated bend: the one nearest to the rotation since alignment.
    fn bend(&self) -> Bend {
        Bend::nearest(&self.r_base_tip())
    }
    /// Covariance of the bend vector, rad²; `None` for an estimator without one.
    fn covariance(&self) -> Option<Matrix2<f64>> {
        None
    }
    /// Change of the bend by the last correction, beyond the integrated rate, rad; zero where it is not known.
    fn correction(&self) -> Vector2<f64> {
        Vector2::zeros()
    }
    /// Widens the covariance for samples that are missing over `gap_s`, rad/s² being the largest angular
    /// acceleration of the tip.
    fn widen_for_gap(&mut self, _acceleration_max_rad_s2: f64, _gap_s: f64) {}
    /// Reports that a rate was rejected that may have been true, so that the next readings are tested for a jump.
    fn suspect_jump(&mut self) {}
    /// Returns true once after each jump that gravity and field have confirmed.
    fn take_reacquired(&mut self) -> bool {
        false
    }
}

/// Lets an enumeration of filters be used as the trait that all of them implement.
macro_rules! as_trait {
    ($kind:ident { $($variant:ident),+ }: $filter:ident) => {
        impl std::ops::Deref for $kind {
            type Target = dyn $filter;
            fn deref(&self) -> &Self::Target {
                match self { $(Self::$variant(it) => it,)+ }
            }
        }
        impl std::ops::DerefMut for $kind {
            fn deref_mut(&mut self) -> &mut Self::Target {
                match self { $(Self::$variant(it) => it,)+ }
            }
        }
    };
}
pub(super) use as_trait;

/// Orientation in which `up` and the horizontal part of `field` (sensor frame) are the world's z and x.
///
/// The triad method of Black (1964) with the accelerometer as the exact vector. Without a usable field the result
/// is the shortest rotation that levels, and the heading is arbitrary.
pub fn level(up: &Vector3<f64>, field: Option<&Vector3<f64>>) -> Rotation<World, Sensor> {
    let up = up.normalize();
    let west = field
        .map(|m| up.cross(m))
        .and_then(|w| w.try_normalize(1e-9));
    let q = match west {
        Some(west) => {
            let columns = Matrix3::from_columns(&[west.cross(&up), west, up]);
            let rows = Rotation3::from_matrix_unchecked(columns.transpose());
            UnitQuaternion::from_rotation_matrix(&rows)
        }
        None => UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_else(|| {
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        }),
    };
    Rotation::assert_frames(q)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levelling_finds_every_attitude_including_upside_down() {
        let field = Vector3::new(20.0, 0.0, -40.0);
        for q in [
            UnitQuaternion::identity(),
            UnitQuaternion::from_euler_angles(3.0, -0.4, 2.9),
            UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::PI),
            UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0),
        ] {
            let (up, mag) = (q.inverse() * Vector3::z(), q.inverse() * field);
            assert!(level(&up, Some(&mag)).quat().angle_to(&q) < 1e-9);
            assert!((level(&up, None).apply(&up) - Vector3::z()).norm() < 1e-9);
        }
    }
}
