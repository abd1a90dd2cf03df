//! The diagnosis as a document: gap, where, which, how much.

use crate::diagnosis::chain::{Model, lines, run};
pub use crate::diagnosis::credit::StageShare;
use crate::diagnosis::credit::{credits, stages};
use crate::diagnosis::decide::{Verdict, decide, floor};
use crate::diagnosis::fit::nominal_start;
use crate::diagnosis::interval::{Compared, closed_ci95};
use crate::diagnosis::observe::{Observed, Quantity};
use crate::diagnosis::search::{Candidate, Found, HeldOut, model_of, score, search};
use crate::diagnosis::sense::sense;
use crate::model::effects::Effect;
use crate::model::transmission::Line;
use nalgebra::Vector3;
use serde::Serialize;

/// The gap in figures, degrees RMS over all kinds of observation.
#[derive(Debug, Clone, Serialize)]
pub struct Gap {
    /// With the calibration as given.
    pub as_configured_deg: f64,
    /// After recalibration, on left-out blocks.
    pub recalibrated_deg: f64,
    /// With the verdict's effects, on left-out blocks.
    pub explained_deg: f64,
    /// What noise alone would leave.
    pub noise_floor_deg: f64,
}

/// A region of bend and direction.
#[derive(Debug, Clone, Serialize)]
pub struct Region {
    /// Bend, degrees, from and to.
    pub bend_deg: [f64; 2],
    /// Direction, degrees, from and to.
    pub dir_deg: [f64; 2],
    /// RMSE of the recalibrated model there, degrees.
    pub rmse_deg: f64,
    /// RMSE with the verdict's effects, degrees.
    pub explained_deg: f64,
}

/// A stretch of time.
#[derive(Debug, Clone, Serialize)]
pub struct When {
    /// Begin, s.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
    /// RMSE of the recalibrated model, degrees.
    pub rmse_deg: f64,
    /// RMSE with the verdict's effects, degrees.
    pub explained_deg: f64,
}

/// One kind of observation.
#[derive(Debug, Clone, Serialize)]
pub struct KindShare {
    /// Which sensor.
    pub name: &'static str,
    /// RMSE of the recalibrated model, degrees (°/s for the gyroscope).
    pub rmse_deg: f64,
    /// RMSE with the verdict's effects.
    pub explained_deg: f64,
}

/// Where the gap lies.
#[derive(Debug, Clone, Serialize)]
pub struct Where {
    /// Stages, largest share first.
    pub stages: Vec<StageShare>,
    /// Stages that this log cannot separate.
    pub merged: Vec<Vec<&'static str>>,
    /// By bend and direction.
    pub regions: Vec<Region>,
    /// By time.
    pub when: Vec<When>,
    /// By sensor.
    pub kinds: Vec<KindShare>,
}

/// A fitted parameter.
#[derive(Debug, Clone, Serialize)]
pub struct ParamValue {
    /// Name.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Estimate.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Channel 1 to 3, 0 if it belongs to none.
    pub channel: u8,
}

/// One effect of the catalogue.
#[derive(Debug, Clone, Serialize)]
pub struct EffectEntry {
    /// Name.
    pub name: &'static str,
    /// Stage.
    pub stage: &'static str,
    /// Probability that it is at work.
    pub probability: f64,
    /// Gap without it, degrees.
    pub gap_before_deg: f64,
    /// Gap with it, degrees.
    pub gap_after_deg: f64,
    /// Part of the gap it closes.
    pub closed: f64,
    /// 95 % interval of that part.
    pub closed_ci95: [f64; 2],
    /// Its parameters.
    pub params: Vec<ParamValue>,
}

/// The verdict as written.
#[derive(Debug, Clone, Serialize)]
pub struct VerdictEntry {
    /// `none`, `effects` or `unknown`.
    pub kind: &'static str,
    /// Names.
    pub names: Vec<&'static str>,
    /// Groups that this log cannot tell apart.
    pub equivalent: Vec<Vec<&'static str>>,
}

/// What is left.
#[derive(Debug, Clone, Serialize)]
pub struct UnknownEntry {
    /// Probability that something outside the catalogue is at work.
    pub probability: f64,
    /// RMSE left, degrees.
    pub rmse_deg: f64,
    /// RMS of the gyroscope's residual that its own reading foretells, °/s.
    pub foretold_deg_s: f64,
}

/// A whole diagnosis.
#[derive(Debug, Clone, Serialize)]
pub struct Diagnosis {
    /// Version of this document.
    pub schema: u32,
    /// The gap.
    pub gap: Gap,
    /// Where it lies.
    #[serde(rename = "where")]
    pub location: Where,
    /// All effects, most probable first.
    pub effects: Vec<EffectEntry>,
    /// The answer.
    pub verdict: VerdictEntry,
    /// What is left.
    pub unknown: UnknownEntry,
    /// Sets that were compared, best first.
    pub rivals: Vec<Rival>,
}

