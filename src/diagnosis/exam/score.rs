//! Scores of an exam.

use crate::diagnosis::decide::VerdictKind;
use crate::diagnosis::exam::question::{Content, Question};
use crate::diagnosis::exam::run::Answer;
use crate::model::effects::by_name;
use serde::Serialize;
use std::collections::BTreeMap;

/// Least probability of an effect that enters the calibration error.
const PROBABLE: f64 = 0.05;

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
        marks.fold(Self::default(), |c, right| Self { right: c.right + usize::from(right), of: c.of + 1 })
    }

    /// Share of right answers; 0 without answers.
    pub fn share(&self) -> f64 {
        self.right as f64 / self.of.max(1) as f64
    }
}

/// Counts with a tracker and without.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Row {
    /// With the tracker.
    pub lab: Count,
    /// With the IMU alone.
    pub field: Count,
}

/// Counts that every method has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Method {
    /// The single effect named, and nothing else.
    pub single: Row,
    /// Both effects of a pair named, and nothing else.
    pub pair: Row,
    /// Effect-free logs with a claim (`right` counts the claims).
    pub alarm: Row,
    /// Mean F1 over all effects, `none` and `unknown`.
    pub macro_f1: f64,
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
    pub stage: Row,
    /// `unknown` for effects outside the catalogue.
    pub outside: Row,
    /// `unknown` for effects whose entry was removed from the catalogue.
    pub left_out: Row,
    /// Mean distance of stated probabilities from frequencies.
    pub calibration_error: f64,
    /// Median part of the gap closed on a fresh log, single effects: with the tracker and without.
    pub fresh_closed: [f64; 2],
    /// Stated 95 % intervals that contain the part closed on the fresh log.
    pub coverage: Row,
    /// In-sample BIC.
    pub bic: Method,
    /// Sparse regression.
    pub sparse: Method,
    /// Nearest signature.
    pub nearest: Method,
    /// Truth → answer → count.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
}

/// What a method reports of a log.
struct Report {
    kind: VerdictKind,
    names: Vec<&'static str>,
    equivalent: Vec<Vec<&'static str>>,
}

impl Report {
    /// The diagnosis' own verdict.
    fn own(a: &Answer) -> Self {
        let v = &a.diagnosis.verdict;
        Self { kind: v.kind, names: v.names.clone(), equivalent: v.equivalent.clone() }
    }

    /// The verdict of another method.
    fn other(a: &Answer, which: usize) -> Self {
        let names = a.others[which].clone();
        Self { kind: VerdictKind::new(names.is_empty(), false), names, equivalent: vec![] }
    }

    /// Whether it names the true effects, and nothing else. An effect counts as named if it is in a stated group with the
    /// given name.
    fn names_all(&self, truth: &[&str]) -> bool {
        let same = |name: &str, truth: &str| name == truth || self.equivalent.iter().any(|g| g.contains(&name) && g.contains(&truth));
        self.kind == VerdictKind::Effects && self.names.len() == truth.len() && truth.iter().all(|t| self.names.iter().any(|n| same(n, t)))
    }

    fn class(&self) -> String {
        if self.kind == VerdictKind::Effects { joined(&self.names) } else { self.kind.name().to_owned() }
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
        Content::Single | Content::Pair => joined(&q.names),
    }
}

type Answered<'a> = (&'a Question, &'a Answer);

