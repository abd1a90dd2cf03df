//! Diagnosis of other rigs: one output, what drives it, and the effects that make sense there.
//!
//! The method is that of the whole: the nominal model first, identified on the log; every operator
//! ([`operators`]) fitted jointly with it; scored on blocks that no fit has seen ([`regress`]);
//! the smallest set that explains the log, grown forward and thinned backward; operators that do as
//! well in a member's place are said to be indistinguishable on this log.

pub mod document;
pub mod file;
pub mod model;
pub mod operators;
pub mod regress;
pub mod table;

use crate::diagnosis::map::document::{Document, Entry, Figures, Fresh, MapVerdict, Parameter};
use crate::diagnosis::map::file::{MapFile, Nominal};
use crate::diagnosis::map::model::{MapBase, Member};
use crate::diagnosis::map::operators::{DRIVEN, Operator, STILL};
use crate::diagnosis::map::regress::{Regressed, Task};
use crate::diagnosis::map::table::Signals;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Largest set.
const MEMBERS: usize = 3;
/// A member must close this part of the gap, and surely close something.
const WORTH: f64 = 0.08;
/// Sets this near in the part they close are the same on this log.
const SAME: f64 = 0.04;
/// A remainder beyond this part of the gap is unexplained …
const LEFT: f64 = 0.25;
/// … if it is also this many times the noise.
const ABOVE_NOISE: f64 = 2.0;

/// A set of operators with its scores.
#[derive(Clone)]
struct Set {
    members: Vec<Member>,
    scores: Regressed,
}

/// Diagnoses; `fresh` are other logs of the rig, on which the fitted model is tried as it is.
#[must_use]
pub fn diagnose(map: &MapFile, log: &Signals, fresh: &[(String, Signals)], seed: u64) -> Document {
    let base_fit = MapBase::new(map, log);
    let task = Task::new(&log.output);
    let catalogue = catalogue(map, log);
    let Some(nominal) = base_fit.scored(&task, log, &[], 0) else { return Document::empty(map) };
    let nominal = Set { members: vec![], scores: nominal };
    let noise = noise(&log.output);
    let gap = (nominal.scores.energy() - noise * noise).max(1e-300);
    let singles: Vec<Set> = catalogue.iter().filter_map(|o| best(&base_fit, &task, log, &[], o)).collect();
    let chosen = thinned(&base_fit, &task, log, grown(&base_fit, &task, log, &nominal, &catalogue, gap), gap);
    let equivalent = equivalent(&base_fit, &task, log, &chosen, &catalogue, gap);
    let mut effects: Vec<Entry> = singles.iter().map(|s| entry(s, &nominal, gap, seed)).collect();
    effects.sort_by(|a, b| b.closed.total_cmp(&a.closed));
    let left = (chosen.scores.energy() - noise * noise) / gap;
    let large = chosen.scores.energy().sqrt() > ABOVE_NOISE * noise;
    let kind = match (left > LEFT && large, chosen.members.is_empty()) {
        (true, _) => "unknown",
        (false, true) => "none",
        (false, false) => "effects",
    };
    let mut notes = notes(log);
    let mut refit = Vec::new();
    for (name, other) in fresh {
        match tried(&base_fit, &nominal, &chosen, name, other) {
            Some(f) => refit.push(f),
            None => notes.push(format!("{name} runs far outside what was fitted and was not tried: record both over one range")),
        }
    }
    Document {
        schema: 1,
        rig: "map",
        unit: map.output_unit.clone(),
        gap: Figures { recalibrated: nominal.scores.energy().sqrt(), explained: chosen.scores.energy().sqrt(), noise_floor: noise },
        set: (!chosen.members.is_empty()).then(|| entry(&chosen, &nominal, gap, seed)).into_iter().collect(),
        effects,
        verdict: MapVerdict { kind, names: chosen.members.iter().map(|m| m.operator.name).collect(), equivalent },
        notes,
        fresh: refit,
    }
}

/// Operators that make sense on this rig: without a clock, those that need one are tried against rows.
fn catalogue(map: &MapFile, log: &Signals) -> Vec<Operator> {
    match map.nominal {
        Nominal::Still => STILL.to_vec(),
        Nominal::Line => DRIVEN.iter().filter(|o| log.clocked || !["periodic_time"].contains(&o.name)).copied().collect(),
        Nominal::Resonance => model::RESONANT.to_vec(),
    }
}

