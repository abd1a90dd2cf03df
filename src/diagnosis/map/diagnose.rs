//! Diagnosis of a mapped rig.
//!
//! The nominal model is identified on the log, every operator ([`crate::diagnosis::map::operators`]) is fitted jointly with it, and sets of
//! them are searched ([`crate::diagnosis::map::search`]) and judged as those of a tip are: by a posterior, whose weights are fitted to random
//! rigs ([`crate::diagnosis::train::rig`]).

use crate::diagnosis::candidates::{Candidates, Scored};
use crate::diagnosis::decide::decide;
use crate::diagnosis::document::{StatementEntry, VerdictEntry};
use crate::diagnosis::map::document::{Document, Entry, Figures, Fresh, Left, Parameter};
use crate::diagnosis::map::features::{HEAD, statements};
use crate::diagnosis::map::file::MapFile;
use crate::diagnosis::map::model::{MapBase, catalogue};
use crate::diagnosis::map::regress::{Regressed, variance};
use crate::diagnosis::map::search::{Bench, Set};
use crate::diagnosis::map::table::Signals;
use crate::diagnosis::posterior::{Posterior, Statement};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Rows below which the probabilities are not to be trusted; the weights are fitted to logs of 500 rows and more.
const FEW: usize = 200;
/// Draws of the bootstrap.
const DRAWS: usize = 1000;
/// Orders of differences from which the noise is estimated.
const ORDERS: u32 = 8;
/// Ratio of the 90th to the 10th percentile of the speed below which a log has one speed only.
const ONE_SPEED: f64 = 1.3;
/// Samples from which the speeds are estimated.
const SPEEDS: usize = 400;

/// A log with its searched sets.
pub struct Searched<'a> {
    bench: Bench<'a>,
    found: Candidates<Set>,
    /// White noise of a row, 1 σ.
    noise: f64,
    /// What can be said of the log.
    pub statements: Vec<Statement>,
}

/// Searches a log; `None` if its inputs do not determine the nominal model.
pub fn search<'a>(map: &MapFile, log: &'a Signals) -> Option<Searched<'a>> {
    let noise = noise(&log.output);
    let (bench, nominal) = Bench::new(
        MapBase::new(map, log),
        &log.output,
        catalogue(map.nominal, log.clocked),
        noise * noise,
    )?;
    let found = bench.search(nominal);
    let statements = statements(&found, noise * noise, variance(&log.output));
    Some(Searched {
        bench,
        found,
        noise,
        statements,
    })
}

/// Diagnoses a log; `fresh` are other logs of the rig, on which the fitted model is evaluated.
pub fn diagnose(map: &MapFile, log: &Signals, fresh: &[(String, Signals)], seed: u64) -> Document {
    let Some(Searched {
        bench,
        found,
        noise,
        statements,
    }) = search(map, log)
    else {
        return Document::empty(map);
    };
    let posterior = Posterior::new(&HEAD, statements);
    let set = |names: &[&str]| found.set(names).unwrap_or(&found.nominal);
    let verdict = decide(&posterior, |names| {
        found.claimable(set(names)).names.clone()
    });
    let chosen = set(&verdict.names);
    let judged = Judged {
        bench: &bench,
        nominal: &found.nominal,
        posterior: &posterior,
        seed,
    };
    let mut effects: Vec<Entry> = found.singles.iter().map(|s| judged.entry(s)).collect();
    effects.sort_by(|a, b| {
        b.probability
            .total_cmp(&a.probability)
            .then(b.closed.total_cmp(&a.closed))
    });
    let mut notes = notes(log);
    let mut evaluated = Vec::new();
    for (name, other) in fresh {
        match judged.on_fresh(chosen, name, other) {
            Some(f) => evaluated.push(f),
            None => notes.push(format!("{name} is far outside the fitted range and was not evaluated: record both over one range")),
        }
    }
    let left = (chosen.energy() - noise * noise).max(0.0).sqrt();
    Document {
        schema: 1,
        rig: "map",
        unit: map.output_unit.clone(),
        gap: Figures {
            recalibrated: found.nominal.energy().sqrt(),
            explained: chosen.energy().sqrt(),
            noise_floor: noise,
        },
        set: (!chosen.names.is_empty())
            .then(|| judged.entry(chosen))
            .into_iter()
            .collect(),
        effects,
        unknown: Left {
            probability: verdict.doubt,
            rmse: left,
        },
        verdict: VerdictEntry {
            kind: verdict.kind,
            names: verdict.names,
            equivalent: verdict.equivalent,
            conformal: StatementEntry::conformal(&posterior),
        },
        notes,
        fresh: evaluated,
    }
}

