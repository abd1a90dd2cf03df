//! A rig as a problem: the sets of operators that are fitted to its logs, and the features of the statements about it.
//!
//! Every operator is fitted alone, at the best η of its grid. All pairs are scored at these η and the best refitted; the best single is
//! extended by every operator anew, and so is the best pair where it leaves something.

use crate::diagnosis::rig::model::range;
use crate::diagnosis::rig::operators::{catalogue, kind};
use crate::diagnosis::rig::{
    MapBase, MapFile, Member, Operator, Regressed, Signals, Task, closed_ci95, poor, variance,
};
use crate::diagnosis::verdict::{Claim, Feature, Head};
use crate::diagnosis::{Candidates, Problem, Scored};
use std::sync::LazyLock;

/// Surcharge per effect when the best set is chosen, in the unit of a density.
const PER_EFFECT: f64 = 0.1;
/// Least ratio of a remainder to what it is compared with that counts.
const LEAST: f64 = 0.01;

/// Density that tells an effect from noise, and one that tells an effect from its form.
const SLIGHT: [f64; 2] = [0.03, 0.3];
/// Logarithm of the part of the gap that a right effect of another form may leave.
const FORM: f64 = -1.2;

/// The weights that diagnoses use.
static HEAD: LazyLock<Head> = LazyLock::new(|| Head::built_in(include_str!("posterior.toml")));

/// Part of the gap that an effect must close to be claimed.
pub const WORTH: f64 = 0.03;
/// Noise, in units of what the nominal model leaves, beyond which the log is too coarse to tell noise.
const COARSE: f64 = 1.1;
/// Least part of what the nominal model leaves that counts as the gap.
const GAP_MIN: f64 = 0.1;
/// Pairs that are fitted again.
const REFITTED: usize = 8;
/// Values of η tried between the neighbours of the best grid point.
const REFINED: u32 = 12;
/// Orders of differences from which the noise is estimated.
const ORDERS: u32 = 8;

/// A set of operators with its scores.
#[derive(Clone)]
pub struct Set {
    /// The operators, in catalogue order.
    pub members: Vec<Member>,
    /// Their names.
    pub names: Vec<&'static str>,
    /// The scores.
    pub scores: Regressed,
    /// Mean square that must be explained to be claimed.
    bar: f64,
}

impl Scored for Set {
    fn names(&self) -> &[&'static str] {
        &self.names
    }
    fn energy(&self) -> f64 {
        self.scores.energy()
    }
    fn gain(&self, beyond: &Self) -> f64 {
        (beyond.energy() - self.energy()) / self.bar
    }
}

/// Logs of one rig with everything that their sets are scored against.
pub struct RigProblem<'a> {
    /// What the columns mean.
    pub map: &'a MapFile,
    /// The logs, at least one.
    pub logs: &'a [Signals],
    /// Seed of the bootstrap.
    pub seed: u64,
    /// White noise of a row, 1 σ.
    pub noise: f64,
    /// The nominal model.
    pub nominal: Set,
    /// Mean square that it leaves above the noise.
    pub gap: f64,
    /// Whether the rows are too far apart to tell noise from signal.
    pub coarse: bool,
    /// The nominal model on the logs.
    pub base: MapBase,
    /// The outputs in blocks.
    pub task: Task,
    catalogue: Vec<Operator>,
}

impl<'a> RigProblem<'a> {
    /// The problem of logs of one rig, with the seed of the bootstrap; `None` if their inputs do not determine the nominal model.
    pub fn new(map: &'a MapFile, logs: &'a [Signals], seed: u64) -> Option<Self> {
        let task = Task::new(logs.iter().map(|log| log.output.as_slice()));
        let base = MapBase::new(map, logs)?;
        let scores = task.regress(&base.columns(&[]))?;
        let noise = noise(logs);
        let (floor, left) = (noise * noise, scores.energy());
        let coarse = floor > COARSE * left;
        let known = if coarse { 0.0 } else { floor };
        let gap = (left - known).max(GAP_MIN * left).max(1e-300);
        let nominal = Set {
            members: vec![],
            names: vec![],
            scores,
            bar: WORTH * gap,
        };
        Some(Self {
            map,
            logs,
            seed,
            noise,
            nominal,
            gap,
            coarse,
            base,
            task,
            catalogue: catalogue(map.nominal, logs[0].clocked),
        })
    }

    /// What a set leaves of each row, on the blocks in which it leaves more; NaN in their margins.
    pub fn left_out(&self, set: &Set) -> Vec<f64> {
        let columns = self.base.columns(&set.members);
        let left = self.task.left_out(&columns, set.scores.worse());
        left.unwrap_or_default()
    }

