//! `retroflex gap exam`: the diagnosis is examined on logs of the built-in plant.

use crate::cli::CommandOutcome;
use crate::cli::output;
use crate::diagnosis::exam::mark::{Method, Row, Sheet, mark};
use crate::diagnosis::exam::question::{Question, paper};
use crate::diagnosis::exam::{Answer, sit};
use crate::model::effects::catalogue;
use miette::{IntoDiagnostic, Result};
use serde::Serialize;
use std::path::PathBuf;

/// Arguments of `gap exam`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Write the sheet and every answer as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Seed of units, schedules, effects and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How often each effect is asked; one round is about 130 logs, some ten minutes on two cores.
    #[arg(long, default_value_t = 1)]
    rounds: usize,
    /// Ask only every so many-th question: 4 takes a few minutes and is a fourth as sure.
    #[arg(long, default_value_t = 4)]
    every: usize,
}

/// One line of the JSON file.
#[derive(Serialize)]
struct Line<'a> {
    truth: &'a [&'static str],
    holds: String,
    lab: bool,
    seed: u64,
    fresh_closed: f64,
    left_out: Option<&'static str>,
    bic: &'a [&'static str],
    sparse: &'a [&'static str],
    nearest: &'a [&'static str],
    diagnosis: &'a crate::diagnosis::diagnose::Diagnosis,
}

#[derive(Serialize)]
struct Document<'a> {
    sheet: &'a Sheet,
    logs: Vec<Line<'a>>,
}

/// Holds the exam.
///
/// # Errors
/// A report if a file cannot be written.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    output::check(&[("--json", args.json.as_deref())], &[])?;
    let questions: Vec<Question> = paper(args.seed, args.rounds.max(1)).into_iter().step_by(args.every.max(1)).collect();
    eprintln!("seed {}, {} logs", args.seed, questions.len());
    let bar = output::bar(questions.len() as u64, "{pos} of {len} logs, {eta} left,");
    let answers = sit(&questions, &catalogue(), || bar.inc(1)).into_diagnostic()?;
    bar.finish_and_clear();
    let sheet = mark(args.seed, &questions, &answers);
    eprintln!("{}", summary(&sheet));
    output::json(args.json.as_deref(), &Document { sheet: &sheet, logs: questions.iter().zip(&answers).map(line).collect() })?;
    Ok(CommandOutcome::Good)
}

fn line<'a>((q, a): (&'a Question, &'a Answer)) -> Line<'a> {
    Line {
        truth: &q.names,
        holds: format!("{:?}", q.holds).to_lowercase(),
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

fn share(c: &crate::diagnosis::exam::mark::Count) -> String {
    if c.of == 0 { "–".to_owned() } else { format!("{:.0} % of {}", c.share() * 100.0, c.of) }
}

fn summary(s: &Sheet) -> String {
    let row = |name: &str, r: &Row| [name.to_owned(), share(&r.lab), share(&r.field)];
    let closed = s.fresh_closed.map(|c| format!("{:.0} %", c * 100.0));
    let results = [
        row("single effect named", &s.diagnosis.single),
        row("stage of the largest share", &s.stage),
        row("both of two named, nothing else", &s.diagnosis.pair),
        row("effect-free logs with a claim", &s.diagnosis.alarm),
        row("outside the catalogue: unknown", &s.outside),
        row("removed from the catalogue: unknown", &s.left_out),
        row("stated intervals that hold", &s.coverage),
        ["gap closed on a fresh log, median".to_owned(), closed[0].clone(), closed[1].clone()],
    ];
    let table = output::table(&["", "lab", "field"], 1..3, results);
    let method = |name: &str, m: &Method| {
        let alarms =
            crate::diagnosis::exam::mark::Count { right: m.alarm.lab.right + m.alarm.field.right, of: m.alarm.lab.of + m.alarm.field.of };
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
        method("diagnosis", &s.diagnosis),
        method("in-sample BIC", &s.bic),
        method("sparse regression", &s.sparse),
        method("nearest signature", &s.nearest),
    ];
    let others =
        output::table(&["method", "single lab", "single field", "pair lab", "pair field", "false alarms", "macro F1"], 1..7, methods);
    let wrong: Vec<String> = s
        .confusion
        .iter()
        .flat_map(|(truth, said)| {
            said.iter()
                .filter(move |(a, _)| *a != truth && !(*a == "unknown" && truth.starts_with("unknown")))
                .map(move |(a, n)| format!("  {truth} → {a} ({n})"))
        })
        .collect();
    format!(
        "{table}\ncalibration error of the probabilities {:.3}\n{others}\nanswers that differ from the truth:\n{}",
        s.calibration_error,
        wrong.join("\n")
    )
}
