//! How much units of one make differ.

use crate::simulation::plant::parameters::parameters;

parameters! {
    /// `[spread]`: one standard deviation of everything in which units of one make differ.
    Spread at "spread" {
        /// Of each k_ε, as a share. Default 0; 0.06 for a batch of moulded bellows. Units of a larger spread need a
        /// calibration of their own sooner.
        k_epsilon: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of each k_λ, as a share. Default 0; 0.1 for printed gears.
        k_lambda: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of each bellow's distance from the centre line, as a share. Default 0; 0.01 for a glued tip.
        r: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of each bellow's angle, degrees. Default 0; 1 for a glued tip.
        angle_deg: f64 = 0.0, "", 0.0..=6.0, "1 is typical of a glued tip";
        /// Of the lag, as a share. Default 0; 0.2 is plausible.
        lag: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of each effect's size, standard deviation of its logarithm. Default 0; 0.2 within a batch.
        effects: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of the base's pitch and roll, degrees. Default 0; 5 for a hand-held base.
        tilt_deg: f64 = 0.0, "", 0.0..=45.0, "5 is typical of a hand-held base";
        /// Of the base's heading, degrees, evenly spread over ± this. Default 0; 180 for any heading.
        heading_deg: f64 = 0.0, "", 0.0..=180.0, "180 is any heading";
        /// Of the magnetic field's strength, as a share. Default 0; 0.1 indoors.
        field: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of the field's dip, degrees. Default 0; 4 indoors.
        dip_deg: f64 = 0.0, "", 0.0..=20.0, "4 is typical indoors";
        /// Of each axis' constant gyroscope bias, °/s. Default 0; 0.5 is an uncalibrated chip.
        gyro_bias_deg_s: f64 = 0.0, "", 0.0..=5.0, "0.5 is an uncalibrated chip";
        /// Of each axis' constant accelerometer bias, mg. Default 0; 5 for a chip after a six-face
        /// calibration, 20 for an uncalibrated one.
        acc_bias_mg: f64 = 0.0, "", 0.0..=50.0, "5 is a calibrated chip";
        /// Of each axis' constant magnetometer bias, µT. Default 0; 0.5 for a chip after calibration.
        mag_bias_ut: f64 = 0.0, "", 0.0..=50.0, "0.5 is a calibrated chip";
        /// Of each component of the chip's tilt in the tip, degrees. Default 0; 0.5 for a glued chip.
        mount_deg: f64 = 0.0, "", 0.0..=20.0, "0.5 is a glued chip";
        /// Of the tip's twist at 60° of bend, degrees. Default 0; 1 for a moulded tip.
        torsion_deg: f64 = 0.0, "", 0.0..=20.0, "1 is a moulded tip";
        /// Of the amplitude of each motor's field where the tip is, µT. Default 0; 0.1 for motors half a metre away.
        motor_field_ut: f64 = 0.0, "", 0.0..=50.0, "0.1 is half a metre away";
    }
}
