//! Diagnosis of a mapped rig.
//!
//! The nominal model is identified on the log; every operator ([`crate::diagnosis::map::operators`]) is fitted jointly with
//! it and scored on blocks that the fit has not seen ([`crate::diagnosis::map::regress`]). The smallest set that explains
//! the log is grown forward and reduced backward. Operators that do as well in place of a member are reported as
//! equivalent on this log.

use crate::diagnosis::decide::VerdictKind;
use crate::diagnosis::map::document::{Document, Entry, Figures, Fresh, MapVerdict, Parameter};
use crate::diagnosis::map::file::{MapFile, Nominal};
use crate::diagnosis::map::model::{MapBase, Member, RESONANT};
use crate::diagnosis::map::operators::{DRIVEN, Operator, STILL};
use crate::diagnosis::map::regress::{Regressed, Task};
use crate::diagnosis::map::table::Signals;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Largest set.
const MEMBERS: usize = 3;
/// Part of the gap that a member must close.
const WORTH: f64 = 0.08;
/// Sets whose closed parts differ by less are equivalent on this log.
const SAME: f64 = 0.04;
/// A remainder above this part of the gap, more than what the set explains, is unexplained if it also exceeds [`ABOVE_NOISE`]. Less may be
/// the form of the effect, which differs from rig to rig.
const LEFT: f64 = 0.5;
/// Multiple of the noise above which a remainder is unexplained.
const ABOVE_NOISE: f64 = 2.0;
/// Values of η tried between the neighbours of the best grid point.
const REFINED: u32 = 12;
/// Draws of the bootstrap.
const DRAWS: usize = 1000;
/// Orders of differences from which the noise is estimated.
const ORDERS: u32 = 8;
/// Ratio of the 90th to the 10th percentile of the speed below which a log has one speed only.
const ONE_SPEED: f64 = 1.3;
/// Samples from which the speeds are estimated.
const SPEEDS: usize = 400;

/// A set of operators with its scores.
#[derive(Clone)]
struct Set {
    members: Vec<Member>,
    scores: Regressed,
}

/// A log with everything that its sets are scored against.
struct Bench<'a> {
    base: MapBase,
    task: Task<'a>,
    catalogue: Vec<Operator>,
    nominal: Set,
    /// Mean square that the nominal model leaves above the noise.
    gap: f64,
    seed: u64,
}

/// Diagnoses a log; `fresh` are other logs of the rig, on which the fitted model is evaluated.
pub fn diagnose(map: &MapFile, log: &Signals, fresh: &[(String, Signals)], seed: u64) -> Document {
    let (base, task) = (MapBase::new(map, log), Task::new(&log.output));
    let Some(scores) = base.scored(&task, &[], 0) else { return Document::empty(map) };
    let noise = noise(&log.output);
    let floor = noise * noise;
    let gap = (scores.energy() - floor).max(1e-300);
    let bench = Bench { catalogue: catalogue(map, log), base, task, nominal: Set { members: vec![], scores }, gap, seed };
    let chosen = bench.reduced(bench.grown());
    let mut effects: Vec<Entry> = bench.catalogue.iter().filter_map(|o| bench.best(&[], o)).map(|s| bench.entry(&s)).collect();
    effects.sort_by(|a, b| b.closed.total_cmp(&a.closed));
    let mut notes = notes(log);
    let mut evaluated = Vec::new();
    for (name, other) in fresh {
        match bench.on_fresh(&chosen, name, other) {
            Some(f) => evaluated.push(f),
            None => notes.push(format!("{name} is far outside the fitted range and was not evaluated: record both over one range")),
        }
    }
    let left = (chosen.scores.energy() - floor) / gap;
    let unexplained = left > LEFT && chosen.scores.energy().sqrt() > ABOVE_NOISE * noise;
    Document {
        schema: 1,
        rig: "map",
        unit: map.output_unit.clone(),
        gap: Figures { recalibrated: bench.nominal.scores.energy().sqrt(), explained: chosen.scores.energy().sqrt(), noise_floor: noise },
        set: (!chosen.members.is_empty()).then(|| bench.entry(&chosen)).into_iter().collect(),
        effects,
        verdict: MapVerdict {
            kind: VerdictKind::new(chosen.members.is_empty(), unexplained),
            names: chosen.members.iter().map(|m| m.operator.name).collect(),
            equivalent: bench.equivalent(&chosen),
        },
        notes,
        fresh: evaluated,
    }
}

/// Operators that apply to this rig; a period in time needs a clock.
fn catalogue(map: &MapFile, log: &Signals) -> Vec<Operator> {
    match map.nominal {
        Nominal::Still => STILL.to_vec(),
        Nominal::Line => DRIVEN.iter().filter(|o| log.clocked || o.name != "periodic_time").copied().collect(),
        Nominal::Resonance => RESONANT.to_vec(),
    }
}

