//! A generic filter in the loop: its world orientation turned into the base frame by the rest.
//!
//! At the rest the sensor *is* the base frame, so `R_base_tip = R_world_sensor(rest)⁻¹ R_world_sensor`,
//! and with a base that has turned by `T` since, `Tᵀ` of that. The filter is built when the rest is
//! known and primed with its means, free of noise, so that the rest orientation is as exact as the
//! averages are; the gyroscope is handed in without the bias of the rest.

use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::base::BaseTurn;
use crate::estimation::fusion::bend::MeasurementMask;
use crate::estimation::fusion::health::FieldReference;
use crate::estimation::fusion::intake::GAP_MAX_S;
use crate::estimation::fusion::madgwick::{Madgwick, MadgwickConfig};
use crate::estimation::fusion::mekf::{Mekf, MekfConfig};
use crate::estimation::fusion::vqf::{Vqf, VqfConfig};
use crate::estimation::fusion::{FilterName, Flags, OrientationFilter, Periods};
use crate::model::bend::Bend;
use crate::primitives::frames::{Base, Rotation, Tip};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::Seconds;
use nalgebra::{UnitQuaternion, Vector3};

/// Step of the priming, s, and how many: a descent at a constant rate ends within a step of the bottom,
/// so the second half of them shrinks.
const PRIME_STEP_S: f64 = 0.02;
const PRIME_STEPS: i32 = 120;
const PRIME_SHRINK: f64 = 0.92;

/// The filters by value: the loop may not allocate.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "one of these lives in the loop's state; a box would allocate at every alignment")]
enum Filter {
    Madgwick(Madgwick),
    Vqf(Vqf),
    Mekf(Mekf),
}

impl Filter {
    fn new(name: FilterName, periods: Periods) -> Self {
        match name {
            FilterName::Madgwick => Self::Madgwick(Madgwick::new(MadgwickConfig::default())),
            FilterName::Vqf => Self::Vqf(Vqf::new(periods, VqfConfig::default())),
            FilterName::VqfLong => Self::Vqf(Vqf::new(periods, VqfConfig::long())),
            FilterName::Mekf => Self::Mekf(Mekf::new(MekfConfig::default())),
        }
    }
    fn inner(&mut self) -> &mut dyn OrientationFilter {
        match self {
            Self::Madgwick(f) => f,
            Self::Vqf(f) => f,
            Self::Mekf(f) => f,
        }
    }
    fn seen(&self) -> &dyn OrientationFilter {
        match self {
            Self::Madgwick(f) => f,
            Self::Vqf(f) => f,
            Self::Mekf(f) => f,
        }
    }
}

/// A generic filter that speaks of the base frame.
#[derive(Debug, Clone)]
pub struct Generic {
    filter: Filter,
    gyro_bias_rad_s: Vector3<f64>,
    r_world_rest: UnitQuaternion<f64>,
    r_base_tip: UnitQuaternion<f64>,
}

impl Generic {
    /// The filter called `name`, primed with the rest.
    #[must_use]
    pub fn new(name: FilterName, periods: Periods, rest: &Alignment) -> Self {
        let mut filter = Filter::new(name, periods);
        if let (Filter::Vqf(vqf), Some(mag)) = (&mut filter, &rest.mag_rest_ut)
            && let Some(field) = FieldReference::from_rest(&rest.acc_rest_m_s2, mag)
        {
            vqf.know_field(field.norm_ut, field.dip_rad);
        }
        let still = ImuSample { t: Seconds(0.0), gyro_rad_s: Vector3::zeros(), acc_m_s2: rest.acc_rest_m_s2, mag_ut: rest.mag_rest_ut };
        for k in 0..PRIME_STEPS {
            filter.inner().update(&still, PRIME_STEP_S * PRIME_SHRINK.powi((k - PRIME_STEPS / 2).max(0)));
        }
        let r_world_rest = filter.seen().orientation().quat();
        let r_base_tip = UnitQuaternion::identity();
        Self { filter, gyro_bias_rad_s: rest.gyro_bias_rad_s, r_world_rest, r_base_tip }
    }

