//! Scores of an exam.

use crate::diagnosis::verdict::{Verdict, VerdictKind};
use crate::experiment::arm::percentile;
use crate::experiment::exam::{Answer, Content, Question};
use crate::model::effects::by_name;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Least probability of an effect that enters the reliability: the many improbable effects would hide the error of the others.
const PROBABLE: f64 = 0.02;

/// Right answers out of all.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// Right answers.
    pub right: usize,
    /// All answers.
    pub of: usize,
}

impl Count {
    fn of(marks: impl Iterator<Item = bool>) -> Self {
        let mut out = Self::default();
        marks.for_each(|right| out.add(right));
        out
    }

    fn add(&mut self, right: bool) {
        (self.right, self.of) = (self.right + usize::from(right), self.of + 1);
    }

    /// Share of right answers; 0 without answers.
    pub fn share(&self) -> f64 {
        self.right as f64 / self.of.max(1) as f64
    }
}

/// Counts with a tracker and without.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Counts {
    /// With the tracker.
    pub lab: Count,
    /// With the IMU alone.
    pub field: Count,
}

/// Counts that every method has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Method {
    /// The single effect named, and nothing else.
    pub single: Counts,
    /// Both effects of a pair named, and nothing else.
    pub pair: Counts,
    /// All effects of three named, and nothing else.
    pub triple: Counts,
    /// Effect-free logs with a claim (`right` counts the claims).
    pub alarm: Counts,
    /// Mean F1 over all effects, `none` and `unknown`.
    pub macro_f1: f64,
}

/// How often statements of about the same probability are true.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReliabilityBin {
    /// Mean of the stated probabilities.
    pub stated: f64,
    /// True statements out of all.
    pub count: Count,
    /// 95 % interval of the frequency (Wilson, *JASA* 1927).
    pub ci95: [f64; 2],
}

/// Stated probabilities beside frequencies.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Reliability {
    /// Up to ten bins of equal width that have statements.
    pub bins: Vec<ReliabilityBin>,
    /// Mean distance of the two, weighted by the number of statements (Naeini et al., AAAI 2015).
    pub error: f64,
}

impl Reliability {
    fn of(said: impl Iterator<Item = (f64, bool)>) -> Self {
        let mut sums = [(0.0, Count::default()); 10];
        for (p, right) in said {
            let bin = &mut sums[((p * 10.0) as usize).min(9)];
            bin.0 += p;
            bin.1.add(right);
        }
        let all: usize = sums.iter().map(|b| b.1.of).sum();
        let wrong: f64 = sums.iter().map(|(p, c)| (p - c.right as f64).abs()).sum();
        let filled = sums.iter().filter(|b| b.1.of > 0);
        let bin = |&(p, count): &(f64, Count)| ReliabilityBin {
            stated: p / count.of as f64,
            count,
            ci95: wilson(&count),
        };
        Self {
            bins: filled.map(bin).collect(),
            error: wrong / all.max(1) as f64,
        }
    }
}

/// 95 % interval of a frequency.
fn wilson(c: &Count) -> [f64; 2] {
    let (n, p, z2) = (c.of as f64, c.share(), 1.96 * 1.96);
    let half = 1.96 * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
    [-half, half].map(|side| ((p + z2 / (2.0 * n) + side) / (1.0 + z2 / n)).clamp(0.0, 1.0))
}

/// Score of an exam.
#[derive(Debug, Clone, Serialize)]
pub struct ExamScore {
    /// Seed of the exam.
    pub seed: u64,
    /// Number of logs.
    pub logs: usize,
    /// The diagnosis.
    pub diagnosis: Method,
    /// Stage with the largest share right, on single effects.
    pub stage: Counts,
    /// `unknown` for effects outside the catalogue.
    pub outside: Counts,
    /// The same for those of them that are not too small to be claimed.
    pub outside_visible: Counts,
    /// `unknown` for effects whose entry was removed from the catalogue.
    pub left_out: Counts,
    /// Probabilities of effects, on all logs.
    pub effects: Reliability,
    /// Probability of a cause outside the catalogue, on all logs.
    pub unknown: Reliability,
    /// Conformal sets that contain the truth.
    pub conformal: Counts,
    /// Mean number of statements in a conformal set.
    pub conformal_size: f64,
    /// Logs with a stated group of effects that the log cannot separate.
    pub grouped: Count,
    /// Verdict `unknown` for effects of the catalogue.
    pub known_called_unknown: Count,
    /// Median part of the gap closed on a fresh log, single effects: with the tracker and without.
    pub fresh_closed: [f64; 2],
    /// Stated 95 % intervals that contain the part closed on the fresh log.
    pub coverage: Counts,
    /// In-sample BIC.
    pub bic: Method,
    /// Sparse regression.
    pub sparse: Method,
    /// Nearest signature.
    pub nearest: Method,
    /// Truth → answer → count.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
}