/// What the entries of a document are made from.
struct Judged<'a> {
    bench: &'a Bench<'a>,
    nominal: &'a Set,
    posterior: &'a Posterior,
    seed: u64,
}

impl Judged<'_> {
    fn entry(&self, set: &Set) -> Entry {
        let (before, after) = (self.nominal.energy(), set.energy());
        let closed = ((before - after) / self.bench.gap).clamp(-1.0, 1.0);
        let ci = interval(
            &self.nominal.scores,
            &set.scores,
            before - self.bench.gap,
            self.seed,
        );
        let params = set.members.iter().filter(|m| !m.operator.eta.is_empty());
        Entry {
            name: set.names.join(" + "),
            probability: match set.names.as_slice() {
                [one] => self.posterior.effect(one),
                several => self.posterior.set(several),
            },
            rmse_before: before.sqrt(),
            rmse_after: after.sqrt(),
            closed,
            closed_ci95: [ci[0].min(closed), ci[1].max(closed)],
            params: params
                .map(|m| Parameter {
                    of: m.operator.name,
                    name: m.operator.eta,
                    value: m.eta,
                })
                .collect(),
        }
    }

    /// The fitted models on a fresh log; only the offset is set again.
    fn on_fresh(&self, chosen: &Set, name: &str, other: &Signals) -> Option<Fresh> {
        let rmse = |set: &Set| {
            self.bench
                .base
                .rmse_on(other, &set.members, &set.scores.coefficients)
        };
        Some(Fresh {
            log: name.to_owned(),
            before: rmse(self.nominal)?,
            after: rmse(chosen)?,
        })
    }
}

