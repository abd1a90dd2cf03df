//! Diagnosis of a mapped rig.
//!
//! The nominal model is identified on the log, every operator ([`crate::diagnosis::rig::operators`]) is fitted jointly with it, and sets of
//! them are searched ([`crate::diagnosis::rig::search`]) and judged as those of a tip are: by a posterior, whose weights are fitted to random
//! rigs.

use crate::diagnosis::candidates::{Candidates, Scored};
use crate::diagnosis::rig::document::{Document, Entry, Figures, Fresh, Left, Parameter};
use crate::diagnosis::rig::features::{HEAD, statements};
use crate::diagnosis::rig::file::MapFile;
use crate::diagnosis::rig::model::{MapBase, catalogue};
use crate::diagnosis::rig::regress::{Regressed, variance};
use crate::diagnosis::rig::search::{Bench, Set};
use crate::diagnosis::rig::table::Signals;
use crate::diagnosis::tip::document::{StatementEntry, VerdictEntry};
use crate::diagnosis::verdict::decide::decide;
use crate::diagnosis::verdict::posterior::{Claim, Posterior, Statement};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Rows below which the probabilities are not to be trusted; the weights are fitted to logs of 500 rows and more.
const FEW: usize = 200;
/// Draws of the bootstrap.
const DRAWS: usize = 400;
/// Orders of differences from which the noise is estimated.
const ORDERS: u32 = 8;
/// Distinct values of the inputs below which a log has few poses.
const FEW_POSES: usize = 30;
/// Mean square of what the output moves from the third to the fourth quarter of a pose, in units of what it moves from pose to pose, below
/// which it stands. A response that goes on through the poses has a sixteenth.
const STANDS: f64 = 0.01;
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

/// Searches a log, with the seed of the bootstrap; `None` if its inputs do not determine the nominal model.
pub fn search<'a>(map: &MapFile, log: &'a Signals, seed: u64) -> Option<Searched<'a>> {
    let noise = noise(&log.output);
    let (bench, nominal) = Bench::new(
        MapBase::new(map, log),
        &log.output,
        catalogue(map.nominal, log.clocked),
        noise * noise,
    )?;
    let found = bench.search(nominal);
    let poor = poor(log);
    let claim = |set: &Set| match poor {
        true => Claim {
            names: None,
            unexplained: 0.0,
        },
        false => claim(&found, set, &bench, seed),
    };
    let statements = statements(&found, noise * noise, variance(&log.output), claim);
    Some(Searched {
        bench,
        found,
        noise,
        statements,
    })
}

/// What may be claimed of a set: the effects that surely close enough of the gap. What it leaves of the gap beyond noise is unknown in
/// proportion.
fn claim(found: &Candidates<Set>, set: &Set, bench: &Bench<'_>, seed: u64) -> Claim {
    let floor = found.nominal.energy() - bench.gap;
    let enough = |c: &Set, part: &Set| {
        c.gain(part) >= 1.0 && interval(&part.scores, &c.scores, floor, seed)[0] > 0.0
    };
    let kept = found.claimable(set, &enough);
    let above = (kept.energy() - floor).max(0.0);
    let structured = above / kept.energy().max(f64::MIN_POSITIVE);
    Claim {
        names: (!kept.names.is_empty()).then(|| kept.names.clone()),
        unexplained: (above / bench.gap * structured).min(1.0),
    }
}

