//! Settings of the error-state filter. `_rt_s` marks a noise density (its unit times √s or per √s).

/// Settings of the error-state filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MekfConfig {
    /// Length of a block between corrections, seconds. Default 0.035. Bigger: less arithmetic, and
    /// corrections come later and in larger steps.
    pub block_s: f64,
    /// Uncertainty of the first levelling, degrees. Default 1. Bigger: a start in motion is
    /// straightened sooner.
    pub first_tilt_deg: f64,
    /// Angle random walk of the gyroscope, °/√s. Default 0.02. Bigger: more trust in gravity and field.
    pub gyro_wander_deg_rt_s: f64,
    /// What scale and skew leave of the gyroscope's error, as a share of the rate, √s. Default 0.0001.
    /// Bigger: more trust in gravity and field while turning fast.
    pub gyro_nonlinearity_rt_s: f64,
    /// Uncertainty of the bias at the start, °/s per axis. Default 0.5. Bigger: a large bias is found
    /// sooner when there is no rest to find it in.
    pub bias_sigma_deg_s: f64,
    /// Random walk of the bias, °/s per √s. Default 0.005. Bigger: warming up is followed sooner, and
    /// the bias is noisier.
    pub bias_wander_deg_s_rt_s: f64,
    /// Uncertainty of the bias that one rest gives, °/s. Default 0.03. Bigger: a rest counts for less.
    pub rest_bias_sigma_deg_s: f64,
    /// Uncertainty of the gyroscope's scale, as a share; half of it for skew. Default 0.005. Bigger:
    /// scale is learnt sooner, and more of other errors is taken for scale.
    pub scale_sigma: f64,
    /// Largest scale error that is believed, as a share. Default 0.05. Bigger: worse gyroscopes are served.
    pub scale_max: f64,
    /// Velocity that the body usually has, m/s per horizontal axis. Default 0.5. Bigger: travelling tilts
    /// the orientation less, gyroscope errors tilt it more.
    pub velocity_sigma_m_s: f64,
    /// How long such a velocity lasts, seconds. Default 1. Bigger: as above.
    pub velocity_memory_s: f64,
    /// Error of the accelerometer at any time, m/s per √s. Default 0.02. Bigger: less trust in gravity.
    pub acc_floor_m_s_rt_s: f64,
    /// Error of the accelerometer as a share of the force that is not gravity (scale, skew, timing),
    /// √s. Default 0.02. Bigger: knocks and shaking count for less.
    pub acc_fault_rt_s: f64,
    /// Age of a magnetometer reading when it is handed in, at first, milliseconds. Default 8. Bigger: the
    /// part has more bus and filter behind it.
    pub latency_ms: f64,
    /// Uncertainty of that age, milliseconds. Default 8. Bigger: it is learnt sooner, from less turning.
    pub latency_sigma_ms: f64,
    /// Largest age that is believed, milliseconds. Default 100. Bigger: slower buses are served.
    pub latency_max_ms: f64,
    /// Error of the field at one place of an undisturbed room, µT per axis. Default 1.5. Bigger:
    /// longer trust in the gyroscope.
    pub field_sigma_ut: f64,
    /// How long that error lasts while the body moves, seconds. Default 2. Bigger: as above.
    pub field_memory_s: f64,
    /// Weight of the field at rest, where its error lasts for ever, 0 to 1. Default 0.3. Bigger: a rest
    /// turns the heading to the field of that place sooner.
    pub rest_field_weight: f64,
    /// Error of the field at the place of the start, µT per axis. Default 1. Bigger: the heading of
    /// the start is given up sooner for that of the room.
    pub first_field_sigma_ut: f64,
    /// Wander of the Earth's field from place to place, µT per √s. Default 0.05. Bigger: strength and
    /// dip are followed sooner.
    pub field_wander_ut_rt_s: f64,
    /// Smallest horizontal field that is believed, µT. Default 1. Bigger: nearer to a magnetic pole,
    /// or inside a magnet's reach, the heading is kept steadier.
    pub horizontal_field_min_ut: f64,
    /// Uncertainty of the hard iron at the start, µT per axis. Default 0.5. Bigger: a poor calibration is
    /// mended sooner, and more of the room's field is taken for hard iron.
    pub iron_sigma_ut: f64,
    /// Random walk of the hard iron, µT per √s. Default 0.1. Bigger: as above, for ever.
    pub iron_wander_ut_rt_s: f64,
    /// Growth of the hard iron's uncertainty when the field does not fit, as a share of the misfit, per
    /// √s. Default 0.5. Bigger: a magnet on the body is learnt sooner, one in the room is too.
    pub iron_unsure_rt_s: f64,
    /// Misfit, as a multiple of `field_sigma_ut`, from which on the field counts as disturbed. Default
    /// 1.5. Bigger: weaker disturbances pass as the room's.
    pub disturbed_ratio: f64,
    /// Time constant of the running misfit, seconds. Default 1. Bigger: a disturbance is remembered longer.
    pub misfit_tau_s: f64,
}

impl Default for MekfConfig {
    fn default() -> Self {
        Self {
            block_s: 0.035,
            first_tilt_deg: 1.0,
            gyro_wander_deg_rt_s: 0.02,
            gyro_nonlinearity_rt_s: 1e-4,
            bias_sigma_deg_s: 0.5,
            bias_wander_deg_s_rt_s: 0.005,
            rest_bias_sigma_deg_s: 0.03,
            scale_sigma: 0.005,
            scale_max: 0.05,
            velocity_sigma_m_s: 0.5,
            velocity_memory_s: 1.0,
            acc_floor_m_s_rt_s: 0.02,
            acc_fault_rt_s: 0.02,
            latency_ms: 8.0,
            latency_sigma_ms: 8.0,
            latency_max_ms: 100.0,
            field_sigma_ut: 1.5,
            field_memory_s: 2.0,
            rest_field_weight: 0.3,
            first_field_sigma_ut: 1.0,
            field_wander_ut_rt_s: 0.05,
            horizontal_field_min_ut: 1.0,
            iron_sigma_ut: 0.5,
            iron_wander_ut_rt_s: 0.1,
            iron_unsure_rt_s: 0.5,
            disturbed_ratio: 1.5,
            misfit_tau_s: 1.0,
        }
    }
}