/// `members` and the operator, at the η that leaves least of what the fits have seen.
fn best(base_fit: &MapBase, task: &Task<'_>, log: &Signals, members: &[Member], operator: &Operator) -> Option<Set> {
    let at = |eta: f64| {
        let member = Member { operator: *operator, eta, columns: (operator.columns)(&base_fit.drive, eta) };
        let all: Vec<Member> = members.iter().cloned().chain([member]).collect();
        base_fit.scored(task, log, &all, operator.sign).map(|scores| Set { members: all, scores })
    };
    let grid = (operator.grid)(&base_fit.drive);
    let found =
        grid.iter().enumerate().filter_map(|(k, &eta)| at(eta).map(|s| (k, s))).min_by(|a, b| a.1.scores.cost.total_cmp(&b.1.scores.cost));
    let (k, set) = found?;
    let (low, high) = (grid[k.saturating_sub(1)], grid[(k + 1).min(grid.len() - 1)]);
    // between the neighbours of the best, more closely
    let near = (1..12).map(|i| low + (high - low) * f64::from(i) / 12.0).filter(|_| high > low).filter_map(at);
    near.chain([set]).min_by(|a, b| a.scores.cost.total_cmp(&b.scores.cost))
}

/// Forward: the operator that closes most, while it is worth it.
fn grown(base_fit: &MapBase, task: &Task<'_>, log: &Signals, nominal: &Set, catalogue: &[Operator], gap: f64) -> Set {
    let mut set = nominal.clone();
    while set.members.len() < MEMBERS {
        let fresh = catalogue.iter().filter(|o| set.members.iter().all(|m| m.operator.name != o.name));
        let next =
            fresh.filter_map(|o| best(base_fit, task, log, &set.members, o)).min_by(|a, b| a.scores.energy().total_cmp(&b.scores.energy()));
        match next.filter(|n| pays(&set.scores, &n.scores, gap)) {
            Some(next) => set = next,
            None => break,
        }
    }
    set
}

/// Whether going from one set to a larger one is worth it, and surely so: blocks drawn with replacement.
fn pays(from: &Regressed, to: &Regressed, gap: f64) -> bool {
    from.energy() - to.energy() > WORTH * gap && interval(from, to, 0.0, 0)[0] > 0.0
}

/// Backward: members that the others have made needless go.
fn thinned(base_fit: &MapBase, task: &Task<'_>, log: &Signals, mut set: Set, gap: f64) -> Set {
    while set.members.len() > 1 {
        let without = (0..set.members.len()).filter_map(|k| {
            let mut rest = set.members.clone();
            rest.remove(k);
            base_fit.scored(task, log, &rest, 0).map(|scores| Set { members: rest, scores })
        });
        let least = without.min_by(|a, b| a.scores.energy().total_cmp(&b.scores.energy()));
        match least.filter(|l| !pays(&l.scores, &set.scores, gap)) {
            Some(less) => set = less,
            None => break,
        }
    }
    set
}

/// For each member the operators that do as well in its place.
fn equivalent(
    base_fit: &MapBase,
    task: &Task<'_>,
    log: &Signals,
    chosen: &Set,
    catalogue: &[Operator],
    gap: f64,
) -> Vec<Vec<&'static str>> {
    let mut out = Vec::new();
    for (k, member) in chosen.members.iter().enumerate() {
        let mut rest = chosen.members.clone();
        rest.remove(k);
        let others = catalogue.iter().filter(|o| chosen.members.iter().all(|m| m.operator.name != o.name));
        let as_good =
            |o: &&Operator| best(base_fit, task, log, &rest, o).is_some_and(|s| s.scores.energy() - chosen.scores.energy() < SAME * gap);
        let group: Vec<&'static str> = [member.operator.name].into_iter().chain(others.filter(as_good).map(|o| o.name)).collect();
        if group.len() > 1 {
            out.push(group);
        }
    }
    out
}

fn entry(set: &Set, nominal: &Set, gap: f64, seed: u64) -> Entry {
    let closed = ((nominal.scores.energy() - set.scores.energy()) / gap).clamp(-1.0, 1.0);
    let ci = interval(&nominal.scores, &set.scores, nominal.scores.energy() - gap, seed);
    let names: Vec<&str> = set.members.iter().map(|m| m.operator.name).collect();
    let params = set.members.iter().filter(|m| !m.operator.eta.is_empty());
    Entry {
        name: names.join(" + "),
        rmse_before: nominal.scores.energy().sqrt(),
        rmse_after: set.scores.energy().sqrt(),
        closed,
        closed_ci95: [ci[0].min(closed), ci[1].max(closed)],
        params: params.map(|m| Parameter { of: m.operator.name, name: m.operator.eta, value: m.eta }).collect(),
    }
}

/// 95 % of the closed part when blocks are drawn with replacement; `floor` is the noise's mean square.
fn interval(from: &Regressed, to: &Regressed, floor: f64, seed: u64) -> [f64; 2] {
    let mut rng = StdRng::seed_from_u64(seed);
    let n = from.blocks.len();
    let mut draws: Vec<f64> = (0..1000)
        .map(|_| {
            let (mut before, mut after, mut rows) = (0.0, 0.0, 0.0);
            for _ in 0..n {
                let i = rng.random_range(0..n);
                before += from.blocks[i].0;
                after += to.blocks[i].0;
                rows += from.blocks[i].1;
            }
            ((before - after) / (before - floor * rows).max(1e-300)).clamp(-1.0, 1.0)
        })
        .collect();
    draws.sort_by(f64::total_cmp);
    [draws[25], draws[974]]
}

