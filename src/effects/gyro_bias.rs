//! The gyroscope's bias drifts.
//!
//! Cause: the proof mass's springs and the electronics warm after power-on, and flicker noise wanders on
//! top (IEEE Std 952-1997, annex C; warm-up as an exponential). A constant bias is part of the nominal model
//! and refitted with it.
//!
//! Law: `ω′ = ω + c (1 − e^(−t/τ)) + d t/100 s` per axis: a warm-up and a trend, linear but for the
//! one shared time constant.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `warm_x`, `warm_y`, `warm_z` c | rad/s | 0 ± 0.01 | 0.002-0.09 (0.1-5 °/s) |
//! | `trend_x`, `trend_y`, `trend_z` d | rad/s per 100 s | 0 ± 0.01 | 0-0.03 |
//! | `tau` τ | s | 40 ± 40 | 10-200 |
//!
//! Signature: in the gyroscope only; the other sensors see no motion. Easily confused with
//! `thermal_drift` and `base_motion`, which the accelerometer sees. Still holds separate it.

use crate::effects::{Effect, Memory, Moment, Param, Reading, Stage, Starts};
use nalgebra::Vector3;

/// Time over which the trend is given, s.
const SPAN_S: f64 = 100.0;

/// Warm-up and trend of the three rates.
#[derive(Debug, Clone, Copy, Default)]
pub struct GyroBias;

impl Effect for GyroBias {
    fn name(&self) -> &'static str {
        "gyro_bias"
    }
    fn stage(&self) -> Stage {
        Stage::Sensor
    }
    fn signature(&self) -> &'static str {
        "a slow drift of the gyroscope alone; the other sensors see no motion"
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["thermal_drift", "base_motion"]
    }
    fn separated_by(&self) -> &'static str {
        "still holds, early and late"
    }
    fn params(&self) -> Vec<Param> {
        let rate = |names| Param::new("", "rad/s", 0.0, 0.01, (-0.15, 0.15)).named(names);
        let mut out = Vec::from(rate(["warm_x", "warm_y", "warm_z"]));
        out.extend(rate(["trend_x", "trend_y", "trend_z"]));
        out.push(Param::new("tau", "s", 40.0, 40.0, (4.0, 400.0)));
        out
    }
    fn starts(&self) -> Starts {
        [15.0, 60.0].map(|tau| vec![1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0, tau]).to_vec()
    }
    fn sensor(&self, p: &[f64], _m: &mut Memory, at: &Moment, reading: &mut Reading) {
        let warm = -(-at.t_s / p[6]).exp_m1();
        let along = at.t_s / SPAN_S;
        reading.gyro_rad_s += Vector3::new(p[0], p[1], p[2]) * warm + Vector3::new(p[3], p[4], p[5]) * along;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::proof;

    #[test]
    fn keeps_the_rules() {
        proof::keeps_the_rules(&GyroBias);
    }

    #[test]
    fn a_fit_finds_it_again() {
        proof::found_again(&GyroBias, &[0.02, -0.01, 0.005, -0.01, 0.01, 0.02, 35.0]);
    }

    #[test]
    fn only_the_gyroscope_drifts() {
        let p = proof::with(&GyroBias, &[("warm_y", 0.02), ("trend_z", 0.01), ("tau", 10.0)]);
        let run = proof::drive(&GyroBias, &p, 100.0, proof::exercise);
        let clean = proof::drive(&GyroBias, &proof::nothing(&GyroBias), 100.0, proof::exercise);
        for (l, c) in run.iter().zip(&clean) {
            assert_eq!((l.pose, l.reading.acc_m_s2, l.reading.mag_ut), (c.pose, c.reading.acc_m_s2, c.reading.mag_ut));
        }
        let drift = run[10_000].reading.gyro_rad_s - run[0].reading.gyro_rad_s;
        assert!((drift - Vector3::new(0.0, 0.02, 0.01)).norm() < 1e-5, "{drift}");
        let early = run[1000].reading.gyro_rad_s - run[0].reading.gyro_rad_s;
        assert!((early.y - 0.02 * (1.0 - (-1.0f64).exp())).abs() < 1e-9 && (early.z - 0.001).abs() < 1e-9);
    }
}