    /// The tip was not straight at the rest but at `bend`.
    pub fn assume(&mut self, bend: Bend) {
        self.r_world_rest *= bend.rotation().quat().inverse();
        self.r_base_tip = bend.rotation().quat();
    }

    /// One sample, `dt_s` after the last.
    pub fn update(&mut self, sample: &ImuSample, dt_s: f64, mask: MeasurementMask, base: &BaseTurn) {
        let told = ImuSample {
            t: sample.t,
            gyro_rad_s: sample.gyro_rad_s - self.gyro_bias_rad_s,
            // a force of zero has no direction, and is left out
            acc_m_s2: if mask.acc { sample.acc_m_s2 } else { Vector3::zeros() },
            mag_ut: sample.mag_ut.filter(|_| mask.mag),
        };
        self.filter.inner().update(&told, dt_s);
        let r_rest_sensor = self.r_world_rest.inverse() * self.filter.seen().orientation().quat();
        self.r_base_tip = base.r_rest_now.inverse() * r_rest_sensor;
    }

    /// Starts again from one sample after a time in which nothing was seen.
    pub fn relevel(&mut self, sample: &ImuSample, mask: MeasurementMask, base: &BaseTurn) {
        self.update(sample, GAP_MAX_S * 1.1, mask, base);
    }

    /// Tip in the base.
    #[must_use]
    pub fn r_base_tip(&self) -> Rotation<Base, Tip> {
        Rotation::assert_frames(self.r_base_tip)
    }
    /// The filter's view of its own trust.
    #[must_use]
    pub fn flags(&self) -> Flags {
        self.filter.seen().flags()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rest(q: &UnitQuaternion<f64>) -> Alignment {
        Alignment {
            gyro_bias_rad_s: Vector3::new(0.01, -0.005, 0.002),
            acc_rest_m_s2: q.inverse() * Vector3::new(0.0, 0.0, 9.81),
            mag_rest_ut: Some(q.inverse() * Vector3::new(20.0, 0.0, -40.0)),
            gyro_sigma_rad_s: 0.002,
            acc_sigma_m_s2: 0.02,
            mag_sigma_ut: 0.3,
            duration_s: 2.0,
            samples: 1000,
            mag_samples: 200,
            repeated: 0,
        }
    }

    /// Bends by 60° in 1 s from any attitude of the base, and holds.
    #[test]
    fn a_bend_is_felt_in_the_base_frame() {
        let want = Bend::from_deg(60.0, 130.0);
        for name in FilterName::ALL {
            for base in [UnitQuaternion::from_euler_angles(0.4, 0.9, -2.0), UnitQuaternion::from_euler_angles(2.8, 0.1, 1.0)] {
                let rest = rest(&base);
                let mut filter = Generic::new(name, Periods { imu_s: 0.002, mag_s: 0.01 }, &rest);
                let mask = MeasurementMask { acc: true, mag: true, still: false };
                let mut before = UnitQuaternion::identity();
                for k in 1..=1500 {
                    let t = f64::from(k) * 0.002;
                    let q = Bend(want.0 * t.min(1.0)).rotation().quat();
                    let back = (base * q).inverse();
                    let sample = ImuSample {
                        t: Seconds(t),
                        gyro_rad_s: (before.inverse() * q).scaled_axis() / 0.002 + rest.gyro_bias_rad_s,
                        acc_m_s2: back * Vector3::new(0.0, 0.0, 9.81),
                        mag_ut: (k % 5 == 0).then(|| back * Vector3::new(20.0, 0.0, -40.0)),
                    };
                    before = q;
                    filter.update(&sample, 0.002, mask, &BaseTurn::none());
                }
                let error = filter.r_base_tip().angle_to(&want.rotation()).to_degrees();
                assert!(error < 0.3, "{name}: {error}");
                assert!(filter.flags().levelled && !filter.flags().field_disturbed);
            }
        }
    }
}