impl Bench<'_> {
    /// `members` and the operator, at the η with the least cost.
    fn best(&self, members: &[Member], operator: &Operator) -> Option<Set> {
        let at = |eta: f64| {
            let member = Member { operator: *operator, eta, columns: (operator.columns)(&self.base.drive, eta) };
            let members: Vec<Member> = members.iter().cloned().chain([member]).collect();
            self.base.scored(&self.task, &members, operator.sign).map(|scores| Set { members, scores })
        };
        let grid = (operator.grid)(&self.base.drive);
        let sets = grid.iter().enumerate().filter_map(|(k, &eta)| at(eta).map(|s| (k, s)));
        let (k, set) = sets.min_by(|a, b| a.1.scores.cost.total_cmp(&b.1.scores.cost))?;
        let (low, high) = (grid[k.saturating_sub(1)], grid[(k + 1).min(grid.len() - 1)]);
        let between = |i: u32| low + (high - low) * f64::from(i) / f64::from(REFINED);
        let near = (1..REFINED).map(between).filter(|_| high > low).filter_map(at);
        near.chain([set]).min_by(|a, b| a.scores.cost.total_cmp(&b.scores.cost))
    }

    /// Operators that are not in a set.
    fn others(&self, set: &Set) -> impl Iterator<Item = &Operator> {
        let names: Vec<&str> = set.members.iter().map(|m| m.operator.name).collect();
        self.catalogue.iter().filter(move |o| !names.contains(&o.name))
    }

    /// Forward: adds the operator that closes most, while it pays.
    fn grown(&self) -> Set {
        let mut set = self.nominal.clone();
        while set.members.len() < MEMBERS {
            let larger = self.others(&set).filter_map(|o| self.best(&set.members, o));
            let next = larger.min_by(|a, b| a.scores.energy().total_cmp(&b.scores.energy()));
            match next.filter(|n| self.pays(&set, n)) {
                Some(next) => set = next,
                None => break,
            }
        }
        set
    }

    /// Whether a larger set closes enough more, and certainly something.
    fn pays(&self, from: &Set, to: &Set) -> bool {
        from.scores.energy() - to.scores.energy() > WORTH * self.gap && interval(&from.scores, &to.scores, 0.0, 0)[0] > 0.0
    }

    /// Backward: removes members that the others have made unnecessary.
    fn reduced(&self, mut set: Set) -> Set {
        while set.members.len() > 1 {
            let smaller = (0..set.members.len()).filter_map(|k| {
                let members = without(&set, k);
                self.base.scored(&self.task, &members, 0).map(|scores| Set { members, scores })
            });
            let least = smaller.min_by(|a, b| a.scores.energy().total_cmp(&b.scores.energy()));
            match least.filter(|l| !self.pays(l, &set)) {
                Some(less) => set = less,
                None => break,
            }
        }
        set
    }

    /// For each member the operators that do as well in its place.
    fn equivalent(&self, chosen: &Set) -> Vec<Vec<&'static str>> {
        let group = |k: usize| {
            let rest = without(chosen, k);
            let as_good = |o: &&Operator| self.best(&rest, o).is_some_and(|s| s.scores.energy() - chosen.scores.energy() < SAME * self.gap);
            let others = self.others(chosen).filter(as_good).map(|o| o.name);
            [chosen.members[k].operator.name].into_iter().chain(others).collect::<Vec<_>>()
        };
        (0..chosen.members.len()).map(group).filter(|g| g.len() > 1).collect()
    }

    fn entry(&self, set: &Set) -> Entry {
        let (before, after) = (self.nominal.scores.energy(), set.scores.energy());
        let closed = ((before - after) / self.gap).clamp(-1.0, 1.0);
        let ci = interval(&self.nominal.scores, &set.scores, before - self.gap, self.seed);
        let names: Vec<&str> = set.members.iter().map(|m| m.operator.name).collect();
        let params = set.members.iter().filter(|m| !m.operator.eta.is_empty());
        Entry {
            name: names.join(" + "),
            rmse_before: before.sqrt(),
            rmse_after: after.sqrt(),
            closed,
            closed_ci95: [ci[0].min(closed), ci[1].max(closed)],
            params: params.map(|m| Parameter { of: m.operator.name, name: m.operator.eta, value: m.eta }).collect(),
        }
    }

    /// The fitted models on a fresh log; only the offset is set again.
    fn on_fresh(&self, chosen: &Set, name: &str, other: &Signals) -> Option<Fresh> {
        let rmse = |set: &Set| self.base.rmse_on(other, &set.members, &set.scores.coefficients);
        Some(Fresh { log: name.to_owned(), before: rmse(&self.nominal)?, after: rmse(chosen)? })
    }
}

