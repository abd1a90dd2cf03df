//! `retroflex gap exam`: the diagnosis is examined on logs of the built-in plant.

use crate::cli::CommandOutcome;
use crate::cli::output;
use crate::diagnosis::exam::mark::{Method, Row, Sheet, mark};
use crate::diagnosis::exam::question::{Question, paper};
use crate::diagnosis::exam::{Answer, sit};
use crate::model::effects::catalogue;
use comfy_table::{CellAlignment, Table, presets};
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
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header(["", "lab", "field"]);
    let mut row = |name: &str, r: &Row| {
        table.add_row([name.to_owned(), share(&r.lab), share(&r.field)]);
    };
    row("single effect named", &s.diagnosis.single);
    row("stage of the largest share", &s.stage);
    row("both of two named, nothing else", &s.diagnosis.pair);
    row("effect-free logs with a claim", &s.diagnosis.alarm);
    row("outside the catalogue: unknown", &s.outside);
    row("struck from the catalogue: unknown", &s.left_out);
    row("stated intervals that hold", &s.coverage);
    table.add_row([
        "gap closed on a fresh log, median".to_owned(),
        format!("{:.0} %", s.fresh_closed[0] * 100.0),
        format!("{:.0} %", s.fresh_closed[1] * 100.0),
    ]);
    let mut others = Table::new();
    others.load_style(presets::UTF8_HORIZONTAL_ONLY);
    others.set_header(["method", "single lab", "single field", "pair lab", "pair field", "false alarms", "macro F1"]);
    let mut add = |name: &str, m: &Method| {
        let alarms =
            crate::diagnosis::exam::mark::Count { right: m.alarm.lab.right + m.alarm.field.right, of: m.alarm.lab.of + m.alarm.field.of };
        others.add_row([
            name.to_owned(),
            share(&m.single.lab),
            share(&m.single.field),
            share(&m.pair.lab),
            share(&m.pair.field),
            share(&alarms),
            format!("{:.2}", m.macro_f1),
        ]);
    };
    add("diagnosis", &s.diagnosis);
    add("in-sample BIC", &s.bic);
    add("sparse regression", &s.sparse);
    add("nearest signature", &s.nearest);
    for t in [&mut table, &mut others] {
        for column in t.column_iter_mut().skip(1) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
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
