//! A saved model on a fresh log: whether it fits this machine, belongs to another unit, or does worse than nothing.

use crate::diagnosis::tip::fit::{CLAIM_DEG, HeldOut, LeastSquares, fit, scored};
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::{SavedGains, SavedModel};
use crate::model::effects::catalogue;
use crate::model::{Model, NOMINAL, nominal_theta};
use crate::named;
use serde::Serialize;

/// Rounds of a fit of the gains.
const ROUNDS: usize = 8;
/// Growth of the RMSE of a sensor from which a model does worse than nothing, degrees or °/s.
const WORSE_DEG: f64 = 0.1;

named! {
    /// What a check finds.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
    pub enum Judgement {
        /// The model fits the machine of the log.
        #[serde(rename = "this machine")]
        ThisMachine = "this machine",
        /// Other gains fit the log better: it is of another unit.
        #[serde(rename = "another unit")]
        AnotherUnit = "another unit",
        /// The log has less error without the effects of the model.
        #[serde(rename = "worse than nothing")]
        WorseThanNothing = "worse than nothing",
    }
}

/// Result of a check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Checked {
    /// What the figures mean.
    pub judgement: Judgement,
    /// RMSE of the recalibrated nominal model, degrees.
    pub before_deg: f64,
    /// RMSE with the effects, degrees.
    pub after_deg: f64,
    /// RMSE with the effects and with gains that are identified on this log, degrees.
    pub refitted_deg: f64,
    /// Part of the gap that the effects close.
    pub closed: f64,
    /// Effects that are left out, because they happen once and not again on a fresh log.
    pub left_out: Vec<&'static str>,
}

/// Runs both models over a fresh log. Only gravity, field and gyroscope bias (base frame and references) are solved again. Effects that
/// happen once are left out.
pub fn check(saved: &SavedModel, log: &Observed) -> Checked {
    let gains = |g: &SavedGains| nominal_theta(&g.lines(), g.lag_s);
    let names: Vec<&str> = saved.effect.iter().map(|e| e.name.as_str()).collect();
    let effects = Model::named(catalogue(), &names).effects.into_iter();
    let (events, lasting): (Vec<_>, Vec<_>) = effects.partition(|e| e.info().is_event());
    let (bare, with) = (Model::new(&[]), Model::new(&lasting));
    let mut theta = gains(&saved.with_effects);
    theta.extend(lasting.iter().filter_map(|e| saved.params_of(*e)).flatten());
    let before = scored(log, &bare, &gains(&saved.nominal));
    let after = scored(log, &with, &theta);
    let mended = scored(log, &bare, &gains(&saved.with_effects));
    let refitted = refitted(log, with, &theta);
    let [e0, e1] = [&before, &after].map(HeldOut::energy);
    let judgement = if e1 <= e0 || after.gain(&before) < WORSE_DEG {
        match after.gain(&refitted) >= CLAIM_DEG {
            true => Judgement::AnotherUnit,
            false => Judgement::ThisMachine,
        }
    } else {
        // without the effects, their gains fit a machine that has been mended
        let healthy = self::refitted(log, bare, &gains(&saved.with_effects));
        match mended.gain(&healthy).min(before.gain(&healthy)) >= CLAIM_DEG {
            true => Judgement::AnotherUnit,
            false => Judgement::WorseThanNothing,
        }
    };
    Checked {
        judgement,
        before_deg: log.rms_deg(e0),
        after_deg: log.rms_deg(e1),
        refitted_deg: log.rms_deg(refitted.energy()),
        closed: ((e0 - e1) / (e0 - log.noise_energy()).max(1e-9)).min(1.0),
        left_out: events.iter().map(|e| e.name()).collect(),
    }
}

/// Scores of the model with gains that are identified on the log, while the effects stay.
fn refitted(log: &Observed, model: Model, theta: &[f64]) -> HeldOut {
    let mut problem = LeastSquares::new(log, model);
    for (bound, value) in problem.bounds.iter_mut().zip(theta).skip(NOMINAL) {
        (bound.low, bound.high, bound.start) = (*value, *value, *value);
    }
    let fit = fit(problem, theta, ROUNDS);
    scored(log, &fit.problem.model, &fit.point.theta)
}
