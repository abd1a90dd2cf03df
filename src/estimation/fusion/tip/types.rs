//! Settings, input and output of the fusion.

use crate::estimation::fusion::align::AlignConfig;
use crate::estimation::fusion::base::BaseConfig;
use crate::estimation::fusion::base_watch::WatchConfig;
use crate::estimation::fusion::bend::BendFilterConfig;
use crate::estimation::fusion::estimator::EstimatorName;
use crate::estimation::fusion::health::HealthConfig;
use crate::estimation::fusion::second::SecondConfig;
use crate::model::Bend;
use crate::parameters;
use crate::primitives::{Base, ImuReading, ImuSample, Rotation, Seconds, Tip};
use nalgebra::Vector3;

parameters! {
    /// Orientation estimation.
    pub struct FuseConfig: Copy {
        /// Estimator of the loop: `bend` uses the constraint that the tip is an arc; `madgwick`, `vqf`, `vqf-long` and `mekf`
        /// are generic filters. The generic ones need the magnetometer; `bend` can do without.
        filter: EstimatorName = EstimatorName::Bend;
        /// Alignment at start: when the tip counts as still.
        align: AlignConfig;
        /// The bend-constrained estimator.
        bend: BendFilterConfig;
        /// The second estimator.
        second: SecondConfig;
        /// Plausibility of readings, and the reaction to implausible ones.
        health: HealthConfig;
        /// The IMU on the base, where there is one.
        base: BaseConfig;
        /// Detection of base motion without a base IMU.
        watch: WatchConfig;
    }
}

/// Output of the fusion.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct TipEstimate {
    /// Tip in the base.
    pub r_base_tip: Rotation<Base, Tip>,
    /// Bend of the tip.
    pub bend: Bend,
    /// Largest standard deviation of the bend vector, rad; `None` for a filter without a covariance.
    pub sigma_rad: Option<f64>,
    /// The second estimator has disagreed for [`SecondConfig::time_s`].
    pub disagrees: bool,
    /// Angle between the two estimates, rad.
    pub disagreement_rad: f64,
}

/// Time since the last step of any motor after which the tip counts as still, s: longer than its slowest lag.
pub const STILL_AFTER_S: f64 = 0.5;

/// Input of the fusion at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FusionInput {
    /// Time of the tick, on the clock of the sample stamps.
    pub now: Seconds,
    /// Reading of the tip's IMU.
    pub tip: ImuReading,
    /// Sample of the base's IMU, if there is one.
    pub base: Option<ImuSample>,
    /// Field of the motor coils in the base frame, µT; zero where it is not known.
    pub coils_ut: Vector3<f64>,
    /// The pistons have stood still for [`STILL_AFTER_S`].
    pub still: bool,
}
