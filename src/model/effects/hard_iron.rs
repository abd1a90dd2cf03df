//! A constant magnetic field that travels with the sensor.
//!
//! Cause: magnetised parts on the tip: camera, screws, the package itself (Renaudin, Afzal and
//! Lachapelle, *Complete triaxis magnetometer calibration in the magnetic domain*, J. Sensors 2010).
//!
//! Law: `m′ = m + b`, sensor frame.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `x`, `y`, `z` b | µT | 0 ± 10 | 1-50 |
//!
//! Signature: in the magnetometer only, fixed to the body. Similar to `motor_field` (fixed
//! in the world, follows the motors) and `torsion`. A tumble with the motors off separates it.

use crate::model::effects::prelude::*;

/// Field of magnetised parts on the tip.
pub struct HardIron;

impl Effect for HardIron {
    info! {
        name: "hard_iron",
        stage: Stage::Sensor,
        signature: "an offset of the magnetometer alone, fixed to the body",
        confused_with: &["motor_field", "torsion", "mount_misalignment"],
        separated_by: "many attitudes with the motors off",
        params: &Param::new("", "µT", 0.0, 10.0, (-120.0, 120.0)).named(["x", "y", "z"]),
        starts: &[&[1.0; 3]],
    }
    fn sensor(&self, p: &[f64], _m: &mut Memory, _at: &Moment, reading: &mut ImuPrediction) {
        reading.mag_ut += Vector3::new(p[0], p[1], p[2]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&HardIron);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&HardIron, &[12.0, -25.0, 3.0]);
    }

    #[test]
    fn the_offset_is_fixed_to_the_body() {
        let p = [12.0, -7.0, 3.0];
        let run = proof::drive(&HardIron, &p, 60.0, proof::exercise);
        let clean = proof::drive(&HardIron, &[0.0; 3], 60.0, proof::exercise);
        for (l, c) in run.iter().zip(&clean) {
            assert!((l.reading.mag_ut - c.reading.mag_ut - Vector3::from(p)).norm() < 1e-12);
            assert_eq!(
                (l.reading.acc_m_s2, l.reading.gyro_rad_s),
                (c.reading.acc_m_s2, c.reading.gyro_rad_s)
            );
        }
        let in_base = |k: usize| {
            run[k].reading.r_base_sensor * (run[k].reading.mag_ut - clean[k].reading.mag_ut)
        };
        assert!(
            (in_base(500) - in_base(4500)).norm() > 1.0,
            "in the world it turns with the tip"
        );
    }
}
