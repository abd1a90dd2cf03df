//! Many units: a row per diagnosed log, and what the rows of a fleet tell about its lots.

pub mod chance;
pub mod row;

use crate::diagnosis::fleet::chance::{at_least, correct, rank_z, two_sided};
use crate::diagnosis::fleet::row::{GAINS, Row};
use crate::model::effects::catalogue;
use serde::Serialize;
use std::collections::BTreeMap;

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

/// What a fleet has in common and where its lots differ.
#[derive(Debug, Clone, Serialize)]
pub struct Survey {
    /// Logs that were diagnosed.
    pub diagnosed: usize,
    /// Logs that were refused.
    pub refused: usize,
    /// Number of diagnosed logs by lot.
    pub lots: BTreeMap<String, usize>,
    /// Share of diagnosed logs by verdict, and with each effect that a verdict names.
    pub shares: BTreeMap<String, f64>,
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

impl Survey {
    /// Surveys the rows of a fleet.
    pub fn new(rows: &[Row]) -> Self {
        let told: Vec<&Row> = rows.iter().filter(|row| row.refused.is_empty()).collect();
        let (mut lots, mut shares) = (BTreeMap::new(), BTreeMap::new());
        for row in &told {
            *lots.entry(row.lot.clone()).or_insert(0) += 1;
            for name in row.names.split('+').chain([row.verdict.as_str()]).filter(|name| !name.is_empty()) {
                *shares.entry(name.to_owned()).or_insert(0.0) += 1.0 / told.len() as f64;
            }
        }
        let gains = gains(&told);
        let mut findings: Vec<Finding> =
            effects(&told).iter().chain(&gains).flat_map(|q| lots.keys().map(Some).chain([None]).filter_map(|lot| compare(&told, q, lot))).collect();
        correct(&mut findings, |f| &mut f.p);
        findings.retain(|f| f.p <= LEVEL);
        findings.sort_by(|a, b| a.p.total_cmp(&b.p));
        let gains = gains.iter().filter_map(|q| Some((q.name.to_owned(), spread(q.values.iter().flatten().copied())?))).collect();
        Self { diagnosed: told.len(), refused: rows.len() - told.len(), lots, shares, gains, findings }
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

/// Compares a lot with the others, or later with earlier logs within every lot; `None` if there are too few values.
fn compare(rows: &[&Row], q: &Quantity, lot: Option<&String>) -> Option<Finding> {
    let is_gain = GAINS.contains(&q.name);
    let told = || rows.iter().zip(&q.values).filter_map(|(row, value)| Some((*row, (*value)?)));
    let (mut here, mut elsewhere) = (Vec::new(), Vec::new());
    let p = if let Some(lot) = lot {
        told().for_each(|(row, value)| if row.lot == *lot { here.push(value) } else { elsewhere.push(value) });
        if is_gain {
            let side: Vec<f64> = told().map(|(row, _)| f64::from(u8::from(row.lot == *lot))).collect();
            two_sided(rank_z(&side, &told().map(|(_, value)| value).collect::<Vec<f64>>()))
        } else {
            let hits = |side: &[f64]| side.iter().filter(|x| **x > 0.0).count();
            at_least(hits(&here), here.len(), hits(&here) + hits(&elsewhere), here.len() + elsewhere.len())
        }
    } else {
        let mut by_lot: BTreeMap<&str, Vec<(&str, f64)>> = BTreeMap::new();
        for (row, value) in told().filter(|(row, _)| !row.date.is_empty()) {
            by_lot.entry(&row.lot).or_default().push((&row.date, value));
        }
        let (mut sum, mut weight) = (0.0, 0.0);
        for dated in by_lot.values_mut() {
            dated.sort_by_key(|(date, _)| *date);
            let day = |k: usize| dated.partition_point(|(date, _)| *date < dated[k].0) as f64;
            let days: Vec<f64> = (0..dated.len()).map(day).collect();
            let values: Vec<f64> = dated.iter().map(|(_, value)| *value).collect();
            sum += rank_z(&days, &values) * (values.len() as f64).sqrt();
            weight += values.len() as f64;
            let (earlier, later) = values.split_at(values.len() / 2);
            elsewhere.extend_from_slice(earlier);
            here.extend_from_slice(later);
        }
        // the weighted sum of independent standard normal numbers (Stouffer 1949)
        two_sided(sum / weight.max(1.0).sqrt())
    };
    let enough = here.len().min(elsewhere.len()) >= VALUES_MIN;
    let middle = |side: Vec<f64>| if is_gain { spread(side.into_iter()).map_or(f64::NAN, |s| s[0]) } else { mean(&side) };
    enough.then(|| Finding { what: q.name.to_owned(), lot: lot.cloned(), here: middle(here), elsewhere: middle(elsewhere), p })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
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