/// A set of effects and what it leaves.
#[derive(Debug, Clone, Serialize)]
pub struct Rival {
    /// Names; empty for the nominal model.
    pub names: Vec<&'static str>,
    /// Held-out energy over all kinds, deg².
    pub energy_deg2: f64,
    /// Held-out RMSE per kind: reference, accelerometer, magnetometer (degrees) and gyroscope (°/s).
    pub rmse_deg: [f64; 4],
    /// Weighted sum of squares in sample.
    pub cost: f64,
}

/// A diagnosis and what it was made from.
pub struct Diagnosed {
    /// The document.
    pub document: Diagnosis,
    /// The search behind it.
    pub found: Found,
    /// The verdict's candidate.
    pub chosen: Candidate,
}

/// Diagnoses a log against a catalogue; `lines` is the calibration the log was driven with.
#[must_use]
pub fn diagnose(log: &Observed, catalogue: &[Box<dyn Effect>], lines: &[Line; 3], seed: u64) -> Diagnosed {
    let found = search(log, catalogue, lines);
    let verdict = decide(log, &found);
    let chosen = pick(&found, &verdict);
    let document = write(log, catalogue, lines, &found, &verdict, &chosen, seed);
    Diagnosed { document, found, chosen }
}

fn pick(found: &Found, verdict: &Verdict) -> Candidate {
    let lists = found.singles.iter().chain(&found.pairs);
    lists.into_iter().find(|c| c.names == verdict.names).unwrap_or(&found.nominal).clone()
}

fn held(c: &Candidate) -> HeldOut {
    c.held_out.clone()
}

fn write(
    log: &Observed,
    catalogue: &[Box<dyn Effect>],
    lines: &[Line; 3],
    found: &Found,
    verdict: &Verdict,
    chosen: &Candidate,
    seed: u64,
) -> Diagnosis {
    let kinds = log.has.iter().filter(|&&h| h).count() as f64;
    let rms = |energy: f64| (energy / kinds).sqrt();
    let (nominal, after) = (held(&found.nominal), held(chosen));
    let floor = floor(log);
    let believed = beliefs(log, found, verdict);
    let mut effects: Vec<EffectEntry> =
        catalogue.iter().map(|e| entry(log, catalogue, e.as_ref(), found, chosen, &believed, floor, seed)).collect();
    effects.sort_by(|a, b| b.probability.total_cmp(&a.probability).then(b.closed.total_cmp(&a.closed)));
    let equivalent = equivalents(log, found, verdict);
    Diagnosis {
        schema: 1,
        gap: Gap {
            as_configured_deg: rms(as_configured(log, lines).energy()),
            recalibrated_deg: rms(nominal.energy()),
            explained_deg: rms(after.energy()),
            noise_floor_deg: rms(floor),
        },
        location: Where {
            stages: stages(catalogue, &credits(found, chosen, (nominal.energy() - floor).max(1e-9)), &believed),
            merged: merged(catalogue, &equivalent),
            regions: regions(log, &nominal, &after),
            when: when(log, &nominal, &after),
            kinds: Quantity::ALL
                .iter()
                .enumerate()
                .filter(|(k, _)| log.has[*k])
                .map(|(k, kind)| KindShare { name: kind.name(), rmse_deg: nominal.rmse_deg[k], explained_deg: after.rmse_deg[k] })
                .collect(),
        },
        unknown: UnknownEntry {
            probability: verdict.doubt,
            foretold_deg_s: verdict.foretold,
            rmse_deg: rms((after.energy() - floor).max(0.0)),
        },
        verdict: VerdictEntry { kind: verdict.kind, names: verdict.names.clone(), equivalent },
        effects,
        rivals: rivals(found),
    }
}

/// Sets shown of each size.
const SHOWN: usize = 12;

fn rivals(found: &Found) -> Vec<Rival> {
    let of = |c: &Candidate| Rival { names: c.names.clone(), energy_deg2: c.energy(), rmse_deg: c.held_out.rmse_deg, cost: c.fitted.cost };
    let shown = found.singles.iter().take(SHOWN).chain(found.pairs.iter().take(SHOWN)).chain([&found.nominal]);
    let mut out: Vec<Rival> = shown.map(of).collect();
    out.sort_by(|a, b| a.energy_deg2.total_cmp(&b.energy_deg2));
    out
}

