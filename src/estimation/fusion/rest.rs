//! Rest: when the gyroscope reads nothing but its bias.
//!
//! Both sensors stay close to their own slow mean for a while (after Laidig & Seel 2023, section
//! 3.4.1). Steady slow turning looks the same; it is told apart by the bias that the last rest
//! showed, which cannot have changed much since.

use super::intake::share;
use super::limits::{self, OutOfRange};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Longest run of lost samples through which rest goes on, s.
const MISSED_MAX_S: f64 = 0.1;

/// When is the sensor still?
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RestConfig {
    /// Time constant of the slow mean both sensors are compared with, seconds. Default 0.5. Bigger:
    /// slow turning is told from rest more surely, rest is noticed later.
    pub mean_tau_s: f64,
    /// How long both must stay close to their mean before it counts as rest, seconds. Default 1.5.
    /// Bigger: fewer false rests, fewer true ones.
    pub min_s: f64,
    /// Largest deviation of the angular rate from its mean at rest, °/s. Default 2. Bigger: a shaking
    /// bench still counts as rest, and so does gentle motion.
    pub gyro_deviation_deg_s: f64,
    /// Largest deviation of the specific force from its mean at rest, m/s². Default 0.5. Bigger: as above.
    pub acc_deviation_m_s2: f64,
    /// Largest mean rate that can be bias at the first rest, °/s on one axis. Default 6. Bigger: worse
    /// gyroscopes are served, and steady slow turning is taken for bias.
    pub bias_max_deg_s: f64,
    /// Largest change of the bias from one rest to the next, °/s on one axis. Default 1. Bigger: as above.
    pub bias_change_deg_s: f64,
    /// Growth of that change with the time since the last rest, °/s per second. Default 0.05. Bigger:
    /// a first rest that was none is forgotten sooner.
    pub bias_change_deg_s2: f64,
}

impl Default for RestConfig {
    fn default() -> Self {
        Self {
            mean_tau_s: 0.5,
            min_s: 1.5,
            gyro_deviation_deg_s: 2.0,
            acc_deviation_m_s2: 0.5,
            bias_max_deg_s: 6.0,
            bias_change_deg_s: 1.0,
            bias_change_deg_s2: 0.05,
        }
    }
}

impl RestConfig {
    /// Refuses settings that are not finite or far from anything sensible.
    ///
    /// # Errors
    /// The first setting that is out of range, with its range.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        let d = Self::default();
        let rows = [
            ("mean_tau_s", self.mean_tau_s, d.mean_tau_s, 0.01, 100.0),
            ("min_s", self.min_s, d.min_s, 0.0, 1000.0),
            ("gyro_deviation_deg_s", self.gyro_deviation_deg_s, d.gyro_deviation_deg_s, 0.001, 100.0),
            ("acc_deviation_m_s2", self.acc_deviation_m_s2, d.acc_deviation_m_s2, 0.001, 100.0),
            ("bias_max_deg_s", self.bias_max_deg_s, d.bias_max_deg_s, 0.01, 100.0),
            ("bias_change_deg_s", self.bias_change_deg_s, d.bias_change_deg_s, 0.01, 100.0),
            ("bias_change_deg_s2", self.bias_change_deg_s2, d.bias_change_deg_s2, 0.0, 100.0),
        ];
        limits::check(&rows)
    }
}

/// Tells rest from motion.
#[derive(Debug, Clone, Copy)]
pub struct RestDetector {
    config: RestConfig,
    means: Option<(Vector3<f64>, Vector3<f64>)>,
    still_s: f64,
    /// Time without a sample, s.
    missed_s: f64,
    /// Bias at the last rest, rad/s, and the time since, s.
    known: Option<(Vector3<f64>, f64)>,
}