    /// The set of these members; `None` if a coefficient does not have its sign.
    fn set(&self, mut members: Vec<Member>) -> Option<Set> {
        let place = |name| self.catalogue.iter().position(|o| o.name == name);
        members.sort_by_key(|m| place(m.operator.name));
        let scores = self.task.regress(&self.base.columns(&members))?;
        Some(Set {
            names: members.iter().map(|m| m.operator.name).collect(),
            members,
            scores,
            bar: self.nominal.bar,
        })
    }

    /// `members` and the operator, at the η with the least cost.
    pub(super) fn best(&self, members: &[Member], operator: &Operator) -> Option<Set> {
        let with = |eta: f64| [&[self.base.member(operator, eta)], members].concat();
        let cost = |eta: f64| Some((self.task.cost(&self.base.columns(&with(eta)))?, eta));
        let grid = self.base.grid(operator);
        let costs = (0..grid.len()).filter_map(|k| Some((k, cost(grid[k])?)));
        let (k, best) = costs.min_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
        let (low, high) = (grid[k.saturating_sub(1)], grid[(k + 1).min(grid.len() - 1)]);
        let between = |i: u32| low + (high - low) * f64::from(i) / f64::from(REFINED);
        let near = (1..REFINED).filter(|_| high > low).map(between);
        let costs = near.filter_map(cost).chain([best]);
        let (_, eta) = costs.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let (least, found) = self.refined(with(eta))?;
        // a period has the second harmonic of its double: of two that fit the log, the shorter one is meant
        let half = found[0].eta / 2.0;
        let halved = kind(operator.name) == "period" && half >= range(&grid).0;
        let halved = halved.then(|| self.refined(with(half))).flatten();
        let fits = |(cost, _): &(f64, _)| *cost <= least * (1.0 + self.rise());
        let found = halved.filter(fits).map_or(found, |(_, halved)| halved);
        self.set(found)
    }

    /// The set and each operator that is not in it.
    fn grown(&self, set: &Set) -> Vec<Set> {
        let operators = self.catalogue.iter();
        let others = operators.filter(|o| !set.names.contains(&o.name));
        others.filter_map(|o| self.best(&set.members, o)).collect()
    }

    /// The best of all pairs, with the η of each member fitted again beside the other.
    fn refitted(&self, singles: &[Set]) -> Vec<Set> {
        let both = |k: usize| {
            let pair = move |first: &Set| {
                self.set([first.members.as_slice(), &singles[k].members].concat())
            };
            singles[..k].iter().filter_map(pair)
        };
        let mut pairs: Vec<Set> = (0..singles.len()).flat_map(both).collect();
        pairs.sort_by(|a, b| a.energy().total_cmp(&b.energy()));
        pairs.truncate(REFITTED);
        let again = |pair: Set| {
            let again = |pair: &Set, k: usize| {
                self.best(&pair.members[1 - k..2 - k], &pair.members[k].operator)
            };
            let both = again(&pair, 0).and_then(|first| again(&first, 1));
            both.unwrap_or(pair)
        };
        pairs.into_iter().map(again).collect()
    }

    /// What a set gains over the nominal model: density of the long and of the short blocks.
    fn gained(&self, set: &Set) -> [f64; 2] {
        let (reference, own) = (self.nominal.scores.density(), set.scores.density());
        [0, 1].map(|k| reference[k] - own[k])
    }

    /// Mean square that a set leaves above the noise.
    fn above(&self, set: &Set) -> f64 {
        (set.energy() - self.noise * self.noise).max(0.0)
    }

    /// Variance of the outputs, each within its log.
    pub(super) fn variance(&self) -> f64 {
        let of = |log: &Signals| variance(&log.output) * log.output.len() as f64;
        self.logs.iter().map(of).sum::<f64>() / self.task.y.len() as f64
    }

    /// The logarithm of what a set leaves above the noise over the noise.
    fn noisy(&self, set: &Set) -> f64 {
        ratio(self.above(set), self.noise * self.noise)
    }
}

