//! Settings of the bend-constrained estimator.

use crate::parameters;

parameters! {
    /// The bend-constrained estimator: priors and noise. All sigmas are one standard deviation.
    pub struct BendFilterConfig: Copy {
        /// Shortest time between two corrections by gravity and field. A larger value costs less time per tick and reacts
        /// later to a disturbed sensor.
        correction_period_s: f64 = 0.01, "s", 0.0005..=0.5, "0.01 is ten ticks of the simulation";
        /// Expected accelerometer bias; the default is 25 mg. A larger value weights gravity less until a few poses have
        /// revealed the bias.
        acc_bias_sigma_m_s2: f64 = 0.25, "m/s²", 0.0001..=3.0, "0.25 is 25 mg";
        /// Expected field of the tip's own iron. A larger value weights the field less at first.
        mag_bias_sigma_ut: f64 = 6.0, "µT", 0.001..=100.0, "6 after a calibration of the magnetometer";
        /// Expected twist per bend; the default is 7.5° at 75°. A larger value attributes more of a rotation about the tip's
        /// axis to torsion.
        twist_sigma: f64 = 0.1, "rad/rad", 1e-6..=1.0, "0.1 is 7.5° of twist at 75°";
        /// Expected tilt of the sensor's z axis against the axis about which the tip cannot turn: a tilted chip, and half of
        /// the tip's sag at rest. The default is 1.7°. A larger value attributes more of a contradiction to either.
        mount_sigma_rad: f64 = 0.03, "rad", 1e-6..=1.0, "0.03 is 1.7°";
        /// Random walk of the gyroscope bias. A part that warms up after power-on changes by tenths of a degree per second
        /// within seconds; gravity bounds the resulting error. A larger value follows the bias sooner and forgets the mean of
        /// the alignment sooner.
        gyro_walk_rad_s_rts: f64 = 3e-3, "rad/s/√s", 0.0..=0.1, "0.003 follows a part that warms up";
        /// Upper limit of the random walk of the gyroscope bias while gravity contradicts the gyroscope, as a multiple of
        /// `gyro_walk_rad_s_rts`. A larger value follows a fast drift sooner, and takes a push on the tip for such a drift.
        gyro_walk_factor_max: f64 = 12.0, "", 1.0..=1000.0, "12 follows a fast drift within seconds";
        /// Random walk of the accelerometer bias. A larger value re-estimates the bias sooner.
        acc_walk_m_s2_rts: f64 = 0.002, "m/s²/√s", 0.0..=1.0, "0.002 is the drift of a part that warms up";
        /// Random walk of the tip's own field. A larger value relies on the field for a shorter time.
        mag_walk_ut_rts: f64 = 0.05, "µT/√s", 0.0..=50.0, "0.05 for a tip without moving iron";
        /// Error of gravity as a direction while the tip turns, per unit of rate. A larger value lets the gyroscope alone
        /// carry fast motion.
        acc_motion_m_s2_per_rad_s: f64 = 0.15, "m/s² per rad/s", 0.0..=20.0, "0.15 suits pistons at 30 mm/s";
        /// Length of the bending section. A larger value subtracts more acceleration while the tip turns.
        arc_mm: f64 = 20.0, "mm", 0.0..=500.0, "20 is the length of the bellows";
        /// Distance of the sensor beyond the bending section. A larger value subtracts more acceleration while the tip turns.
        beyond_mm: f64 = 5.0, "mm", -100.0..=200.0, "measure from the end of the bellows to the chip";
        /// Error of gravity that no noise figure covers (scale and axes of the accelerometer), as a fraction. A larger value
        /// relies on the gyroscope for longer.
        direction_error: f64 = 0.004, "", 1e-5..=1.0, "0.004 is 0.2°";
        /// Expected error of the field (soft iron, motors, a field that is not uniform), until motion has shown it; the
        /// default is one and a half microteslas. A larger value gives the field less weight at first.
        field_error: f64 = 0.03, "", 1e-5..=1.0, "0.03 is one and a half microteslas";
        /// Time for which an error of the field stays constant. A larger value gives the field less weight.
        field_time_s: f64 = 15.0, "s", 0.0..=1000.0, "15 is the time of some poses";
        /// Time for which an error of gravity or twist stays constant: within it, samples do not average out. A larger value gives many
        /// samples less weight.
        direction_time_s: f64 = 1.0, "s", 0.0..=100.0, "1 is the time of a motion";
        /// Twist that is not proportional to bend; the default is 2.2° at 75°. A larger value lets the estimate turn about
        /// the tip's axis more freely.
        twist_error: f64 = 0.03, "rad/rad", 0.0001..=10.0, "0.03 is 2.2° at 75°";
        /// Random walk of the twist per radian of bending motion. A larger value follows torsion that is not proportional to
        /// bend.
        twist_walk: f64 = 0.02, "rad/rad/√rad", 0.0..=1.0, "0.02 for a tip whose torsion is nearly proportional to bend";
        /// Rate that a still tip may have (creep, leak), averaged over one second of standstill. A smaller value gives
        /// standstill more weight as a calibration of the gyroscope.
        still_rate_sigma_rad_s: f64 = 0.005, "rad/s", 1e-5..=1.0, "0.005 is the creep of a fresh bend";
        /// Uses the magnetometer.
        use_mag: bool = true;
    }
}
