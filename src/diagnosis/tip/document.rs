//! The diagnosis as a document. `docs/gap.md` describes the JSON form.

use crate::diagnosis::tip::TipProblem;
use crate::diagnosis::tip::fit::{Candidate, HeldOut, closed_ci95, score, scored};
use crate::diagnosis::tip::location::{self, Location, credits, stages};
use crate::diagnosis::tip::observed::{
    CORRELATED_S, Depends, Observed, PerQuantity, Segment, dependences,
};
use crate::diagnosis::verdict::Verdict;
use crate::diagnosis::{Candidates, Documented, Judged, Scored, diagnose};
use crate::model::effects::{Effect, Param, by_name};
use crate::model::{Model, nominal_theta};
use nalgebra::Vector3;
use serde::Serialize;
use std::ops::Range;

/// Least part of a remainder that a dependence must predict to be told.
const TOLD: f64 = 0.1;
/// Compared single effects, and larger sets, in the document.
const RIVALS: usize = 12;

/// The diagnosis of a tip and what it was made from.
pub type Diagnosed = diagnose::Diagnosed<Diagnosis, Candidate>;

/// The gap, degrees RMS over the logged quantities.
#[derive(Debug, Clone, Serialize)]
pub struct Gap {
    /// With the calibration as given.
    pub as_configured_deg: f64,
    /// After recalibration, on left-out blocks.
    pub recalibrated_deg: f64,
    /// With the verdict's effects, on left-out blocks.
    pub explained_deg: f64,
    /// White noise alone.
    pub noise_floor_deg: f64,
}

/// A fitted parameter.
#[derive(Debug, Clone, Serialize)]
pub struct ParamValue {
    /// As the law names it; an effect may have it once per channel.
    pub name: &'static str,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
    /// Estimate.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Channel 1 to 3; 0 if the parameter belongs to none.
    pub channel: u8,
}

/// An effect of the catalogue.
#[derive(Debug, Clone, Serialize)]
pub struct EffectEntry {
    /// As in the catalogue.
    pub name: &'static str,
    /// Stage of the chain in which it acts.
    pub stage: &'static str,
    /// Probability that the effect is present.
    pub probability: f64,
    /// RMSE without the effect, degrees.
    pub gap_before_deg: f64,
    /// RMSE with the effect, degrees.
    pub gap_after_deg: f64,
    /// Part of the gap that the effect closes.
    pub closed: f64,
    /// 95 % interval of that part.
    pub closed_ci95: [f64; 2],
    /// Parameters.
    pub params: Vec<ParamValue>,
}

/// The unexplained remainder.
#[derive(Debug, Clone, Serialize)]
pub struct UnknownEntry {
    /// Probability that a cause outside the catalogue is present.
    pub probability: f64,
    /// RMSE left above the noise, degrees.
    pub rmse_deg: f64,
    /// What it depends on, the strongest first.
    pub goes_with: Vec<Depends>,
}

/// A set of effects and what it leaves.
#[derive(Debug, Clone, Serialize)]
pub struct Rival {
    /// Names; empty for the nominal model.
    pub names: Vec<&'static str>,
    /// Held-out energy over all quantities, deg².
    pub energy_deg2: f64,
    /// Held-out RMSE: reference, accelerometer, magnetometer (degrees) and gyroscope (°/s).
    pub rmse_deg: PerQuantity<f64>,
    /// Weighted sum of squares in sample.
    pub cost: f64,
}

/// One of the logs that were diagnosed together.
#[derive(Debug, Clone, Serialize)]
pub struct LogEntry {
    /// Name of the file.
    pub file: String,
    /// RMS of its part of the gap after recalibration, on left-out blocks, degrees.
    pub recalibrated_deg: f64,
    /// The same with the verdict's effects.
    pub explained_deg: f64,
}