/// The fitted models on a log they have not seen; only the offset is set anew.
fn tried(base_fit: &MapBase, nominal: &Set, chosen: &Set, name: &str, other: &Signals) -> Option<Fresh> {
    let rmse = |set: &Set| base_fit.rmse_on(other, &set.members, &set.scores.coefficients);
    Some(Fresh { log: name.to_owned(), before: rmse(nominal)?, after: rmse(chosen)? })
}

/// White noise of a row: differences of order d leave `C(2d, d)` times its variance and less and less of
/// a smooth signal, so the least of several orders is taken.
fn noise(y: &[f64]) -> f64 {
    let mut left = y.to_vec();
    let (mut least, mut binomial) = (f64::INFINITY, 1.0);
    for d in 1..=8 {
        left = left.windows(2).map(|w| w[1] - w[0]).collect();
        binomial *= f64::from(2 * (2 * d - 1)) / f64::from(d);
        least = least.min(left.iter().map(|x| x * x).sum::<f64>() / left.len() as f64 / binomial);
    }
    least.sqrt()
}

/// A speed counts as the only one if nine tenths of the moving time are this near to it.
const ONE_SPEED: f64 = 1.3;

/// What this log cannot show, whatever the scores say.
fn notes(log: &Signals) -> Vec<String> {
    let mut out = Vec::new();
    if !log.clocked {
        out.push("the log has no clock: what depends on time cannot be told from what depends on the path; times are in rows. Record a clock, and a second speed".to_owned());
    }
    if let Some(m) = log.motion.as_ref().filter(|_| log.clocked) {
        let step = (m.len() / 400).max(1);
        let at: Vec<(f64, f64)> = m.iter().zip(&log.t).step_by(step).map(|(m, t)| (*m, *t)).collect();
        let mut speeds: Vec<f64> = at.windows(2).map(|w| ((w[1].0 - w[0].0) / (w[1].1 - w[0].1)).abs()).collect();
        speeds.sort_by(f64::total_cmp);
        let (low, high) = (speeds[speeds.len() / 10], speeds[speeds.len() * 9 / 10]);
        if low > 0.0 && high / low < ONE_SPEED {
            out.push(format!("cannot be told apart: one speed ({high:.3} a second): what is periodic in position is periodic in time as well. Record a second speed"));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAP: &str = "input = \"u\"\noutput = \"y\"\ntime = \"t\"\n";

    /// Two speeds and several amplitudes, the output by `law`, and noise.
    fn log(law: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> Signals {
        let mut rng = StdRng::seed_from_u64(9);
        let t: Vec<f64> = (0..6000).map(|k| f64::from(k) * 0.01).collect();
        let u: Vec<f64> = t.iter().map(|t| (1.0 + (0.21 * t).sin()) * (1.3 * t + 0.9 * (0.5 * t).sin()).sin()).collect();
        let output = law(&u, &t).iter().map(|y| y + 0.01 * rng.random_range(-1.0..1.0)).collect();
        Signals { inputs: vec![u.clone()], output, motion: Some(u), t, clocked: true }
    }

    fn said(law: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> Document {
        diagnose(&toml::from_str(MAP).unwrap(), &log(law), &[], 1)
    }

    #[test]
    fn a_known_cause_is_named_and_nothing_else() {
        let d = said(|u, _| operators::play(u, 0.3).iter().map(|w| 2.0 * w + 1.0).collect());
        assert_eq!((d.verdict.kind, d.verdict.names.as_slice()), ("effects", &["play"][..]), "{:?}", d.set);
        assert!(d.set[0].closed > 0.95 && d.set[0].closed_ci95[0] > 0.9, "{:?}", d.set);
        let d = said(|u, t| u.iter().zip(t).map(|(u, t)| 3.0 * u + 0.4 * t / 60.0).collect());
        assert_eq!(d.verdict.names, ["drift"]);
        let d = said(|u, _| u.iter().map(|u| u + 0.2 * u.powi(3)).collect());
        assert_eq!(d.verdict.names, ["cubic"]);
    }

    #[test]
    fn nothing_is_claimed_where_the_line_suffices_or_no_operator_helps() {
        assert_eq!(said(|u, _| u.iter().map(|u| 3.0 * u - 1.0).collect()).verdict.kind, "none");
        let d = said(|u, t| u.iter().zip(t).map(|(u, t)| u + 0.5 * (7.0 * t * t / 30.0).sin()).collect());
        assert_eq!(d.verdict.kind, "unknown", "{:?}", d.set);
    }
}
