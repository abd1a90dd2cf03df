//! What a saved model on a fresh log shows: whether it fits this machine, belongs to another unit, or does worse than nothing.

use crate::named;

named! {
    /// What a check finds.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Judgement {
        /// The model fits the machine of the log.
        ThisMachine = "this machine",
        /// Other gains or, of a mapped rig, effects of another size fit the log better: it is of another unit.
        AnotherUnit = "another unit",
        /// The log has less error without the effects of the model.
        WorseThanNothing = "worse than nothing",
    }
}

impl Judgement {
    /// The judgement from what is explained beyond the model by what is identified on the log, in units of the least that is claimed:
    /// `refitted` by gains and, of a mapped rig, effects, or, if the effects make the model worse, `healthy` by gains without them.
    pub fn new(is_worse: bool, refitted: f64, healthy: impl FnOnce() -> f64) -> Self {
        let (gained, otherwise) = if is_worse {
            (healthy(), Self::WorseThanNothing)
        } else {
            (refitted, Self::ThisMachine)
        };
        if gained >= 1.0 {
            Self::AnotherUnit
        } else {
            otherwise
        }
    }
}

/// Result of a check. Errors are RMSE in the unit, or in degrees without one.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    /// What the figures mean.
    pub judgement: Judgement,
    /// Error of the recalibrated nominal model.
    pub before: f64,
    /// Error with the effects.
    pub after: f64,
    /// Error with gains, and for a mapped rig sizes of the effects, that are identified on this log.
    pub refitted: f64,
    /// Part of the gap that the effects close.
    pub closed: f64,
    /// Effects that are left out, because they happen once and not again on a fresh log.
    pub left_out: Vec<&'static str>,
    /// Unit of the output of a mapped rig.
    pub unit: Option<String>,
}