/// A whole diagnosis.
#[derive(Debug, Clone, Serialize)]
pub struct Diagnosis {
    /// Version of this document.
    pub schema: u32,
    /// Size of the gap.
    pub gap: Gap,
    /// Location of the gap.
    #[serde(rename = "where")]
    pub location: Location,
    /// All effects, most probable first.
    pub effects: Vec<EffectEntry>,
    /// Verdict.
    pub verdict: Verdict,
    /// Unexplained remainder.
    pub unknown: UnknownEntry,
    /// The logs.
    pub logs: Vec<LogEntry>,
    /// Compared sets, best first.
    pub rivals: Vec<Rival>,
}

impl Documented for TipProblem<'_> {
    type Document = Diagnosis;

    fn document(&self, judged: &Judged<Self>) -> Diagnosis {
        let (log, nominal, chosen) = (self.log, &self.nominal, judged.chosen());
        let verdict = judged.verdict.clone();
        let all = self.catalogue.iter();
        let mut effects: Vec<EffectEntry> = all.map(|e| self.entry(judged, *e)).collect();
        // of equally probable effects, the one that closes most comes first
        effects.sort_by(|a, b| b.closed.total_cmp(&a.closed));
        effects.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let credits = credits(&judged.found, chosen, self.gap());
        let probability = |s: &Candidate| (s.names[0], judged.posterior.effect(s.names[0]));
        let probabilities: Vec<_> = judged.found.singles.iter().map(probability).collect();
        let scores = [nominal, chosen].map(|c| &c.held_out);
        // with the calibration as given, only gravity, field and gyroscope bias are solved
        let given = nominal_theta(self.lines, log.rig.prior_lag_s);
        let as_configured = scored(log, &Model::new(&[]), &given).energy();
        Diagnosis {
            schema: 1,
            gap: Gap {
                as_configured_deg: log.rms_deg(as_configured),
                recalibrated_deg: log.rms_deg(nominal.energy()),
                explained_deg: log.rms_deg(chosen.energy()),
                noise_floor_deg: log.rms_deg(log.noise_energy()),
            },
            location: Location {
                stages: stages(&credits, &probabilities),
                merged: Self::merged(&verdict.equivalent),
                regions: location::regions(log, scores),
                when: location::stretches(log, scores),
                kinds: location::kinds(log, scores),
            },
            unknown: UnknownEntry {
                probability: verdict.doubt,
                rmse_deg: log.rms_deg((chosen.energy() - log.noise_energy()).max(0.0)),
                goes_with: goes_with(log, &chosen.held_out),
            },
            verdict,
            effects,
            logs: self.logs(&chosen.held_out),
            rivals: rivals(&judged.found),
        }
    }
}

