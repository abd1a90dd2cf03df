//! `retroflex gap compare`: the user's own simulator beside a log.

use crate::cli::gap::input;
use crate::cli::{CommandOutcome, inputs, logging, output};
use crate::diagnosis::diagnose;
use crate::diagnosis::tip::fit::CLAIM_DEG;
use crate::diagnosis::tip::model::Motion;
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::{DependenceEntry, Diagnosis, TipProblem, goes_with};
use crate::experiment::compare::{Compared, Knob, compare, drive};
use crate::experiment::rig::RigError;
use crate::log::columns::{self, Column};
use crate::model::effects::catalogue;
use crate::simulation::link::Link;
use crate::simulation::world::World as _;
use miette::{IntoDiagnostic, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};

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
    /// Board file of the machine; default: the machine of the paper.
    #[arg(long, value_name = "FILE.toml")]
    board: Option<PathBuf>,
    /// Calibration the log was driven with.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// Write the result as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Write what the simulator leaves of each sensor.
    #[arg(long, value_name = "FILE.parquet")]
    residuals: Option<PathBuf>,
    /// Seed of the block bootstrap of the diagnosis.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// A parameter with its range.
fn knob(text: &str) -> std::result::Result<Knob, String> {
    let parsed = || {
        let (name, range) = text.split_once('=')?;
        let (low, high) = range.split_once(':')?;
        let knob = Knob {
            name: name.to_owned(),
            low: low.parse().ok()?,
            high: high.parse().ok()?,
        };
        let finite = knob.low.is_finite() && knob.high.is_finite();
        (!name.is_empty() && finite && knob.low < knob.high).then_some(knob)
    };
    parsed().ok_or("expected NAME=LOW:HIGH with LOW below HIGH, for example stiffness=0.5:2".into())
}

#[derive(Serialize)]
struct Document {
    schema: u32,
    plant: PlantEntry,
    nominal_deg: f64,
    diagnosed_deg: f64,
    noise_floor_deg: f64,
    goes_with: Vec<DependenceEntry>,
    params: Vec<ParamEntry>,
}

#[derive(Serialize)]
struct PlantEntry {
    name: String,
    rmse_deg: f64,
    kinds: Vec<KindEntry>,
}

#[derive(Serialize)]
struct KindEntry {
    name: &'static str,
    rmse_deg: f64,
    nominal_deg: f64,
    diagnosed_deg: f64,
}

#[derive(Serialize)]
struct ParamEntry {
    name: String,
    value: f64,
    ci95: [f64; 2],
    /// The interval is the whole range.
    #[serde(skip)]
    untold: bool,
}

/// Compares and writes.
///
/// # Errors
/// A report that names the faulty input, or says what the program did.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let results = [
        ("--json", args.json.as_deref()),
        ("--residuals", args.residuals.as_deref()),
    ];
    let mut read = vec![args.log.as_path()];
    read.extend(args.board.as_deref());
    read.extend(args.calib.as_deref());
    output::check(&results, &read)?;
    let lines = inputs::calibration(args.calib.as_deref())?.lines();
    let log = input::observe(&args.log, &input::rig(args.board.as_deref())?)?;
    let (name, compared) = simulated(args, &log)?;
    let diagnosis = diagnose(&TipProblem::new(&log, &catalogue(), &lines, args.seed)).document;
    let document = document(args, &log, name, &compared, &diagnosis);
    if let Some(path) = &args.residuals {
        write_residuals(path, &log, &compared)?;
    }
    output::json(args.json.as_deref(), &document)?;
    let (text, good) = said(&document);
    output::show(&text, args.json.as_deref());
    Ok(good.into())
}

