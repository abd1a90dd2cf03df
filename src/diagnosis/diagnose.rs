//! Puts a diagnosis together: size of the gap, location, effects, verdict.

use crate::diagnosis::chain::{Model, run};
use crate::diagnosis::confusion::EQUIVALENT_WITHOUT_TRACKER;
use crate::diagnosis::credit::{credits, stages};
use crate::diagnosis::decide::{Verdict, decide};
use crate::diagnosis::document::{Diagnosis, EffectEntry, Gap, Location, LogEntry, ParamValue, Rival, UnknownEntry, VerdictEntry};
use crate::diagnosis::holdout::{HeldOut, score};
use crate::diagnosis::interval::{Compared, closed_ci95};
use crate::diagnosis::location::BeforeAfter;
use crate::diagnosis::observe::{Observed, Segment};
use crate::diagnosis::quantity::Quantity;
use crate::diagnosis::search::{Candidate, Candidates, search};
use crate::diagnosis::sense::{every_bin, sense};
use crate::model::effects::Effect;
use crate::model::{Line, lines, nominal_theta};
use nalgebra::Vector3;

/// Share of the gap by which energies must differ for their probabilities to differ by a factor e.
const TEMPERATURE: f64 = 0.04;
/// Handicap, in natural logarithms, of every set other than the verdict's, and the same per effect of difference in size.
const HANDICAP: f64 = 2.0;
/// Energies closer than this share of the gap are equal.
const EQUAL_SHARE: f64 = 0.02;
/// Residuals are correlated over about this long, s: one independent observation per stretch.
const CORRELATED_S: f64 = 2.0;
/// Compared sets of each size in the document.
const RIVALS: usize = 12;

/// A diagnosis and what it was made from.
pub struct Diagnosed {
    /// The document.
    pub document: Diagnosis,
    /// All candidates.
    pub found: Candidates,
    /// The verdict's candidate.
    pub chosen: Candidate,
}

/// Diagnoses a log against a catalogue; `lines` is the calibration the log was driven with, `seed` that of the
/// bootstrap.
pub fn diagnose(log: &Observed, catalogue: &[Box<dyn Effect>], lines: &[Line; 3], seed: u64) -> Diagnosed {
    let found = search(log, catalogue, lines);
    let (verdict, chosen) = decide(log, &found);
    let probabilities = probabilities(log, &found, &verdict, chosen);
    let assembly = Assembly { log, catalogue, found: &found, chosen, probabilities: &probabilities, seed };
    let document = assembly.document(verdict, lines);
    let chosen = chosen.clone();
    Diagnosed { document, found, chosen }
}

/// Probability of each effect by name: the candidates weighted by the energy they leave.
fn probabilities(log: &Observed, found: &Candidates, verdict: &Verdict, chosen: &Candidate) -> Vec<(&'static str, f64)> {
    let unit = (TEMPERATURE * (found.nominal.energy() - log.noise_energy())).max(0.05);
    let weight = |c: &Candidate| {
        let size = c.names.len().abs_diff(verdict.names.len()) as f64;
        let behind = ((c.energy() - chosen.energy()) / unit).max(0.0) + HANDICAP + HANDICAP * size;
        if c.names == verdict.names { 1.0 } else { (-behind).exp() }
    };
    let weighted: Vec<(&Candidate, f64)> = found.all().map(|c| (c, weight(c))).collect();
    let total: f64 = weighted.iter().map(|r| r.1).sum();
    let of = |name: &'static str| {
        let with = weighted.iter().filter(|(c, _)| c.names.contains(&name));
        (name, with.fold(0.0, |sum, (_, w)| sum + w / total))
    };
    found.singles.iter().map(|s| of(s.names[0])).collect()
}

/// What a document is assembled from.
struct Assembly<'a> {
    log: &'a Observed,
    catalogue: &'a [Box<dyn Effect>],
    found: &'a Candidates,
    chosen: &'a Candidate,
    probabilities: &'a [(&'static str, f64)],
    seed: u64,
}

