//! Puts a diagnosis together: size of the gap, location, effects, verdict.

use crate::diagnosis::candidates::{Candidates, Scored};
use crate::diagnosis::tip::confusion::alike;
use crate::diagnosis::tip::credit::{credits, stages};
use crate::diagnosis::tip::document::{
    DependenceEntry, Diagnosis, EffectEntry, Gap, Location, LogEntry, ParamValue, Rival,
    StatementEntry, UnknownEntry, VerdictEntry,
};
use crate::diagnosis::tip::features::{HEAD, statements};
use crate::diagnosis::tip::fit::candidate::Candidate;
use crate::diagnosis::tip::fit::holdout::{HeldOut, score};
use crate::diagnosis::tip::fit::interval::{Compared, closed_ci95};
use crate::diagnosis::tip::location::BeforeAfter;
use crate::diagnosis::tip::model::chain::{Model, run};
use crate::diagnosis::tip::model::sense::{every_bin, sense};
use crate::diagnosis::tip::observed::dependence::dependences;
use crate::diagnosis::tip::observed::quantity::Quantity;
use crate::diagnosis::tip::observed::{CORRELATED_S, Observed, Segment};
use crate::diagnosis::tip::search::search;
use crate::diagnosis::verdict::decide::{Verdict, decide};
use crate::diagnosis::verdict::posterior::Posterior;
use crate::model::effects::Effect;
use crate::model::{Line, lines, nominal_theta};
use nalgebra::Vector3;

/// Least part of a remainder that a dependence must predict to be told.
const TOLD: f64 = 0.1;
/// Compared single effects, and larger sets, in the document.
const RIVALS: usize = 12;

/// A diagnosis and what it was made from.
pub struct Diagnosed {
    /// The document.
    pub document: Diagnosis,
    /// All candidates.
    pub found: Candidates<Candidate>,
    /// The verdict's candidate.
    pub chosen: Candidate,
}

/// Diagnoses a log against a catalogue; `lines` is the calibration the log was driven with, `seed` that of the
/// bootstrap.
pub fn diagnose(
    log: &Observed,
    catalogue: &[Box<dyn Effect>],
    lines: &[Line; 3],
    seed: u64,
) -> Diagnosed {
    let found = search(log, catalogue, lines);
    let set = |names: &[&str]| found.set(names).unwrap_or(&found.nominal);
    let alike = alike(log.has[Quantity::Reference]);
    let posterior = Posterior::new(&HEAD, statements(log, &found)).shared(&alike);
    let verdict = decide(&posterior, &alike, |_| vec![]);
    let chosen = set(&verdict.names);
    let probabilities: Vec<_> = found
        .singles
        .iter()
        .map(|s| (s.names[0], posterior.effect(s.names[0])))
        .collect();
    let conformal = StatementEntry::conformal(&posterior);
    let assembly = Assembly {
        log,
        catalogue,
        found: &found,
        chosen,
        probabilities: &probabilities,
        conformal,
        seed,
    };
    let document = assembly.document(verdict, lines);
    let chosen = chosen.clone();
    Diagnosed {
        document,
        found,
        chosen,
    }
}

/// What the remainder depends on.
pub fn goes_with(log: &Observed, left: &HeldOut) -> Vec<DependenceEntry> {
    let mut told = dependences(log, &left.residual).to_vec();
    told.retain(|d| d.gain > 0.0 && d.share >= TOLD);
    told.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    told.into_iter()
        .map(|d| DependenceEntry {
            name: d.on.name(),
            share: d.share,
        })
        .collect()
}

/// What a document is assembled from.
struct Assembly<'a> {
    log: &'a Observed,
    catalogue: &'a [Box<dyn Effect>],
    found: &'a Candidates<Candidate>,
    chosen: &'a Candidate,
    probabilities: &'a [(&'static str, f64)],
    conformal: Vec<StatementEntry>,
    seed: u64,
}

