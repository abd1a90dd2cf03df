//! The estimator that the loop has selected, by name and by value.

use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::bend::{BendFilter, BendFilterConfig};
use crate::estimation::fusion::filter::{TipEstimator, as_trait};
use crate::estimation::fusion::generic::Generic;
use crate::estimation::fusion::registry::FilterName;
use crate::model::Bend;
use crate::primitives::{Setting, Shape};
use serde::{Deserialize, Serialize};

/// Name of the bend filter.
const BEND: &str = "bend";

/// An estimator of the loop, by its name in the gains file: `bend` or a [`FilterName`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "&'static str")]
pub enum EstimatorName {
    /// [`BendFilter`], which is constrained to the motion of the bellows.
    #[default]
    Bend,
    /// A generic orientation filter.
    Generic(FilterName),
}

impl EstimatorName {
    /// The names of all estimators of the loop.
    pub const NAMES: [&'static str; 1 + FilterName::ALL.len()] = {
        let [a, b, c, d] = FilterName::ALL;
        [BEND, a.name(), b.name(), c.name(), d.name()]
    };

    /// The independent estimator to compare with: Madgwick, or the bend filter if Madgwick is selected.
    #[must_use]
    pub fn second(self) -> Self {
        match self {
            Self::Generic(FilterName::Madgwick) => Self::Bend,
            _ => Self::Generic(FilterName::Madgwick),
        }
    }
}

impl Setting for EstimatorName {
    const SHAPE: Shape = Shape::Choice(&EstimatorName::NAMES);
}

impl TryFrom<String> for EstimatorName {
    type Error = String;
    fn try_from(name: String) -> Result<Self, String> {
        match name.parse() {
            Ok(generic) => Ok(Self::Generic(generic)),
            Err(_) if name == BEND => Ok(Self::Bend),
            Err(_) => {
                let names = Self::NAMES.join(", ");
                Err(format!(
                    "there is no estimator \"{name}\"; use one of {names}"
                ))
            }
        }
    }
}

impl From<EstimatorName> for &'static str {
    fn from(name: EstimatorName) -> Self {
        match name {
            EstimatorName::Bend => BEND,
            EstimatorName::Generic(name) => name.name(),
        }
    }
}

/// An estimator with its state; it dereferences to [`TipEstimator`].
#[derive(Debug, Clone)]
#[allow(
    clippy::large_enum_variant,
    reason = "lives in the state of the loop, which may not allocate"
)]
pub enum Estimator {
    /// The bend-constrained filter.
    Bend(BendFilter),
    /// A generic filter in the base frame.
    Generic(Generic),
}

as_trait!(Estimator { Bend, Generic }: TipEstimator);

impl Estimator {
    /// The named estimator, starting from the alignment, updated at most once in `period_s`.
    pub fn new(
        name: EstimatorName,
        bend: &BendFilterConfig,
        alignment: &Alignment,
        period_s: f64,
    ) -> Self {
        match name {
            EstimatorName::Bend => Self::Bend(BendFilter::new(bend, alignment)),
            EstimatorName::Generic(name) => {
                Self::Generic(Generic::new(name, alignment, Bend::STRAIGHT, period_s))
            }
        }
    }

    /// Restarts from an alignment during which the tip was at `bend`, 1 σ `sigma_rad`. The bend filter keeps its
    /// estimates of the sensor errors; a generic filter starts anew.
    pub fn rebase(&mut self, now: &Alignment, bend: Bend, sigma_rad: f64) {
        match self {
            Self::Bend(f) => f.rebase(now, bend, sigma_rad),
            Self::Generic(f) => f.rebase(now, bend),
        }
    }

    /// The bend filter, if it is the selected estimator.
    pub fn as_bend(&self) -> Option<&BendFilter> {
        match self {
            Self::Bend(f) => Some(f),
            Self::Generic(_) => None,
        }
    }
}