/// Name of the simulator, and what it leaves of the log.
fn simulated(args: &Args, log: &Observed) -> Result<(String, Compared)> {
    let (program, arguments) = inputs::program(&args.plant)?;
    let _logging = logging::start();
    let (bar, mut name) = (
        output::bar(0, "{pos} runs of the simulator,"),
        String::new(),
    );
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    let run = |values: &[f64]| -> std::result::Result<Motion, RigError> {
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
    bar.finish_and_clear();
    Ok((name, compared))
}

fn document(
    args: &Args,
    log: &Observed,
    name: String,
    compared: &Compared,
    diagnosis: &Diagnosis,
) -> Document {
    let kinds = log.quantities().map(|q| {
        let known = diagnosis.location.kinds.iter().find(|k| k.name == q.name());
        KindEntry {
            name: q.name(),
            rmse_deg: compared.held_out.rmse_deg[q],
            nominal_deg: known.map_or(0.0, |k| k.rmse_deg),
            diagnosed_deg: known.map_or(0.0, |k| k.explained_deg),
        }
    });
    let param = |(knob, (value, ci95)): (&Knob, &(f64, [f64; 2]))| ParamEntry {
        name: knob.name.clone(),
        value: *value,
        ci95: *ci95,
        untold: *ci95 == [knob.low, knob.high],
    };
    Document {
        schema: 1,
        plant: PlantEntry {
            name,
            rmse_deg: log.rms_deg(compared.held_out.energy()),
            kinds: kinds.collect(),
        },
        nominal_deg: diagnosis.gap.recalibrated_deg,
        diagnosed_deg: diagnosis.gap.explained_deg,
        noise_floor_deg: diagnosis.gap.noise_floor_deg,
        goes_with: goes_with(log, &compared.held_out),
        params: args.fit.iter().zip(&compared.params).map(param).collect(),
    }
}

/// The answer, and whether it is better than no simulator.
fn said(d: &Document) -> (String, bool) {
    let (left, floor) = (d.plant.rmse_deg, d.noise_floor_deg);
    let within = |k: &KindEntry| k.rmse_deg - k.diagnosed_deg < CLAIM_DEG;
    let fits = left - floor < CLAIM_DEG && d.plant.kinds.iter().all(within);
    let sentence = match (fits, left < d.nominal_deg) {
        (true, _) => "The simulator fits the log",
        (_, true) => "The simulator is nearer to the log than the nominal model, but not all of it",
        _ => "The simulator does not fit the log, the nominal model is nearer",
    };
    let mut text = format!(
        "{sentence}: it leaves {left:.2}°, the nominal model {:.2}°, the diagnosed one {:.2}°; noise alone is {floor:.2}°.\n",
        d.nominal_deg, d.diagnosed_deg
    );
    for p in &d.params {
        let [low, high] = p.ci95;
        let told = match p.untold {
            true => ": it changes nothing here; is its name right?",
            false => "",
        };
        text += &format!(
            "{} = {:.4}, 95 %: {low:.4} to {high:.4}{told}\n",
            p.name, p.value
        );
    }
    if !fits {
        for d in &d.goes_with {
            let part = d.share * 100.0;
            text += &format!(
                "What remains goes with the {}, which predicts {part:.0} % of it in one sensor.\n",
                d.name
            );
        }
    }
    let row = |k: &KindEntry| {
        let unit = if k.name == "gyroscope" { "°/s" } else { "°" };
        let [a, b, c] =
            [k.rmse_deg, k.nominal_deg, k.diagnosed_deg].map(|x| format!("{x:.2}{unit}"));
        [k.name.to_owned(), a, b, c]
    };
    let header = ["left-out RMSE", "simulator", "nominal", "diagnosed"];
    text += &format!(
        "{}\n",
        output::table(&header, 1..4, d.plant.kinds.iter().map(row))
    );
    (text, fits || left < d.nominal_deg)
}

/// A row for each bin: time, counted pistons and, of each sensor, what the simulator leaves, degrees (°/s for the gyroscope).
fn write_residuals(path: &Path, log: &Observed, compared: &Compared) -> Result<()> {
    let of =
        |value: &dyn Fn(usize) -> f64| Column::Numbers((0..log.bins.len()).map(value).collect());
    let mut table = vec![("time_s".to_owned(), of(&|k| log.bins[k].t_s))];
    for i in 0..3 {
        let piston = |k: usize| log.piston_mm[log.bins[k].at][i];
        table.push((format!("piston{}_mm", i + 1), of(&piston)));
    }
    for q in log.quantities() {
        let unit = if q.name() == "gyroscope" {
            "deg_s"
        } else {
            "deg"
        };
        for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
            let value = |k: usize| match log.bins[k].weight[q] > 0.0 {
                true => compared.held_out.residual[q][k][i].to_degrees(),
                false => f64::NAN,
            };
            table.push((format!("{}_{axis}_{unit}", q.name()), of(&value)));
        }
    }
    output::write(path, columns::write(&table, &[]).into_diagnostic()?)
}
