//! From IMU samples to tip orientation: alignment at rest, then the estimator.

use crate::frames::{Base, Rotation, Tip};
use crate::fuse::align::{AlignConfig, AlignState, Alignment};
use crate::fuse::bend::{BendFilter, BendFilterConfig};
use crate::model::bend::Bend;
use crate::sample::ImuSample;
use serde::Deserialize;

/// Alignment and filter settings.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseConfig {
    /// When the tip counts as still.
    pub align: AlignConfig,
    /// The bend-constrained estimator.
    pub bend: BendFilterConfig,
}

/// Orientation estimation from power-up on.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "one per loop, and a box would allocate within a tick")]
pub enum Fusion {
    /// Waiting for a still tip.
    Aligning(AlignState),
    /// Aligned and running.
    Running {
        /// What the rest said.
        rest: Alignment,
        /// The estimator.
        filter: BendFilter,
    },
}

impl Default for Fusion {
    fn default() -> Self {
        Self::Aligning(AlignState::default())
    }
}

/// What fusion says after a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Felt {
    /// Tip in the base.
    pub r_base_tip: Rotation<Base, Tip>,
    /// The bend in it.
    pub bend: Bend,
    /// Largest standard deviation of the bend vector, rad.
    pub sigma_rad: f64,
}

impl Fusion {
    /// One sample, `dt_s` after the last; `still` says that the pistons have rested for a while.
    pub fn update(&mut self, config: &FuseConfig, sample: &ImuSample, dt_s: f64, still: bool) {
        match self {
            Self::Aligning(state) => {
                if let Some(rest) = state.add(&config.align, sample) {
                    *self = Self::Running { rest, filter: BendFilter::new(&config.bend, &rest) };
                }
            }
            Self::Running { filter, .. } => {
                if sample.is_finite() {
                    filter.update(sample, dt_s, still);
                }
            }
        }
    }

    /// What alignment still waits for, in words.
    #[must_use]
    pub fn waiting_for(&self) -> String {
        match self {
            Self::Aligning(state) => state.refused.map_or_else(|| "no sample came".to_owned(), |why| why.to_string()),
            Self::Running { .. } => "nothing".to_owned(),
        }
    }

    /// The felt orientation, once aligned.
    #[must_use]
    pub fn felt(&self) -> Option<Felt> {
        match self {
            Self::Aligning(_) => None,
            Self::Running { filter, .. } => {
                let c = filter.covariance();
                // largest eigenvalue of a symmetric 2 x 2
                let (mean, half) = ((c[(0, 0)] + c[(1, 1)]) / 2.0, (c[(0, 0)] - c[(1, 1)]) / 2.0);
                let sigma_rad = (mean + half.hypot(c[(0, 1)])).max(0.0).sqrt();
                Some(Felt { r_base_tip: filter.r_base_tip(), bend: filter.bend(), sigma_rad })
            }
        }
    }
}
