//! `retroflex gap exam`: tests the diagnosis on logs of the built-in plant, or of a simulator that is a program of its own.
//!
//! Beside the plant link such a program knows
//!
//! ```text
//! PROGRAM ARG… --list                                     one effect a line, its name first
//! PROGRAM ARG… --seed N --calib                           the gains of the unit as a calibration file
//! PROGRAM ARG… --seed N --effect NAME,NAME… --size X      the unit with these effects, X times as large as drawn
//! ```

use crate::cli::{ResultFile, inputs, output};
use crate::config::{Calibration, source};
use crate::experiment::exam::run::run as answer_all;
use crate::experiment::exam::{
    Answer, ExamScore, Logs, Question, Recorded, questions, record, score,
};
use crate::log::bend_log::BendLog;
use crate::model::Line;
use crate::model::effects::by_catalogue;
use crate::report::exam::summary;
use crate::simulation::link::Link;
use crate::simulation::plant::effect_names;
use crate::supervisor::MachineError;
use clap::builder::TypedValueParser;
use miette::{IntoDiagnostic, Result};
use rand::rngs::StdRng;
use rand::{Rng, RngExt, SeedableRng};
use serde::Serialize;
use std::process::{Command, Stdio};

/// Factor by which an effect grows while it is too small to be claimed, and the largest size.
const GROWTH: f64 = 1.4;
const SIZE_MAX: f64 = 3.0;

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
struct Answered<'a> {
    #[serde(flatten)]
    question: &'a Question,
    #[serde(flatten)]
    answer: &'a Answer,
}

/// The JSON file.
#[derive(Serialize)]
struct Document<'a> {
    score: &'a ExamScore,
    logs: Vec<Answered<'a>>,
}

/// Runs the exam and writes its score.
///
/// # Errors
/// A report if a file cannot be written.
pub fn run(args: &Args) -> Result<()> {
    let simulator = args.plant.as_deref().map(inputs::program).transpose()?;
    let simulator = simulator.map(|(program, args)| Simulator { program, args });
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
            .map(|(question, answer)| Answered { question, answer })
            .collect(),
    };
    output::answer(&args.json, &document, summary(&score) + "\n")
}

/// The program and what it has been started with.
#[derive(Debug, Clone)]
struct Simulator {
    program: String,
    args: Vec<String>,
}

impl Simulator {
    /// What the program prints with `more` arguments.
    fn print(&self, more: &[String]) -> Result<String, MachineError> {
        let fail = |source| MachineError::Start {
            program: self.program.clone(),
            source,
        };
        let mut command = Command::new(&self.program);
        command.args(self.args.iter().chain(more));
        command.stdin(Stdio::null()).stderr(Stdio::inherit());
        let out = command.output().map_err(fail)?;
        if !out.status.success() {
            let why = format!("with {} it ended with {}", more.join(" "), out.status);
            return Err(fail(std::io::Error::other(why)));
        }
        Ok(String::from_utf8_lossy(&out.stdout).into_owned())
    }

    /// The effects that the program lists, those of the catalogue and others.
    ///
    /// # Errors
    /// [`MachineError`] if it lists none.
    fn effects(&self) -> Result<[Vec<&'static str>; 2], MachineError> {
        let text = self.print(&["--list".to_owned()])?;
        let names = text.lines().filter_map(|l| l.split_whitespace().next());
        // as long-lived as the names of the built-in plant
        let names = names.map(|name| &*name.to_owned().leak());
        let known = by_catalogue(names.filter(|name| *name != "none"));
        let why = "the program lists no effect of the catalogue; with --list it prints one effect a line, its name first";
        if known[0].is_empty() {
            Err(malformed(&text, why))
        } else {
            Ok(known)
        }
    }

    /// Records the logs of a question. The gains of the calibration are off by a few percent; an effect that is too small to be claimed
    /// is made larger.
    ///
    /// # Errors
    /// [`MachineError`] of the program.
    fn draw(&self, q: &Question) -> Result<Logs, MachineError> {
        let mut rng = StdRng::seed_from_u64(q.seed);
        let seed = rng.random_range(1..1_000_000u32).to_string();
        let seed = ["--seed".to_owned(), seed];
        let printed = self.print(&[seed.as_slice(), &["--calib".to_owned()]].concat())?;
        let calib: Calibration = source::parse("PROGRAM --calib", &printed)
            .map_err(|e| malformed(&printed, &e.to_string()))?;
        let lines = calib.lines().map(|l| Line {
            k_epsilon: l.k_epsilon * rng.random_range(0.94..1.06),
            k_lambda_mm: l.k_lambda_mm * rng.random_range(0.9..1.1),
        });
        let log = |names: &[&str], size: f64, schedule, lab| -> Result<BendLog, MachineError> {
            let mut args = [self.args.as_slice(), &seed].concat();
            if !names.is_empty() {
                let with = ["--effect", &names.join(","), "--size", &size.to_string()];
                args.extend(with.map(str::to_owned));
            }
            record(|_| Link::start(&self.program, &args), &lines, schedule, lab)
        };
        let (first, second) = (rng.next_u64(), rng.next_u64());
        let recorded = |names: &[&str], size| {
            log(names, size, first, true).map(|log| Recorded::new(log, &lines))
        };
        let mut size = 1.0;
        let (with, hidden) = loop {
            let with = recorded(&q.names, size)?;
            let mut hidden = false;
            for name in &q.names {
                let rest: Vec<&str> = q.names.iter().filter(|n| *n != name).copied().collect();
                hidden = hidden || recorded(&rest, size)?.hides(&with, q.lab);
            }
            if !hidden || size * GROWTH > SIZE_MAX {
                break (with, hidden);
            }
            size *= GROWTH;
        };
        let mut asked = with.log;
        asked.reference = asked.reference.filter(|_| q.lab);
        let fresh = log(&q.names, size, second, q.lab)?;
        Ok(Logs {
            log: asked,
            fresh,
            lines,
            hidden,
        })
    }
}

/// The error about what a program has printed.
fn malformed(printed: &str, problem: &str) -> MachineError {
    MachineError::Malformed {
        line: printed.lines().next().unwrap_or_default().to_owned(),
        problem: problem.to_owned(),
    }
}
