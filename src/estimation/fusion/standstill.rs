//! Detects standstill, during which the gyroscope measures nothing but its bias.
//!
//! Both sensors must stay close to their own slow mean for a while (after Laidig & Seel 2023, section 3.4.1). A
//! slow steady rotation satisfies this too. It is told from standstill by the bias of the previous standstill,
//! which changes only slowly.

use super::intake::share;
use crate::primitives::lasting;
use nalgebra::Vector3;

crate::constants! {
    /// What counts as still. Mean, time and deviations are the settings that Laidig & Seel publish for VQF.
    const STILL: StillConstants;
    /// Time constant of the slow mean of both sensors, s.
    mean_tau_s = 0.5;
    /// Time for which both sensors must stay close to their mean, s.
    time_s = 1.5;
    /// Largest deviation of the angular rate from its mean, °/s.
    gyro_deg_s = 2.0;
    /// Largest deviation of the specific force from its mean, m/s².
    acc_m_s2 = 0.5;
    /// Longest run of lost samples that does not end a standstill, s.
    missed_max_s = 0.1;
    /// Largest mean rate that can be bias at the first standstill, °/s per axis.
    bias_max_deg_s = 6.0;
    /// Largest change of the bias between two standstills, °/s per axis.
    bias_change_deg_s = 1.0;
    /// Growth of that limit with the time since the previous standstill, °/s per second. It bounds the time for which a false first
    /// standstill blocks true ones.
    bias_change_deg_s2 = 0.05;
}

/// Tells standstill from motion.
#[derive(Debug, Clone, Copy, Default)]
pub struct StandstillDetector {
    means: Option<(Vector3<f64>, Vector3<f64>)>,
    still_s: f64,
    /// Time without a sample, s.
    missed_s: f64,
    /// Bias at the last standstill, rad/s, and the time since, s.
    known: Option<(Vector3<f64>, f64)>,
}

impl StandstillDetector {
    /// Takes one pair of samples (rad/s, m/s²); true at standstill.
    pub fn update(&mut self, gyro: &Vector3<f64>, acc: &Vector3<f64>, dt_s: f64) -> bool {
        self.missed_s = 0.0;
        let share = share(dt_s, STILL.mean_tau_s);
        let (gyro_mean, acc_mean) = self.means.get_or_insert((*gyro, *acc));
        *gyro_mean += share * (gyro - *gyro_mean);
        *acc_mean += share * (acc - *acc_mean);
        let mean = *gyro_mean;
        let still = (gyro - mean).norm() < STILL.gyro_deg_s.to_radians()
            && (acc - *acc_mean).norm() < STILL.acc_m_s2;
        self.still_s = lasting(still && self.may_be_bias(&mean), self.still_s, dt_s);
        if self.standstill() {
            self.known = Some((mean, 0.0));
        } else if let Some((_, since_s)) = &mut self.known {
            *since_s += dt_s;
        }
        self.standstill()
    }

    fn may_be_bias(&self, mean: &Vector3<f64>) -> bool {
        let change_deg_s = |since_s: f64| {
            (STILL.bias_change_deg_s + STILL.bias_change_deg_s2 * since_s).min(STILL.bias_max_deg_s)
        };
        mean.amax() < STILL.bias_max_deg_s.to_radians()
            && self.known.is_none_or(|(bias, since_s)| {
                (mean - bias).amax() < change_deg_s(since_s).to_radians()
            })
    }
    /// Counts a lost sample. After a run of them the sensor may have moved.
    pub fn miss(&mut self, dt_s: f64) {
        self.missed_s += dt_s;
        if self.missed_s > STILL.missed_max_s {
            self.still_s = 0.0;
        }
    }
    /// True when the sensor has been still for long enough.
    pub fn standstill(&self) -> bool {
        self.still_s >= STILL.time_s
    }
    /// Slow mean of the angular rate, rad/s: the bias, at standstill.
    pub fn gyro_mean_rad_s(&self) -> Vector3<f64> {
        self.means.map_or_else(Vector3::zeros, |(gyro, _)| gyro)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standstill_needs_time_and_yields_the_bias() {
        let bias = Vector3::new(0.01, -0.02, 0.005);
        let up = Vector3::new(0.0, 0.0, 9.81);
        let mut detector = StandstillDetector::default();
        for k in 0..149 {
            assert!(
                !detector.update(&bias, &up, 0.01),
                "standstill after {k} samples"
            );
        }
        assert!((0..2).any(|_| detector.update(&bias, &up, 0.01)));
        assert!((detector.gyro_mean_rad_s() - bias).norm() < 1e-12);
        assert!(!detector.update(&Vector3::new(0.5, 0.0, 0.0), &up, 0.01));
    }

    #[test]
    fn steady_fast_rotation_is_not_standstill() {
        let mut detector = StandstillDetector::default();
        let (rate, up) = (Vector3::new(0.0, 0.0, 0.3), Vector3::new(0.0, 0.0, 9.81));
        assert!((0..1000).all(|_| !detector.update(&rate, &up, 0.01)));
    }

    #[test]
    fn slow_rotation_is_not_standstill_once_the_bias_is_known() {
        let mut detector = StandstillDetector::default();
        let (bias, up) = (Vector3::new(0.07, 0.0, 0.0), Vector3::new(0.0, 0.0, 9.81));
        assert!(
            (0..300).any(|_| detector.update(&bias, &up, 0.01)),
            "4 °/s of bias is accepted at the first standstill"
        );
        let turning = bias + Vector3::new(0.0, 0.0, 0.04);
        let settled = (0..1000)
            .skip(300)
            .map(|_| detector.update(&turning, &up, 0.01))
            .filter(|r| *r)
            .count();
        assert_eq!(settled, 0, "2.3 °/s of rotation is no standstill");
        assert!(
            (0..300).any(|_| detector.update(&bias, &up, 0.01)),
            "standstill is found again"
        );
    }

    #[test]
    fn a_lost_sample_keeps_standstill_and_a_lost_second_ends_it() {
        let (bias, up) = (Vector3::zeros(), Vector3::new(0.0, 0.0, 9.81));
        let mut detector = StandstillDetector::default();
        for _ in 0..200 {
            detector.update(&bias, &up, 0.01);
            detector.miss(0.01);
        }
        assert!(detector.standstill());
        for _ in 0..100 {
            detector.miss(0.01);
        }
        assert!(!detector.standstill());
    }
}
