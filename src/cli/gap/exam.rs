//! `retroflex gap exam`: tests the diagnosis on logs of the built-in plant, or of another simulator.

mod simulator;

use crate::cli::{ResultFile, inputs, output};
use crate::experiment::exam::run::run as answer_all;
use crate::experiment::exam::{Answer, ExamScore, Question, questions, score};
use crate::model::effects::by_catalogue;
use crate::report::exam::summary;
use crate::simulation::plant::effect_names;
use clap::builder::TypedValueParser;
use miette::{IntoDiagnostic, Result};
use serde::Serialize;
use simulator::Simulator;

/// Arguments of `gap exam`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Simulator to ask about, `exec:PROGRAM ARG…`, which speaks the plant link and knows `--list`, `--seed`, `--effect`, `--size` and
    /// `--calib` (docs/gap.md); the default is the built-in plant.
    #[arg(long)]
    plant: Option<String>,
    /// Write the score and every answer as JSON.
    #[arg(long)]
    json: Option<ResultFile>,
    /// Seed of units, schedules, effects and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Questions per effect; one round is about 140 logs and takes some four minutes on two cores.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=10_000).map(usize::from))]
    rounds: usize,
    /// Ask only every n-th question: 4 takes a fourth of the time and doubles the uncertainty.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=10_000).map(usize::from))]
    every: usize,
}

/// One answer in the JSON file.
#[derive(Serialize)]
struct Line<'a> {
    #[serde(flatten)]
    question: &'a Question,
    #[serde(flatten)]
    answer: &'a Answer,
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
pub fn run(args: &Args) -> Result<()> {
    let simulator = args.plant.as_deref().map(inputs::program).transpose()?;
    let simulator = simulator.map(Simulator::new);
    let known = match &simulator {
        Some(simulator) => simulator.effects().into_diagnostic()?,
        None => by_catalogue(effect_names().map(|e| e.name)),
    };
    let asked = questions(args.seed, args.rounds, &known).into_iter();
    let asked: Vec<Question> = asked.step_by(args.every).collect();
    let draw = |q: &Question| simulator.as_ref().map_or_else(|| q.draw(), |s| s.draw(q));
    eprintln!("seed {}, {} logs", args.seed, asked.len());
    let bar = output::bar(asked.len() as u64, "{pos} of {len} logs, {eta} left,");
    let answers = answer_all(&asked, draw, || bar.inc(1)).into_diagnostic()?;
    bar.finish_and_clear();
    let score = score(args.seed, &asked, &answers);
    let lines = asked.iter().zip(&answers);
    let document = Document {
        score: &score,
        logs: lines
            .map(|(question, answer)| Line { question, answer })
            .collect(),
    };
    output::answer(&args.json, &document, summary(&score) + "\n")
}
