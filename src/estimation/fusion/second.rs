//! A second, independent estimator at a lower rate, and a flag for persistent disagreement with the selected one.
//!
//! Samples are averaged over a period, so that the second estimator costs a few nanoseconds per tick. The
//! comparison is the angle between the two tip axes; while the field is disturbed it is the angle between the two
//! verticals, which does not depend on the heading. The allowed angle grows with the rate of the tip, because the
//! second estimate is late by half a period.

use crate::estimation::fusion::estimator::Estimator;
use crate::estimation::fusion::filter::{TipEstimator, TipSample};
use crate::estimation::fusion::intake::Mean;
use crate::parameters;
use crate::primitives::{ImuSample, lasting};
use nalgebra::{UnitQuaternion, Vector3};

parameters! {
    /// The second estimator, which runs beside the selected one and raises a flag when the two disagree.
    pub struct SecondConfig: Copy {
        /// Period of the second estimator. A larger value costs less time and follows fast motion less exactly.
        period_s: f64 = 0.01, "s", 0.0005..=0.5, "0.01 costs little time";
        /// Angle between the two estimates that counts as agreement. A larger value raises the flag later.
        angle_deg: f64 = 8.0, "deg", 0.1..=180.0, "8 is above what two sound filters differ by";
        /// Further angle that is allowed per °/s of turning. A larger value ignores differences in fast motion.
        angle_per_rate_s: f64 = 0.05, "s", 0.0..=10.0, "0.05 covers the delay of the second estimator";
        /// Time for which the estimates must differ before the flag is raised, and agree before it is cleared. A larger value
        /// ignores longer transients.
        time_s: f64 = 2.0, "s", 0.0..=600.0, "2 ignores transients";
    }
}

/// Mean sample over a period, as sums.
#[derive(Debug, Clone, Default)]
struct Average {
    turn: UnitQuaternion<f64>,
    acc: Mean,
    mag: Mean,
    length_s: f64,
}

/// The second estimator, its averaged input and the flag.
#[derive(Debug, Clone)]
pub struct Second {
    /// The estimator.
    pub estimator: Estimator,
    average: Average,
    /// Time for which the comparison has contradicted the flag, s.
    changed_s: f64,
    /// Angle at the last comparison, rad.
    pub angle_rad: f64,
    /// The two estimators have disagreed for [`SecondConfig::time_s`].
    pub disagrees: bool,
}

impl Second {
    /// Starts in agreement.
    pub fn new(estimator: Estimator) -> Self {
        Self {
            estimator,
            average: Average::default(),
            changed_s: 0.0,
            angle_rad: 0.0,
            disagrees: false,
        }
    }

    /// Adds a sample; true when a period is complete and the estimator has processed its mean.
    pub fn add(&mut self, config: &SecondConfig, sample: &TipSample) -> bool {
        let (sum, imu) = (&mut self.average, &sample.imu);
        sum.turn *= UnitQuaternion::from_scaled_axis(imu.gyro_rad_s * sample.dt_s);
        sum.length_s += sample.dt_s;
        sum.acc.add(sample.acc.then_some(imu.acc_m_s2));
        sum.mag.add(imu.mag_ut.filter(|_| sample.mag));
        if sum.length_s < config.period_s - 1e-9 {
            return false;
        }
        let sum = std::mem::take(sum);
        let (acc, mag_ut) = (sum.acc.get(), sum.mag.get());
        self.estimator.update(&TipSample {
            imu: ImuSample {
                t: imu.t,
                gyro_rad_s: sum.turn.scaled_axis() / sum.length_s,
                acc_m_s2: acc.unwrap_or_default(),
                mag_ut,
            },
            dt_s: sum.length_s,
            acc: acc.is_some(),
            mag: mag_ut.is_some(),
            ..*sample
        });
        true
    }

    /// Restarts from one sample after a gap.
    pub fn recover(&mut self, sample: &TipSample) {
        self.average = Average::default();
        self.estimator.recover(sample);
    }

    /// Compares with the selected estimator once per period. `up` is the specific force during alignment, `field`
    /// is true if the heading can be compared, `rate_rad_s` the angular rate of the tip.
    pub fn compare(
        &mut self,
        config: &SecondConfig,
        first: &dyn TipEstimator,
        up: &Vector3<f64>,
        field: bool,
        rate_rad_s: f64,
    ) {
        let a = first.r_base_tip().quat();
        let b = self.estimator.r_base_tip().quat();
        self.angle_rad = if field {
            (a * Vector3::z()).angle(&(b * Vector3::z()))
        } else {
            (a.inverse() * up).angle(&(b.inverse() * up))
        };
        let allowed = config.angle_deg.to_radians() + config.angle_per_rate_s * rate_rad_s;
        let differs = self.angle_rad > allowed;
        let changes = differs != self.disagrees;
        self.changed_s = lasting(changes, self.changed_s, config.period_s);
        if self.changed_s >= config.time_s {
            (self.disagrees, self.changed_s) = (differs, 0.0);
        }
    }
}
