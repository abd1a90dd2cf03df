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

/// How a transfer failed, as the driver reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum ReadFault {
    /// The chip did not acknowledge.
    Nack,
    /// The transfer ended early.
    ShortRead,
    /// Bus error: arbitration lost, timeout, or a line held low.
    Bus,
    /// Another chip responds.
    WrongId,
    /// The chip has returned to its power-on settings.
    BrownOut,
}

/// Properties of a sample besides its values.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Quality {
    /// Largest gyroscope count as a share of the full scale, 0 to 1; 0 if unknown.
    pub gyro_load: f64,
    /// Largest accelerometer count as a share of the full scale, 0 to 1; 0 if unknown.
    pub acc_load: f64,
    /// The magnetometer flagged an overflow.
    pub mag_overflow: bool,
    /// The source has noise, so that identical samples indicate a frozen sensor. True for chips, false for a plant
    /// or a log, which may be noise-free.
    pub expect_noise: bool,
}

impl Default for Quality {
    fn default() -> Self {
        Self {
            gyro_load: 0.0,
            acc_load: 0.0,
            mag_overflow: false,
            expect_noise: true,
        }
    }
}

/// What the sensor delivered in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub enum ImuReading {
    /// A sample, in the sensor frame.
    Sample(ImuSample, Quality),
    /// The transfer failed.
    Failed(ReadFault),
    /// No sample was due, or none arrived.
    #[default]
    Nothing,
}

impl ImuReading {
    /// The reading of a plant or a log, which may be free of noise.
    pub fn from_world(sample: Option<ImuSample>) -> Self {
        let quality = Quality {
            expect_noise: false,
            ..Quality::default()
        };
        sample.map_or(Self::Nothing, |s| Self::Sample(s, quality))
    }
    /// The sample, if one arrived.
    pub fn sample(&self) -> Option<&ImuSample> {
        match self {
            Self::Sample(sample, _) => Some(sample),
            _ => None,
        }
    }
    /// The same with another sample, if one arrived.
    #[must_use]
    pub fn map(mut self, change: impl FnOnce(&mut ImuSample, &mut Quality)) -> Self {
        if let Self::Sample(sample, quality) = &mut self {
            change(sample, quality);
        }
        self
    }
}