/// The calibration as given, only gravity, field and gyroscope bias solved.
fn as_configured(log: &Observed, lines: &[Line; 3]) -> HeldOut {
    let (model, all) = (Model::new(&[]), vec![1.0; log.bins.len()]);
    let theta = nominal_start(lines);
    let s = sense(log, &model, &theta, &run(log, &model, &theta), &all);
    score(log, s.residual, &all)
}

/// Sharpness of belief: energies this share of the gap apart differ by a factor e.
const TEMPERATURE: f64 = 0.04;

/// Probability of each effect by name: sets weighed by the energy they leave, the verdict's set first.
fn beliefs(log: &Observed, found: &Found, verdict: &Verdict) -> Vec<(&'static str, f64)> {
    let nominal = held(&found.nominal).energy();
    let unit = (TEMPERATURE * (nominal - floor(log))).max(0.05);
    let chosen = held(&pick(found, verdict)).energy();
    let rivals: Vec<(&Candidate, f64)> = found
        .singles
        .iter()
        .chain(&found.pairs)
        .chain([&found.nominal])
        .map(|c| (c, c.energy()))
        .map(|(c, e)| {
            // a set larger than the verdict's must earn its size, and the verdict has earned its own
            let size = c.names.len().abs_diff(verdict.names.len()) as f64;
            let ahead = if c.names == verdict.names { 0.0 } else { ((e - chosen) / unit).max(0.0) + 2.0 + 2.0 * size };
            (c, (-ahead).exp())
        })
        .collect();
    let total: f64 = rivals.iter().map(|r| r.1).sum();
    let mut out: Vec<(&'static str, f64)> = found.singles.iter().map(|s| (s.names[0], 0.0)).collect();
    for (c, w) in rivals {
        for (name, p) in &mut out {
            if c.names.contains(name) {
                *p += w / total;
            }
        }
    }
    out
}

#[allow(clippy::too_many_arguments)]
fn entry(
    log: &Observed,
    catalogue: &[Box<dyn Effect>],
    e: &dyn Effect,
    found: &Found,
    chosen: &Candidate,
    believed: &[(&'static str, f64)],
    floor: f64,
    seed: u64,
) -> EffectEntry {
    let kinds = log.has.iter().filter(|&&h| h).count() as f64;
    let single = found.singles.iter().find(|s| s.names[0] == e.name());
    let nominal = held(&found.nominal);
    // a member of the verdict is credited with what comes back when it is taken out
    let member = chosen.names.contains(&e.name()) && chosen.names.len() > 1;
    let (before, after, from) = if member {
        let rest = found.singles.iter().find(|s| chosen.names.contains(&s.names[0]) && s.names[0] != e.name());
        (rest.map_or(nominal.clone(), held), held(chosen), Some(chosen))
    } else {
        (nominal.clone(), single.map_or(nominal.clone(), held), single)
    };
    let gap = (nominal.energy() - floor).max(1e-9);
    let closed = |b: f64, a: f64, whole: f64| ((b - a) / whole.max(1e-9)).clamp(-1.0, 1.0);
    let value = closed(before.energy(), after.energy(), gap);
    EffectEntry {
        name: e.name(),
        stage: e.stage().name(),
        probability: believed.iter().find(|b| b.0 == e.name()).map_or(0.0, |b| b.1),
        gap_before_deg: (before.energy() / kinds).sqrt(),
        gap_after_deg: (after.energy() / kinds).sqrt(),
        closed: value,
        closed_ci95: closed_ci95(&Compared { before: &before, after: &after, nominal: &nominal, floor }, value, seed),
        params: from.map_or(vec![], |c| params(log, catalogue, e, c)),
    }
}

/// Residuals are correlated over about this long, s: one independent observation per such stretch.
const CORRELATED_S: f64 = 2.0;

fn params(log: &Observed, catalogue: &[Box<dyn Effect>], e: &dyn Effect, c: &Candidate) -> Vec<ParamValue> {
    let model = model_of(catalogue, &c.names);
    let Some(i) = model.effects.iter().position(|x| x.name() == e.name()) else { return vec![] };
    let independent = (log.duration_s() / CORRELATED_S).max(10.0);
    let kinds = log.has.iter().filter(|&&h| h).count() as f64;
    let variance = c.fitted.cost / (independent * 3.0 * kinds) / (log.bins.len() as f64 / independent);
    let inflation = variance * log.bins.len() as f64 / independent;
    let mut named = model.of(&c.fitted.theta, i).to_vec();
    e.canonical(&mut named, &Vector3::from(lines(&c.fitted.theta).map(|l| l.k_epsilon)));
    e.params()
        .iter()
        .enumerate()
        .map(|(k, p)| {
            let at = model.at[i] + k;
            let (value, half) = (named[k], 1.96 * (c.fitted.covariance[(at, at)].max(0.0) * inflation).sqrt());
            let shown = |x: f64| p.shown(x).0;
            ParamValue {
                name: p.name,
                unit: p.shown(value).1,
                value: shown(value),
                ci95: [shown((value - half).max(p.low)), shown((value + half).min(p.high))],
                channel: p.channel,
            }
        })
        .collect()
}

fn merged(catalogue: &[Box<dyn Effect>], groups: &[Vec<&'static str>]) -> Vec<Vec<&'static str>> {
    let stage = |name: &str| catalogue.iter().find(|e| e.name() == name).map_or("", |e| e.stage().name());
    groups
        .iter()
        .map(|g| {
            let mut s: Vec<&'static str> = g.iter().map(|n| stage(n)).collect();
            s.dedup();
            s
        })
        .filter(|s| s.len() > 1)
        .collect()
}

/// Pairs that no log without an outside reference can separate, by physics.
const TWINS: [[&str; 2]; 2] = [["transport_delay", "sensor_latency"], ["clocking", "mount_misalignment"]];
/// Energies closer than this share of the gap are the same.
const SAME_SHARE: f64 = 0.02;

fn equivalents(log: &Observed, found: &Found, verdict: &Verdict) -> Vec<Vec<&'static str>> {
    let nominal = held(&found.nominal).energy();
    let unit = SAME_SHARE * (nominal - floor(log));
    let energy = |name: &str| found.singles.iter().find(|s| s.names[0] == name).map(Candidate::energy);
    TWINS
        .iter()
        .filter(|t| t.iter().any(|n| verdict.names.contains(n)) && !log.has[0])
        .filter(|t| matches!((energy(t[0]), energy(t[1])), (Some(a), Some(b)) if (a - b).abs() < unit))
        .map(|t| found.singles.iter().map(|s| s.names[0]).filter(|n| t.contains(n)).collect())
        .collect()
}

/// Bend and direction each bin is at, degrees, from the nominal model's gravity-free side: the command.
fn pose_of(log: &Observed, k: usize) -> (f64, f64) {
    let g = crate::model::arc::Geometry::default();
    let u = log.piston_mm[log.bins[k].at] / 3.2;
    let b = g.shape(&u).bend;
    (b.beta().to_degrees(), b.delta().to_degrees().rem_euclid(360.0))
}

fn square(h: &HeldOut, log: &Observed, k: usize) -> (f64, f64) {
    let deg2 = 1f64.to_degrees().powi(2);
    (0..3)
        .filter(|&kind| log.bins[k].weight[kind] > 0.0)
        .fold((0.0, 0.0), |(s, n), kind| (s + h.residual[kind][k].norm_squared() * deg2, n + 1.0))
}

fn pooled(log: &Observed, nominal: &HeldOut, after: &HeldOut, pick: impl Fn(usize) -> bool) -> Option<(f64, f64)> {
    let (mut a, mut b, mut n) = (0.0, 0.0, 0.0);
    for k in (0..log.bins.len()).filter(|&k| pick(k)) {
        let (x, y) = (square(nominal, log, k), square(after, log, k));
        a += x.0;
        b += y.0;
        n += x.1;
    }
    (n > 0.0).then(|| ((a / n).sqrt(), (b / n).sqrt()))
}

fn regions(log: &Observed, nominal: &HeldOut, after: &HeldOut) -> Vec<Region> {
    let mut out = Vec::new();
    for b in 0..3 {
        for d in 0..6 {
            let (bend, dir) = ([f64::from(b) * 30.0, f64::from(b + 1) * 30.0], [f64::from(d) * 60.0, f64::from(d + 1) * 60.0]);
            let inside = |k: usize| {
                let (x, y) = pose_of(log, k);
                (bend[0]..bend[1]).contains(&x) && (dir[0]..dir[1]).contains(&y)
            };
            if let Some((rmse_deg, explained_deg)) = pooled(log, nominal, after, inside) {
                out.push(Region { bend_deg: bend, dir_deg: dir, rmse_deg, explained_deg });
            }
        }
    }
    out
}

fn when(log: &Observed, nominal: &HeldOut, after: &HeldOut) -> Vec<When> {
    let (t0, length) = (log.start_s(), log.duration_s() / 20.0);
    (0..20)
        .filter_map(|i| {
            let (from_s, to_s) = (t0 + length * f64::from(i), t0 + length * f64::from(i + 1));
            let inside = |k: usize| (from_s..to_s).contains(&log.bins[k].t_s);
            pooled(log, nominal, after, inside).map(|(rmse_deg, explained_deg)| When { from_s, to_s, rmse_deg, explained_deg })
        })
        .collect()
}
