//! Settings of the error-state filter. `_rt_s` marks a noise density (its unit times √s or per √s).

use crate::parameters;

parameters! {
    /// Settings of the error-state filter.
    pub struct MekfConfig: Copy {
        /// Length of a block between corrections, s. A larger value needs less arithmetic and corrects later and in larger
        /// steps.
        block_s: f64 = 0.035;
        /// Uncertainty of the first levelling, degrees. A larger value corrects a start in motion sooner.
        first_tilt_deg: f64 = 1.0;
        /// Rate above which the first sample counts as taken in motion, rad/s. A larger value trusts a start in motion more.
        moving_rad_s: f64 = 0.2;
        /// Further uncertainty of a levelling in motion, rad. A larger value corrects it sooner.
        moving_tilt_rad: f64 = 0.2;
        /// Largest uncertainty of the tilt at which a field reading may define north, rad: the dip turns tilt into heading. A
        /// larger value finds north sooner and less exactly.
        level_enough_rad: f64 = 0.06;
        /// Uncertainty of the heading before north is found, rad: large, but small enough for the linearisation. A larger value
        /// lets the first readings turn the heading further.
        heading_unknown_rad: f64 = 1.0;
        /// Rate that a lost gyroscope sample may have missed, rad/s. A larger value lets gravity and field correct more after
        /// a loss.
        missed_rate_rad_s: f64 = 1.0;
        /// Rate beyond the range of a saturated gyroscope, as a fraction of the range. A larger value lets gravity and field
        /// correct more after it.
        saturated_excess: f64 = 0.3;
        /// Specific force that a lost accelerometer sample may have missed, m/s². A larger value gives gravity less weight after
        /// a loss.
        missed_force_m_s2: f64 = 3.0;
        /// Angle random walk of the gyroscope, °/√s. A larger value gives gravity and field more weight.
        gyro_wander_deg_rt_s: f64 = 0.02;
        /// Error of the gyroscope that scale and skew do not cover, as a fraction of the rate, √s. A larger value gives
        /// gravity and field more weight in fast turns.
        gyro_nonlinearity_rt_s: f64 = 1e-4;
        /// Initial uncertainty of the bias, °/s per axis. A larger value finds a large bias sooner when there is no rest.
        bias_sigma_deg_s: f64 = 0.5;
        /// Random walk of the bias, °/s per √s. A larger value follows warming up sooner and gives a noisier bias.
        bias_wander_deg_s_rt_s: f64 = 0.005;
        /// Uncertainty of the bias that one rest gives, °/s. A larger value gives a rest less weight.
        rest_bias_sigma_deg_s: f64 = 0.03;
        /// Correlation time of an error of the gyroscope's slow mean, s. A larger value gives a rest less weight.
        rest_bias_memory_s: f64 = 0.5;
        /// Uncertainty of the gyroscope's scale, as a fraction; half of it for skew. A larger value learns the scale sooner
        /// and attributes more of other errors to it.
        scale_sigma: f64 = 0.005;
        /// Largest scale error, as a fraction. A larger value serves worse gyroscopes.
        scale_max: f64 = 0.05;
        /// Typical velocity of the body, m/s per horizontal axis. With a larger value travel tilts the orientation less and
        /// gyroscope errors tilt it more.
        velocity_sigma_m_s: f64 = 0.5;
        /// Correlation time of that velocity, s. A larger value acts like a larger velocity.
        velocity_memory_s: f64 = 1.0;
        /// Velocity of a body at rest, m/s. A larger value gives gravity less weight at rest.
        rest_velocity_sigma_m_s: f64 = 0.02;
        /// Correlation time of that velocity, s. A larger value acts like a larger velocity.
        rest_velocity_memory_s: f64 = 0.1;
        /// Error of the accelerometer at any time, m/s per √s. A larger value gives gravity less weight.
        acc_floor_m_s_rt_s: f64 = 0.02;
        /// Error of the accelerometer as a fraction of the force that is not gravity (scale, skew, timing), √s. A larger
        /// value gives knocks and shaking less weight.
        acc_fault_rt_s: f64 = 0.02;
        /// Initial age of a magnetometer reading when it arrives, ms. A larger value suits a part with more bus and filter
        /// delay.
        latency_ms: f64 = 8.0;
        /// Uncertainty of that age, ms. A larger value learns it sooner, from less turning.
        latency_sigma_ms: f64 = 8.0;
        /// Largest age, ms. A larger value serves slower buses.
        latency_max_ms: f64 = 100.0;
        /// Uncertainty of the Earth's field before the first reading, µT. A larger value lets that reading say more.
        field_unknown_ut: f64 = 30.0;
        /// Error of the field at one place of an undisturbed room, µT per axis. A larger value relies on the gyroscope for
        /// longer.
        field_sigma_ut: f64 = 1.5;
        /// Correlation time of that error while the body moves, s. A larger value relies on the gyroscope for longer.
        field_memory_s: f64 = 2.0;
        /// Weight of the field at rest, where its error does not change, 0 to 1. A larger value turns the heading to the
        /// field of that place sooner.
        rest_field_weight: f64 = 0.3;
        /// Error of the field at the place of the start, µT per axis. A larger value replaces the heading of the start by
        /// that of the room sooner.
        first_field_sigma_ut: f64 = 1.0;
        /// Random walk of the Earth's field from place to place, µT per √s. A larger value follows strength and dip sooner.
        field_wander_ut_rt_s: f64 = 0.05;
        /// Smallest horizontal field that is used, µT. A larger value keeps the heading steadier near a magnetic pole or a
        /// magnet.
        horizontal_field_min_ut: f64 = 1.0;
        /// Initial uncertainty of the hard iron, µT per axis. A larger value corrects a poor calibration sooner and
        /// attributes more of the room's field to hard iron.
        iron_sigma_ut: f64 = 0.5;
        /// Random walk of the hard iron, µT per √s. A larger value does so permanently.
        iron_wander_ut_rt_s: f64 = 0.1;
        /// Growth of the hard iron's uncertainty when the field does not fit, as a fraction of the misfit, per √s. A larger
        /// value learns a magnet on the body sooner, and one in the room as well.
        iron_unsure_rt_s: f64 = 0.5;
        /// Misfit, as a multiple of `field_sigma_ut`, above which the field counts as disturbed. A larger value accepts
        /// weaker disturbances.
        disturbed_ratio: f64 = 1.5;
        /// Time constant of the running misfit, s. A larger value remembers a disturbance longer.
        misfit_tau_s: f64 = 1.0;
        /// Largest ratio of the misfit of one reading to the running one. A larger value lets one reading count for more.
        misfit_step_max: f64 = 100.0;
    }
}