impl TipProblem<'_> {
    /// The gap that recalibration leaves above noise, deg².
    fn gap(&self) -> f64 {
        (self.nominal.energy() - self.log.noise_energy()).max(1e-9)
    }

    /// Each log's part of the gap; the parts of all logs are in the ratio of their left-out residuals.
    fn logs(&self, chosen: &HeldOut) -> Vec<LogEntry> {
        let log = self.log;
        let deg = |of: &HeldOut, part: &Segment| {
            let there = |k: usize, q| of.residual[q][k] != Vector3::zeros();
            let within = |bins: Range<usize>| {
                let known = |k: usize| log.quantities().any(|q| there(k, q));
                let used = |k: usize| bins.contains(&k) && known(k);
                score(log, of.residual.clone(), used).energy()
            };
            let all = within(0..log.bins.len()).max(f64::MIN_POSITIVE);
            log.rms_deg(of.energy() * within(part.bins.clone()) / all)
        };
        let entry = |part: &Segment| LogEntry {
            file: part.file.clone(),
            recalibrated_deg: deg(&self.nominal.held_out, part),
            explained_deg: deg(chosen, part),
        };
        log.segments.iter().map(entry).collect()
    }

    fn entry(&self, judged: &Judged<Self>, e: &dyn Effect) -> EffectEntry {
        let (log, found, chosen) = (self.log, &judged.found, judged.chosen());
        let nominal = &self.nominal;
        // one of several effects is credited with what returns when it is taken out
        let rest = found.without(chosen, e.name()).unwrap_or(nominal);
        let (before, after) = if chosen.names.contains(&e.name()) {
            (rest, Some(chosen))
        } else {
            (nominal, found.set(&[e.name()]))
        };
        let with = after.unwrap_or(nominal);
        let closed = with.closed(before, self.gap());
        let scores = [before, with, nominal].map(|c| &c.held_out);
        EffectEntry {
            name: e.name(),
            stage: e.stage().name(),
            probability: judged.posterior.effect(e.name()),
            gap_before_deg: log.rms_deg(before.energy()),
            gap_after_deg: log.rms_deg(with.energy()),
            closed,
            closed_ci95: closed_ci95(scores, log.noise_energy(), closed, self.seed),
            params: after.map_or(vec![], |c| self.params(e, c)),
        }
    }

    /// Parameters of an effect in a candidate, with intervals widened for correlated residuals.
    fn params(&self, e: &dyn Effect, c: &Candidate) -> Vec<ParamValue> {
        let (log, model) = (self.log, &c.model);
        let Some(i) = model.position(e.name()) else {
            return vec![];
        };
        let independent = (log.duration_s() / CORRELATED_S).max(10.0);
        let variance = c.cost
            / (independent * 3.0 * log.quantities().count() as f64)
            / (log.bins.len() as f64 / independent);
        let inflation = variance * log.bins.len() as f64 / independent;
        let mut values = model.of(&c.theta, i).to_vec();
        let gains = c.lines().map(|l| l.k_epsilon);
        e.canonical(&mut values, &gains.into());
        let one = |(k, p): (usize, &Param)| {
            let at = model.at[i] + k;
            let variance = c.covariance[(at, at)].max(0.0) * inflation;
            let (value, half) = (values[k], 1.96 * variance.sqrt());
            let shown = |x: f64| p.shown(x).0;
            ParamValue {
                name: p.name,
                unit: p.shown(value).1,
                value: shown(value),
                ci95: [(value - half).max(p.low), (value + half).min(p.high)].map(shown),
                channel: p.channel,
            }
        };
        let absent = model.absent(&c.theta);
        let present = |(k, _): &(usize, &Param)| !absent[model.at[i] + k];
        let params = e.params().iter().enumerate();
        params.filter(present).map(one).collect()
    }

    /// Stages of each group that spans more than one.
    fn merged(groups: &[Vec<&'static str>]) -> Vec<Vec<&'static str>> {
        let of = |group: &Vec<&'static str>| {
            let stage = |name: &&'static str| by_name(name).map_or("", |e| e.stage().name());
            let mut stages: Vec<&'static str> = group.iter().map(stage).collect();
            stages.dedup();
            stages
        };
        groups.iter().map(of).filter(|s| s.len() > 1).collect()
    }
}

/// What the remainder depends on.
pub fn goes_with(log: &Observed, left: &HeldOut) -> Vec<Depends> {
    let mut told = dependences(log, &left.residual);
    told.retain(|d| d.gain > 0.0 && d.share >= TOLD);
    told.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    told
}

fn rivals(found: &Candidates<Candidate>) -> Vec<Rival> {
    let of = |c: &Candidate| Rival {
        names: c.names.clone(),
        energy_deg2: c.energy(),
        rmse_deg: c.held_out.rmse_deg,
        cost: c.cost,
    };
    let [singles, larger] = [&found.singles, &found.larger].map(|all| all.iter().take(RIVALS));
    let shown = singles.chain(larger).chain([&found.nominal]);
    let mut out: Vec<Rival> = shown.map(of).collect();
    out.sort_by(|a, b| a.energy_deg2.total_cmp(&b.energy_deg2));
    out
}
