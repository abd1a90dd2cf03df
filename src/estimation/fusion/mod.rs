//! Orientation of the sensor in the world, from its own samples: three filters behind one seam.
//!
//! | name | what it is | when |
//! |---|---|---|
//! | `madgwick` | gradient descent (Madgwick 2010) on the `ahrs` crate, with bias, gate and levelled inputs | the least arithmetic that can still be trusted |
//! | `vqf` | Laidig & Seel 2023 as published, on the `vqf-rs` crate | the yardstick |
//! | `vqf-long` | the same, trusting the gyroscope for longer than the magnetometer's authors do | a room with iron in it |
//! | `mekf` | error-state Kalman filter that also learns gyro scale, hard iron and magnetometer latency | the best we have |
//!
//! All of them are causal and online, take time as an argument, allocate nothing in `update`, and
//! outlive every sample: a number that is missing, not finite or absurd is left out of the update
//! ([`intake::usable`]), never passed on.

pub mod align;
pub mod base;
pub mod base_watch;
pub mod bend;
pub mod correction_smoother;
pub mod estimator;
pub mod gate;
pub mod generic;
pub mod health;
pub mod intake;
pub mod limits;
pub mod madgwick;
pub mod mekf;
pub mod rest;
pub mod second;
pub mod tip;
pub mod vqf;

use crate::primitives::frames::{Rotation, Sensor, World};
use crate::primitives::sample::ImuSample;
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// What a filter says of its own trust, besides the orientation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Flags {
    /// A usable accelerometer sample has levelled the filter; before that the orientation is identity.
    pub levelled: bool,
    /// A usable magnetometer sample has given it a north; before that the heading is arbitrary.
    pub north_found: bool,
    /// The sensor has been still for long enough that its gyroscope reads nothing but bias.
    pub at_rest: bool,
    /// The magnetic field is not the one learnt: the heading now rests on the gyroscope.
    pub field_disturbed: bool,
}

/// A filter that turns samples into an orientation, one sample at a time.
pub trait OrientationFilter {
    /// Takes one sample, `dt_s` seconds after the one before.
    ///
    /// `dt_s` may vary. A step that is not positive and finite is ignored; one longer than
    /// [`intake::GAP_MAX_S`] re-levels the filter from the sample and keeps what was learnt of the sensor.
    fn update(&mut self, sample: &ImuSample, dt_s: f64);
    /// Orientation of the sensor after the last sample (world: z up, x to magnetic north).
    fn orientation(&self) -> Rotation<World, Sensor>;
    /// Estimated gyroscope bias in the sensor frame, rad/s.
    fn gyro_bias_rad_s(&self) -> Vector3<f64>;
    /// The filter's view of its own trust.
    fn flags(&self) -> Flags;
}

/// Sampling periods a filter is built for, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Periods {
    /// Between gyroscope and accelerometer samples.
    pub imu_s: f64,
    /// Between magnetometer samples handed in (a sensor that repeats old readings hands them in too).
    pub mag_s: f64,
}

/// The filters by the names that files and the command line use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FilterName {
    /// [`madgwick::Madgwick`] with its defaults.
    Madgwick,
    /// [`vqf::Vqf`] with its authors' defaults.
    Vqf,
    /// [`vqf::Vqf`] with the longer magnetometer time constant of [`vqf::TAU_MAG_LONG_S`].
    VqfLong,
    /// [`mekf::Mekf`] with its defaults.
    Mekf,
}

/// A filter name nobody has heard of.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no filter is called \"{name}\": use one of madgwick, vqf, vqf-long, mekf")]
pub struct UnknownFilter {
    /// What was asked for.
    pub name: String,
}

impl FilterName {
    /// Every filter, simplest first.
    pub const ALL: [Self; 4] = [Self::Madgwick, Self::Vqf, Self::VqfLong, Self::Mekf];

    /// The name as files and the command line write it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Madgwick => "madgwick",
            Self::Vqf => "vqf",
            Self::VqfLong => "vqf-long",
            Self::Mekf => "mekf",
        }
    }

    /// A fresh filter with its shipped defaults. Building allocates; updating never does.
    #[must_use]
    pub fn build(self, periods: Periods) -> Box<dyn OrientationFilter + Send> {
        match self {
            Self::Madgwick => Box::new(madgwick::Madgwick::new(madgwick::MadgwickConfig::default())),
            Self::Vqf => Box::new(vqf::Vqf::new(periods, vqf::VqfConfig::default())),
            Self::VqfLong => Box::new(vqf::Vqf::new(periods, vqf::VqfConfig::long())),
            Self::Mekf => Box::new(mekf::Mekf::new(mekf::MekfConfig::default())),
        }
    }
}

impl fmt::Display for FilterName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for FilterName {
    type Err = UnknownFilter;
    fn from_str(name: &str) -> Result<Self, UnknownFilter> {
        Self::ALL.into_iter().find(|f| f.as_str() == name).ok_or_else(|| UnknownFilter { name: name.to_owned() })
    }
}

/// Orientation in which `up` and the horizontal part of `field` (sensor frame) are the world's z and x.
///
/// The triad of Black (1964), the accelerometer taken at its word. Without a usable field the
/// rotation is the shortest that levels, and the heading arbitrary.
#[must_use]
pub fn level(up: &Vector3<f64>, field: Option<&Vector3<f64>>) -> Rotation<World, Sensor> {
    let up = up.normalize();
    let west = field.map(|m| up.cross(m)).and_then(|w| w.try_normalize(1e-9));
    let q = match west {
        Some(west) => {
            let north = west.cross(&up);
            let rows = nalgebra::Matrix3::from_rows(&[north.transpose(), west.transpose(), up.transpose()]);
            UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(rows))
        }
        None => UnitQuaternion::rotation_between(&up, &Vector3::z())
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)),
    };
    Rotation::assert_frames(q)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_strangers_are_refused() {
        for f in FilterName::ALL {
            assert_eq!(f.as_str().parse(), Ok(f));
            assert_eq!(serde_json::to_string(&f).unwrap(), format!("\"{f}\""));
        }
        assert!("kalman".parse::<FilterName>().unwrap_err().to_string().contains("madgwick, vqf, vqf-long, mekf"));
    }

    #[test]
    fn levelling_finds_any_attitude_and_survives_upside_down() {
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