impl Problem for RigProblem<'_> {
    type Set = Set;

    fn nominal(&self) -> &Set {
        &self.nominal
    }
    /// The pairs are the best of all, and the best single extended by every operator.
    fn singles_and_pairs(&self) -> [Vec<Set>; 2] {
        let mut singles = self.grown(&self.nominal);
        singles.sort_by(|a, b| a.energy().total_cmp(&b.energy()));
        let mut pairs = self.refitted(&singles);
        pairs.extend(
            singles
                .first()
                .into_iter()
                .flat_map(|best| self.grown(best)),
        );
        [singles, pairs]
    }
    fn triples(&self, pair: &Set) -> Vec<Set> {
        let further = (pair.energy() > pair.bar).then(|| self.grown(pair));
        further.unwrap_or_default()
    }
    fn parts(&self, _: &Candidates<Set>, triples: &[Set]) -> Vec<Set> {
        let mut parts = vec![];
        for set in triples {
            for k in 0..set.members.len() {
                let mut rest = set.members.clone();
                rest.remove(k);
                parts.extend(self.set(rest));
            }
        }
        parts
    }

    fn head() -> &'static Head {
        &HEAD
    }
    fn lack(&self, set: &Set) -> f64 {
        2.0 * PER_EFFECT * set.names.len() as f64 - self.gained(set).iter().sum::<f64>()
    }
    /// What a set gains over the nominal model: the density of the long and of the short blocks, and their mean up to each of `SLIGHT`.
    fn density(&self, set: &Set) -> Vec<Feature> {
        let [long, short] = self.gained(set);
        let [slight, clear] = SLIGHT.map(|most| ((long + short) / 2.0 / most).min(1.0));
        vec![
            ("density_long", long),
            ("density_short", short),
            ("slight", slight),
            ("clear", clear),
        ]
    }
    fn of_set(&self, found: &Candidates<Set>, set: &Set) -> Vec<Feature> {
        let columns: usize = set.members.iter().map(|m| m.columns.len()).sum();
        let [claim, second_claim] = found.claims(set);
        vec![
            ("further_effects", set.names.len() as f64 - 1.0),
            ("columns", columns as f64 / 8.0),
            ("claim", claim),
            ("second_claim", second_claim),
        ]
    }
    /// One, and the logarithm of what is left above the noise over the noise, the same where it is negative, and over the output.
    fn of_none(&self) -> Vec<Feature> {
        let noise = self.noisy(&self.nominal);
        let output = ratio(self.above(&self.nominal), self.variance());
        vec![
            ("none", 1.0),
            ("none_noise", noise),
            ("none_below_noise", noise.min(0.0)),
            ("none_output", output),
        ]
    }
    /// One, and the logarithm of what the best set leaves above the noise over the noise, the same where it is negative, over the gap, and the
    /// same above `FORM`.
    fn of_unknown(&self, _: &Candidates<Set>, best: &Set) -> Vec<Feature> {
        let noise = self.noisy(best);
        let left = ratio(self.above(best), self.above(&self.nominal));
        vec![
            ("unknown", 1.0),
            ("unknown_noise", noise),
            ("unknown_below_noise", noise.min(0.0)),
            ("unknown_left", left),
            ("unknown_much_left", (left - FORM).max(0.0)),
        ]
    }
    fn forms(best: &Set) -> Vec<&'static str> {
        let mut names = best.names.clone();
        names.sort_unstable();
        names
    }
    /// The effects that surely close enough of the gap. What the set leaves of the gap beyond noise is unknown in proportion.
    fn claim(&self, found: &Candidates<Set>, set: &Set) -> Claim {
        if poor(self.logs) {
            return Claim::default();
        }
        let floor = self.nominal.energy() - self.gap;
        let sure = |c: &Set, part: &Set| closed_ci95(&part.scores, &c.scores, floor, self.seed)[0];
        let kept = found.claimable(set, &|c, part| c.gain(part) >= 1.0 && sure(c, part) > 0.0);
        let above = (kept.energy() - floor).max(0.0);
        let structured = above / kept.energy().max(f64::MIN_POSITIVE);
        Claim {
            names: (!kept.names.is_empty()).then(|| kept.names.clone()),
            unexplained: (above / self.gap * structured).min(1.0),
        }
    }

    fn stand_ins(&self, found: &Candidates<Set>, names: &[&'static str]) -> Vec<&'static str> {
        let least = found.set(names).unwrap_or(&found.nominal).energy();
        let better = found.singles.iter().filter(|s| s.energy() < least);
        better.map(|s| s.names[0]).collect()
    }
}

/// Half the logarithm of a ratio of squares.
fn ratio(of: f64, to: f64) -> f64 {
    (of / to.max(f64::MIN_POSITIVE)).max(LEAST * LEAST).ln() / 2.0
}

/// White noise of a row, 1 σ. Differences of order d have `C(2d, d)` times its variance and contain less of a smooth signal
/// the higher the order; the least estimate of all orders is used.
fn noise(logs: &[Signals]) -> f64 {
    let mut left: Vec<Vec<f64>> = logs.iter().map(|log| log.output.clone()).collect();
    let (mut least, mut binomial) = (f64::INFINITY, 1.0);
    for d in 1..=ORDERS {
        for log in &mut left {
            *log = log.windows(2).map(|w| w[1] - w[0]).collect();
        }
        binomial *= f64::from(2 * (2 * d - 1)) / f64::from(d);
        let rows: usize = left.iter().map(Vec::len).sum();
        let squares = left.iter().flatten().map(|x| x * x);
        least = least.min(squares.sum::<f64>() / rows as f64 / binomial);
    }
    least.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_in_the_program_can_be_read() {
        assert!(HEAD.weight["density_short"] > 0.0 && (0.5..1.0).contains(&HEAD.conformal));
    }
}
