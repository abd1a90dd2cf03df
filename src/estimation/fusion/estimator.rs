//! The seam of the loop: one estimator of the tip in the base, whatever is behind it.

use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::base::BaseTurn;
use crate::estimation::fusion::bend::{BendFilter, BendFilterConfig, MeasurementMask};
use crate::estimation::fusion::generic::Generic;
use crate::estimation::fusion::{FilterName, Periods};
use crate::model::bend::Bend;
use crate::primitives::frames::{Base, Rotation, Tip};
use crate::primitives::sample::ImuSample;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Estimators of the loop, by the names of the gains file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Choice {
    /// The estimator that knows the mechanism.
    #[default]
    Bend,
    /// Madgwick's, on the `ahrs` crate.
    Madgwick,
    /// VQF as published.
    Vqf,
    /// VQF that trusts the gyroscope for longer.
    VqfLong,
    /// The generic error-state filter.
    Mekf,
}

impl Choice {
    /// Every estimator of the loop.
    pub const ALL: [Self; 5] = [Self::Bend, Self::Madgwick, Self::Vqf, Self::VqfLong, Self::Mekf];

    /// The name as files write it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        self.generic().map_or("bend", FilterName::as_str)
    }
    fn generic(self) -> Option<FilterName> {
        match self {
            Self::Bend => None,
            Self::Madgwick => Some(FilterName::Madgwick),
            Self::Vqf => Some(FilterName::Vqf),
            Self::VqfLong => Some(FilterName::VqfLong),
            Self::Mekf => Some(FilterName::Mekf),
        }
    }
    /// What runs beside it: Madgwick on `ahrs`, or, beside that, the bend filter.
    #[must_use]
    pub fn second(self) -> Self {
        if self == Self::Madgwick { Self::Bend } else { Self::Madgwick }
    }
}

/// An estimator with its state.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "lives in the loop's state, which may not allocate")]
pub enum Estimator {
    /// Knows the mechanism.
    Bend(BendFilter),
    /// Does not.
    Generic(Generic),
}

impl Estimator {
    /// The chosen estimator, starting from the rest, to be called at most once in `period_s`.
    #[must_use]
    pub fn new(choice: Choice, bend: &BendFilterConfig, rest: &Alignment, period_s: f64) -> Self {
        let (imu_s, mag_s) = rest.periods_s();
        let periods = Periods { imu_s: imu_s.max(period_s), mag_s: mag_s.max(period_s).min(1.0) };
        match choice.generic() {
            None => Self::Bend(BendFilter::new(bend, rest)),
            Some(name) => Self::Generic(Generic::new(name, periods, rest)),
        }
    }

    /// Starts from a rest at which the tip was at `bend`, 1 σ `sigma_rad`; the bend filter keeps what
    /// it knows of the sensor.
    pub fn rebase(&mut self, choice: Choice, config: &BendFilterConfig, now: &Alignment, bend: Bend, sigma_rad: f64) {
        if let Self::Bend(f) = self {
            f.rebase(now, bend, sigma_rad);
            return;
        }
        *self = Self::new(choice, config, now, 0.0);
        if let Self::Generic(f) = self {
            f.assume(bend);
        }
    }

    /// One sample, `dt_s` after the last.
    pub fn update(&mut self, sample: &ImuSample, dt_s: f64, mask: MeasurementMask, base: &BaseTurn) {
        match self {
            Self::Bend(f) => f.update(sample, dt_s, mask, base),
            Self::Generic(f) => f.update(sample, dt_s, mask, base),
        }
    }

    /// Samples are missing for `gap_s`, and the rate between its ends is taken for their mean. A rate that
    /// changes by α_max at the most goes by up to `α_max gap²/4` besides: three standard deviations.
    pub fn unseen(&mut self, acceleration_max_rad_s2: f64, gap_s: f64) {
        if let Self::Bend(f) = self {
            f.unseen((acceleration_max_rad_s2 * gap_s * gap_s / 12.0).min(gap_s * DARK_RAD_S));
        }
    }

    /// The first sample after `gap_s` in which nothing could be used.
    pub fn recover(&mut self, sample: &ImuSample, gap_s: f64, mask: MeasurementMask, base: &BaseTurn) {
        match self {
            Self::Bend(f) => f.lost((gap_s * DARK_RAD_S).min(DARK_RAD)),
            Self::Generic(f) => f.relevel(sample, mask, base),
        }
    }

    /// A rate was refused that may have been true. A generic filter knows no covariance to open: it levels
    /// itself as it always does.
    pub fn may_have_leapt(&mut self) {
        if let Self::Bend(f) = self {
            f.may_have_leapt();
        }
    }
    /// True once after gravity and field have shown that the tip leapt.
    pub fn leapt(&mut self) -> bool {
        if let Self::Bend(f) = self { f.leapt() } else { false }
    }

    /// Estimated bend: the one nearest to the turn since the rest.
    #[must_use]
    pub fn bend(&self) -> Bend {
        match self {
            Self::Bend(f) => f.bend(),
            Self::Generic(f) => Bend::nearest(&f.r_base_tip()),
        }
    }
    /// Tip in the base.
    #[must_use]
    pub fn r_base_tip(&self) -> Rotation<Base, Tip> {
        match self {
            Self::Bend(f) => f.r_base_tip(),
            Self::Generic(f) => f.r_base_tip(),
        }
    }
    /// Largest standard deviation of the bend vector, rad; generic filters give none.
    #[must_use]
    pub fn sigma_rad(&self) -> Option<f64> {
        let Self::Bend(f) = self else { return None };
        let c = f.covariance();
        // largest eigenvalue of a symmetric 2 x 2
        let (mean, half) = ((c[(0, 0)] + c[(1, 1)]) / 2.0, (c[(0, 0)] - c[(1, 1)]) / 2.0);
        Some((mean + half.hypot(c[(0, 1)])).max(0.0).sqrt())
    }
    /// What the last update moved the bend by against the gyroscope, rad; zero where it is not known.
    #[must_use]
    pub fn corrected(&self) -> Vector2<f64> {
        match self {
            Self::Bend(f) => f.corrected(),
            Self::Generic(_) => Vector2::zeros(),
        }
    }
    /// The bend filter, if it is that.
    #[must_use]
    pub fn as_bend(&self) -> Option<&BendFilter> {
        if let Self::Bend(f) = self { Some(f) } else { None }
    }
    /// True unless the estimator itself calls the field disturbed.
    #[must_use]
    pub fn believes_field(&self) -> bool {
        match self {
            Self::Bend(f) => f.field_surprise() < FIELD_SURPRISE_MAX,
            Self::Generic(f) => f.flags().north_found && !f.flags().field_disturbed,
        }
    }
}

/// Surprise of the field from which the bend filter's readings count as disturbed.
const FIELD_SURPRISE_MAX: f64 = 4.0;
/// What a hand, or a piston's last push, may turn the tip by in the dark, rad/s (60 °/s), and at the most, rad.
const DARK_RAD_S: f64 = 1.0;
const DARK_RAD: f64 = 0.3;