/// Diagnoses a log; `fresh` are other logs of the rig, on which the fitted model is evaluated.
pub fn diagnose(map: &MapFile, log: &Signals, fresh: &[(String, Signals)], seed: u64) -> Document {
    let Some(Searched {
        bench,
        found,
        noise,
        statements,
    }) = search(map, log, seed)
    else {
        return Document::empty(map);
    };
    let posterior = Posterior::new(&HEAD, statements);
    let set = |names: &[&str]| found.set(names).unwrap_or(&found.nominal);
    let verdict = decide(&posterior, &[], |names| {
        let least = set(names).energy();
        let better = found.singles.iter().filter(|s| s.energy() < least);
        better.map(|s| s.names[0]).collect()
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
    if bench.coarse {
        notes.push("the rows are too far apart to tell noise from signal, so the parts that are closed include noise. Record more rows per second".to_owned());
    }
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
        set: judged.parts(&found, chosen),
        effects,
        unknown: Left {
            probability: verdict.doubt,
            rmse: left,
        },
        verdict: VerdictEntry {
            kind: verdict.kind,
            names: verdict.names,
            probability: verdict.probability,
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
    /// A set as a whole, and what each of several effects closes beyond the others.
    fn parts(&self, found: &Candidates<Set>, set: &Set) -> Vec<Entry> {
        let beside = |name: &&'static str| {
            let rest = found.without(set, name)?;
            Some(Entry {
                name: format!("{name}, beside the other"),
                probability: self.posterior.effect(name),
                params: vec![],
                ..self.beyond(rest, set)
            })
        };
        let several = set.names.iter().filter(|_| set.names.len() > 1);
        let whole = (!set.names.is_empty()).then(|| self.entry(set));
        whole
            .into_iter()
            .chain(several.filter_map(beside))
            .collect()
    }

    fn entry(&self, set: &Set) -> Entry {
        self.beyond(self.nominal, set)
    }

    /// What a set closes beyond a part of it.
    fn beyond(&self, from: &Set, set: &Set) -> Entry {
        let (before, after) = (from.energy(), set.energy());
        let closed = ((before - after) / self.bench.gap).clamp(-1.0, 1.0);
        let floor = self.nominal.energy() - self.bench.gap;
        let part = (before - floor).max(0.0) / self.bench.gap;
        let ci = interval(&from.scores, &set.scores, floor, self.seed).map(|c| c * part);
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

/// Whether a log shows nothing but a few poses: the output stands still while the inputs do, so that it has no more independent rows than
/// poses.
fn poor(log: &Signals) -> bool {
    let rows = log.output.len();
    let changes = |k: &usize| *k == 0 || log.inputs.iter().any(|u| u[*k] != u[k - 1]);
    let mut starts: Vec<usize> = (0..rows).filter(changes).collect();
    if log.inputs.is_empty() || starts.len() >= FEW_POSES || starts.len() < 2 {
        return false;
    }
    starts.push(rows);
    // the means of the last two quarters of each pose
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
    let quarters: Vec<[f64; 2]> = starts
        .windows(2)
        .map(|w| {
            let quarter = ((w[1] - w[0]) / 4).max(1);
            let third = w[1].saturating_sub(2 * quarter);
            [
                mean(&log.output[third..w[1] - quarter]),
                mean(&log.output[w[1] - quarter..w[1]]),
            ]
        })
        .collect();
    let within: f64 = quarters.iter().map(|[a, b]| (b - a).powi(2)).sum();
    let between: f64 = quarters
        .windows(2)
        .map(|w| (w[1][1] - w[0][1]).powi(2))
        .sum();
    within < STANDS * between
}

/// Number of distinct values of the inputs, up to [`FEW_POSES`].
fn poses(log: &Signals) -> usize {
    let mut known: Vec<Vec<f64>> = Vec::new();
    for k in 0..log.output.len() {
        let pose: Vec<f64> = log.inputs.iter().map(|u| u[k]).collect();
        if known.len() < FEW_POSES && !known.contains(&pose) {
            known.push(pose);
        }
    }
    known.len()
}

/// What this log cannot show, regardless of the scores.
fn notes(log: &Signals) -> Vec<String> {
    let mut out = Vec::new();
    if log.output.len() < FEW {
        let rows = log.output.len();
        out.push(format!("the log has {rows} rows; of fewer than {FEW}, noise is taken for an effect too often. Record a longer log"));
    }
    let poses = poses(log);
    if !log.inputs.is_empty() && poses < FEW_POSES {
        out.push(format!("the inputs have {poses} distinct values; a law of the path fits so few poses by chance. Record a log that passes {FEW_POSES} poses or more, each from both sides"));
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
    use crate::diagnosis::rig::operators::play;
    use crate::diagnosis::verdict::decide::VerdictKind;

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

    /// A staircase of few poses after each of which the output stands shows no effect, whatever it looks like; one that moves on does.
    #[test]
    fn a_few_poses_claim_nothing_unless_the_output_moves_on() {
        let mut rng = StdRng::seed_from_u64(6);
        for poses in [5, 12, 20] {
            let u: Vec<f64> = (0..poses).map(|_| rng.random_range(-1.0..1.0)).collect();
            let hold = 60;
            let inputs: Vec<f64> = (0..poses * hold).map(|k| u[k / hold]).collect();
            let t: Vec<f64> = (0..poses * hold).map(|k| k as f64).collect();
            let slow = |tau: f64| {
                let mut y = 0.0;
                inputs
                    .iter()
                    .map(|u| {
                        y += (u - y) / tau;
                        y
                    })
                    .collect::<Vec<f64>>()
            };
            let signals = |output: Vec<f64>| Signals {
                inputs: vec![inputs.clone()],
                output,
                motion: Some(inputs.clone()),
                t: t.clone(),
                clocked: true,
            };
            let wrong: Vec<f64> = u.iter().map(|_| rng.random_range(-1.0..1.0)).collect();
            let stands = signals(
                (0..poses * hold)
                    .map(|k| u[k / hold] + wrong[k / hold])
                    .collect(),
            );
            assert!(poor(&stands) && !poor(&signals(slow(80.0))), "{poses}");
            let d = diagnose(&toml::from_str(MAP).unwrap(), &stands, &[], 1);
            assert!(
                d.verdict.names.is_empty() && d.notes.iter().any(|n| n.contains("distinct")),
                "{:?}",
                d.verdict
            );
        }
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
