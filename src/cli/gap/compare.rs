//! `retroflex gap compare`: the user's own simulator beside a log.

use crate::cli::gap::input;
use crate::cli::{ResultFile, inputs, logging, output};
use crate::diagnosis::diagnose;
use crate::diagnosis::tip::TipProblem;
use crate::diagnosis::tip::model::Motion;
use crate::diagnosis::tip::observed::{Observed, Quantity};
use crate::experiment::compare::{Compared, Knob, compare, drive};
use crate::experiment::error::ExperimentError;
use crate::log::columns::{self, Column};
use crate::model::effects::catalogue;
use crate::report::gap::compare::{document, said};
use crate::simulation::link::Link;
use crate::simulation::world::World as _;
use miette::{IntoDiagnostic, Result};
use std::path::PathBuf;

/// Arguments of `gap compare`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Bend log of the machine.
    log: PathBuf,
    /// Program of the simulator, `exec:PROGRAM ARG…`, which speaks the plant link.
    #[arg(long)]
    plant: String,
    /// Parameter of the program to be fitted, and its range; the program is started with `--param NAME=VALUE`. May be repeated.
    #[arg(long, value_name = "NAME=LOW:HIGH", value_parser = knob)]
    fit: Vec<Knob>,
    #[command(flatten)]
    driven: input::DrivenArgs,
    /// Write the result as JSON.
    #[arg(long)]
    json: Option<ResultFile>,
    /// Write what the simulator leaves of each sensor.
    #[arg(long, value_name = "FILE.parquet")]
    residuals: Option<ResultFile>,
    /// Seed of the block bootstrap of the diagnosis.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// A parameter with its range.
fn knob(text: &str) -> std::result::Result<Knob, String> {
    let parsed = || {
        let (name, range) = text.split_once('=')?;
        let (low, high) = range.split_once(':')?;
        let (low, high): (f64, f64) = (low.parse().ok()?, high.parse().ok()?);
        let name = Some(name.to_owned()).filter(|name| !name.is_empty())?;
        let is_range = low.is_finite() && high.is_finite() && low < high;
        is_range.then_some(Knob { name, low, high })
    };
    parsed().ok_or("expected NAME=LOW:HIGH with LOW below HIGH, for example stiffness=0.5:2".into())
}

/// Compares and writes.
///
/// # Errors
/// A report that names the faulty input, or says what the program did.
pub fn run(args: &Args) -> Result<bool> {
    let lines = args.driven.lines()?;
    let log = input::observe(&args.log, &args.driven.rig()?)?;
    let (name, compared) = simulated(args, &log)?;
    let diagnosis = diagnose(&TipProblem::new(&log, catalogue(), &lines, args.seed)).document;
    output::write_some(&args.residuals, || residuals(&log, &compared))?;
    let document = document(&log, name, compared, &diagnosis);
    let (text, good) = said(&document);
    output::answer(&args.json, &document, text)?;
    Ok(good)
}

/// Name of the simulator, and what it leaves of the log.
fn simulated(args: &Args, log: &Observed) -> Result<(String, Compared)> {
    let (program, arguments) = inputs::program(&args.plant)?;
    let _logging = logging::start();
    let bar = output::bar(0, "{pos} runs of the simulator,");
    let mut name = String::new();
    let run = |values: &[f64]| -> std::result::Result<Motion, ExperimentError> {
        let mut arguments = arguments.clone();
        for (knob, value) in args.fit.iter().zip(values) {
            arguments.extend(["--param".to_owned(), format!("{}={value}", knob.name)]);
        }
        let mut link = Link::start(&program, &arguments)?;
        name.clone_from(&link.info().name);
        let motion = drive(&mut link, log);
        bar.inc(1);
        motion
    };
    let compared = compare(log, &args.fit, run).into_diagnostic()?;
    Ok((name, compared))
}

/// A row for each bin: time, counted pistons and, of each sensor, what the simulator leaves, degrees (°/s for the gyroscope).
fn residuals(log: &Observed, compared: &Compared) -> Result<Vec<u8>> {
    let mut table = Vec::new();
    let mut add = |name: String, value: &dyn Fn(usize) -> f64| {
        let values = (0..log.bins.len()).map(value).collect();
        table.push((name, Column::Numbers(values)));
    };
    add("time_s".to_owned(), &|k| log.bins[k].t_s);
    for i in 0..3 {
        let name = format!("piston{}_mm", i + 1);
        add(name, &|k| log.instants[log.bins[k].at].piston_mm[i]);
    }
    for q in log.quantities() {
        let unit = if q == Quantity::Gyro { "deg_s" } else { "deg" };
        for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
            let name = format!("{}_{axis}_{unit}", q.name());
            add(name, &|k| {
                if log.bins[k].weight[q] > 0.0 {
                    compared.held_out.residual[q][k][i].to_degrees()
                } else {
                    f64::NAN
                }
            });
        }
    }
    columns::write(&table, &[]).into_diagnostic()
}
