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

use crate::gap::map::document::{Document, Entry, Figures, Fresh, Parameter, Verdict};
use crate::gap::map::file::{MapFile, Nominal};
use crate::gap::map::model::{Ground, Member};
use crate::gap::map::operators::{DRIVEN, Operator, STILL};
use crate::gap::map::regress::{Regressed, Task};
use crate::gap::map::table::Signals;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Largest set.
const MEMBERS: usize = 3;
/// A member must close this part of the gap …
const WORTH: f64 = 0.08;
/// … by more than this many standard errors over the blocks.
const SURE: f64 = 2.0;
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
    let ground = Ground::new(map, log);
    let task = Task::new(&log.output);
    let catalogue = catalogue(map, log);
    let Some(nominal) = ground.scored(&task, log, &[], 0) else { return Document::empty(map) };
    let nominal = Set { members: vec![], scores: nominal };
    let noise = noise(&log.output);
    let gap = (nominal.scores.energy() - noise * noise).max(1e-300);
    let singles: Vec<Set> = catalogue.iter().filter_map(|o| best(&ground, &task, log, &[], o)).collect();
    let chosen = thinned(&ground, &task, log, grown(&ground, &task, log, &nominal, &catalogue, gap), gap);
    let equivalent = equivalent(&ground, &task, log, &chosen, &catalogue, gap);
    let mut effects: Vec<Entry> = singles.iter().map(|s| entry(s, &nominal, gap, seed)).collect();
    effects.sort_by(|a, b| b.closed.total_cmp(&a.closed));
    let left = (chosen.scores.energy() - noise * noise) / gap;
    let large = chosen.scores.energy().sqrt() > ABOVE_NOISE * noise;
    let kind = match (left > LEFT && large, chosen.members.is_empty()) {
        (true, _) => "unknown",
        (false, true) => "none",
        (false, false) => "effects",
    };
    let refit: Vec<Fresh> = fresh.iter().map(|(name, other)| tried(&ground, &nominal, &chosen, name, other)).collect();
    Document {
        schema: 1,
        rig: "map",
        unit: map.output_unit.clone(),
        gap: Figures { recalibrated: nominal.scores.energy().sqrt(), explained: chosen.scores.energy().sqrt(), noise_floor: noise },
        set: (!chosen.members.is_empty()).then(|| entry(&chosen, &nominal, gap, seed)).into_iter().collect(),
        effects,
        verdict: Verdict { kind, names: chosen.members.iter().map(|m| m.operator.name).collect(), equivalent },
        notes: notes(log),
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
fn best(ground: &Ground, task: &Task<'_>, log: &Signals, members: &[Member], operator: &Operator) -> Option<Set> {
    let at = |eta: f64| {
        let member = Member { operator: *operator, eta, columns: (operator.columns)(&ground.drive, eta) };
        let all: Vec<Member> = members.iter().cloned().chain([member]).collect();
        ground.scored(task, log, &all, operator.sign).map(|scores| Set { members: all, scores })
    };
    let grid = (operator.grid)(&ground.drive);
    let found =
        grid.iter().enumerate().filter_map(|(k, &eta)| at(eta).map(|s| (k, s))).min_by(|a, b| a.1.scores.cost.total_cmp(&b.1.scores.cost));
    let (k, set) = found?;
    let (low, high) = (grid[k.saturating_sub(1)], grid[(k + 1).min(grid.len() - 1)]);
    // between the neighbours of the best, more closely
    let near = (1..12).map(|i| low + (high - low) * f64::from(i) / 12.0).filter(|_| high > low).filter_map(at);
    near.chain([set]).min_by(|a, b| a.scores.cost.total_cmp(&b.scores.cost))
}

/// Forward: the operator that closes most, while it is worth it.
fn grown(ground: &Ground, task: &Task<'_>, log: &Signals, nominal: &Set, catalogue: &[Operator], gap: f64) -> Set {
    let mut set = nominal.clone();
    while set.members.len() < MEMBERS {
        let fresh = catalogue.iter().filter(|o| set.members.iter().all(|m| m.operator.name != o.name));
        let next =
            fresh.filter_map(|o| best(ground, task, log, &set.members, o)).min_by(|a, b| a.scores.energy().total_cmp(&b.scores.energy()));
        match next.filter(|n| pays(&set.scores, &n.scores, gap)) {
            Some(next) => set = next,
            None => break,
        }
    }
    set
}

/// Whether going from one set to a larger one is worth it, and surely so.
fn pays(from: &Regressed, to: &Regressed, gap: f64) -> bool {
    let gains: Vec<f64> = from.blocks.iter().zip(&to.blocks).map(|(a, b)| (a.0 - b.0) / a.1.max(1.0)).collect();
    let n = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / n;
    let error = (gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt();
    from.energy() - to.energy() > WORTH * gap && mean > SURE * error
}

/// Backward: members that the others have made needless go.
fn thinned(ground: &Ground, task: &Task<'_>, log: &Signals, mut set: Set, gap: f64) -> Set {
    while set.members.len() > 1 {
        let without = (0..set.members.len()).filter_map(|k| {
            let mut rest = set.members.clone();
            rest.remove(k);
            ground.scored(task, log, &rest, 0).map(|scores| Set { members: rest, scores })
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
fn equivalent(ground: &Ground, task: &Task<'_>, log: &Signals, chosen: &Set, catalogue: &[Operator], gap: f64) -> Vec<Vec<&'static str>> {
    let mut out = Vec::new();
    for (k, member) in chosen.members.iter().enumerate() {
        let mut rest = chosen.members.clone();
        rest.remove(k);
        let others = catalogue.iter().filter(|o| chosen.members.iter().all(|m| m.operator.name != o.name));
        let as_good =
            |o: &&Operator| best(ground, task, log, &rest, o).is_some_and(|s| s.scores.energy() - chosen.scores.energy() < SAME * gap);
        let group: Vec<&'static str> = [member.operator.name].into_iter().chain(others.filter(as_good).map(|o| o.name)).collect();
        if group.len() > 1 {
            out.push(group);
        }
    }
    out
}

fn entry(set: &Set, nominal: &Set, gap: f64, seed: u64) -> Entry {
    let closed = (nominal.scores.energy() - set.scores.energy()) / gap;
    let names: Vec<&str> = set.members.iter().map(|m| m.operator.name).collect();
    let params = set.members.iter().filter(|m| !m.operator.eta.is_empty());
    Entry {
        name: names.join(" + "),
        rmse_before: nominal.scores.energy().sqrt(),
        rmse_after: set.scores.energy().sqrt(),
        closed: closed.clamp(-1.0, 1.0),
        closed_ci95: interval(nominal, set, gap, closed, seed),
        params: params.map(|m| Parameter { of: m.operator.name, name: m.operator.eta, value: m.eta }).collect(),
    }
}

/// 95 % of the closed part when blocks are drawn with replacement.
fn interval(nominal: &Set, set: &Set, gap: f64, closed: f64, seed: u64) -> [f64; 2] {
    let mut rng = StdRng::seed_from_u64(seed);
    let n = nominal.scores.blocks.len();
    let noise = nominal.scores.energy() - gap;
    let mut draws: Vec<f64> = (0..1000)
        .map(|_| {
            let (mut before, mut after, mut rows) = (0.0, 0.0, 0.0);
            for _ in 0..n {
                let i = rng.random_range(0..n);
                before += nominal.scores.blocks[i].0;
                after += set.scores.blocks[i].0;
                rows += nominal.scores.blocks[i].1;
            }
            ((before - after) / (before - noise * rows).max(1e-300)).clamp(-1.0, 1.0)
        })
        .collect();
    draws.sort_by(f64::total_cmp);
    let closed = closed.clamp(-1.0, 1.0);
    [draws[25].min(closed), draws[974].max(closed)]
}

/// The fitted models on a log they have not seen; only the offset is set anew.
fn tried(ground: &Ground, nominal: &Set, chosen: &Set, name: &str, other: &Signals) -> Fresh {
    let rmse = |set: &Set| ground.rmse_on(other, &set.members, &set.scores.coefficients);
    Fresh { log: name.to_owned(), before: rmse(nominal), after: rmse(chosen) }
}

/// White noise of a row, from second differences (a parabola has none).
fn noise(y: &[f64]) -> f64 {
    let square: f64 = y.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).powi(2)).sum();
    (square / (6.0 * (y.len() - 2) as f64)).sqrt()
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
