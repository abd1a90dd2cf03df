//! A saved model on a fresh log: whether it fits this machine, belongs to another unit, or does worse than nothing.

use crate::diagnosis::tip::fit::{CLAIM_DEG, HeldOut, LeastSquares, fit, scored};
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::{SavedGains, SavedModel};
use crate::diagnosis::{Checked, Judgement};
use crate::model::effects::catalogue;
use crate::model::{Model, NOMINAL, nominal_theta};

/// Rounds of a fit of the gains.
const ROUNDS: usize = 8;
/// Growth of the RMSE of a sensor from which a model does worse than nothing, degrees or °/s.
const WORSE_DEG: f64 = 0.1;

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
    let is_worse = e1 > e0 && after.gain(&before) >= WORSE_DEG;
    let judgement = Judgement::new(is_worse, after.gain(&refitted) / CLAIM_DEG, || {
        // without the effects, their gains fit a machine that has been mended
        let healthy = self::refitted(log, bare, &gains(&saved.with_effects));
        mended.gain(&healthy).min(before.gain(&healthy)) / CLAIM_DEG
    });
    Checked {
        judgement,
        before: log.rms_deg(e0),
        after: log.rms_deg(e1),
        refitted: log.rms_deg(refitted.energy()),
        closed: ((e0 - e1) / (e0 - log.noise_energy()).max(1e-9)).min(1.0),
        left_out: events.iter().map(|e| e.name()).collect(),
        unit: None,
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
