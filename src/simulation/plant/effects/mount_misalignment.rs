//! A chip that sits askew in the tip, on a board that gives under its own weight.
//!
//! Rotation vector `m + w (f/g) × ẑ`: a constant tilt, and `w` of bending per g across.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.mount_misalignment]`
    MountMisalignment at "effects.mount_misalignment" sized by tilt_deg; background 0.06; drawn by rng, severity {
        let size = rng.sized(3.0, 15.0, severity);
        /// Tilt m of the chip in the tip, a rotation vector in degrees. Default 0 (none); typical 1 to
        /// 15. A larger value mixes the axes more.
        tilt_deg: [f64; 3] = [0.0; 3], -180.0..=180.0, "1 to 15 is typical", draw (rng.direction() * size).into();
        /// Give w of the board, as a share of the tilt's angle per g. Default 0.03. A larger value depends more
        /// on attitude.
        give: f64 = 0.03, 0.0..=0.5, "0.03 is typical", draw rng.between(0.0, 0.05);
    }
}

impl Law for MountMisalignment {
    fn sensor(&mut self, stimulus: &mut Stimulus, _at: &Moment) {
        let tilt = Vector3::from(self.tilt_deg).map(f64::to_radians);
        let give = stimulus.force.cross(&Vector3::z()) * (self.give * tilt.norm() / GRAVITY_M_S2);
        *stimulus = stimulus.turned_by(&UnitQuaternion::from_scaled_axis(tilt + give));
    }
}
