//! What the judge is asked: a sample, a failure or nothing, and what the field looks like at rest.

use crate::primitives::sample::ImuSample;
use crate::primitives::units::Seconds;
use nalgebra::Vector3;

/// How a transfer failed, as the sensor edge reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReadFault {
    /// Not acknowledged.
    Nack,
    /// Broke off early.
    ShortRead,
    /// The bus itself misbehaved: arbitration, timeout, a line held down.
    Bus,
    /// Another chip answers.
    WrongId,
    /// The chip is back at its defaults.
    BrownOut,
}

/// What is known of a sample besides its values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    /// Largest gyroscope count as a share of the full scale, 0 to 1; 0 if unknown.
    pub gyro_load: f64,
    /// Largest accelerometer count as a share of the full scale, 0 to 1; 0 if unknown.
    pub acc_load: f64,
    /// The magnetometer flagged an overflow.
    pub mag_overflow: bool,
    /// The source has noise, so identical samples mean a frozen sensor. True for chips; false for a
    /// plant or a log that may be noiseless.
    pub expect_noise: bool,
}

impl Default for Quality {
    fn default() -> Self {
        Self { gyro_load: 0.0, acc_load: 0.0, mag_overflow: false, expect_noise: true }
    }
}

/// What came from the sensor at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ImuReading {
    /// A sample, in the sensor frame.
    Sample(ImuSample, Quality),
    /// The transfer failed.
    Failed(ReadFault),
    /// Nothing was due, or nothing came.
    Nothing,
}

impl ImuReading {
    /// What a world or a log gave, of whose noise nothing is promised.
    #[must_use]
    pub fn from_world(sample: Option<ImuSample>) -> Self {
        let quality = Quality { expect_noise: false, ..Quality::default() };
        sample.map_or(Self::Nothing, |s| Self::Sample(s, quality))
    }
}

/// One question to the judge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedReading {
    /// Time of asking, on the clock of the sample stamps, s.
    pub now: Seconds,
    /// What came.
    pub outcome: ImuReading,
}

/// The earth's field and gravity as found at rest, for later comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldReference {
    /// |m|, µT.
    pub norm_ut: f64,
    /// Angle of the field below the horizontal, rad.
    pub dip_rad: f64,
    /// |a| of the still accelerometer, m/s².
    pub gravity_m_s2: f64,
}

impl FieldReference {
    /// From the means over a rest; `None` when either is zero or not finite.
    #[must_use]
    pub fn from_rest(acc_m_s2: &Vector3<f64>, mag_ut: &Vector3<f64>) -> Option<Self> {
        let dip_rad = dip(acc_m_s2, mag_ut)?;
        Some(Self { norm_ut: mag_ut.norm(), dip_rad, gravity_m_s2: acc_m_s2.norm() })
    }
}

/// Angle of `mag` below the plane across `acc`, rad; `None` for a zero or non-finite vector.
pub(super) fn dip(acc: &Vector3<f64>, mag: &Vector3<f64>) -> Option<f64> {
    let norms = acc.norm() * mag.norm();
    (norms.is_finite() && norms > 1e-9).then(|| (-acc.dot(mag) / norms).clamp(-1.0, 1.0).asin())
}
