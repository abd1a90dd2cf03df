//! Marks of an exam, once the labels are open.

use crate::diagnosis::exam::Answer;
use crate::diagnosis::exam::question::{Holds, Question};
use crate::model::effects::Stage;
use serde::Serialize;
use std::collections::BTreeMap;

/// Right out of asked.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// Right.
    pub right: usize,
    /// Asked.
    pub of: usize,
}

impl Count {
    fn of(marks: impl Iterator<Item = bool>) -> Self {
        marks.fold(Self::default(), |c, right| Self { right: c.right + usize::from(right), of: c.of + 1 })
    }

    /// Share that is right; 0 if nothing was asked.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.right as f64 / self.of.max(1) as f64
    }
}

/// One row: with a tracker and without.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Row {
    /// With the tracker.
    pub lab: Count,
    /// With the IMU alone.
    pub field: Count,
}

/// Rows that every method has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Method {
    /// A single effect named, and nothing else.
    pub single: Row,
    /// Both of two named, and nothing else.
    pub pair: Row,
    /// Something claimed where there is nothing (`right` counts the alarms).
    pub alarm: Row,
    /// F1 over all effects, `none` and `unknown`.
    pub macro_f1: f64,
}

/// The whole sheet.
#[derive(Debug, Clone, Serialize)]
pub struct Sheet {
    /// Seed of the sitting.
    pub seed: u64,
    /// Logs asked.
    pub logs: usize,
    /// The diagnosis.
    pub diagnosis: Method,
    /// Stage of the largest share right, on singles.
    pub stage: Row,
    /// `unknown` for effects outside the catalogue.
    pub outside: Row,
    /// `unknown` for effects whose entry was struck from the catalogue.
    pub left_out: Row,
    /// Mean distance of stated probabilities from frequencies.
    pub calibration_error: f64,
    /// Median gap closed on a fresh log, singles: with the tracker and without.
    pub fresh_closed: [f64; 2],
    /// Stated 95 % intervals that hold on the fresh log.
    pub coverage: Row,
    /// In-sample BIC.
    pub bic: Method,
    /// Sparse regression.
    pub sparse: Method,
    /// Nearest signature.
    pub nearest: Method,
    /// What was said of what: truth → answer → how often.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
}

/// What a set is called in the confusion matrix.
fn called(kind: &str, names: &[&str]) -> String {
    match kind {
        "effects" => {
            let mut names = names.to_vec();
            names.sort_unstable();
            names.join("+")
        }
        kind => kind.to_owned(),
    }
}

type Marked<'a> = (&'a Question, &'a Answer);

/// Marks all answers.
#[must_use]
pub fn mark(seed: u64, questions: &[Question], answers: &[Answer]) -> Sheet {
    let all: Vec<Marked<'_>> = questions.iter().zip(answers).collect();
    let other = |which: usize| {
        method(&all, |a| {
            let names = &a.others[which];
            (if names.is_empty() { "none" } else { "effects" }, names.clone(), vec![])
        })
    };
    let said = |a: &Answer| {
        let v = &a.diagnosis.verdict;
        (v.kind, v.names.clone(), v.equivalent.clone())
    };
    let unknown = |a: &Answer| a.diagnosis.verdict.kind == "unknown";
    let mut confusion: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for (q, a) in &all {
        let truth = match q.holds {
            Holds::None => "none".to_owned(),
            Holds::Outside => format!("unknown ({})", q.names[0]),
            Holds::Single | Holds::Pair => called("effects", &q.names),
        };
        let v = &a.diagnosis.verdict;
        *confusion.entry(truth).or_default().entry(called(v.kind, &v.names)).or_default() += 1;
    }
    Sheet {
        seed,
        logs: all.len(),
        diagnosis: method(&all, said),
        stage: row(&all, Holds::Single, |q, a| a.diagnosis.location.stages.first().map(|s| s.name) == stage_of(q.names[0])),
        outside: row(&all, Holds::Outside, |_, a| unknown(a)),
        left_out: left_out(&all),
        calibration_error: calibration_error(&all),
        fresh_closed: [true, false].map(|lab| median(singles(&all, lab).map(|(_, a)| a.fresh_closed).collect())),
        coverage: row(&all, Holds::Single, |_, a| {
            let ci = a.diagnosis.effects.first().map_or([0.0, 0.0], |e| e.closed_ci95);
            (ci[0]..=ci[1]).contains(&a.fresh_closed.clamp(-1.0, 1.0))
        }),
        bic: other(0),
        sparse: other(1),
        nearest: other(2),
        confusion,
    }
}

fn stage_of(name: &str) -> Option<&'static str> {
    crate::model::effects::by_name(name).map(|e| e.stage()).map(Stage::name)
}

fn singles<'a>(all: &'a [Marked<'a>], lab: bool) -> impl Iterator<Item = &'a Marked<'a>> {
    all.iter().filter(move |(q, _)| q.holds == Holds::Single && q.lab == lab)
}

fn row(all: &[Marked<'_>], holds: Holds, right: impl Fn(&Question, &Answer) -> bool) -> Row {
    let count = |lab: bool| Count::of(all.iter().filter(|(q, _)| q.holds == holds && q.lab == lab).map(|(q, a)| right(q, a)));
    Row { lab: count(true), field: count(false) }
}

fn left_out(all: &[Marked<'_>]) -> Row {
    let count = |lab: bool| Count::of(singles(all, lab).filter_map(|(_, a)| a.left_out).map(|kind| kind == "unknown"));
    Row { lab: count(true), field: count(false) }
}

/// Kind, names and groups that cannot be told apart.
type Said = (&'static str, Vec<&'static str>, Vec<Vec<&'static str>>);

fn method(all: &[Marked<'_>], said: impl Fn(&Answer) -> Said) -> Method {
    // a stated pair counts where the truth is in it and the name given is, too
    let named = |q: &Question, a: &Answer| {
        let (kind, names, groups) = said(a);
        let same = |name: &str, truth: &str| name == truth || groups.iter().any(|g| g.contains(&name) && g.contains(&truth));
        kind == "effects" && names.len() == q.names.len() && q.names.iter().all(|t| names.iter().any(|n| same(n, t)))
    };
    Method {
        single: row(all, Holds::Single, named),
        pair: row(all, Holds::Pair, named),
        alarm: row(all, Holds::None, |_, a| said(a).0 != "none"),
        macro_f1: macro_f1(all, |a| {
            let (kind, names, _) = said(a);
            called(kind, &names)
        }),
    }
}

/// Mean F1 over the classes of the singles, empty logs and outside effects.
fn macro_f1(all: &[Marked<'_>], said: impl Fn(&Answer) -> String) -> f64 {
    let truth = |q: &Question| match q.holds {
        Holds::None => "none".to_owned(),
        Holds::Outside => "unknown".to_owned(),
        Holds::Single | Holds::Pair => called("effects", &q.names),
    };
    let asked: Vec<(String, String)> = all.iter().filter(|(q, _)| q.holds != Holds::Pair).map(|(q, a)| (truth(q), said(a))).collect();
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

/// Expected calibration error of the effects' probabilities, in ten bins (Naeini et al., AAAI 2015); what
/// is said of the many effects that nobody believes in is left out.
fn calibration_error(all: &[Marked<'_>]) -> f64 {
    let mut bins = [(0.0, 0.0, 0.0); 10];
    for (q, a) in all.iter().filter(|(q, _)| matches!(q.holds, Holds::Single | Holds::Pair | Holds::None)) {
        for e in a.diagnosis.effects.iter().filter(|e| e.probability > 0.05) {
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