/// The members of a set without the `k`-th.
fn without(set: &Set, k: usize) -> Vec<Member> {
    let mut members = set.members.clone();
    members.remove(k);
    members
}

/// 95 % interval of the closed part from blocks drawn with replacement; `floor` is the mean square of the noise.
fn interval(from: &Regressed, to: &Regressed, floor: f64, seed: u64) -> [f64; 2] {
    let mut rng = StdRng::seed_from_u64(seed);
    let n = from.blocks.len();
    let mut draws: Vec<f64> = (0..DRAWS)
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
    [draws[DRAWS / 40], draws[DRAWS - 1 - DRAWS / 40]]
}

/// White noise of a row, 1 σ. Differences of order d have `C(2d, d)` times its variance and contain less of a smooth signal
/// the higher the order; the least estimate of all orders is used.
fn noise(y: &[f64]) -> f64 {
    let mut left = y.to_vec();
    let (mut least, mut binomial) = (f64::INFINITY, 1.0);
    for d in 1..=ORDERS {
        left = left.windows(2).map(|w| w[1] - w[0]).collect();
        binomial *= f64::from(2 * (2 * d - 1)) / f64::from(d);
        least = least.min(left.iter().map(|x| x * x).sum::<f64>() / left.len() as f64 / binomial);
    }
    least.sqrt()
}

/// What this log cannot show, regardless of the scores.
fn notes(log: &Signals) -> Vec<String> {
    let mut out = Vec::new();
    if !log.clocked {
        out.push("the log has no clock: effects of time and effects of the path cannot be separated; times are in rows. Record a clock, and a second speed".to_owned());
    }
    if let Some(m) = log.motion.as_ref().filter(|_| log.clocked) {
        let step = (m.len() / SPEEDS).max(1);
        let at: Vec<(f64, f64)> = m.iter().zip(&log.t).step_by(step).map(|(m, t)| (*m, *t)).collect();
        let mut speeds: Vec<f64> = at.windows(2).map(|w| ((w[1].0 - w[0].0) / (w[1].1 - w[0].1)).abs()).collect();
        speeds.sort_by(f64::total_cmp);
        let (low, high) = (speeds[speeds.len() / 10], speeds[speeds.len() * 9 / 10]);
        if low > 0.0 && high / low < ONE_SPEED {
            out.push(format!("the log has one speed ({high:.3} per second): an effect that is periodic in position is periodic in time as well. Record a second speed"));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::map::operators::play;

    const MAP: &str = "input = \"u\"\noutput = \"y\"\ntime = \"t\"\n";

    /// A log with several speeds and amplitudes, its output by `law` with noise.
    fn log(law: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> Signals {
        let mut rng = StdRng::seed_from_u64(9);
        let t: Vec<f64> = (0..6000).map(|k| f64::from(k) * 0.01).collect();
        let u: Vec<f64> = t.iter().map(|t| (1.0 + (0.21 * t).sin()) * (1.3 * t + 0.9 * (0.5 * t).sin()).sin()).collect();
        let output = law(&u, &t).iter().map(|y| y + 0.01 * rng.random_range(-1.0..1.0)).collect();
        Signals { inputs: vec![u.clone()], output, motion: Some(u), t, clocked: true }
    }

    fn diagnosis(law: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> Document {
        diagnose(&toml::from_str(MAP).unwrap(), &log(law), &[], 1)
    }

    #[test]
    fn a_known_cause_is_named_and_no_other() {
        let d = diagnosis(|u, _| play(u, 0.3).iter().map(|w| 2.0 * w + 1.0).collect());
        assert_eq!((d.verdict.kind, d.verdict.names.as_slice()), (VerdictKind::Effects, &["play"][..]), "{:?}", d.set);
        assert!(d.set[0].closed > 0.95 && d.set[0].closed_ci95[0] > 0.9, "{:?}", d.set);
        let d = diagnosis(|u, t| u.iter().zip(t).map(|(u, t)| 3.0 * u + 0.4 * t / 60.0).collect());
        assert_eq!(d.verdict.names, ["drift"]);
        let d = diagnosis(|u, _| u.iter().map(|u| u + 0.2 * u.powi(3)).collect());
        assert_eq!(d.verdict.names, ["cubic"]);
    }

    #[test]
    fn no_effect_is_claimed_if_the_line_suffices_or_no_operator_helps() {
        assert_eq!(diagnosis(|u, _| u.iter().map(|u| 3.0 * u - 1.0).collect()).verdict.kind, VerdictKind::None);
        let d = diagnosis(|u, t| u.iter().zip(t).map(|(u, t)| u + 0.5 * (7.0 * t * t / 30.0).sin()).collect());
        assert_eq!(d.verdict.kind, VerdictKind::Unknown, "{:?}", d.set);
    }
}