impl RestDetector {
    /// A detector that has seen nothing yet.
    #[must_use]
    pub fn new(config: RestConfig) -> Self {
        Self { config, means: None, still_s: 0.0, missed_s: 0.0, known: None }
    }
    /// Takes one pair of samples (rad/s, m/s²); true at rest.
    pub fn update(&mut self, gyro: &Vector3<f64>, acc: &Vector3<f64>, dt_s: f64) -> bool {
        self.missed_s = 0.0;
        let share = share(dt_s, self.config.mean_tau_s);
        let (gyro_mean, acc_mean) = self.means.get_or_insert((*gyro, *acc));
        *gyro_mean += share * (gyro - *gyro_mean);
        *acc_mean += share * (acc - *acc_mean);
        let mean = *gyro_mean;
        let still = (gyro - mean).norm() < self.config.gyro_deviation_deg_s.to_radians()
            && (acc - *acc_mean).norm() < self.config.acc_deviation_m_s2;
        self.still_s = if still && self.may_be_bias(&mean) { self.still_s + dt_s } else { 0.0 };
        if self.at_rest() {
            self.known = Some((mean, 0.0));
        } else if let Some((_, since_s)) = &mut self.known {
            *since_s += dt_s;
        }
        self.at_rest()
    }

    fn may_be_bias(&self, mean: &Vector3<f64>) -> bool {
        let c = &self.config;
        let change_deg_s = |since_s: f64| (c.bias_change_deg_s + c.bias_change_deg_s2 * since_s).min(c.bias_max_deg_s);
        mean.amax() < c.bias_max_deg_s.to_radians()
            && self.known.is_none_or(|(bias, since_s)| (mean - bias).amax() < change_deg_s(since_s).to_radians())
    }
    /// A sample was lost. When too many are, nobody knows whether the sensor moved.
    pub fn miss(&mut self, dt_s: f64) {
        self.missed_s += dt_s;
        if self.missed_s > MISSED_MAX_S {
            self.still_s = 0.0;
        }
    }
    /// True when the sensor has been still for long enough.
    #[must_use]
    pub fn at_rest(&self) -> bool {
        self.still_s >= self.config.min_s
    }
    /// Slow mean of the angular rate, rad/s: the bias, when at rest.
    #[must_use]
    pub fn gyro_mean_rad_s(&self) -> Vector3<f64> {
        self.means.map_or_else(Vector3::zeros, |(gyro, _)| gyro)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rest_needs_time_and_yields_the_bias() {
        let bias = Vector3::new(0.01, -0.02, 0.005);
        let up = Vector3::new(0.0, 0.0, 9.81);
        let mut rest = RestDetector::new(RestConfig::default());
        for k in 0..149 {
            assert!(!rest.update(&bias, &up, 0.01), "rest after {k} samples");
        }
        assert!((0..2).any(|_| rest.update(&bias, &up, 0.01)));
        assert!((rest.gyro_mean_rad_s() - bias).norm() < 1e-12);
        assert!(!rest.update(&Vector3::new(0.5, 0.0, 0.0), &up, 0.01));
    }

    #[test]
    fn steady_fast_turning_is_not_rest() {
        let mut rest = RestDetector::new(RestConfig::default());
        let (rate, up) = (Vector3::new(0.0, 0.0, 0.3), Vector3::new(0.0, 0.0, 9.81));
        assert!((0..1000).all(|_| !rest.update(&rate, &up, 0.01)));
    }

    #[test]
    fn slow_turning_is_not_rest_once_the_bias_is_known() {
        let mut rest = RestDetector::new(RestConfig::default());
        let (bias, up) = (Vector3::new(0.07, 0.0, 0.0), Vector3::new(0.0, 0.0, 9.81));
        assert!((0..300).any(|_| rest.update(&bias, &up, 0.01)), "4 deg/s of bias is learnt at the first rest");
        let turning = bias + Vector3::new(0.0, 0.0, 0.04);
        let settled = (0..1000).skip(300).map(|_| rest.update(&turning, &up, 0.01)).filter(|r| *r).count();
        assert_eq!(settled, 0, "2.3 deg/s of turning is no rest");
        assert!((0..300).any(|_| rest.update(&bias, &up, 0.01)), "rest is found again");
    }

    #[test]
    fn a_lost_sample_is_no_motion_and_a_lost_second_may_be() {
        let (bias, up) = (Vector3::zeros(), Vector3::new(0.0, 0.0, 9.81));
        let mut rest = RestDetector::new(RestConfig::default());
        for _ in 0..200 {
            rest.update(&bias, &up, 0.01);
            rest.miss(0.01);
        }
        assert!(rest.at_rest());
        for _ in 0..100 {
            rest.miss(0.01);
        }
        assert!(!rest.at_rest());
    }
}
