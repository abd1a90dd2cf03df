//! Settings of the bend-constrained estimator.

use serde::Deserialize;

/// Priors and noise of the estimator.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BendFilterConfig {
    /// Least time between two corrections by gravity and field, s. Default 0.01. Larger costs less
    /// time per tick and reacts later to a disturbed sensor.
    pub correction_period_s: f64,
    /// Expected accelerometer bias, m/s², 1 σ. Default 0.25 (25 mg). Larger trusts gravity less until
    /// a few poses have shown the bias.
    pub acc_bias_sigma_m_s2: f64,
    /// Expected field of the tip's own iron, µT, 1 σ. Default 6. Larger trusts the field less at first.
    pub mag_bias_sigma_ut: f64,
    /// Expected twist per bend, rad/rad, 1 σ. Default 0.1 (7.5° at 75°). Larger takes more of what the
    /// tip turns about its own axis for torsion.
    pub twist_sigma: f64,
    /// Expected tilt of the axis about which nothing turns against the sensor's z, rad, 1 σ: a tilted
    /// chip, and half of what the tip sags at rest. Default 0.03 (1.7°). Larger lets more of a
    /// contradiction pass for either.
    pub mount_sigma_rad: f64,
    /// Wander of the gyroscope bias, rad/s per √s. Default 3e-3 (a part that warms after power-on changes
    /// by tenths of a degree per second within seconds; gravity holds what that costs). Larger follows it sooner and forgets the rest's mean sooner.
    pub gyro_walk_rad_s_rts: f64,
    /// Wander of the accelerometer bias, m/s² per √s. Default 0.002.
    pub acc_walk_m_s2_rts: f64,
    /// Wander of the tip's own field, µT per √s. Default 0.05.
    pub mag_walk_ut_rts: f64,
    /// Wander of the gyroscope bias while gravity keeps contradicting the gyroscope, as a multiple of
    /// `gyro_walk_rad_s_rts` at the most. Default 12. Larger follows a part that drifts fast sooner, and
    /// takes a push on the tip for such a drift.
    pub gyro_walk_factor_max: f64,
    /// Error of gravity as a direction while the tip turns, m/s² per rad/s. Default 0.15. Larger lets
    /// the gyroscope alone carry fast motion.
    pub acc_motion_m_s2_per_rad_s: f64,
    /// Length of the bending section, mm. Default 20. Larger takes more acceleration off what the
    /// accelerometer says while the tip turns.
    pub arc_mm: f64,
    /// How far past the bending section the sensor sits, mm. Default 5. Larger likewise.
    pub beyond_mm: f64,
    /// What no noise figure holds of gravity: scale and axes of the accelerometer, as a fraction, 1 σ.
    /// Default 0.004. Larger leans on the gyroscope for longer.
    pub direction_error: f64,
    /// The same of the field: soft iron, a field that is not uniform. Default 0.012 (half a microtesla).
    /// Larger makes the field a weaker helper, and a lying one a smaller harm.
    pub field_error: f64,
    /// How long such an error stays the same, s: it does not average out within that time. Default 1.
    pub direction_time_s: f64,
    /// Twist that is not proportional to bend, rad per rad, 1 σ. Default 0.03 (2.2° at 75°). Larger lets
    /// the tip turn about its own axis more freely.
    pub twist_error: f64,
    /// Wander of the twist per radian of bending motion, rad/rad per √rad. Default 0.02. Larger lets
    /// torsion that is not proportional to bend be followed.
    pub twist_walk: f64,
    /// Rate that a still tip may really have (creep, leak), rad/s, 1 σ over a second of rest.
    /// Default 0.005. Smaller trusts stillness more as a gyroscope calibration.
    pub still_rate_sigma_rad_s: f64,
    /// Use the magnetometer at all. Default true.
    pub use_mag: bool,
}

impl Default for BendFilterConfig {
    fn default() -> Self {
        Self {
            correction_period_s: 0.01,
            acc_bias_sigma_m_s2: 0.25,
            mag_bias_sigma_ut: 6.0,
            twist_sigma: 0.1,
            mount_sigma_rad: 0.03,
            gyro_walk_rad_s_rts: 3e-3,
            acc_walk_m_s2_rts: 0.002,
            mag_walk_ut_rts: 0.05,
            gyro_walk_factor_max: 12.0,
            acc_motion_m_s2_per_rad_s: 0.15,
            arc_mm: 20.0,
            beyond_mm: 5.0,
            direction_error: 0.004,
            field_error: 0.012,
            twist_error: 0.03,
            direction_time_s: 1.0,
            twist_walk: 0.02,
            still_rate_sigma_rad_s: 0.005,
            use_mag: true,
        }
    }
}
