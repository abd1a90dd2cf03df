//! A generic orientation filter in the loop: its world orientation, expressed in the base frame.
//!
//! During alignment the sensor frame is the base frame, so `R_base_tip = R_world_sensor(alignment)⁻¹ R_world_sensor`,
//! multiplied by `Tᵀ` from the left if the base has turned by `T` since. The filter is primed with the noise-free
//! means of the alignment, so that the initial orientation is as accurate as the means. The gyroscope bias of the
//! alignment is subtracted before the filter.

use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::filter::{Periods, TipEstimator, TipSample};
use crate::estimation::fusion::health::FieldShape;
use crate::estimation::fusion::intake::GAP_MAX_S;
use crate::estimation::fusion::registry::{Filter, FilterName};
use crate::model::Bend;
use crate::primitives::{Base, ImuSample, Rotation, Seconds, Tip};
use nalgebra::{UnitQuaternion, Vector3};

/// Step of the priming, s.
const PRIME_STEP_S: f64 = 0.02;
/// Number of priming steps. A descent at a constant rate ends within one step of the optimum, so the steps of the
/// second half shrink by [`PRIME_SHRINK`] each.
const PRIME_STEPS: i32 = 120;
const PRIME_SHRINK: f64 = 0.92;

/// A generic filter whose output is in the base frame.
#[derive(Debug, Clone)]
pub struct Generic {
    name: FilterName,
    filter: Filter,
    gyro_bias_rad_s: Vector3<f64>,
    r_world_base: UnitQuaternion<f64>,
    r_base_tip: UnitQuaternion<f64>,
}

impl Generic {
    /// The filter called `name`, primed with an alignment during which the tip was at `bend`, and updated at most once in
    /// `period_s`.
    pub fn new(name: FilterName, alignment: &Alignment, bend: Bend, period_s: f64) -> Self {
        let (imu_s, mag_s) = alignment.periods_s();
        let mut filter = name.build(Periods {
            imu_s: imu_s.max(period_s),
            mag_s: mag_s.max(period_s).min(1.0),
        });
        let shape = |mag| FieldShape::from_rest(&alignment.acc_rest_m_s2, mag);
        if let Some(field) = alignment.mag_rest_ut.as_ref().and_then(shape) {
            filter.set_field_reference(field.norm_ut, field.dip_rad);
        }
        let still = ImuSample {
            t: Seconds(0.0),
            gyro_rad_s: Vector3::zeros(),
            acc_m_s2: alignment.acc_rest_m_s2,
            mag_ut: alignment.mag_rest_ut,
        };
        for k in 0..PRIME_STEPS {
            let shrink = PRIME_SHRINK.powi((k - PRIME_STEPS / 2).max(0));
            filter.update(&still, PRIME_STEP_S * shrink);
        }
        let r_base_tip = bend.rotation().quat();
        Self {
            name,
            gyro_bias_rad_s: alignment.gyro_bias_rad_s,
            r_world_base: filter.orientation().quat() * r_base_tip.inverse(),
            r_base_tip,
            filter,
        }
    }

    /// Starts anew from an alignment during which the tip was at `bend`.
    pub fn rebase(&mut self, now: &Alignment, bend: Bend) {
        *self = Self::new(self.name, now, bend, 0.0);
    }
}

impl TipEstimator for Generic {
    fn update(&mut self, sample: &TipSample) {
        let imu = &sample.imu;
        let masked = ImuSample {
            t: imu.t,
            gyro_rad_s: imu.gyro_rad_s - self.gyro_bias_rad_s,
            // a zero vector has no direction, so the filter leaves it out
            acc_m_s2: if sample.acc {
                imu.acc_m_s2
            } else {
                Vector3::zeros()
            },
            mag_ut: imu.mag_ut.filter(|_| sample.mag),
        };
        self.filter.update(&masked, sample.dt_s);
        let r_aligned_sensor = self.r_world_base.inverse() * self.filter.orientation().quat();
        self.r_base_tip = sample.base.r_rest_now.inverse() * r_aligned_sensor;
    }

    /// A step longer than [`GAP_MAX_S`] makes the filter level itself again.
    fn recover(&mut self, sample: &TipSample) {
        let dt_s = GAP_MAX_S * 1.1;
        self.update(&TipSample { dt_s, ..*sample });
    }

    fn r_base_tip(&self) -> Rotation<Base, Tip> {
        Rotation::assert_frames(self.r_base_tip)
    }

    fn trusts_field(&self) -> bool {
        let status = self.filter.status();
        status.north_found && !status.field_disturbed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::fusion::base::BaseTurn;

    fn alignment(q: &UnitQuaternion<f64>) -> Alignment {
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

    /// Bends by 60° within 1 s, from two attitudes of the base, and holds.
    #[test]
    fn a_bend_is_estimated_in_the_base_frame() {
        let truth = Bend::from_deg(60.0, 130.0);
        for name in FilterName::ALL {
            for base in [
                UnitQuaternion::from_euler_angles(0.4, 0.9, -2.0),
                UnitQuaternion::from_euler_angles(2.8, 0.1, 1.0),
            ] {
                let rest = alignment(&base);
                let mut filter = Generic::new(name, &rest, Bend::STRAIGHT, 0.0);
                let mut before = UnitQuaternion::identity();
                for k in 1..=1500 {
                    let t = f64::from(k) * 0.002;
                    let q = Bend(truth.0 * t.min(1.0)).rotation().quat();
                    let back = (base * q).inverse();
                    let imu = ImuSample {
                        t: Seconds(t),
                        gyro_rad_s: (before.inverse() * q).scaled_axis() / 0.002
                            + rest.gyro_bias_rad_s,
                        acc_m_s2: back * Vector3::new(0.0, 0.0, 9.81),
                        mag_ut: (k % 5 == 0).then(|| back * Vector3::new(20.0, 0.0, -40.0)),
                    };
                    before = q;
                    filter.update(&TipSample {
                        imu,
                        dt_s: 0.002,
                        acc: true,
                        mag: true,
                        still: false,
                        base: BaseTurn::default(),
                    });
                }
                let error = filter.r_base_tip().angle_to(&truth.rotation()).to_degrees();
                assert!(error < 0.3, "{name}: {error}");
                let status = filter.filter.status();
                assert!(status.levelled && !status.field_disturbed);
            }
        }
    }
}