/// 95 % interval of the closed part from blocks drawn with replacement; `floor` is the mean square of the noise.
fn interval(from: &Regressed, to: &Regressed, floor: f64, seed: u64) -> [f64; 2] {
    let mut rng = StdRng::seed_from_u64(seed);
    // the blocks in which the set leaves more
    let worse = to.worse();
    let (from, to) = (&from.blocks[worse], &to.blocks[worse]);
    let n = from.len();
    let mut draws: Vec<f64> = (0..DRAWS)
        .map(|_| {
            let (mut before, mut after, mut rows) = (0.0, 0.0, 0.0);
            for _ in 0..n {
                let i = rng.random_range(0..n);
                before += from[i].0;
                after += to[i].0;
                rows += from[i].1;
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
    if log.output.len() < FEW {
        let rows = log.output.len();
        out.push(format!("the log has {rows} rows; of fewer than {FEW}, noise is taken for an effect too often. Record a longer log"));
    }
    if !log.clocked {
        out.push("the log has no clock: effects of time and effects of the path cannot be separated; times are in rows. Record a clock, and a second speed".to_owned());
    }
    if let Some(m) = log.motion.as_ref().filter(|_| log.clocked) {
        let step = (m.len() / SPEEDS).max(1);
        let at: Vec<(f64, f64)> = m
            .iter()
            .zip(&log.t)
            .step_by(step)
            .map(|(m, t)| (*m, *t))
            .collect();
        let mut speeds: Vec<f64> = at
            .windows(2)
            .map(|w| ((w[1].0 - w[0].0) / (w[1].1 - w[0].1)).abs())
            .collect();
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
    use crate::diagnosis::decide::VerdictKind;
    use crate::diagnosis::map::operators::play;

    const MAP: &str = "input = \"u\"\noutput = \"y\"\ntime = \"t\"\n";

    /// A log with several speeds and amplitudes, its output by `law` with noise.
    fn log(law: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> Signals {
        let mut rng = StdRng::seed_from_u64(9);
        let t: Vec<f64> = (0..6000).map(|k| f64::from(k) * 0.01).collect();
        let u: Vec<f64> = t
            .iter()
            .map(|t| (1.0 + (0.21 * t).sin()) * (1.3 * t + 0.9 * (0.5 * t).sin()).sin())
            .collect();
        let output = law(&u, &t)
            .iter()
            .map(|y| y + 0.01 * rng.random_range(-1.0..1.0))
            .collect();
        Signals {
            inputs: vec![u.clone()],
            output,
            motion: Some(u),
            t,
            clocked: true,
        }
    }

    fn diagnosis(law: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> Document {
        diagnose(&toml::from_str(MAP).unwrap(), &log(law), &[], 1)
    }

    #[test]
    fn a_known_cause_is_named_and_no_other() {
        let d = diagnosis(|u, _| play(u, 0.3).iter().map(|w| 2.0 * w + 1.0).collect());
        assert_eq!(
            (d.verdict.kind, d.verdict.names.as_slice()),
            (VerdictKind::Effects, &["play"][..]),
            "{:?}",
            d.set
        );
        assert!(
            d.set[0].closed > 0.95 && d.set[0].closed_ci95[0] > 0.9,
            "{:?}",
            d.set
        );
        let d = diagnosis(|u, t| {
            u.iter()
                .zip(t)
                .map(|(u, t)| 3.0 * u + 0.4 * t / 60.0)
                .collect()
        });
        assert_eq!(d.verdict.names, ["drift"]);
        let d = diagnosis(|u, _| u.iter().map(|u| u + 0.2 * u.powi(3)).collect());
        assert_eq!(d.verdict.names, ["cubic"]);
    }

    /// Lines with noise: nothing is claimed of a log that is long enough, and a short one has a note.
    #[test]
    fn noise_is_not_taken_for_an_effect() {
        let mut rng = StdRng::seed_from_u64(4);
        for (rows, seed) in [60, 200, 300, 500]
            .into_iter()
            .flat_map(|rows| (0..6).map(move |seed| (rows, seed)))
        {
            let t: Vec<f64> = (0..rows).map(f64::from).collect();
            let u: Vec<f64> = t
                .iter()
                .map(|t| (t * f64::from(seed + 3) * 0.04).sin())
                .collect();
            let output = u
                .iter()
                .map(|u| 2.0 * u + 0.03 * rng.random_range(-1.0..1.0))
                .collect();
            let signals = Signals {
                inputs: vec![u.clone()],
                output,
                motion: Some(u),
                t,
                clocked: true,
            };
            let d = diagnose(&toml::from_str(MAP).unwrap(), &signals, &[], 1);
            let noted = d.notes.iter().any(|n| n.contains("Record a longer log"));
            assert!(
                if rows < 200 {
                    noted
                } else {
                    !noted && d.verdict.kind == VerdictKind::None
                },
                "{rows} {seed}: {:?}",
                d.verdict
            );
        }
    }

    #[test]
    fn no_effect_is_claimed_if_the_line_suffices_or_no_operator_helps() {
        assert_eq!(
            diagnosis(|u, _| u.iter().map(|u| 3.0 * u - 1.0).collect())
                .verdict
                .kind,
            VerdictKind::None
        );
        let d = diagnosis(|u, t| {
            u.iter()
                .zip(t)
                .map(|(u, t)| u + 0.5 * (7.0 * t * t / 30.0).sin())
                .collect()
        });
        assert_eq!(d.verdict.kind, VerdictKind::Unknown, "{:?}", d.set);
    }
}
