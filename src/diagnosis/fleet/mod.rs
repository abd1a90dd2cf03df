//! Many units: a row per diagnosed log, and what the rows of a fleet tell about its lots.

pub mod chance;
pub mod row;

pub use row::GAINS;

use crate::diagnosis::fleet::chance::{at_least, rank_z, two_sided};
use crate::diagnosis::fleet::row::FleetRow;
use crate::log::table::median;
use crate::model::effects::catalogue;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Largest corrected p-value of a finding.
const LEVEL: f64 = 0.01;
/// Fewest values on each side of a comparison.
const VALUES_MIN: usize = 8;
/// Standard deviations of a normal distribution per median absolute deviation.
const SIGMA_PER_MAD: f64 = 1.4826;

/// A difference that chance does not explain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Effect or gain.
    pub what: String,
    /// The lot that differs or drifts; `None` for a drift within all lots.
    pub lot: Option<String>,
    /// Whether it changes over time.
    pub drifts: bool,
    /// Share of logs with the effect, or median of the gain: in the lot or, of a drift, in the later half.
    pub here: f64,
    /// The same in the other lots, or in the earlier half.
    pub elsewhere: f64,
    /// Probability of such a difference by chance, corrected for the number of comparisons.
    pub p: f64,
}

/// Verdicts of a lot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lot {
    /// Name; `all` for the whole fleet.
    pub name: String,
    /// Number of diagnosed logs.
    pub logs: usize,
    /// Share of logs whose verdict names an effect, and of those with the verdict `none` or `unknown`; the largest first.
    pub shares: Vec<(String, f64)>,
}

/// A gain of the sound units, and what to expect of the next one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Sound logs.
    pub n: usize,
    /// Median.
    pub median: f64,
    /// Standard deviation of the next unit's gain. The spread of few units is itself uncertain: it is that of the paper's tip, as if
    /// [`KNOWN`] units had shown it, together with that of the fleet, and the gain follows Student's t (Gelman et al., *Bayesian Data
    /// Analysis*, 3rd ed. 2013, § 3.3).
    pub sigma: f64,
}

/// Degrees of freedom that the spread of the paper's tip counts as.
pub const KNOWN: f64 = 4.0;

impl Spread {
    /// Of these values; `usual` is the spread of the paper's tip. `None` without values.
    pub fn new(values: impl Iterator<Item = f64>, usual: f64) -> Option<Self> {
        let values: Vec<f64> = values.collect();
        let [median, seen] = spread(values.iter().copied())?;
        let n = values.len() as f64;
        let freedom = KNOWN + n - 1.0;
        let variance = (KNOWN * usual * usual + (n - 1.0) * seen * seen) / freedom;
        // the median itself is uncertain, and Student's t is wider than a normal distribution
        let sigma = (variance * (1.0 + 1.0 / n) * freedom / (freedom - 2.0)).sqrt();
        Some(Self {
            n: values.len(),
            median,
            sigma,
        })
    }
}

/// Spread of a gain over the three lines of the paper's tip: k_ε, k_λ in mm; the lag, whose prior has it, in s.
fn usual(gain: &str) -> f64 {
    match gain {
        "lag_s" => 0.015,
        name if name.starts_with("k_epsilon") => 0.18,
        _ => 0.055,
    }
}

/// What a fleet has in common and where its lots differ.
#[derive(Debug, Clone, Serialize)]
pub struct Survey {
    /// Logs that cannot be diagnosed.
    pub refused: usize,
    /// The whole fleet, then its lots.
    pub lots: Vec<Lot>,
    /// Each gain over the logs without an effect.
    pub gains: BTreeMap<String, Spread>,
    /// Differences between lots and over time, the least probable first.
    pub findings: Vec<Finding>,
}

