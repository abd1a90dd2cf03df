//! What each mechanism of loop and estimate contributes: the closed loop with one of them off at a time, under every condition of the
//! sweep.

use crate::control::LoopConfig;
use crate::control::learning::schedule::HOLD_S;
use crate::estimation::fusion::estimator::EstimatorName;
use crate::estimation::fusion::registry::FilterName;
use crate::experiment::arm::{percentile, root_mean};
use crate::experiment::error::ExperimentError;
use crate::experiment::evaluation::Arm;
use crate::experiment::sweep::{Condition, Study, rows};
use rayon::prelude::*;
use serde::Serialize;

/// A mechanism and the configuration of the loop without it.
type Mechanism = (&'static str, fn(&mut LoopConfig));

/// Too small a standard deviation for anything to be learned.
const NEVER: f64 = 1e-6;
/// Too large a standard deviation for anything to be believed.
const ANY: f64 = 1e3;

/// Lists mechanisms: a name, and what switches it off in the configuration of the whole loop, of the feedback if there is
/// one, or of the bend filter.
macro_rules! mechanisms {
    ($($name:literal: $part:ident => $off:expr;)+) => {
        [$(($name, |config| mechanisms!(@$part config, $off))),+]
    };
    (@whole $config:ident, $off:expr) => { with($config, $off) };
    (@feedback $config:ident, $off:expr) => { $config.feedback.iter_mut().for_each(|f| with(f, $off)) };
    (@filter $config:ident, $off:expr) => { with(&mut $config.fuse.bend, $off) };
}

fn with<T>(part: &mut T, off: fn(&mut T)) {
    off(part);
}

/// The loop as configured, then each mechanism.
pub const MECHANISMS: [Mechanism; 27] = mechanisms! {
    "nothing": whole => |_| ();
    "online k_eps, k_lambda": whole => |c| c.refine.enabled = false;
    "learned curves": feedback => |f| f.observer.curve_sigma = 0.0;
    "learned plies": feedback => |f| f.observer.ply_sigma = 0.0;
    "learned creep": feedback => |f| f.observer.creep_sigma = 0.0;
    "learned leaks": feedback => |f| f.observer.leak_sigma_1_s = 0.0;
    "learned rotation and offset": feedback => |f| {
        (f.observer.rotation_sigma_deg, f.observer.offset_sigma_deg) = (0.0, 0.0)
    };
    "what no law explains": feedback => |f| (f.observer.residual_deg, f.ki_1_s) = (NEVER, NEVER);
    "dynamics bank": feedback => |f| f.learn_dynamics = false;
    "doubt about timing": feedback => |f| (f.observer.timing_s, f.observer.timing_share) = (0.0, 0.0);
    "periodic disturbance": feedback => |f| f.periodic.enabled = false;
    "rule for moving": feedback => |f| f.caution = 0.0;
    "free common length": feedback => |f| f.free_length_mm = 0.0;
    "slow corrections": feedback => |f| f.calm.after_s = f64::INFINITY;
    "set-point lead": feedback => |f| f.lead = 0.0;
    "obstruction": feedback => |f| f.obstruction.push_deg = f64::INFINITY;
    "base watch": whole => |c| c.fuse.watch.enabled = false;
    "bias that drifts": filter => |b| b.gyro_drift_rad_s_rts = b.gyro_walk_rad_s_rts;
    "rate that is wrong": filter => |b| b.wrong_rate_error = b.rate_error;
    "scale of the gyroscope": filter => |b| b.gyro_scale_sigma = NEVER;
    "torsion": filter => |b| (b.twist_sigma, b.twist_walk) = (NEVER, 0.0);
    "tilted chip": filter => |b| b.mount_sigma_rad = NEVER;
    "standstill": filter => |b| (b.still_rate_sigma_rad_s, b.still_twist_sigma_rad_s) = (ANY, ANY);
    "acceleration of the arc": filter => |b| (b.arc_mm, b.beyond_mm) = (0.0, 0.0);
    "magnetometer": filter => |b| b.use_mag = false;
    "bend filter (vqf)": whole => |c| c.fuse.filter = EstimatorName::Generic(FilterName::Vqf);
    "bend filter (madgwick)": whole => |c| c.fuse.filter = EstimatorName::Generic(FilterName::Madgwick);
};

/// The closed loop without one mechanism, under all conditions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AblationRow {
    /// The mechanism that is off.
    pub without: &'static str,
    /// Bend RMSE, mean over the conditions, degrees.
    pub bend_rmse_deg: f64,
    /// The RMSE without the mechanism relative to that with it, geometric mean over the conditions.
    pub ratio: f64,
    /// Median settling time to 1°, s, as in [`crate::experiment::arm::ArmResult`].
    pub settle_s_median: f64,
    /// States that do not settle.
    pub unsettled: usize,
    /// The condition that needs the mechanism most: its name, value, and ratio.
    pub needed: (&'static str, f64, f64),
}

/// One condition without a mechanism: bend RMSE, degrees, and the settling time of each state, s.
type Outcome = (f64, Vec<Option<f64>>);

/// Runs every row; `progress` is called after each unit of a condition, from several threads.
///
/// # Errors
/// [`ExperimentError`] from a plant.
pub fn run(
    study: &Study,
    mechanisms: &[Mechanism],
    conditions: &[Condition],
    progress: &(dyn Fn() + Sync),
) -> Result<Vec<AblationRow>, ExperimentError> {
    let rows = rows(conditions);
    let without = |&(_, change): &Mechanism| -> Result<Vec<Outcome>, ExperimentError> {
        let mut config = study.config.clone();
        change(&mut config);
        let outcome = |&(condition, value): &(&Condition, f64)| {
            let units = (0..study.units).map(|n| {
                let unit = study.unit_under(condition, value, n);
                let result = study.run(&config, Arm::Closed, &unit, n);
                progress();
                result
            });
            let units = units.collect::<Result<Vec<_>, _>>()?;
            let held = || units.iter().flat_map(|u| &u.held);
            let rmse_deg = root_mean(held().map(|h| h.bend_error_sq));
            Ok((rmse_deg, held().map(|h| h.settle_s).collect()))
        };
        rows.par_iter().map(outcome).collect()
    };
    let outcomes: Result<Vec<_>, _> = mechanisms.par_iter().map(without).collect();
    let outcomes = outcomes?;
    let row = |((name, _), outcome): (&Mechanism, &Vec<Outcome>)| {
        let ratios = outcome.iter().zip(&outcomes[0]);
        let ratios: Vec<f64> = ratios.map(|((off, _), (on, _))| off / on).collect();
        let most = (0..rows.len()).max_by(|&a, &b| ratios[a].total_cmp(&ratios[b]));
        let (condition, value) = rows[most.unwrap_or(0)];
        let settled = || outcome.iter().flat_map(|(_, settle_s)| settle_s);
        AblationRow {
            without: name,
            bend_rmse_deg: outcome.iter().map(|(deg, _)| deg).sum::<f64>() / rows.len() as f64,
            ratio: (ratios.iter().map(|r| r.ln()).sum::<f64>() / rows.len() as f64).exp(),
            settle_s_median: percentile(settled().map(|s| s.unwrap_or(HOLD_S)), 0.5),
            unsettled: settled().filter(|s| s.is_none()).count(),
            needed: (condition.name, value, ratios[most.unwrap_or(0)]),
        }
    };
    Ok(mechanisms.iter().zip(&outcomes).map(row).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Board, Calibration, Gains, assemble, source};

    /// A row whose switch changes nothing would say that its mechanism earns nothing.
    #[test]
    fn every_mechanism_but_the_first_is_switched_off_and_each_is_another() {
        let board: Board =
            source::parse("sim.toml", include_str!("../../boards/sim.toml")).unwrap();
        let calib: Calibration =
            source::parse("paper.toml", include_str!("../../calib/paper.toml")).unwrap();
        let whole = assemble(&board, &calib, &Gains::default());
        let mut seen: Vec<LoopConfig> = Vec::new();
        for (name, change) in MECHANISMS {
            let mut config = whole.clone();
            change(&mut config);
            assert_eq!(config == whole, name == "nothing", "{name}");
            assert!(!seen.contains(&config), "{name}");
            seen.push(config);
        }
    }
}
