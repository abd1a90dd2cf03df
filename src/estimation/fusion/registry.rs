//! The generic orientation filters by name: the only place that lists them.
//!
//! | name | filter | purpose |
//! |---|---|---|
//! | `madgwick` | gradient descent (Madgwick 2010) on the `ahrs` crate, with bias, gate and levelled inputs | the least arithmetic |
//! | `vqf` | Laidig & Seel 2023 as published, on the `vqf-rs` crate | the reference |
//! | `vqf-long` | the same with a longer magnetometer time constant | rooms with iron |
//! | `mekf` | error-state Kalman filter that also estimates gyroscope scale, hard iron and magnetometer latency | the most accurate |
//!
//! A new filter needs its own file, a line in `fusion/mod.rs` and its entries in [`FilterName`] and [`Filter`].

use crate::estimation::fusion::filter::{OrientationFilter, Periods, as_trait};
use crate::estimation::fusion::madgwick::Madgwick;
use crate::estimation::fusion::mekf::{Mekf, MekfConfig};
use crate::estimation::fusion::vqf::{TAU_MAG_LONG_S, TAU_MAG_S, Vqf};
use crate::named;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

named! {
    /// A filter with its shipped settings, by the name that files and the command line use.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum FilterName {
        /// [`Madgwick`] with its default settings.
        Madgwick = "madgwick",
        /// [`Vqf`] with the settings of its authors.
        Vqf = "vqf",
        /// [`Vqf`] with the magnetometer time constant [`super::vqf::TAU_MAG_LONG_S`].
        VqfLong = "vqf-long",
        /// [`Mekf`] with its default settings.
        Mekf = "mekf",
    }
}

impl FilterName {
    /// A new filter with its shipped settings.
    pub fn build(self, periods: Periods) -> Filter {
        match self {
            Self::Madgwick => Filter::Madgwick(Madgwick::default()),
            Self::Vqf => Filter::Vqf(Vqf::new(periods, TAU_MAG_S)),
            Self::VqfLong => Filter::Vqf(Vqf::new(periods, TAU_MAG_LONG_S)),
            Self::Mekf => Filter::Mekf(Mekf::new(MekfConfig::default())),
        }
    }
}

/// A filter by value; it dereferences to [`OrientationFilter`].
#[derive(Debug, Clone)]
#[allow(
    clippy::large_enum_variant,
    reason = "lives in the state of the loop, which may not allocate"
)]
pub enum Filter {
    /// Gradient descent.
    Madgwick(Madgwick),
    /// VQF, with any time constants.
    Vqf(Vqf),
    /// Error-state Kalman filter.
    Mekf(Mekf),
}

as_trait!(Filter { Madgwick, Vqf, Mekf }: OrientationFilter);

impl FromStr for FilterName {
    type Err = String;
    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|f| f.name() == name);
        found.ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("there is no filter \"{name}\"; use one of {names}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_unknown_names_are_refused() {
        for f in FilterName::ALL {
            assert_eq!(f.name().parse(), Ok(f));
            assert_eq!(serde_json::to_string(&f).unwrap(), format!("\"{f}\""));
        }
        assert!(
            "kalman"
                .parse::<FilterName>()
                .unwrap_err()
                .to_string()
                .contains("madgwick, vqf, vqf-long, mekf")
        );
    }
}
