//! Counts as they come off a chip, and the scale that turns them into SI.

use super::ImuError;
use crate::estimation::fusion::health::Quality;
use crate::primitives::sample::ImuSample;
use crate::primitives::units::Seconds;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Standard gravity, m/s²: the g of the data sheets.
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;

/// One reading in counts, in the axes of each chip.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RawImu {
    /// Gyroscope counts.
    pub gyro: [i16; 3],
    /// Accelerometer counts.
    pub acc: [i16; 3],
    /// Magnetometer counts in the magnetometer's own axes; `None` when it had nothing new.
    pub mag: Option<[i16; 3]>,
    /// Temperature counts.
    pub temp: i16,
    /// Accelerometer and gyroscope hold another conversion than at the last reading.
    pub fresh: bool,
    /// The magnetometer overflowed; its value is withheld from the sample.
    pub mag_overflow: bool,
    /// A separate magnetometer failed while the rest is sound; six axes are better than none.
    pub mag_fault: Option<ImuError>,
}

/// Largest count as a share of the positive full scale.
fn load(counts: &[i16; 3]) -> f64 {
    counts.iter().map(|c| f64::from(c.unsigned_abs())).fold(0.0, f64::max) / f64::from(i16::MAX)
}

impl RawImu {
    /// What the health judge wants to know besides the values.
    #[must_use]
    pub fn quality(&self) -> Quality {
        Quality { gyro_load: load(&self.gyro), acc_load: load(&self.acc), mag_overflow: self.mag_overflow, expect_noise: true }
    }
}

/// A chip axis given in another chip's axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Axis {
    /// Along x.
    #[serde(rename = "+x")]
    PlusX,
    /// Against x.
    #[serde(rename = "-x")]
    MinusX,
    /// Along y.
    #[serde(rename = "+y")]
    PlusY,
    /// Against y.
    #[serde(rename = "-y")]
    MinusY,
    /// Along z.
    #[serde(rename = "+z")]
    PlusZ,
    /// Against z.
    #[serde(rename = "-z")]
    MinusZ,
}

impl Axis {
    /// Index of the component and its sign.
    fn parts(self) -> (usize, f64) {
        match self {
            Self::PlusX => (0, 1.0),
            Self::MinusX => (0, -1.0),
            Self::PlusY => (1, 1.0),
            Self::MinusY => (1, -1.0),
            Self::PlusZ => (2, 1.0),
            Self::MinusZ => (2, -1.0),
        }
    }
}

/// How a magnetometer sits against the accelerometer: x, y and z of the accelerometer's frame, each
/// as a signed axis of the magnetometer.
///
/// A mirror image is allowed: the arrows printed in some data sheets are left-handed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Axes(pub [Axis; 3]);

impl Axes {
    /// Both chips agree.
    pub const ALIGNED: Self = Self([Axis::PlusX, Axis::PlusY, Axis::PlusZ]);
    /// AK09916 inside the ICM-20948: y and z run the other way (DS-000189, orientation of axes).
    pub const AK09916: Self = Self([Axis::PlusX, Axis::MinusY, Axis::MinusZ]);

    /// Each magnetometer axis is used exactly once.
    #[must_use]
    pub fn is_permutation(&self) -> bool {
        let mut used = [false; 3];
        for axis in self.0 {
            used[axis.parts().0] = true;
        }
        used == [true; 3]
    }
    /// Chip axes to the accelerometer's frame.
    #[must_use]
    pub fn turn(&self, chip: &Vector3<f64>) -> Vector3<f64> {
        let pick = |axis: Axis| {
            let (i, sign) = axis.parts();
            sign * chip[i]
        };
        Vector3::new(pick(self.0[0]), pick(self.0[1]), pick(self.0[2]))
    }
    /// The accelerometer's frame to chip axes; inverse of [`Axes::turn`].
    #[must_use]
    pub fn turn_back(&self, frame: &Vector3<f64>) -> Vector3<f64> {
        let mut chip = Vector3::zeros();
        for (k, axis) in self.0.into_iter().enumerate() {
            let (i, sign) = axis.parts();
            chip[i] = sign * frame[k];
        }
        chip
    }
}

/// SI value of one count, per sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// rad/s per count.
    pub gyro_rad_s: f64,
    /// m/s² per count.
    pub acc_m_s2: f64,
    /// µT per count.
    pub mag_ut: f64,
    /// Magnetometer axes to the accelerometer's.
    pub mag_axes: Axes,
    /// °C per count.
    pub temp_c: f64,
    /// °C at zero counts.
    pub temp_zero_c: f64,
}

fn scaled(counts: &[i16; 3], unit: f64) -> Vector3<f64> {
    Vector3::new(f64::from(counts[0]), f64::from(counts[1]), f64::from(counts[2])) * unit
}

impl Scale {
    /// The reading in SI, in the accelerometer's frame ([`crate::primitives::frames::Sensor`]), taken at `t`.
    #[must_use]
    pub fn sample(&self, raw: &RawImu, t: Seconds) -> ImuSample {
        let mag = raw.mag.filter(|_| !raw.mag_overflow);
        ImuSample {
            t,
            gyro_rad_s: scaled(&raw.gyro, self.gyro_rad_s),
            acc_m_s2: scaled(&raw.acc, self.acc_m_s2),
            mag_ut: mag.map(|m| self.mag_axes.turn(&scaled(&m, self.mag_ut))),
        }
    }
    /// Die temperature, °C.
    #[must_use]
    pub fn temperature_c(&self, raw: &RawImu) -> f64 {
        self.temp_zero_c + self.temp_c * f64::from(raw.temp)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_turn_there_and_back() {
        let v = Vector3::new(1.0, 2.0, 3.0);
        assert_eq!(Axes::AK09916.turn(&v), Vector3::new(1.0, -2.0, -3.0));
        let odd = Axes([Axis::MinusZ, Axis::PlusX, Axis::MinusY]);
        assert_eq!(odd.turn(&v), Vector3::new(-3.0, 1.0, -2.0));
        assert_eq!(odd.turn_back(&odd.turn(&v)), v);
        assert!(odd.is_permutation());
        assert!(!Axes([Axis::PlusX, Axis::MinusX, Axis::PlusZ]).is_permutation());
    }

    #[test]
    fn an_overflowed_field_is_withheld() {
        let scale = Scale { gyro_rad_s: 1.0, acc_m_s2: 1.0, mag_ut: 0.15, mag_axes: Axes::ALIGNED, temp_c: 1.0 / 256.0, temp_zero_c: 25.0 };
        let mut raw = RawImu { mag: Some([100, -200, 300]), temp: -256, ..RawImu::default() };
        let field = scale.sample(&raw, Seconds(1.0)).mag_ut.expect("new");
        assert!((field - Vector3::new(15.0, -30.0, 45.0)).norm() < 1e-12);
        assert!((scale.temperature_c(&raw) - 24.0).abs() < 1e-12);
        raw.mag_overflow = true;
        assert_eq!(scale.sample(&raw, Seconds(1.0)).mag_ut, None);
        assert!(raw.quality().mag_overflow);
    }
}
