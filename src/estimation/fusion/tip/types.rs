//! Settings, input and output of the fusion.

use crate::estimation::fusion::align::AlignConfig;
use crate::estimation::fusion::base::BaseConfig;
use crate::estimation::fusion::base_watch::WatchConfig;
use crate::estimation::fusion::bend::BendFilterConfig;
use crate::estimation::fusion::estimator::EstimatorName;
use crate::estimation::fusion::health::{HealthConfig, ImuReading};
use crate::estimation::fusion::second::SecondConfig;
use crate::model::bend::Bend;
use crate::primitives::frames::{Base, Rotation, Tip};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::Seconds;
use nalgebra::Vector3;
use serde::Deserialize;

/// Settings of alignment, estimators and sensor health.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseConfig {
    /// Estimator of the loop: `bend` (default), `madgwick`, `vqf`, `vqf-long` or `mekf`. The generic ones need the
    /// magnetometer; `bend` works without it.
    pub filter: EstimatorName,
    /// When the tip counts as still.
    pub align: AlignConfig,
    /// The bend-constrained estimator.
    pub bend: BendFilterConfig,
    /// The independent second estimator.
    pub second: SecondConfig,
    /// When a reading may be used, and the consequence of each fault.
    pub health: HealthConfig,
    /// The IMU on the base, if there is one.
    pub base: BaseConfig,
    /// Detection of base motion without a base IMU.
    pub watch: WatchConfig,
}

/// Output of the fusion.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// The pistons have stood still for a while.
    pub still: bool,
}
