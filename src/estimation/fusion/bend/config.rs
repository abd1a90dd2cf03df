//! Settings of the bend-constrained estimator.

use crate::parameters;

parameters! {
    /// The bend-constrained estimator: priors and noise. All sigmas are one standard deviation.
    pub struct BendFilterConfig: Copy {
        /// Time over which readings are averaged before they correct the estimate. A larger value costs less time per tick and
        /// reacts later to a disturbed sensor.
        correction_period_s: f64 = 0.05, "s", 0.002..=0.5, "0.05 is 25 samples at 500 Hz";
        /// Rate at which the gyroscope begins to drift, its rate begins to be wrong or the base begins to sway, and at which
        /// each of these ends. A larger value notices the change sooner and believes in a false one more often.
        change_per_s: f64 = 0.02, "1/s", 1e-5..=1.0, "0.02 is once in 50 s";
        /// Expected accelerometer bias; the default is 15 mg. A larger value weights gravity less until a few poses have
        /// revealed the bias.
        acc_bias_sigma_m_s2: f64 = 0.15, "m/s²", 0.0001..=3.0, "0.15 is 15 mg";
        /// Expected field of the tip's own iron. A larger value weights the field less at first.
        mag_bias_sigma_ut: f64 = 6.0, "µT", 0.001..=100.0, "6 after a calibration of the magnetometer";
        /// Expected scale error of each axis of the gyroscope. A larger value learns it sooner, and takes other errors of a
        /// motion for it.
        gyro_scale_sigma: f64 = 0.008, "", 1e-6..=0.2, "0.008 is half of what data sheets allow";
        /// Expected twist per bend; the default is 7.5° at 75°. A larger value attributes more of a rotation about the tip's
        /// axis to torsion.
        twist_sigma: f64 = 0.1, "rad/rad", 1e-6..=1.0, "0.1 is 7.5° of twist at 75°";
        /// Expected tilt of the sensor's z axis against the axis about which the tip cannot turn: a tilted chip, and half of
        /// the tip's sag at rest. The default is 5.7°. A larger value attributes more of a contradiction to either.
        mount_sigma_rad: f64 = 0.1, "rad", 1e-6..=1.0, "0.1 is 5.7°";
        /// Random walk of the bias of a steady gyroscope. A larger value follows the bias sooner and forgets the mean of the
        /// alignment sooner.
        gyro_walk_rad_s_rts: f64 = 1e-4, "rad/s/√s", 0.0..=0.1, "0.0001 is a part at constant temperature";
        /// Random walk of the bias of a gyroscope that drifts, such as one that warms up by tenths of a degree per second
        /// within seconds. A larger value follows a faster drift.
        gyro_drift_rad_s_rts: f64 = 3e-3, "rad/s/√s", 0.0..=0.1, "0.003 follows a part that warms up";
        /// Error of the measured rate as a share of it, correlated over 0.1 s. A larger value trusts a motion less.
        rate_error: f64 = 0.0015, "", 0.0..=1.0, "0.0015 is a good part";
        /// The same while the rate is wrong, because samples are late by a time that wanders or the scale changes. A larger
        /// value lets gravity and field correct more of a motion.
        wrong_rate_error: f64 = 0.1, "", 0.0..=1.0, "0.1 covers a latency of 0.3 s that wanders by 6 %";
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
        direction_error: f64 = 0.0035, "", 1e-5..=1.0, "0.0035 is 0.2°";
        /// Time for which an error of gravity or twist stays constant: within it, samples do not average out. A larger value gives many
        /// samples less weight.
        direction_time_s: f64 = 0.4, "s", 0.0..=100.0, "0.4 is the time of a motion";
        /// Expected error of the field (soft iron, motors, a field that is not uniform), until motion has shown it; the
        /// default is one and a half microteslas. A larger value gives the field less weight at first.
        field_error: f64 = 0.03, "", 1e-5..=1.0, "0.03 is one and a half microteslas";
        /// Time for which an error of the field stays constant. A larger value gives the field less weight.
        field_time_s: f64 = 15.0, "s", 0.01..=1000.0, "15 is the time of some poses";
        /// Twist that is not proportional to bend, on a tip without torsion; the default is 1.1° at 75°. A larger value lets the
        /// estimate turn about the tip's axis more freely.
        twist_error: f64 = 0.015, "rad/rad", 0.0001..=10.0, "0.015 is 1.1° at 75°";
        /// The same as a share of the estimated torsion: it levels off with the bend and differs from direction to direction.
        /// A larger value expects a stranger torsion.
        twist_form: f64 = 0.35, "", 0.0..=10.0, "0.35 of the torsion is of another form";
        /// Random walk of the twist per radian of bending motion. A larger value follows torsion that is not proportional to
        /// bend.
        twist_walk: f64 = 0.02, "rad/rad/√rad", 0.0..=1.0, "0.02 for a tip whose torsion is nearly proportional to bend";
        /// Rate of bend that a still tip may have (creep, leak), averaged over one second of standstill. What it has shown raises
        /// it. A smaller value gives standstill more weight as a calibration of the gyroscope.
        still_rate_sigma_rad_s: f64 = 0.002, "rad/s", 1e-5..=1.0, "0.002 is the creep of a fresh bend";
        /// Rate of twist that a still tip may have. A smaller value notices a drift sooner, and takes creep for one.
        still_twist_sigma_rad_s: f64 = 0.001, "rad/s", 1e-5..=1.0, "0.001 is the creep of a tip with torsion";
        /// Uses the magnetometer.
        use_mag: bool = true;
    }
}