/// What rows are compared by.
#[derive(Debug, Clone, Copy)]
enum Quantity {
    /// Whether the verdict names an effect, 0 or 1.
    Effect(&'static str),
    /// A gain of a row without an effect: an effect distorts it.
    Gain(&'static str),
}

impl Quantity {
    fn all() -> Vec<Self> {
        let effects = catalogue().iter().map(|e| Self::Effect(e.name()));
        effects.chain(GAINS.map(Self::Gain)).collect()
    }

    /// Its value; `None` if the row does not tell.
    fn of(self, row: &FleetRow) -> Option<f64> {
        match self {
            Self::Effect(name) => Some(f64::from(row.names.split('+').any(|n| n == name))),
            Self::Gain(_) if row.verdict != "none" => None,
            Self::Gain(name) => row.numbers.get(name).copied(),
        }
    }

    /// A finding; `None` if there are too few values, or if chance explains it.
    fn finding(
        self,
        (lot, drifts): (Option<&str>, bool),
        here: &[f64],
        elsewhere: &[f64],
        p: f64,
    ) -> Option<Finding> {
        let (what, middle): (_, fn(&[f64]) -> f64) = match self {
            Self::Effect(name) => (name, |side| side.iter().sum::<f64>() / side.len() as f64),
            Self::Gain(name) => (name, |side| {
                spread(side.iter().copied()).map_or(f64::NAN, |s| s[0])
            }),
        };
        let enough = here.len().min(elsewhere.len()) >= VALUES_MIN && p <= LEVEL;
        enough.then(|| Finding {
            what: what.to_owned(),
            lot: lot.map(str::to_owned),
            drifts,
            here: middle(here),
            elsewhere: middle(elsewhere),
            p,
        })
    }
}

impl Lot {
    fn new<'a>(name: &str, rows: impl Iterator<Item = &'a &'a FleetRow>) -> Self {
        let (mut logs, mut counts) = (0_usize, BTreeMap::new());
        for row in rows {
            logs += 1;
            let verdict = Some(row.verdict.as_str()).filter(|kind| *kind != "effects");
            let names = row.names.split('+').filter(|name| !name.is_empty());
            for name in names.chain(verdict) {
                *counts.entry(name.to_owned()).or_insert(0.0) += 1.0;
            }
        }
        let share = |(name, count)| (name, count / logs as f64);
        let mut shares: Vec<(String, f64)> = counts.into_iter().map(share).collect();
        shares.sort_by(|a, b| b.1.total_cmp(&a.1));
        Self {
            name: name.to_owned(),
            logs,
            shares,
        }
    }
}

impl Survey {
    /// Surveys the rows of a fleet.
    pub fn new(rows: &[FleetRow]) -> Self {
        let told: Vec<&FleetRow> = rows.iter().filter(|row| row.refused.is_empty()).collect();
        let names: BTreeSet<&str> = told.iter().map(|row| row.lot.as_str()).collect();
        let lot = |name: &&str| Lot::new(name, told.iter().filter(|row| row.lot == **name));
        let lots = [Lot::new("all", told.iter())].into_iter();
        let lots = lots.chain(names.iter().map(lot)).collect();
        let quantities = Quantity::all();
        // every lot beside the others, its drift, and the common drift, of every quantity (Bonferroni)
        let comparisons = (quantities.len() * (2 * names.len() + 1)) as f64;
        let mut findings = Vec::new();
        for q in quantities {
            findings.extend(apart(&told, q, &names, comparisons));
            let drift = |lot: Option<&str>| drifts(&told, q, lot, comparisons);
            let before = findings.len();
            findings.extend(names.iter().filter_map(|lot| drift(Some(lot))));
            if findings.len() == before {
                findings.extend(drift(None));
            }
        }
        findings.sort_by(|a, b| a.p.total_cmp(&b.p));
        let gain = |name: &&'static str| {
            let values = told.iter().filter_map(|row| Quantity::Gain(name).of(row));
            Some(((*name).to_owned(), Spread::new(values, usual(name))?))
        };
        let gains = GAINS.iter().filter_map(gain).collect();
        Self {
            refused: rows.len() - told.len(),
            lots,
            gains,
            findings,
        }
    }
}

/// The lots that differ, the clearest first. A lot that was found is left out of the comparisons of the others: beside it they
/// would differ too.
fn apart(rows: &[&FleetRow], q: Quantity, lots: &BTreeSet<&str>, comparisons: f64) -> Vec<Finding> {
    let (mut found, mut rows, mut left) = (Vec::new(), rows.to_vec(), lots.clone());
    while left.len() > 1 {
        let differ = |lot: &&str| differs(&rows, q, lot, comparisons);
        let apart = left.iter().filter_map(differ);
        let Some(finding) = apart.min_by(|a, b| a.p.total_cmp(&b.p)) else {
            break;
        };
        left.retain(|lot| finding.lot.as_deref() != Some(lot));
        rows.retain(|row| left.contains(row.lot.as_str()));
        found.push(finding);
    }
    found
}