impl Assembly<'_> {
    fn document(&self, verdict: Verdict, lines: &[Line; 3]) -> Diagnosis {
        let (log, found, chosen) = (self.log, self.found, self.chosen);
        let mut effects: Vec<EffectEntry> = self.catalogue.iter().map(|e| self.entry(e.as_ref())).collect();
        effects.sort_by(|a, b| b.probability.total_cmp(&a.probability).then(b.closed.total_cmp(&a.closed)));
        let equivalent = self.equivalent(&verdict);
        let place = BeforeAfter { log, before: &found.nominal.held_out, after: &chosen.held_out };
        Diagnosis {
            schema: 1,
            gap: Gap {
                as_configured_deg: log.rms_deg(as_configured(log, lines)),
                recalibrated_deg: log.rms_deg(found.nominal.energy()),
                explained_deg: log.rms_deg(chosen.energy()),
                noise_floor_deg: log.rms_deg(log.noise_energy()),
            },
            location: Location {
                stages: stages(self.catalogue, &credits(found, chosen, found.gap(log)), self.probabilities),
                merged: self.merged(&equivalent),
                regions: place.regions(),
                when: place.when(),
                kinds: place.quantities(),
            },
            unknown: UnknownEntry {
                probability: verdict.doubt,
                rmse_deg: log.rms_deg((chosen.energy() - log.noise_energy()).max(0.0)),
                predictable_deg_s: verdict.predictable_deg_s,
            },
            verdict: VerdictEntry { kind: verdict.kind, names: verdict.names, equivalent },
            effects,
            logs: self.logs(),
            rivals: rivals(found),
        }
    }

    /// Each log's part of the gap; the parts of all logs are in the ratio of their left-out residuals.
    fn logs(&self) -> Vec<LogEntry> {
        let deg = |of: &HeldOut, part: &Segment| {
            let energy = |used: &dyn Fn(usize) -> bool| score(self.log, of.residual.clone(), used).energy();
            let scored = |k: usize| self.log.quantities().any(|q| of.residual[q][k] != Vector3::zeros());
            let all = energy(&scored).max(f64::MIN_POSITIVE);
            self.log.rms_deg(of.energy() * energy(&|k| part.bins.contains(&k) && scored(k)) / all)
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
        // a member of a pair is credited with what returns when it is taken out
        let (before, after) = if chosen.names.contains(&e.name()) && chosen.names.len() > 1 {
            let rest = found.singles.iter().find(|s| chosen.names.contains(&s.names[0]) && s.names[0] != e.name());
            (rest.unwrap_or(nominal), Some(chosen))
        } else {
            (nominal, found.single(e.name()))
        };
        let with = after.unwrap_or(nominal);
        let closed = ((before.energy() - with.energy()) / found.gap(log)).clamp(-1.0, 1.0);
        let compared = Compared { before: &before.held_out, after: &with.held_out, nominal: &nominal.held_out, floor: log.noise_energy() };
        EffectEntry {
            name: e.name(),
            stage: e.stage().name(),
            probability: self.probabilities.iter().find(|p| p.0 == e.name()).map_or(0.0, |p| p.1),
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
        let Some(i) = model.effects.iter().position(|x| x.name() == e.name()) else { return vec![] };
        let independent = (log.duration_s() / CORRELATED_S).max(10.0);
        let variance = c.fitted.cost / (independent * 3.0 * log.quantities().count() as f64) / (log.bins.len() as f64 / independent);
        let inflation = variance * log.bins.len() as f64 / independent;
        let mut values = model.of(&c.fitted.theta, i).to_vec();
        e.canonical(&mut values, &Vector3::from(lines(&c.fitted.theta).map(|l| l.k_epsilon)));
        let one = |(k, p): (usize, &crate::model::effects::Param)| {
            let at = model.at[i] + k;
            let (value, half) = (values[k], 1.96 * (c.fitted.covariance[(at, at)].max(0.0) * inflation).sqrt());
            let shown = |x: f64| p.shown(x).0;
            ParamValue {
                name: p.name,
                unit: p.shown(value).1,
                value: shown(value),
                ci95: [shown((value - half).max(p.low)), shown((value + half).min(p.high))],
                channel: p.channel,
            }
        };
        e.params().iter().enumerate().map(one).collect()
    }

    /// Groups of effects, one of them in the verdict, that this log cannot separate.
    fn equivalent(&self, verdict: &Verdict) -> Vec<Vec<&'static str>> {
        let equal = EQUAL_SHARE * (self.found.nominal.energy() - self.log.noise_energy());
        let energy = |name: &str| self.found.single(name).map(Candidate::energy);
        EQUIVALENT_WITHOUT_TRACKER
            .iter()
            .filter(|pair| pair.iter().any(|n| verdict.names.contains(n)) && !self.log.has[Quantity::Reference])
            .filter(|[a, b]| matches!((energy(a), energy(b)), (Some(a), Some(b)) if (a - b).abs() < equal))
            .map(|pair| self.found.singles.iter().map(|s| s.names[0]).filter(|n| pair.contains(n)).collect())
            .collect()
    }

    /// Stages of each group that spans more than one.
    fn merged(&self, groups: &[Vec<&'static str>]) -> Vec<Vec<&'static str>> {
        let stage = |name: &str| self.catalogue.iter().find(|e| e.name() == name).map_or("", |e| e.stage().name());
        let of = |group: &Vec<&'static str>| {
            let mut stages: Vec<&'static str> = group.iter().map(|n| stage(n)).collect();
            stages.dedup();
            stages
        };
        groups.iter().map(of).filter(|s| s.len() > 1).collect()
    }
}

fn rivals(found: &Candidates) -> Vec<Rival> {
    let of = |c: &Candidate| Rival { names: c.names.clone(), energy_deg2: c.energy(), rmse_deg: c.held_out.rmse_deg, cost: c.fitted.cost };
    let shown = found.singles.iter().take(RIVALS).chain(found.pairs.iter().take(RIVALS)).chain([&found.nominal]);
    let mut out: Vec<Rival> = shown.map(of).collect();
    out.sort_by(|a, b| a.energy_deg2.total_cmp(&b.energy_deg2));
    out
}

/// Energy with the calibration as given, deg²; only gravity, field and gyroscope bias are solved.
fn as_configured(log: &Observed, lines: &[Line; 3]) -> f64 {
    let (model, theta) = (Model::new(&[]), nominal_theta(lines, log.rig.prior_lag_s));
    score(log, sense(log, &model, &theta, &run(log, &model, &theta), every_bin), every_bin).energy()
}
