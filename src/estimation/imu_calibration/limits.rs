//! How good a recording must be before a number is taken from it.

use crate::parameters;

parameters! {
    /// How good a recording must be. The limits are set in code.
    pub struct CalibrationLimits {
        /// Largest standard deviation of the gyroscope at rest, rad/s per axis; the default is four times the noise of the parts
        /// used. A larger value accepts an unsteady hand, and its bias.
        still_gyro_rad_s: f64 = 0.02;
        /// Largest standard deviation of the accelerometer at rest, m/s² per axis.
        still_acc_m_s2: f64 = 0.15;
        /// Largest mean rate at rest, rad/s per axis: 8.6 °/s, beyond the zero-rate level of any part used. A larger value would
        /// take a steady turn about the vertical, which the accelerometer does not measure, for bias.
        still_mean_rad_s: f64 = 0.15;
        /// Largest tilt or heading change within a rest, degrees. A larger value accepts a slow creep, which is taken for bias:
        /// 0.5° in 2 s is 0.25 °/s.
        still_turn_deg: f64 = 0.5;
        /// Shortest rest, s. Longer rests average more noise.
        still_min_s: f64 = 1.0;
        /// Smallest fraction of the sphere of directions that a tumble covers, of 32 equal cells. A smaller value accepts a
        /// smaller tumble and a worse matrix.
        sphere_coverage: f64 = 0.6;
        /// Fewest samples (or rests) for an ellipsoid; nine numbers are fitted.
        ellipsoid_samples: usize = 20;
        /// Largest sigma of an ellipsoid's centre, as a fraction of its radius.
        centre_sigma: f64 = 0.02;
        /// Largest residual of an ellipsoid, as a fraction of its radius. A larger value accepts a field that is not uniform.
        ellipsoid_residual: f64 = 0.05;
        /// Largest ratio of an ellipsoid's longest to its shortest axis. A turn about one axis alone fits an arbitrarily flat
        /// ellipsoid; real soft iron stays below 1.5.
        ellipsoid_ratio: f64 = 2.0;
        /// Smallest fraction of the coil cycle, of 12 phases, that each motor covers while energised.
        phase_coverage: f64 = 0.75;
        /// Largest sigma of any component of a motor's field, µT: a third of a degree of heading.
        motor_sigma_ut: f64 = 0.3;
        /// Smallest turn of a bend that counts for the mount angle, degrees.
        bend_min_deg: f64 = 10.0;
        /// Smallest spread of the bend directions: the smaller of the two in-plane fractions of the squared axes. 0.5 is a full
        /// circle, 0 a single direction back and forth.
        bend_spread: f64 = 0.15;
        /// Largest deviation of the bend axes from their common plane, degrees rms. A larger value accepts twisting bends.
        bend_out_of_plane_deg: f64 = 5.0;
    }
}