/// Compares a lot with the others: whether it has an effect more often, or another gain.
fn differs(rows: &[&FleetRow], q: Quantity, lot: &str, comparisons: f64) -> Option<Finding> {
    let side = |inside| {
        let rows = rows.iter().filter(|row| (row.lot == lot) == inside);
        rows.filter_map(|row| q.of(row)).collect::<Vec<f64>>()
    };
    let [here, elsewhere] = [true, false].map(side);
    let p = match q {
        Quantity::Effect(_) => {
            let [hits, others] =
                [&here, &elsewhere].map(|side| side.iter().filter(|x| **x > 0.0).count());
            let all = here.len() + elsewhere.len();
            at_least(hits, here.len(), hits + others, all)
        }
        Quantity::Gain(_) => {
            let side = [vec![1.0; here.len()], vec![0.0; elsewhere.len()]].concat();
            two_sided(rank_z(&side, &[here.as_slice(), &elsewhere].concat()))
        }
    };
    q.finding((Some(lot), false), &here, &elsewhere, p * comparisons)
}

/// Compares later with earlier logs of a lot, or within every lot, so that a difference between lots is no drift.
fn drifts(rows: &[&FleetRow], q: Quantity, lot: Option<&str>, comparisons: f64) -> Option<Finding> {
    let mut lots: BTreeMap<&str, Vec<(&str, f64)>> = BTreeMap::new();
    let asked = |row: &&&FleetRow| !row.date.is_empty() && lot.is_none_or(|lot| row.lot == lot);
    for row in rows.iter().filter(asked) {
        let dated = q.of(row).map(|value| (row.date.as_str(), value));
        lots.entry(&row.lot).or_default().extend(dated);
    }
    let (mut here, mut elsewhere, mut sum) = (Vec::new(), Vec::new(), 0.0);
    for dated in lots.values_mut() {
        dated.sort_by_key(|(date, _)| *date);
        let (dates, values): (Vec<&str>, Vec<f64>) = dated.iter().copied().unzip();
        let day = |day| dates.partition_point(|other| other < day) as f64;
        let days: Vec<f64> = dates.iter().map(day).collect();
        sum += rank_z(&days, &values) * (values.len() as f64).sqrt();
        let (earlier, later) = values.split_at(values.len() / 2);
        elsewhere.extend_from_slice(earlier);
        here.extend_from_slice(later);
    }
    // a weighted sum of independent standard normal numbers (Stouffer et al. 1949)
    let z = sum / ((here.len() + elsewhere.len()).max(1) as f64).sqrt();
    q.finding((lot, true), &here, &elsewhere, two_sided(z) * comparisons)
}

/// Median and robust standard deviation.
fn spread(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let values: Vec<f64> = values.collect();
    let middle = median(values.iter().copied())?;
    let apart = values.iter().map(|x| (x - middle).abs());
    Some([middle, SIGMA_PER_MAD * median(apart)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    /// Units with a spread between a third of the usual one and three times it: the next unit lies within two σ about as often as it
    /// should, from two units on, and a spread is never zero.
    #[test]
    fn the_next_unit_lies_within_the_stated_spread() {
        let mut rng = StdRng::seed_from_u64(8);
        for n in [1, 2, 3, 6, 20] {
            let (mut within, draws) = (0, 2000);
            for _ in 0..draws {
                let sigma = 0.18 * 3f64.powf(rng.random_range(-1.0..1.0));
                let mut unit = || 2.3 + sigma * rng.sample::<f64, _>(StandardNormal);
                let values: Vec<f64> = (0..n).map(|_| unit()).collect();
                let next = unit();
                let s = Spread::new(values.into_iter(), 0.18).unwrap();
                assert!(s.sigma > 0.03 && s.n == n);
                within += usize::from((next - s.median).abs() < 2.0 * s.sigma);
            }
            let share = within as f64 / f64::from(draws);
            assert!((0.87..0.995).contains(&share), "{n}: {share}");
        }
    }
}