impl Assembly<'_> {
    fn document(&self, verdict: Verdict, lines: &[Line; 3]) -> Diagnosis {
        let (log, found, chosen) = (self.log, self.found, self.chosen);
        let mut effects: Vec<EffectEntry> = self
            .catalogue
            .iter()
            .map(|e| self.entry(e.as_ref()))
            .collect();
        effects.sort_by(|a, b| {
            b.probability
                .total_cmp(&a.probability)
                .then(b.closed.total_cmp(&a.closed))
        });
        let place = BeforeAfter {
            log,
            before: &found.nominal.held_out,
            after: &chosen.held_out,
        };
        Diagnosis {
            schema: 1,
            gap: Gap {
                as_configured_deg: log.rms_deg(as_configured(log, lines)),
                recalibrated_deg: log.rms_deg(found.nominal.energy()),
                explained_deg: log.rms_deg(chosen.energy()),
                noise_floor_deg: log.rms_deg(log.noise_energy()),
            },
            location: Location {
                stages: stages(
                    self.catalogue,
                    &credits(found, chosen, gap(log, found)),
                    self.probabilities,
                ),
                merged: self.merged(&verdict.equivalent),
                regions: place.regions(),
                when: place.when(),
                kinds: place.quantities(),
            },
            unknown: UnknownEntry {
                probability: verdict.doubt,
                rmse_deg: log.rms_deg((chosen.energy() - log.noise_energy()).max(0.0)),
                goes_with: goes_with(log, &chosen.held_out),
            },
            verdict: VerdictEntry {
                kind: verdict.kind,
                names: verdict.names,
                probability: verdict.probability,
                equivalent: verdict.equivalent,
                conformal: self.conformal.clone(),
            },
            effects,
            logs: self.logs(),
            rivals: rivals(found),
        }
    }

    /// Each log's part of the gap; the parts of all logs are in the ratio of their left-out residuals.
    fn logs(&self) -> Vec<LogEntry> {
        let deg = |of: &HeldOut, part: &Segment| {
            let energy =
                |used: &dyn Fn(usize) -> bool| score(self.log, of.residual.clone(), used).energy();
            let scored = |k: usize| {
                self.log
                    .quantities()
                    .any(|q| of.residual[q][k] != Vector3::zeros())
            };
            let all = energy(&scored).max(f64::MIN_POSITIVE);
            self.log
                .rms_deg(of.energy() * energy(&|k| part.bins.contains(&k) && scored(k)) / all)
        };
        let entry = |part: &Segment| LogEntry {
            file: part.file.clone(),
            recalibrated_deg: deg(&self.found.nominal.held_out, part),
            explained_deg: deg(&self.chosen.held_out, part),
        };
        self.log.segments.iter().map(entry).collect()
    }

    fn entry(&self, e: &dyn Effect) -> EffectEntry {
        let (log, found, chosen) = (self.log, self.found, self.chosen);
        let nominal = &found.nominal;
        // one of several effects is credited with what returns when it is taken out
        let (before, after) = if chosen.names.contains(&e.name()) {
            (
                found.without(chosen, e.name()).unwrap_or(nominal),
                Some(chosen),
            )
        } else {
            (nominal, found.single(e.name()))
        };
        let with = after.unwrap_or(nominal);
        let closed = ((before.energy() - with.energy()) / gap(log, found)).clamp(-1.0, 1.0);
        let compared = Compared {
            before: &before.held_out,
            after: &with.held_out,
            nominal: &nominal.held_out,
            floor: log.noise_energy(),
        };
        EffectEntry {
            name: e.name(),
            stage: e.stage().name(),
            probability: self
                .probabilities
                .iter()
                .find(|p| p.0 == e.name())
                .map_or(0.0, |p| p.1),
            gap_before_deg: log.rms_deg(before.energy()),
            gap_after_deg: log.rms_deg(with.energy()),
            closed,
            closed_ci95: closed_ci95(&compared, closed, self.seed),
            params: after.map_or(vec![], |c| self.params(e, c)),
        }
    }

    /// Parameters of an effect in a candidate, with intervals widened for correlated residuals.
    fn params(&self, e: &dyn Effect, c: &Candidate) -> Vec<ParamValue> {
        let log = self.log;
        let model = Model::named(self.catalogue, &c.names);
        let Some(i) = model.effects.iter().position(|x| x.name() == e.name()) else {
            return vec![];
        };
        let independent = (log.duration_s() / CORRELATED_S).max(10.0);
        let variance = c.fitted.cost
            / (independent * 3.0 * log.quantities().count() as f64)
            / (log.bins.len() as f64 / independent);
        let inflation = variance * log.bins.len() as f64 / independent;
        let mut values = model.of(&c.fitted.theta, i).to_vec();
        e.canonical(
            &mut values,
            &Vector3::from(lines(&c.fitted.theta).map(|l| l.k_epsilon)),
        );
        let one = |(k, p): (usize, &crate::model::effects::Param)| {
            let at = model.at[i] + k;
            let (value, half) = (
                values[k],
                1.96 * (c.fitted.covariance[(at, at)].max(0.0) * inflation).sqrt(),
            );
            let shown = |x: f64| p.shown(x).0;
            ParamValue {
                name: p.name,
                unit: p.shown(value).1,
                value: shown(value),
                ci95: [
                    shown((value - half).max(p.low)),
                    shown((value + half).min(p.high)),
                ],
                channel: p.channel,
            }
        };
        e.params().iter().enumerate().map(one).collect()
    }

    /// Stages of each group that spans more than one.
    fn merged(&self, groups: &[Vec<&'static str>]) -> Vec<Vec<&'static str>> {
        let stage = |name: &str| {
            self.catalogue
                .iter()
                .find(|e| e.name() == name)
                .map_or("", |e| e.stage().name())
        };
        let of = |group: &Vec<&'static str>| {
            let mut stages: Vec<&'static str> = group.iter().map(|n| stage(n)).collect();
            stages.dedup();
            stages
        };
        groups.iter().map(of).filter(|s| s.len() > 1).collect()
    }
}

/// The gap that recalibration leaves above noise, deg².
fn gap(log: &Observed, found: &Candidates<Candidate>) -> f64 {
    (found.nominal.energy() - log.noise_energy()).max(1e-9)
}

fn rivals(found: &Candidates<Candidate>) -> Vec<Rival> {
    let of = |c: &Candidate| Rival {
        names: c.names.clone(),
        energy_deg2: c.energy(),
        rmse_deg: c.held_out.rmse_deg,
        cost: c.fitted.cost,
    };
    let shown = found
        .singles
        .iter()
        .take(RIVALS)
        .chain(found.larger.iter().take(RIVALS))
        .chain([&found.nominal]);
    let mut out: Vec<Rival> = shown.map(of).collect();
    out.sort_by(|a, b| a.energy_deg2.total_cmp(&b.energy_deg2));
    out
}

/// Energy with the calibration as given, deg²; only gravity, field and gyroscope bias are solved.
fn as_configured(log: &Observed, lines: &[Line; 3]) -> f64 {
    let (model, theta) = (Model::new(&[]), nominal_theta(lines, log.rig.prior_lag_s));
    score(
        log,
        sense(log, &model, &theta, &run(log, &model, &theta), every_bin),
        every_bin,
    )
    .energy()
}
