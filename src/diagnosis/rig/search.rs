//! Which set of operators explains the log of a rig.
//!
//! Every operator is fitted alone, at the best η of its grid. All pairs are scored at these η and the best refitted; the best single is
//! extended by every operator anew, and so is the best pair where it leaves something.

use crate::diagnosis::candidates::{Candidates, Scored, sort_by_energy};
use crate::diagnosis::rig::model::{MapBase, Member};
use crate::diagnosis::rig::operators::Operator;
use crate::diagnosis::rig::regress::{Regressed, Task};

/// Part of the gap that an effect must close to be claimed.
const WORTH: f64 = 0.03;
/// Noise, in units of what the nominal model leaves, beyond which the log is too coarse to tell noise.
const COARSE: f64 = 1.1;
/// Least part of what the nominal model leaves that counts as the gap.
const GAP_MIN: f64 = 0.1;
/// Pairs that are fitted again.
const REFITTED: usize = 8;
/// Values of η tried between the neighbours of the best grid point.
const REFINED: u32 = 12;

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

/// A log with everything that its sets are scored against.
pub struct Bench<'a> {
    /// The nominal model.
    pub base: MapBase,
    task: Task<'a>,
    catalogue: Vec<Operator>,
    /// Mean square that the nominal model leaves above the noise.
    pub gap: f64,
    /// Whether the rows are too far apart to tell noise from signal.
    pub coarse: bool,
}

impl<'a> Bench<'a> {
    /// The bench of a signal whose noise has the variance `floor`, with the scores of the nominal model; `None` if the inputs do not
    /// determine it.
    pub fn new(
        base: MapBase,
        y: &'a [f64],
        catalogue: Vec<Operator>,
        floor: f64,
    ) -> Option<(Self, Regressed)> {
        let task = Task::new(y);
        let nominal = base.scored(&task, &[])?;
        let coarse = floor > COARSE * nominal.energy();
        let noise = if coarse { 0.0 } else { floor };
        let gap = (nominal.energy() - noise)
            .max(GAP_MIN * nominal.energy())
            .max(1e-300);
        Some((
            Self {
                base,
                task,
                catalogue,
                gap,
                coarse,
            },
            nominal,
        ))
    }

    /// Runs the search.
    pub fn search(&self, nominal: Regressed) -> Candidates<Set> {
        let nominal = Set {
            members: vec![],
            names: vec![],
            scores: nominal,
            bar: self.bar(),
        };
        let mut found = Candidates {
            nominal,
            singles: self
                .catalogue
                .iter()
                .filter_map(|o| self.best(&[], o))
                .collect(),
            larger: vec![],
        };
        sort_by_energy(&mut found.singles);
        if let Some(best) = found.singles.first().map(|s| s.members.clone()) {
            let pairs = self
                .pairs(&found.singles)
                .into_iter()
                .chain(self.grown(&best))
                .collect();
            add(&mut found, pairs);
        }
        if let Some(best) = found
            .larger
            .first()
            .filter(|pair| pair.energy() > self.bar())
            .map(|pair| pair.members.clone())
        {
            let triples = self.grown(&best);
            let parts = triples
                .iter()
                .flat_map(|t| (0..t.members.len()).map(|k| without(&t.members, k)))
                .filter_map(|m| self.set(m))
                .collect();
            add(&mut found, triples);
            add(&mut found, parts);
        }
        found
    }

    fn bar(&self) -> f64 {
        WORTH * self.gap
    }

    /// The set of these members; `None` if a coefficient does not have its sign.
    fn set(&self, mut members: Vec<Member>) -> Option<Set> {
        let place = |m: &Member| {
            self.catalogue
                .iter()
                .position(|o| o.name == m.operator.name)
        };
        members.sort_by_key(place);
        let scores = self.base.scored(&self.task, &members)?;
        Some(Set {
            names: members.iter().map(|m| m.operator.name).collect(),
            members,
            scores,
            bar: self.bar(),
        })
    }

    /// `members` and the operator, at the η with the least cost.
    fn best(&self, members: &[Member], operator: &Operator) -> Option<Set> {
        let with = |eta: f64| {
            let member = Member {
                operator: *operator,
                eta,
                columns: (operator.columns)(&self.base.drive, eta),
            };
            members
                .iter()
                .cloned()
                .chain([member])
                .collect::<Vec<Member>>()
        };
        let cost = |eta: f64| {
            self.base
                .cost(&self.task, &with(eta))
                .map(|cost| (cost, eta))
        };
        let grid = (operator.grid)(&self.base.drive);
        let costs = grid
            .iter()
            .enumerate()
            .filter_map(|(k, &eta)| cost(eta).map(|c| (k, c)));
        let (k, best) = costs.min_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
        let (low, high) = (grid[k.saturating_sub(1)], grid[(k + 1).min(grid.len() - 1)]);
        let between = |i: u32| low + (high - low) * f64::from(i) / f64::from(REFINED);
        let near = (1..REFINED)
            .map(between)
            .filter(|_| high > low)
            .filter_map(cost);
        let (_, eta) = near.chain([best]).min_by(|a, b| a.0.total_cmp(&b.0))?;
        self.set(with(eta))
    }

    /// The members and each operator that is not among them.
    fn grown(&self, members: &[Member]) -> Vec<Set> {
        let others = self
            .catalogue
            .iter()
            .filter(|o| members.iter().all(|m| m.operator.name != o.name));
        others.filter_map(|o| self.best(members, o)).collect()
    }

    /// The best of all pairs, with the η of each member fitted again beside the other.
    fn pairs(&self, singles: &[Set]) -> Vec<Set> {
        let both = |k: usize| {
            singles[..k]
                .iter()
                .filter_map(move |a| self.set([a.members.as_slice(), &singles[k].members].concat()))
        };
        let mut pairs: Vec<Set> = (0..singles.len()).flat_map(both).collect();
        sort_by_energy(&mut pairs);
        pairs.truncate(REFITTED);
        let again = |pair: Set| {
            let again = |pair: &Set, k: usize| {
                self.best(&pair.members[1 - k..2 - k], &pair.members[k].operator)
            };
            again(&pair, 0)
                .and_then(|first| again(&first, 1))
                .unwrap_or(pair)
        };
        pairs.into_iter().map(again).collect()
    }
}

/// Adds sets; of those with the same operators the better one stays.
fn add(found: &mut Candidates<Set>, sets: Vec<Set>) {
    for set in sets.into_iter().filter(|s| s.members.len() > 1) {
        match found
            .larger
            .iter_mut()
            .find(|known| known.names == set.names)
        {
            Some(known) if known.energy() <= set.energy() => {}
            Some(known) => *known = set,
            None => found.larger.push(set),
        }
    }
    sort_by_energy(&mut found.larger);
}

/// Members without the `k`-th.
fn without(members: &[Member], k: usize) -> Vec<Member> {
    let mut rest = members.to_vec();
    rest.remove(k);
    rest
}
