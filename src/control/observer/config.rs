//! Settings of the observer.

use super::laws::{self, Theta};
use crate::parameters;

parameters! {
    /// What the observer expects of a tip before any motion, and how fast it may change.
    pub struct ObserverConfig: Copy {
        /// Standard deviation of a line's gain. A larger value learns the gain from fewer poses, and a disturbance as well.
        gain_sigma: f64 = 0.2, "", 0.0..=2.0, "0.2 covers the spread between units";
        /// Factor on the standard deviations that the calibration states for k_ε and k_λ, with which the loop starts, at most `gain_sigma` and
        /// `play_sigma_mm`. A larger value trusts the calibration less.
        calibration: f64 = 4.0, "", 0.01..=100.0, "4, because the gains take more than the calibration measured: temperature, load and what no law explains";
        /// Standard deviation of the curves of a channel, per rad and per rad². A larger value bends the map for less evidence.
        curve_sigma: f64 = 0.1, "", 0.0..=2.0, "0.1 is a tenth of the gain at one rad";
        /// Standard deviation of the half-width of the backlash. A larger value trusts the calibrated backlash less, and moves less often.
        play_sigma_mm: f64 = 0.25, "mm", 0.0..=2.0, "0.25 is the spread between lines";
        /// Standard deviation of the stiffness of each rubber ply. A larger value explains more by hysteresis.
        ply_sigma: f64 = 0.08, "", 0.0..=1.0, "0.08 is a hysteresis of some degrees";
        /// Standard deviation of each creeping share. A larger value explains more of a slow change by creep.
        creep_sigma: f64 = 0.05, "", 0.0..=1.0, "0.05 is rubber";
        /// Standard deviation of a line's leak. A larger value explains more of a slow change by a leak.
        leak_sigma_1_s: f64 = 0.003, "1/s", 0.0..=1.0, "0.003 loses a sixth in a minute";
        /// Standard deviation of a rotation of the bend plane. A larger value explains more by a turned tip.
        rotation_sigma_deg: f64 = 3.0, "deg", 0.0..=45.0, "3 is a tip mounted by hand";
        /// Standard deviation of a constant offset. A larger value explains more by a shifted zero.
        offset_sigma_deg: f64 = 1.7, "deg", 0.0..=45.0, "1.7 is a drift of the zero";
        /// Time of motion in which gains and curves become unknown again. A larger value remembers longer and follows a change later.
        memory_s: f64 = 60.0, "s", 1.0..=1e6, "60 is some eighty poses";
        /// The same for plays, plies, creep and leaks.
        constants_memory_s: f64 = 300.0, "s", 1.0..=1e6, "300: they change with wear";
        /// The same for the offset, at rest as well.
        offset_memory_s: f64 = 20.0, "s", 0.1..=1e6, "20: it drifts";
        /// Standard deviation of the unexplained bend g. A larger value follows the estimate more and the laws less.
        residual_deg: f64 = 0.7, "deg", 0.01..=30.0, "0.7 is what a learned map leaves";
        /// Path of the tip over which g changes. A larger value carries the correction of one pose further to the next.
        residual_path_deg: f64 = 15.0, "deg", 0.1..=360.0, "15 is the distance of two poses";
        /// Noise of the estimated bend per 10 ms, the least that is assumed. A larger value reacts later.
        noise_deg: f64 = 0.086, "deg", 0.001..=10.0, "0.086 is a quiet IMU";
        /// Error of the timing of the prediction: a constant. A larger value learns less during motion.
        timing_s: f64 = 0.01, "s", 0.0..=1.0, "0.01 is a few samples";
        /// The same as a share of lag plus dead time.
        timing_share: f64 = 0.05, "", 0.0..=1.0, "0.05: a line is no first-order lag";
        /// Time by which a residual that still changes may be off. A larger value waits longer for a pose to settle.
        unsettled_s: f64 = 0.02, "s", 0.0..=10.0, "0.02 waits for what is slower than the lag";
    }
}

/// Standard deviations of the parameters before any motion.
pub(super) fn standard_deviations(config: &ObserverConfig, fixed: bool) -> Theta {
    let mut sigma = Theta::zeros();
    let of_lines = if fixed { 0.0 } else { 1.0 };
    for (first, count, value) in [
        (laws::GAIN, 3, config.gain_sigma * of_lines),
        (laws::EVEN, 3, config.curve_sigma),
        (laws::ODD, 3, config.curve_sigma),
        (laws::PLAY, 3, config.play_sigma_mm * of_lines),
        (laws::PLY, laws::PLIES, config.ply_sigma),
        (laws::CREEP, laws::CREEPS, config.creep_sigma),
        (laws::LEAK, 3, config.leak_sigma_1_s),
        (laws::ROTATION, 1, config.rotation_sigma_deg.to_radians()),
        (laws::OFFSET, 2, config.offset_sigma_deg.to_radians()),
    ] {
        sigma.rows_mut(first, count).fill(value);
    }
    sigma
}
