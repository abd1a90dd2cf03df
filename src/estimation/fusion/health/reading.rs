//! Readings of the sensor, and the field reference of the alignment.

use crate::primitives::ImuSample;
use nalgebra::Vector3;

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

/// Strength and dip of a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldShape {
    /// |m|, µT.
    pub norm_ut: f64,
    /// Angle of the field below the horizontal, rad.
    pub dip_rad: f64,
}

impl FieldShape {
    /// From the means over a still stretch; `None` when either is zero or not finite.
    pub fn from_rest(acc_m_s2: &Vector3<f64>, mag_ut: &Vector3<f64>) -> Option<Self> {
        Some(Self {
            norm_ut: mag_ut.norm(),
            dip_rad: dip(acc_m_s2, mag_ut)?,
        })
    }
}

/// Angle of `mag` below the plane orthogonal to `acc`, rad; `None` for a zero or non-finite vector.
pub(super) fn dip(acc: &Vector3<f64>, mag: &Vector3<f64>) -> Option<f64> {
    let norms = acc.norm() * mag.norm();
    (norms.is_finite() && norms > 1e-9).then(|| (-acc.dot(mag) / norms).clamp(-1.0, 1.0).asin())
}
