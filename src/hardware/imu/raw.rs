//! Raw counts of a chip, and the scale that converts them to SI units.

use super::ImuError;
use crate::choices;
use crate::primitives::{ImuSample, Quality, Seconds, Setting, Shape};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Standard gravity, m/s², the unit g of the data sheets.
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;

/// One reading in counts, in the axes of each chip.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RawImu {
    /// Gyroscope counts.
    pub gyro: [i16; 3],
    /// Accelerometer counts.
    pub acc: [i16; 3],
    /// Magnetometer counts in the magnetometer's axes; `None` without a new measurement.
    pub mag: Option<[i16; 3]>,
    /// Temperature counts.
    pub temp: i16,
    /// Accelerometer and gyroscope have converted since the last reading.
    pub fresh: bool,
    /// The magnetometer overflowed; the sample does not contain its value.
    pub mag_overflow: bool,
    /// The magnetometer failed or has lost its settings; the other six axes are valid.
    pub mag_fault: Option<ImuError>,
}

/// Largest count as a share of the full scale.
fn load(counts: &[i16; 3]) -> f64 {
    let sizes = counts.iter().map(|c| f64::from(c.unsigned_abs()));
    sizes.fold(0.0, f64::max) / f64::from(i16::MAX)
}

impl RawImu {
    /// Properties of the reading that the health monitor needs besides the values.
    pub fn quality(&self) -> Quality {
        Quality {
            gyro_load: load(&self.gyro),
            acc_load: load(&self.acc),
            mag_overflow: self.mag_overflow,
            expect_noise: true,
        }
    }
}

choices! {
    /// A signed axis of a chip.
    pub enum Axis {
        /// +x.
        PlusX = "+x",
        /// −x.
        MinusX = "-x",
        /// +y.
        PlusY = "+y",
        /// −y.
        MinusY = "-y",
        /// +z.
        PlusZ = "+z",
        /// −z.
        MinusZ = "-z",
    }
}

impl Axis {
    /// Index of the component, and its sign.
    fn parts(self) -> (usize, f64) {
        let is_negative = self as usize % 2 == 1;
        (self as usize / 2, if is_negative { -1.0 } else { 1.0 })
    }
}

/// Three words in a file: `["+x", "-y", "+z"]`.
impl Setting for Axes {
    const SHAPE: Shape = Shape::Scalar;
}

/// Orientation of a magnetometer relative to the accelerometer: x, y and z of the accelerometer's frame,
/// each as a signed axis of the magnetometer.
///
/// A reflection is allowed, because the axes printed in some data sheets are left-handed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Axes(pub [Axis; 3]);

impl Axes {
    /// Parallel axes.
    pub const ALIGNED: Self = Self([Axis::PlusX, Axis::PlusY, Axis::PlusZ]);
    /// AK09916 inside the ICM-20948: y and z are opposite (DS-000189, orientation of axes).
    pub const AK09916: Self = Self([Axis::PlusX, Axis::MinusY, Axis::MinusZ]);

    /// Whether each magnetometer axis appears exactly once.
    pub fn is_permutation(&self) -> bool {
        let mut used = [false; 3];
        for axis in self.0 {
            used[axis.parts().0] = true;
        }
        used == [true; 3]
    }
    /// Converts from chip axes to the accelerometer's frame.
    pub fn to_frame(&self, chip: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from(self.0.map(|axis| {
            let (i, sign) = axis.parts();
            sign * chip[i]
        }))
    }
}

/// SI values of one count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// rad/s per count.
    pub gyro_rad_s: f64,
    /// m/s² per count.
    pub acc_m_s2: f64,
    /// µT per count.
    pub mag_ut: f64,
    /// Orientation of the magnetometer.
    pub mag_axes: Axes,
    /// °C per count.
    pub temp_c: f64,
    /// °C at zero counts.
    pub temp_zero_c: f64,
}

fn scaled(counts: &[i16; 3], unit: f64) -> Vector3<f64> {
    Vector3::from(counts.map(f64::from)) * unit
}

impl Scale {
    /// The reading at time `t` in SI units, in the accelerometer's frame
    /// ([`crate::primitives::frames::Sensor`]).
    pub fn sample(&self, raw: &RawImu, t: Seconds) -> ImuSample {
        let mag = raw.mag.filter(|_| !raw.mag_overflow);
        ImuSample {
            t,
            gyro_rad_s: scaled(&raw.gyro, self.gyro_rad_s),
            acc_m_s2: scaled(&raw.acc, self.acc_m_s2),
            mag_ut: mag.map(|m| self.mag_axes.to_frame(&scaled(&m, self.mag_ut))),
        }
    }
    /// Die temperature, °C.
    pub fn temperature_c(&self, raw: &RawImu) -> f64 {
        self.temp_zero_c + self.temp_c * f64::from(raw.temp)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_convert() {
        let v = Vector3::new(1.0, 2.0, 3.0);
        assert_eq!(Axes::AK09916.to_frame(&v), Vector3::new(1.0, -2.0, -3.0));
        let odd = Axes([Axis::MinusZ, Axis::PlusX, Axis::MinusY]);
        assert_eq!(odd.to_frame(&v), Vector3::new(-3.0, 1.0, -2.0));
        assert!(odd.is_permutation());
        assert!(!Axes([Axis::PlusX, Axis::MinusX, Axis::PlusZ]).is_permutation());
    }

    #[test]
    fn a_sample_omits_an_overflowed_field() {
        let scale = Scale {
            gyro_rad_s: 1.0,
            acc_m_s2: 1.0,
            mag_ut: 0.15,
            mag_axes: Axes::ALIGNED,
            temp_c: 1.0 / 256.0,
            temp_zero_c: 25.0,
        };
        let mut raw = RawImu {
            mag: Some([100, -200, 300]),
            temp: -256,
            ..RawImu::default()
        };
        let field = scale.sample(&raw, Seconds(1.0)).mag_ut.expect("new");
        assert!((field - Vector3::new(15.0, -30.0, 45.0)).norm() < 1e-12);
        assert!((scale.temperature_c(&raw) - 24.0).abs() < 1e-12);
        raw.mag_overflow = true;
        assert_eq!(scale.sample(&raw, Seconds(1.0)).mag_ut, None);
        assert!(raw.quality().mag_overflow);
    }
}
