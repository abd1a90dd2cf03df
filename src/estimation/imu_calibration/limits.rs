//! How good a recording must be before a number is taken from it.

use serde::{Deserialize, Serialize};

/// How good a recording must be: the `[calib_imu]` table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrationLimits {
    /// Largest standard deviation of the gyroscope in a rest, rad/s per axis. Default 0.02, four
    /// times the noise of the parts used. A bigger value accepts an unsteady hand, and its bias.
    pub still_gyro_rad_s: f64,

    /// Largest standard deviation of the accelerometer in a rest, m/s² per axis. Default 0.15.
    pub still_acc_m_s2: f64,

    /// Largest mean rate of a rest, rad/s per axis. Default 0.15 (8.6 °/s), beyond the zero-rate level of any
    /// part used. A bigger value would take a steady turn about the vertical, which the accelerometer does not
    /// see, for bias.
    pub still_mean_rad_s: f64,

    /// Largest tilt or heading change within a rest, degrees. Default 0.5. A bigger value accepts
    /// a slow creep, which a bias would swallow: 0.5° in 2 s is 0.25 °/s.
    pub still_turn_deg: f64,

    /// Shortest rest, s. Default 1.0. Longer rests average more noise away.
    pub still_min_s: f64,

    /// Smallest share of the sphere of directions that a tumble must touch, of 32 equal cells.
    /// Default 0.6: more than one half. A smaller value accepts a lazier tumble and a worse matrix.
    pub sphere_coverage: f64,

    /// Fewest samples (or rests) for an ellipsoid. Default 20; nine numbers are fitted.
    pub ellipsoid_samples: usize,

    /// Largest sigma of an ellipsoid's centre, as a share of its radius. Default 0.02.
    pub centre_sigma: f64,

    /// Largest residual of an ellipsoid, as a share of its radius. Default 0.05. A bigger value
    /// accepts a field that is not the same everywhere.
    pub ellipsoid_residual: f64,

    /// Largest ratio of an ellipsoid's longest to its shortest axis. Default 2. A turn about one axis
    /// alone can be fitted by an arbitrarily flat ellipsoid; real soft iron stays below 1.5.
    pub ellipsoid_ratio: f64,

    /// Smallest share of the coil cycle, of 12 phases, that each motor must visit while energised.
    /// Default 0.75.
    pub phase_coverage: f64,

    /// Largest sigma of any component of a motor's field, µT. Default 0.3, a third of a degree of
    /// heading.
    pub motor_sigma_ut: f64,

    /// Smallest turn of a bend that counts for the mount angle, degrees. Default 10.
    pub bend_min_deg: f64,

    /// Smallest spread of the bend directions: the lesser of the two in-plane shares of the squared
    /// axes. Default 0.15; 0.5 is a full circle, 0 a single direction there and back.
    pub bend_spread: f64,

    /// Largest angle by which the bend axes may leave their common plane, degrees rms. Default 5. A
    /// bigger value accepts twisting bends.
    pub bend_out_of_plane_deg: f64,
}

impl Default for CalibrationLimits {
    fn default() -> Self {
        Self {
            still_gyro_rad_s: 0.02,
            still_acc_m_s2: 0.15,
            still_mean_rad_s: 0.15,
            still_turn_deg: 0.5,
            still_min_s: 1.0,
            sphere_coverage: 0.6,
            ellipsoid_samples: 20,
            centre_sigma: 0.02,
            ellipsoid_residual: 0.05,
            ellipsoid_ratio: 2.0,
            phase_coverage: 0.75,
            motor_sigma_ut: 0.3,
            bend_min_deg: 10.0,
            bend_spread: 0.15,
            bend_out_of_plane_deg: 5.0,
        }
    }
}
