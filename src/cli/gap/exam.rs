//! `retroflex gap exam`: tests the diagnosis on logs of the built-in plant.

use crate::cli::{CommandOutcome, output};
use crate::diagnosis::exam::run::run as answer_all;
use crate::diagnosis::exam::{
    Answer, Count, ExamScore, Method, Question, ReliabilityBin, Row, questions, score,
};
use crate::diagnosis::tip::Diagnosis;
use crate::diagnosis::verdict::VerdictKind;
use crate::model::effects::catalogue;
use miette::{IntoDiagnostic, Result};
use serde::Serialize;
use std::path::PathBuf;

/// Arguments of `gap exam`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Write the score and every answer as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Seed of units, schedules, effects and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Questions per effect; one round is about 140 logs and takes some four minutes on two cores.
    #[arg(long, default_value_t = 1)]
    rounds: usize,
    /// Ask only every n-th question: 4 takes a fourth of the time and doubles the uncertainty.
    #[arg(long, default_value_t = 4)]
    every: usize,
}

/// One answer in the JSON file.
#[derive(Serialize)]
struct Line<'a> {
    truth: &'a [&'static str],
    content: String,
    lab: bool,
    seed: u64,
    fresh_closed: f64,
    left_out: Option<VerdictKind>,
    bic: &'a [&'static str],
    sparse: &'a [&'static str],
    nearest: &'a [&'static str],
    diagnosis: &'a Diagnosis,
}

/// The JSON file.
#[derive(Serialize)]
struct Document<'a> {
    score: &'a ExamScore,
    logs: Vec<Line<'a>>,
}

/// Runs the exam and writes its score.
///
/// # Errors
/// A report if a file cannot be written.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    output::check(&[("--json", args.json.as_deref())], &[])?;
    let asked: Vec<Question> = questions(args.seed, args.rounds.max(1))
        .into_iter()
        .step_by(args.every.max(1))
        .collect();
    eprintln!("seed {}, {} logs", args.seed, asked.len());
    let bar = output::bar(asked.len() as u64, "{pos} of {len} logs, {eta} left,");
    let answers =
        answer_all(&asked, Question::draw, &catalogue(), || bar.inc(1)).into_diagnostic()?;
    bar.finish_and_clear();
    let score = score(args.seed, &asked, &answers);
    output::show(&(summary(&score) + "\n"), args.json.as_deref());
    output::json(
        args.json.as_deref(),
        &Document {
            score: &score,
            logs: asked.iter().zip(&answers).map(line).collect(),
        },
    )?;
    Ok(CommandOutcome::Good)
}

fn line<'a>((q, a): (&'a Question, &'a Answer)) -> Line<'a> {
    Line {
        truth: &q.names,
        content: format!("{:?}", q.content).to_lowercase(),
        lab: q.lab,
        seed: q.seed,
        fresh_closed: a.fresh_closed,
        left_out: a.left_out,
        bic: &a.others[0],
        sparse: &a.others[1],
        nearest: &a.others[2],
        diagnosis: &a.diagnosis,
    }
}

fn share(c: &Count) -> String {
    if c.of == 0 {
        "–".to_owned()
    } else {
        format!("{:.0} % of {}", c.share() * 100.0, c.of)
    }
}

/// The score for people.
pub fn summary(s: &ExamScore) -> String {
    format!(
        "{}\n{}\ncalibration error: effects {:.3}, unknown {:.3}; a 95 % set has {:.1} statements\n{}\nanswers that differ from the truth:\n{}",
        own(s),
        reliability(s),
        s.effects.error,
        s.unknown.error,
        s.conformal_size,
        comparison(s),
        mistakes(s).join("\n")
    )
}

/// Table of the diagnosis alone.
fn own(s: &ExamScore) -> comfy_table::Table {
    let row = |name: &str, r: &Row| [name.to_owned(), share(&r.lab), share(&r.field)];
    let percent = |x: f64| format!("{:.0} %", x * 100.0);
    let rows = [
        row("single effect named", &s.diagnosis.single),
        row("stage with the largest share", &s.stage),
        row("both of two named, nothing else", &s.diagnosis.pair),
        row("three of three named, nothing else", &s.diagnosis.triple),
        row("effect-free logs with a claim", &s.diagnosis.alarm),
        row("outside the catalogue: unknown", &s.outside),
        row("of them, not too small to be claimed", &s.outside_visible),
        row("removed from the catalogue: unknown", &s.left_out),
        row("95 % sets of statements that hold", &s.conformal),
        row("stated intervals that hold", &s.coverage),
        [
            "known effects called unknown".to_owned(),
            share(&s.known_called_unknown),
            String::new(),
        ],
        [
            "logs with a group of equivalent effects".to_owned(),
            share(&s.grouped),
            String::new(),
        ],
        [
            "gap closed on a fresh log, median".to_owned(),
            percent(s.fresh_closed[0]),
            percent(s.fresh_closed[1]),
        ],
    ];
    output::table(&["", "lab", "field"], 1..3, rows)
}

/// Table of stated probabilities and frequencies.
fn reliability(s: &ExamScore) -> comfy_table::Table {
    let row = |what: &str, b: &ReliabilityBin| {
        let [low, high] = b.ci95;
        [
            what.to_owned(),
            format!("{:.2}", b.stated),
            share(&b.count),
            format!("{:.0} to {:.0} %", low * 100.0, high * 100.0),
        ]
    };
    let effects = s.effects.bins.iter().map(|b| row("an effect", b));
    let rows: Vec<[String; 4]> = effects
        .chain(s.unknown.bins.iter().map(|b| row("unknown", b)))
        .collect();
    output::table(&["statement", "stated", "true", "95 %"], 1..4, rows)
}

/// Table of the diagnosis beside the other methods.
fn comparison(s: &ExamScore) -> comfy_table::Table {
    let row = |(name, m): (&str, &Method)| {
        let alarms = Count {
            right: m.alarm.lab.right + m.alarm.field.right,
            of: m.alarm.lab.of + m.alarm.field.of,
        };
        [
            name.to_owned(),
            share(&m.single.lab),
            share(&m.single.field),
            share(&m.pair.lab),
            share(&m.pair.field),
            share(&alarms),
            format!("{:.2}", m.macro_f1),
        ]
    };
    let methods = [
        ("diagnosis", &s.diagnosis),
        ("in-sample BIC", &s.bic),
        ("sparse regression", &s.sparse),
        ("nearest signature", &s.nearest),
    ];
    let header = [
        "method",
        "single lab",
        "single field",
        "pair lab",
        "pair field",
        "false alarms",
        "macro F1",
    ];
    output::table(&header, 1..7, methods.map(row))
}

fn mistakes(s: &ExamScore) -> Vec<String> {
    let wrong = |truth: &str, answer: &str| {
        answer != truth && !(answer == "unknown" && truth.starts_with("unknown"))
    };
    let all = s
        .confusion
        .iter()
        .flat_map(|(truth, answers)| answers.iter().map(move |(answer, n)| (truth, answer, n)));
    all.filter(|(truth, answer, _)| wrong(truth, answer))
        .map(|(truth, answer, n)| format!("  {truth} → {answer} ({n})"))
        .collect()
}