/// Scores all answers.
pub fn score(seed: u64, questions: &[Question], answers: &[Answer]) -> ExamScore {
    let all: Vec<Answered<'_>> = questions.iter().zip(answers).collect();
    let [bic, sparse, nearest] = [0, 1, 2].map(|which| method(&all, |a| Report::other(a, which)));
    let covered = |a: &Answer| {
        let ci = a.diagnosis.effects.first().map_or([0.0, 0.0], |e| e.closed_ci95);
        (ci[0]..=ci[1]).contains(&a.fresh_closed.clamp(-1.0, 1.0))
    };
    let stage = |q: &Question, a: &Answer| {
        let first = a.diagnosis.location.stages.first().map(|s| s.name);
        first == by_name(q.names[0]).map(|e| e.stage().name())
    };
    let singles = |lab: bool| all.iter().filter(move |(q, _)| q.content == Content::Single && q.lab == lab);
    let left_out = |lab| Count::of(singles(lab).filter_map(|(_, a)| a.left_out).map(|kind| kind == VerdictKind::Unknown));
    ExamScore {
        seed,
        logs: all.len(),
        diagnosis: method(&all, Report::own),
        stage: row(&all, Content::Single, stage),
        outside: row(&all, Content::Outside, |_, a| a.diagnosis.verdict.kind == VerdictKind::Unknown),
        left_out: Row { lab: left_out(true), field: left_out(false) },
        calibration_error: calibration_error(&all),
        fresh_closed: [true, false].map(|lab| median(singles(lab).map(|(_, a)| a.fresh_closed).collect())),
        coverage: row(&all, Content::Single, |_, a| covered(a)),
        bic,
        sparse,
        nearest,
        confusion: confusion(&all),
    }
}

fn row(all: &[Answered<'_>], content: Content, right: impl Fn(&Question, &Answer) -> bool) -> Row {
    let count = |lab: bool| Count::of(all.iter().filter(|(q, _)| q.content == content && q.lab == lab).map(|(q, a)| right(q, a)));
    Row { lab: count(true), field: count(false) }
}

fn method(all: &[Answered<'_>], report: impl Fn(&Answer) -> Report) -> Method {
    Method {
        single: row(all, Content::Single, |q, a| report(a).names_all(&q.names)),
        pair: row(all, Content::Pair, |q, a| report(a).names_all(&q.names)),
        alarm: row(all, Content::None, |_, a| report(a).kind != VerdictKind::None),
        macro_f1: macro_f1(all, |a| report(a).class()),
    }
}

fn confusion(all: &[Answered<'_>]) -> BTreeMap<String, BTreeMap<String, usize>> {
    let mut out: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for (q, a) in all {
        let truth = if q.content == Content::Outside { format!("unknown ({})", q.names[0]) } else { truth(q) };
        *out.entry(truth).or_default().entry(Report::own(a).class()).or_default() += 1;
    }
    out
}

/// Mean F1 over the classes of single effects, effect-free logs and outside effects.
fn macro_f1(all: &[Answered<'_>], answer: impl Fn(&Answer) -> String) -> f64 {
    let asked: Vec<(String, String)> = all.iter().filter(|(q, _)| q.content != Content::Pair).map(|(q, a)| (truth(q), answer(a))).collect();
    let mut classes: Vec<&String> = asked.iter().map(|(t, _)| t).collect();
    classes.sort();
    classes.dedup();
    let f1 = |c: &String| {
        let hit = asked.iter().filter(|(t, s)| t == c && s == c).count() as f64;
        let wrong = asked.iter().filter(|(t, s)| (t == c) != (s == c)).count() as f64;
        if hit > 0.0 { 2.0 * hit / (2.0 * hit + wrong) } else { 0.0 }
    };
    classes.iter().map(|c| f1(c)).sum::<f64>() / classes.len().max(1) as f64
}

/// Expected calibration error of the probabilities of the effects, in ten bins (Naeini et al., AAAI 2015). The many
/// improbable effects are left out; they would hide the error of the probable ones.
fn calibration_error(all: &[Answered<'_>]) -> f64 {
    let mut bins = [(0.0, 0.0, 0.0); 10];
    for (q, a) in all.iter().filter(|(q, _)| q.content != Content::Outside) {
        for e in a.diagnosis.effects.iter().filter(|e| e.probability > PROBABLE) {
            let b = &mut bins[((e.probability * 10.0) as usize).min(9)];
            *b = (b.0 + e.probability, b.1 + f64::from(u8::from(q.names.contains(&e.name))), b.2 + 1.0);
        }
    }
    let n: f64 = bins.iter().map(|b| b.2).sum();
    bins.iter().map(|b| (b.0 - b.1).abs()).sum::<f64>() / n.max(1.0)
}

fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    v.get(v.len() / 2).copied().unwrap_or(0.0)
}
