//! One IMU reading, and what may be said of a reading that did not come.

use crate::primitives::units::Seconds;
use nalgebra::Vector3;

/// A 9-DoF sample in the [`crate::primitives::frames::Sensor`] frame.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ImuSample {
    /// When the sample was taken, seconds on the loop's monotonic clock.
    pub t: Seconds,
    /// Angular rate, rad/s, raw (bias included).
    pub gyro_rad_s: Vector3<f64>,
    /// Specific force, m/s²: +9.81 on the axis that points up when still.
    pub acc_m_s2: Vector3<f64>,
    /// Magnetic field, µT; `None` when the magnetometer had nothing new.
    pub mag_ut: Option<Vector3<f64>>,
}

impl ImuSample {
    /// True when every number in the sample is finite.
    pub fn is_finite(&self) -> bool {
        let finite = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
        finite(&self.gyro_rad_s)
            && finite(&self.acc_m_s2)
            && self.mag_ut.as_ref().is_none_or(finite)
    }
}
