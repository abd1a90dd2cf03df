//! A constant offset of the accelerometer.
//!
//! Cause: stress of soldering and packaging, temperature (Titterton and Weston, *Strapdown Inertial
//! Navigation Technology*, 2nd ed. 2004, ch. 6).
//!
//! Law: `f′ = f + b`, sensor frame.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `x`, `y`, `z` b | m/s² | 0 ± 0.3 | 0.1-1 (10-100 mg) |
//!
//! Signature: in the accelerometer only, and the norm depends on the pose. Similar to
//! `gravity` (the tip really sags), a tilted base and `mount_misalignment` (turns the other sensors
//! too). Many attitudes separate it.

use crate::model::effects::prelude::*;

/// Offset of the specific force.
pub struct AccelBias;

impl Effect for AccelBias {
    info! {
        name: "accel_bias",
        stage: Stage::Sensor,
        signature: "an offset of the accelerometer alone; its norm depends on the pose",
        confused_with: &["gravity", "mount_misalignment", "base_motion"],
        separated_by: "many attitudes",
        params: &Param::new("", "m/s²", 0.0, 0.3, (-3.0, 3.0)).named(["x", "y", "z"]),
        starts: &[&[0.02; 3]],
    }
    fn sensor(&self, p: &[f64], _m: &mut Memory, _at: &Moment, reading: &mut ImuPrediction) {
        reading.acc_m_s2 += Vector3::new(p[0], p[1], p[2]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&AccelBias);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&AccelBias, &[0.5, -0.3, 0.2]);
    }

    #[test]
    fn the_norm_depends_on_the_pose_and_nothing_else_changes() {
        let p = [0.5, -0.3, 0.2];
        let run = proof::drive(&AccelBias, &p, 60.0, proof::exercise);
        let clean = proof::drive(&AccelBias, &[0.0; 3], 60.0, proof::exercise);
        for (l, c) in run.iter().zip(&clean) {
            assert!((l.reading.acc_m_s2 - c.reading.acc_m_s2 - Vector3::from(p)).norm() < 1e-12);
            assert_eq!(
                (l.reading.mag_ut, l.reading.gyro_rad_s),
                (c.reading.mag_ut, c.reading.gyro_rad_s)
            );
        }
        let norms: Vec<f64> = run.iter().map(|l| l.reading.acc_m_s2.norm()).collect();
        let spread = norms.iter().copied().fold(f64::MIN, f64::max)
            - norms.iter().copied().fold(f64::MAX, f64::min);
        assert!(spread > 0.3, "{spread}");
    }
}
