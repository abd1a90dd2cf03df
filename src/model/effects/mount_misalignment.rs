//! The IMU is tilted against the tip.
//!
//! Cause: gluing and soldering (boresight: Titterton and Weston, *Strapdown Inertial Navigation
//! Technology*, 2nd ed. 2004, ch. 10).
//!
//! Law: `v_tip = exp([θ]×) v_sensor` for all three sensors, θ constant.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `x`, `y`, `z` θ | rad | 0 ± 0.1 | 0.02-0.26 (1-15°) |
//!
//! Signature: a constant rotation of all sensors, in their own frame. Similar to
//! `clocking` (in the IMU alone a turn of all bellows is the turn about z), a tilted base and `accel_bias`. A known
//! rotation of the base separates it.

use crate::model::effects::prelude::*;

/// Constant turn from sensor to tip.
pub struct MountMisalignment;

impl Effect for MountMisalignment {
    info! {
        name: "mount_misalignment",
        stage: Stage::Sensor,
        signature: "a constant rotation of all sensors in their own frame",
        confused_with: &["clocking", "accel_bias", "hard_iron"],
        separated_by: "a known rotation of the base; a reference",
        params: &Param::new("", "rad", 0.0, 0.1, (-0.6, 0.6)).named(["x", "y", "z"]),
        starts: &[&[0.01; 3]],
    }
    fn mount(&self, p: &[f64]) -> Option<UnitQuaternion<f64>> {
        let turn = Vector3::new(p[0], p[1], p[2]);
        (turn != Vector3::zeros()).then(|| UnitQuaternion::from_scaled_axis(turn))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&MountMisalignment);
    }

    #[test]
    fn the_mount_turns_by_its_vector_and_vanishes_at_zero() {
        let turn = MountMisalignment.mount(&[0.0, 0.0, 0.2]).expect("a turn");
        let seen = turn * Vector3::x();
        assert!((seen - Vector3::new(0.2f64.cos(), 0.2f64.sin(), 0.0)).norm() < 1e-12);
        assert!(MountMisalignment.mount(&[0.0; 3]).is_none());
        assert!(MountMisalignment.sensing_only());
    }
}
