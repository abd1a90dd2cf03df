//! The gyroscope's bias drifts.
//!
//! Cause: the proof mass's springs and the electronics warm up after power-on, and flicker noise adds
//! a wander (IEEE Std 952-1997, annex C; warm-up as an exponential). A constant bias is part of the nominal model
//! and refitted with it.
//!
//! Law: `ω′ = ω + b(t)` with b piecewise linear per axis between knots at 0 (where it is zero), 12,
//! 30, 50 s and every 25 s up to 300 s: dense during the warm-up, sparse during the wander.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `x1`…`z13` b at the knots | rad/s | 0 ± 0.02 | 0.002-0.09 (0.1-5 °/s) |
//!
//! Signature: in the gyroscope only; the other sensors measure no motion. Similar to
//! `thermal_drift` and `base_motion`, which the accelerometer measures. Still holds separate it.

use crate::model::effects::prelude::*;

/// Times of the knots after the first, s.
const KNOTS_S: [f64; 13] = [
    12.0, 30.0, 50.0, 75.0, 100.0, 125.0, 150.0, 175.0, 200.0, 225.0, 250.0, 275.0, 300.0,
];
/// Names of the knots' values, axis by axis.
const NAMES: [&str; 39] = [
    "x1", "x2", "x3", "x4", "x5", "x6", "x7", "x8", "x9", "x10", "x11", "x12", "x13", "y1", "y2",
    "y3", "y4", "y5", "y6", "y7", "y8", "y9", "y10", "y11", "y12", "y13", "z1", "z2", "z3", "z4",
    "z5", "z6", "z7", "z8", "z9", "z10", "z11", "z12", "z13",
];

/// A wander of the three rates.
pub struct GyroBias;

impl Effect for GyroBias {
    info! {
        name: "gyro_bias",
        stage: Stage::Sensor,
        signature: "a slow drift of the gyroscope alone; the other sensors measure no motion",
        confused_with: &["thermal_drift", "base_motion"],
        separated_by: "still holds, early and late",
        params: &Param::new("", "rad/s", 0.0, 0.02, (-0.3, 0.3)).named(NAMES),
        starts: &[&[1e-4; NAMES.len()]],
    }
    fn sensor(&self, p: &[f64], _m: &mut Memory, at: &Moment, reading: &mut ImuPrediction) {
        let next = KNOTS_S.iter().position(|&k| at.t_s < k);
        let (from, to, share) = match next {
            None => (KNOTS_S.len(), KNOTS_S.len(), 0.0),
            Some(0) => (0, 1, at.t_s / KNOTS_S[0]),
            Some(k) => {
                let (last_s, next_s) = (KNOTS_S[k - 1], KNOTS_S[k]);
                (k, k + 1, (at.t_s - last_s) / (next_s - last_s))
            }
        };
        // the bias is zero at knot 0 by definition
        let value = |axis: usize, knot: usize| match knot {
            0 => 0.0,
            _ => p[axis * KNOTS_S.len() + knot - 1],
        };
        reading.gyro_rad_s += Vector3::from_fn(|axis, _| {
            value(axis, from) + (value(axis, to) - value(axis, from)) * share
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&GyroBias);
    }

    #[test]
    fn only_the_gyroscope_drifts() {
        let p = proof::with(
            &GyroBias,
            &[("y1", 0.01), ("y2", 0.02), ("z1", 0.004), ("z2", 0.01)],
        );
        let run = proof::drive(&GyroBias, &p, 40.0, proof::exercise);
        let clean = proof::drive(&GyroBias, &proof::nothing(&GyroBias), 40.0, proof::exercise);
        for (l, c) in run.iter().zip(&clean) {
            assert_eq!(
                (l.pose, l.reading.acc_m_s2, l.reading.mag_ut),
                (c.pose, c.reading.acc_m_s2, c.reading.mag_ut)
            );
        }
        let drift = |k: usize| run[k].reading.gyro_rad_s - clean[k].reading.gyro_rad_s;
        assert!((drift(600) - Vector3::new(0.0, 0.005, 0.002)).norm() < 1e-9);
        assert!((drift(2100) - Vector3::new(0.0, 0.015, 0.007)).norm() < 1e-9);
    }
}