/// The verdict of one of the other methods.
fn other(names: &[&'static str]) -> Verdict {
    Verdict {
        kind: VerdictKind::of(Some(names)),
        names: names.to_vec(),
        ..Verdict::default()
    }
}

/// Whether a verdict names the true effects, and nothing else. An effect counts as named if it is in a stated group with the given name.
fn names_all(v: &Verdict, truth: &[&str]) -> bool {
    let groups = &v.equivalent;
    let grouped = |n: &str, t: &str| groups.iter().any(|g| g.contains(&n) && g.contains(&t));
    let named = |t: &&str| v.names.iter().any(|n| n == t || grouped(n, t));
    let as_many = v.names.len() == truth.len();
    v.kind == VerdictKind::Effects && as_many && truth.iter().all(named)
}

/// The names, or the kind of a statement without names.
fn class(kind: VerdictKind, names: &[&str]) -> String {
    match kind {
        VerdictKind::Effects => joined(names),
        other => other.name().to_owned(),
    }
}

fn joined(names: &[&str]) -> String {
    let mut names = names.to_vec();
    names.sort_unstable();
    names.join("+")
}

/// True class of a question.
fn truth(q: &Question) -> String {
    match q.content {
        Content::None => VerdictKind::None.name().to_owned(),
        Content::Outside => VerdictKind::Unknown.name().to_owned(),
        Content::Single | Content::Pair | Content::Triple => joined(&q.truth()),
    }
}

type Answered<'a> = (&'a Question, &'a Answer);

/// Scores all answers.
pub fn score(seed: u64, questions: &[Question], answers: &[Answer]) -> ExamScore {
    let all: Vec<Answered<'_>> = questions.iter().zip(answers).collect();
    let bic = method(&all, |a| other(&a.others.bic));
    let sparse = method(&all, |a| other(&a.others.sparse));
    let nearest = method(&all, |a| other(&a.others.nearest));
    let says_unknown = |a: &Answer| a.diagnosis.verdict.kind == VerdictKind::Unknown;
    let covered = |_: &Question, a: &Answer| {
        let first = a.diagnosis.effects.first();
        let [low, high] = first.map_or([0.0, 0.0], |e| e.closed_ci95);
        (low..=high).contains(&a.fresh_closed.clamp(-1.0, 1.0))
    };
    let stage = |q: &Question, a: &Answer| {
        let first = a.diagnosis.location.stages.first().map(|s| s.name);
        first == by_name(q.truth()[0]).map(|e| e.stage().name())
    };
    let left_out = |_: &Question, a: &Answer| a.left_out.map(|kind| kind == VerdictKind::Unknown);
    let outside = |q: &Question| q.content == Content::Outside;
    let visible = |q: &Question, a: &Answer| (outside(q) && !a.hidden).then(|| says_unknown(a));
    let unknown = |(q, a): &Answered<'_>| (a.diagnosis.unknown.probability, outside(q));
    let closed = |lab: bool| {
        let single = |(q, _): &&Answered<'_>| q.content == Content::Single && q.lab == lab;
        let closed = all.iter().filter(single).map(|(_, a)| a.fresh_closed);
        percentile(closed, 0.5)
    };
    let known = |q: &Question| !matches!(q.content, Content::None | Content::Outside);
    let known = all.iter().filter(|(q, _)| known(q));
    let verdicts = || all.iter().map(|(_, a)| &a.diagnosis.verdict);
    let sizes = verdicts().map(|v| v.conformal.len());
    let grouped = verdicts().map(|v| !v.equivalent.is_empty());
    ExamScore {
        seed,
        logs: all.len(),
        diagnosis: method(&all, |a| a.diagnosis.verdict.clone()),
        stage: row(&all, Content::Single, stage),
        outside: row(&all, Content::Outside, |_, a| says_unknown(a)),
        outside_visible: counted(&all, visible),
        left_out: counted(&all, left_out),
        effects: Reliability::of(all.iter().flat_map(said_of_effects)),
        unknown: Reliability::of(all.iter().map(unknown)),
        conformal: counted(&all, |q, a| Some(holds_truth(q, a))),
        conformal_size: sizes.sum::<usize>() as f64 / all.len().max(1) as f64,
        grouped: Count::of(grouped),
        known_called_unknown: Count::of(known.map(|(_, a)| says_unknown(a))),
        fresh_closed: [true, false].map(closed),
        coverage: row(&all, Content::Single, covered),
        bic,
        sparse,
        nearest,
        confusion: confusion(&all),
    }
}

/// The probabilities of the effects that an answer holds for possible, and whether each is there.
fn said_of_effects<'a>((q, a): &Answered<'a>) -> impl Iterator<Item = (f64, bool)> + use<'a> {
    let (q, effects) = (*q, &a.diagnosis.effects);
    let said = effects.iter().filter(|e| e.probability > PROBABLE);
    said.map(move |e| {
        let there = q.truth().contains(&e.name) && q.content != Content::Outside;
        (e.probability, there)
    })
}

