//! What each mechanism of the loop contributes: the closed loop with one of them off at a time.
//!
//! Every second unit has slow lines, because some mechanisms act on nothing else.

use crate::control::{FeedbackConfig, LoopConfig};
use crate::estimation::fusion::estimator::EstimatorName;
use crate::estimation::fusion::registry::FilterName;
use crate::experiment::arm::{percentile, root_mean};
use crate::experiment::evaluation::Arm;
use crate::experiment::rig::RigError;
use crate::experiment::schedule::{DIRECTIONS, HOLD_S};
use crate::experiment::sweep::Study;
use rayon::prelude::*;
use serde::Serialize;

/// Lag of the slow lines, s.
const SLOW_LAG_S: f64 = 0.25;

/// A mechanism and the configuration of the loop without it.
type Mechanism = (&'static str, fn(&mut LoopConfig));

/// The loop as configured, then each mechanism.
pub const MECHANISMS: [Mechanism; 15] = [
    ("nothing", |_| ()),
    ("online k_eps, k_lambda", |c| c.refine.enabled = false),
    ("learned curves", |c| {
        feedback(c, |f| f.observer.curve_sigma = 0.0)
    }),
    ("learned plies", |c| {
        feedback(c, |f| f.observer.ply_sigma = 0.0)
    }),
    ("learned creep", |c| {
        feedback(c, |f| f.observer.creep_sigma = 0.0)
    }),
    ("learned leaks", |c| {
        feedback(c, |f| f.observer.leak_sigma_1_s = 0.0)
    }),
    ("dynamics bank", |c| {
        feedback(c, |f| f.learn_dynamics = false)
    }),
    ("periodic disturbance", |c| {
        feedback(c, |f| f.periodic.enabled = false)
    }),
    ("rule for moving", |c| feedback(c, |f| f.caution = 0.0)),
    ("free common length", |c| {
        feedback(c, |f| f.free_length_mm = 0.0)
    }),
    ("slow corrections", |c| {
        feedback(c, |f| f.calm.after_s = f64::INFINITY)
    }),
    ("set-point lead", |c| feedback(c, |f| f.lead = 0.0)),
    ("base watch", |c| c.fuse.watch.enabled = false),
    ("bend filter (vqf)", |c| {
        c.fuse.filter = EstimatorName::Generic(FilterName::Vqf)
    }),
    ("bend filter (madgwick)", |c| {
        c.fuse.filter = EstimatorName::Generic(FilterName::Madgwick)
    }),
];

fn feedback(config: &mut LoopConfig, change: fn(&mut FeedbackConfig)) {
    config.feedback.iter_mut().for_each(change);
}

/// The closed loop without one mechanism, over all units.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AblationRow {
    /// The mechanism that is off.
    pub without: &'static str,
    /// Bend RMSE of all units, degrees.
    pub bend_rmse_deg: f64,
    /// Bend RMSE of the worst unit, degrees.
    pub worst_deg: f64,
    /// Median settling time to 1°, s, as in [`crate::experiment::arm::ArmResult`].
    pub settle_s_median: f64,
    /// 95th percentile of the settling time, s.
    pub settle_s_p95: f64,
    /// States that do not settle.
    pub unsettled: usize,
    /// Largest motion within a scored part, peak to peak, degrees.
    pub peak_to_peak_max_deg: f64,
}

/// Runs every row; `progress` is called after each unit of a row, from several threads.
///
/// # Errors
/// [`RigError`] from a plant.
pub fn run(
    study: &Study,
    mechanisms: &[Mechanism],
    progress: &(dyn Fn() + Sync),
) -> Result<Vec<AblationRow>, RigError> {
    let row = |&(without, change): &Mechanism| {
        let mut config = study.config.clone();
        change(&mut config);
        let unit = |n: u64| {
            let mut unit = study.unit(n);
            if n % 2 == 1 {
                unit.effects.line_lag.get_or_insert_default().lag_s = [SLOW_LAG_S; 3];
            }
            let result = study.run(&config, Arm::Closed, &unit, n, DIRECTIONS);
            progress();
            result
        };
        let units: Result<Vec<_>, _> = (0..study.units).into_par_iter().map(unit).collect();
        let units = units?;
        let held = || units.iter().flat_map(|u| &u.held);
        let settle = |share: f64| percentile(held().map(|h| h.settle_s.unwrap_or(HOLD_S)), share);
        let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
        Ok(AblationRow {
            without,
            bend_rmse_deg: root_mean(held().map(|h| h.bend_error_sq)),
            worst_deg: largest(&mut units.iter().map(|u| u.bend_rmse_deg)),
            settle_s_median: settle(0.5),
            settle_s_p95: settle(0.95),
            unsettled: held().filter(|h| h.settle_s.is_none()).count(),
            peak_to_peak_max_deg: largest(&mut held().map(|h| h.peak_to_peak_deg)),
        })
    };
    mechanisms.par_iter().map(row).collect()
}
