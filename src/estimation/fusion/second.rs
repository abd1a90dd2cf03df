//! The second opinion: another estimator beside the selected one, at a lower rate, and the flag that
//! the two have disagreed for long.
//!
//! Samples are gathered into one mean sample a period, so that the second estimator costs a few
//! nanoseconds a tick. Compared is where the tip points, as an angle; while the field is not to be
//! believed only where up is, since heading is then anybody's guess. What may differ without a word
//! grows with the rate of the tip: the second opinion is late by half a period.

use crate::estimation::fusion::base::BaseTurn;
use crate::estimation::fusion::bend::MeasurementMask;
use crate::estimation::fusion::estimator::Estimator;
use crate::primitives::sample::ImuSample;
use nalgebra::{UnitQuaternion, Vector3};
use serde::Deserialize;

/// Settings of the second opinion.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SecondConfig {
    /// Period of the second estimator, s. Default 0.01. Larger costs less time and sees fast motion
    /// less exactly.
    pub period_s: f64,
    /// Angle between the two that is still agreement, degrees. Default 8. Larger raises the flag later.
    pub angle_deg: f64,
    /// How much more is allowed per °/s of turning, s. Default 0.05. Larger is silent in fast motion.
    pub angle_per_rate_s: f64,
    /// How long they must differ before the flag is raised, s. Default 2; agreement for as long takes
    /// it down. Larger ignores longer transients.
    pub time_s: f64,
}

impl Default for SecondConfig {
    fn default() -> Self {
        Self { period_s: 0.01, angle_deg: 8.0, angle_per_rate_s: 0.05, time_s: 2.0 }
    }
}

/// The second estimator, its gathered samples and the flag.
#[derive(Debug, Clone)]
pub struct Second {
    /// The estimator.
    pub estimator: Estimator,
    turn: UnitQuaternion<f64>,
    acc: Vector3<f64>,
    mag: (Vector3<f64>, u32),
    n: u32,
    gathered_s: f64,
    differ_s: f64,
    angle_rad: f64,
    disagrees: bool,
}

impl Second {
    /// Beside the selected one.
    #[must_use]
    pub fn new(estimator: Estimator) -> Self {
        Self {
            estimator,
            turn: UnitQuaternion::identity(),
            acc: Vector3::zeros(),
            mag: (Vector3::zeros(), 0),
            n: 0,
            gathered_s: 0.0,
            differ_s: 0.0,
            angle_rad: 0.0,
            disagrees: false,
        }
    }

    /// Gathers a sample; true when a period was full and the estimator took its mean.
    pub fn gather(&mut self, config: &SecondConfig, sample: &ImuSample, dt_s: f64, mask: MeasurementMask, base: &BaseTurn) -> bool {
        self.turn *= UnitQuaternion::from_scaled_axis(sample.gyro_rad_s * dt_s);
        self.gathered_s += dt_s;
        if mask.acc {
            (self.acc, self.n) = (self.acc + sample.acc_m_s2, self.n + 1);
        }
        if let (Some(mag), true) = (sample.mag_ut, mask.mag) {
            self.mag = (self.mag.0 + mag, self.mag.1 + 1);
        }
        if self.gathered_s < config.period_s - 1e-9 {
            return false;
        }
        let mean = ImuSample {
            t: sample.t,
            gyro_rad_s: self.turn.scaled_axis() / self.gathered_s,
            acc_m_s2: self.acc / f64::from(self.n.max(1)),
            mag_ut: (self.mag.1 > 0).then(|| self.mag.0 / f64::from(self.mag.1)),
        };
        let mask = MeasurementMask { acc: self.n > 0, mag: self.mag.1 > 0, ..mask };
        self.estimator.update(&mean, self.gathered_s, mask, base);
        self.empty();
        true
    }

    /// Starts again from one sample after a time in which nothing was seen.
    pub fn recover(&mut self, sample: &ImuSample, gap_s: f64, mask: MeasurementMask, base: &BaseTurn) {
        self.empty();
        self.estimator.recover(sample, gap_s, mask, base);
    }

    fn empty(&mut self) {
        self.turn = UnitQuaternion::identity();
        (self.acc, self.mag, self.n, self.gathered_s) = (Vector3::zeros(), (Vector3::zeros(), 0), 0, 0.0);
    }

    /// Compares with the selected estimator; `up` is the rest's specific force, `field` says that the
    /// heading is to be believed.
    pub fn compare(&mut self, config: &SecondConfig, first: &Estimator, up: &Vector3<f64>, field: bool, turning_rad_s: f64, dt_s: f64) {
        let (a, b) = (first.r_base_tip().quat(), self.estimator.r_base_tip().quat());
        self.angle_rad = if field { (a * Vector3::z()).angle(&(b * Vector3::z())) } else { (a.inverse() * up).angle(&(b.inverse() * up)) };
        let allowed = config.angle_deg.to_radians() + config.angle_per_rate_s * turning_rad_s;
        let differs = self.angle_rad > allowed;
        // the flag changes once the other answer has lasted
        self.differ_s = if differs == self.disagrees { 0.0 } else { self.differ_s + dt_s };
        if self.differ_s >= config.time_s {
            (self.disagrees, self.differ_s) = (differs, 0.0);
        }
    }

    /// The two have differed for long.
    #[must_use]
    pub fn disagrees(&self) -> bool {
        self.disagrees
    }
    /// Angle between the two at the last comparison, rad.
    #[must_use]
    pub fn angle_rad(&self) -> f64 {
        self.angle_rad
    }
}