/// Counts of the answers for which `right` tells whether they are right.
fn counted(all: &[Answered<'_>], right: impl Fn(&Question, &Answer) -> Option<bool>) -> Counts {
    let [lab, field] = [true, false].map(|lab| {
        let here = all.iter().filter(|(q, _)| q.lab == lab);
        Count::of(here.filter_map(|(q, a)| right(q, a)))
    });
    Counts { lab, field }
}

fn row(all: &[Answered<'_>], of: Content, right: impl Fn(&Question, &Answer) -> bool) -> Counts {
    counted(all, |q, a| (q.content == of).then(|| right(q, a)))
}

/// Counts of a method that says `verdict` of a log.
fn method(all: &[Answered<'_>], verdict: impl Fn(&Answer) -> Verdict) -> Method {
    let right = |q: &Question, a: &Answer| names_all(&verdict(a), &q.truth());
    let claims = |_: &Question, a: &Answer| verdict(a).kind != VerdictKind::None;
    Method {
        single: row(all, Content::Single, right),
        pair: row(all, Content::Pair, right),
        triple: row(all, Content::Triple, right),
        alarm: row(all, Content::None, claims),
        macro_f1: macro_f1(all, &verdict),
    }
}

fn confusion(all: &[Answered<'_>]) -> BTreeMap<String, BTreeMap<String, usize>> {
    let mut out: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for (q, a) in all {
        let truth = match q.content {
            Content::Outside => format!("unknown ({})", q.names[0]),
            _ => truth(q),
        };
        let (answers, v) = (out.entry(truth).or_default(), &a.diagnosis.verdict);
        *answers.entry(class(v.kind, &v.names)).or_default() += 1;
    }
    out
}

/// Mean F1 over the classes of single effects, effect-free logs and outside effects.
fn macro_f1(all: &[Answered<'_>], verdict: impl Fn(&Answer) -> Verdict) -> f64 {
    let answer = |a: &Answer| {
        let v = verdict(a);
        class(v.kind, &v.names)
    };
    let alone = |(q, _): &&Answered<'_>| !matches!(q.content, Content::Pair | Content::Triple);
    let asked = all.iter().filter(alone);
    let asked: Vec<(String, String)> = asked.map(|(q, a)| (truth(q), answer(a))).collect();
    let classes: BTreeSet<&String> = asked.iter().map(|(t, _)| t).collect();
    let f1 = |c: &&String| {
        let hit = asked.iter().filter(|(t, s)| t == *c && s == *c).count() as f64;
        let wrong = asked.iter().filter(|(t, s)| (t == *c) != (s == *c)).count() as f64;
        2.0 * hit / (2.0 * hit + wrong).max(1.0)
    };
    classes.iter().map(f1).sum::<f64>() / classes.len().max(1) as f64
}

/// Whether the conformal set of an answer contains the true statement.
fn holds_truth(q: &Question, a: &Answer) -> bool {
    let mut statements = a.diagnosis.verdict.conformal.iter();
    statements.any(|s| class(s.kind, &s.names) == truth(q))
}
