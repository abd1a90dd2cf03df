//! Many units: a row per diagnosed log, and what the rows of a fleet tell about its lots.

pub mod chance;
pub mod row;

use crate::diagnosis::fleet::chance::{at_least, correct, rank_z, two_sided};
use crate::diagnosis::fleet::row::{GAINS, Row};
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
    /// The lot that differs from the others; `None` for a drift over time within the lots.
    pub lot: Option<String>,
    /// Share of logs with the effect, or median of the gain: in the lot, or in the later half of every lot.
    pub here: f64,
    /// The same in the other lots, or in the earlier half of every lot.
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

/// What a fleet has in common and where its lots differ.
#[derive(Debug, Clone, Serialize)]
pub struct Survey {
    /// Logs that cannot be diagnosed.
    pub refused: usize,
    /// The whole fleet, then its lots.
    pub lots: Vec<Lot>,
    /// Median and robust standard deviation of each gain over the logs without an effect.
    pub gains: BTreeMap<String, [f64; 2]>,
    /// Differences between lots and over time, the least probable first.
    pub findings: Vec<Finding>,
}

/// An effect or a gain with its value by row; `None` where a row does not tell.
struct Quantity {
    name: &'static str,
    values: Vec<Option<f64>>,
}

impl Lot {
    fn new<'a>(name: &str, rows: impl Iterator<Item = &'a Row>) -> Self {
        let (mut logs, mut counts) = (0_usize, BTreeMap::new());
        for row in rows {
            logs += 1;
            let verdict = [row.verdict.as_str()].into_iter().filter(|kind| *kind != "effects");
            for name in row.names.split('+').filter(|name| !name.is_empty()).chain(verdict) {
                *counts.entry(name.to_owned()).or_insert(0.0) += 1.0;
            }
        }
        let mut shares: Vec<(String, f64)> = counts.into_iter().map(|(name, count)| (name, count / logs as f64)).collect();
        shares.sort_by(|a, b| b.1.total_cmp(&a.1));
        Self { name: name.to_owned(), logs, shares }
    }
}

impl Survey {
    /// Surveys the rows of a fleet.
    pub fn new(rows: &[Row]) -> Self {
        let told: Vec<&Row> = rows.iter().filter(|row| row.refused.is_empty()).collect();
        let names: BTreeSet<&str> = told.iter().map(|row| row.lot.as_str()).collect();
        let mut lots = vec![Lot::new("all", told.iter().copied())];
        lots.extend(names.iter().map(|name| Lot::new(name, told.iter().copied().filter(|row| row.lot == *name))));
        let gains = gains(&told);
        let mut findings = Vec::new();
        for q in effects(&told).iter().chain(&gains) {
            findings.extend(names.iter().filter_map(|lot| differs(&told, q, lot)).chain(drifts(&told, q)));
        }
        correct(&mut findings, |f| &mut f.p);
        findings.retain(|f| f.p <= LEVEL);
        findings.sort_by(|a, b| a.p.total_cmp(&b.p));
        let gains = gains.iter().filter_map(|q| Some((q.name.to_owned(), spread(q.values.iter().flatten().copied())?))).collect();
        Self { refused: rows.len() - told.len(), lots, gains, findings }
    }
}

/// Whether the verdict of a row names an effect, as 0 or 1.
fn effects(rows: &[&Row]) -> Vec<Quantity> {
    let names = catalogue().into_iter().map(|e| e.name());
    let has = |row: &Row, name| f64::from(u8::from(row.names.split('+').any(|n| n == name)));
    names.map(|name| Quantity { name, values: rows.iter().map(|row| Some(has(row, name))).collect() }).collect()
}

/// Gains of the rows without an effect: an effect distorts them.
fn gains(rows: &[&Row]) -> Vec<Quantity> {
    let value = |row: &Row, name| row.numbers.get(name).copied().filter(|_| row.verdict == "none");
    GAINS.iter().map(|name| Quantity { name, values: rows.iter().map(|row| value(row, *name)).collect() }).collect()
}

impl Quantity {
    /// Rows that tell the value, with it.
    fn told<'a>(&'a self, rows: &'a [&'a Row]) -> impl Iterator<Item = (&'a Row, f64)> {
        rows.iter().zip(&self.values).filter_map(|(row, value)| Some((*row, (*value)?)))
    }

    /// A finding; `None` if there are too few values.
    fn finding(&self, lot: Option<&str>, here: &[f64], elsewhere: &[f64], p: f64) -> Option<Finding> {
        let middle = |side: &[f64]| match GAINS.contains(&self.name) {
            true => spread(side.iter().copied()).map_or(f64::NAN, |s| s[0]),
            false => side.iter().sum::<f64>() / side.len().max(1) as f64,
        };
        let enough = here.len().min(elsewhere.len()) >= VALUES_MIN;
        let (what, lot) = (self.name.to_owned(), lot.map(str::to_owned));
        enough.then(|| Finding { what, lot, here: middle(here), elsewhere: middle(elsewhere), p })
    }
}

/// Compares a lot with the others: whether it has an effect more often, or another gain.
fn differs(rows: &[&Row], q: &Quantity, lot: &str) -> Option<Finding> {
    let (inside, outside): (Vec<_>, Vec<_>) = q.told(rows).partition(|(row, _)| row.lot == lot);
    let [here, elsewhere] = [inside, outside].map(|side| side.into_iter().map(|(_, value)| value).collect::<Vec<f64>>());
    let p = if GAINS.contains(&q.name) {
        let side: Vec<f64> = here.iter().map(|_| 1.0).chain(elsewhere.iter().map(|_| 0.0)).collect();
        two_sided(rank_z(&side, &[here.as_slice(), &elsewhere].concat()))
    } else {
        let hits = |side: &[f64]| side.iter().filter(|x| **x > 0.0).count();
        at_least(hits(&here), here.len(), hits(&here) + hits(&elsewhere), here.len() + elsewhere.len())
    };
    q.finding(Some(lot), &here, &elsewhere, p)
}

/// Compares later with earlier logs within every lot, so that a difference between lots is no drift.
fn drifts(rows: &[&Row], q: &Quantity) -> Option<Finding> {
    let mut lots: BTreeMap<&str, Vec<(&str, f64)>> = BTreeMap::new();
    for (row, value) in q.told(rows).filter(|(row, _)| !row.date.is_empty()) {
        lots.entry(&row.lot).or_default().push((&row.date, value));
    }
    let (mut here, mut elsewhere, mut sum) = (Vec::new(), Vec::new(), 0.0);
    for dated in lots.values_mut() {
        dated.sort_by_key(|(date, _)| *date);
        let (dates, values): (Vec<&str>, Vec<f64>) = dated.iter().copied().unzip();
        let days: Vec<f64> = dates.iter().map(|day| dates.partition_point(|other| other < day) as f64).collect();
        sum += rank_z(&days, &values) * (values.len() as f64).sqrt();
        let (earlier, later) = values.split_at(values.len() / 2);
        elsewhere.extend_from_slice(earlier);
        here.extend_from_slice(later);
    }
    // a weighted sum of independent standard normal numbers (Stouffer et al. 1949)
    let z = sum / ((here.len() + elsewhere.len()).max(1) as f64).sqrt();
    q.finding(None, &here, &elsewhere, two_sided(z))
}

/// Median and robust standard deviation.
fn spread(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let median = |mut all: Vec<f64>| {
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied()
    };
    let values: Vec<f64> = values.collect();
    let middle = median(values.clone())?;
    Some([middle, SIGMA_PER_MAD * median(values.iter().map(|x| (x - middle).abs()).collect())?])
}
