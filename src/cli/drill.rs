//! `retroflex drill`: injects every fault; `--soak HOURS` injects them at random for a long time.

use crate::cli::{ResultFile, inputs, output, within};
use crate::config::Gains;
use crate::config::supervisor::assemble;
use crate::drill::bench::BenchConfig;
use crate::drill::process::{self, Harm};
use crate::drill::row::FaultResult;
use crate::drill::run::{Allowance, fly};
use crate::drill::{list, soak};
use crate::service::{Memory, Store};
use crate::simulation::sim::Sim;
use crate::simulation::world::World;
use miette::{IntoDiagnostic, Result, bail};
use serde_json::json;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Arguments of `drill`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Write the rows as JSON; `-` is standard output.
    #[arg(long)]
    json: Option<ResultFile>,
    /// Inject only faults whose name contains this text.
    #[arg(long)]
    only: Option<String>,
    /// Number of kills of the process.
    #[arg(long, default_value_t = 200)]
    kills: u32,
    /// Number of stops under each attack on the service.
    #[arg(long, default_value_t = 4)]
    tries: u32,
    /// Leave out the faults of the process, which run in real time.
    #[arg(long)]
    in_flight: bool,
    /// Inject only the faults of the process.
    #[arg(long, conflicts_with = "in_flight")]
    process: bool,
    /// Instead of the drill, run random commands and faults for this many simulated hours.
    #[arg(long, value_parser = within(0.001..=10_000.0, "h"))]
    soak: Option<f64>,
    /// Seed of the soak.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Work with the memory in this folder; the drill kills such a child.
    #[arg(long, hide = true)]
    exercise: Option<PathBuf>,
    /// Damage that the exercise does to its own disk.
    #[arg(long, hide = true, requires = "exercise")]
    harm: Option<Harm>,
    /// Print the number and the position of the newest write of the memory in this folder.
    #[arg(long, hide = true)]
    recall: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// A report about the input.
pub fn run(args: &Args) -> Result<bool> {
    // the simulated machine of the paper with the paper's calibration
    let (board, calibration) = (inputs::board(None)?, inputs::calibration(None)?);
    let plant = board.plant.clone().unwrap_or_default();
    let sim = Sim::new(&plant, 0, 0, plant.period_s).into_diagnostic()?;
    let supervisor = assemble(&board, &calibration, &Gains::default(), sim.info());
    let config = BenchConfig { plant, supervisor };
    if let Some(folder) = &args.exercise {
        let done = process::exercise(&config, folder, args.harm);
        done.map_err(std::io::Error::other).into_diagnostic()?;
        return Ok(true);
    }
    if let Some(folder) = &args.recall {
        return recall(folder);
    }
    if let Some(hours) = args.soak {
        return run_soak(args, &config, hours);
    }
    let rows = rows(args, &config)?;
    if rows.is_empty() {
        let only = args.only.as_deref().unwrap_or("");
        let names: Vec<_> = list::specs().iter().map(|s| s.name).collect();
        let names = names.join(", ");
        bail!(
            "--only {only}: no fault has a name that contains this text; in flight there are {names}"
        );
    }
    show(&rows, &args.json)?;
    Ok(rows.iter().all(|r| r.ok))
}

fn rows(args: &Args, config: &BenchConfig) -> Result<Vec<FaultResult>> {
    let only = args.only.as_deref().unwrap_or_default();
    let selected = |name: &str| name.contains(only);
    let mut rows = Vec::new();
    let allowance = Allowance::new(config).into_diagnostic()?;
    let mut specs = list::specs();
    specs.retain(|s| selected(s.name) && !args.process);
    let bar = output::bar(specs.len() as u64, "fault {pos} of {len}");
    for spec in &specs {
        rows.push(fly(config, spec, &allowance).into_diagnostic()?);
        bar.inc(1);
    }
    drop(bar);
    if !args.in_flight && (args.only.is_none() || rows.is_empty()) {
        let program = std::env::current_exe().into_diagnostic()?;
        let scratch = output::Scratch::new("drill")?;
        let plan = process::Plan {
            config,
            program: &program,
            scratch: &scratch.0,
            kills: args.kills,
            tries: args.tries,
            selected: &selected,
        };
        rows.extend(process::rows(&plan).into_diagnostic()?);
    }
    Ok(rows)
}

fn recall(folder: &Path) -> Result<bool> {
    let (_, recall) = Store::open(folder).into_diagnostic()?;
    let words = |m: Memory| Some(format!("armed {}, steps {:?}", m.armed, m.restart?.steps.0));
    let position = recall.memory.and_then(words);
    let shown = position.as_deref().unwrap_or("nothing");
    output::print(format!("recalled {} . {shown}\n", recall.sequence));
    Ok(position.is_some())
}

fn run_soak(args: &Args, config: &BenchConfig, hours: f64) -> Result<bool> {
    eprintln!("seed {}", args.seed);
    let bar = output::bar(1000, "soak {percent} %");
    let mut progress = |h| bar.set_position((1000.0 * h / hours) as u64);
    let result = soak::run(config, hours, args.seed, &mut progress);
    bar.finish_and_clear();
    let soak = result.into_diagnostic()?;
    let stdout = || Some(OsString::from("-").into());
    output::json(&args.json.clone().or_else(stdout), &soak)?;
    Ok(soak.ok)
}

fn show(rows: &[FaultResult], json: &Option<ResultFile>) -> Result<()> {
    let time = |s: f64| {
        if s < 1.0 {
            format!("{:.0} ms", s * 1e3)
        } else {
            format!("{s:.1} s")
        }
    };
    let row = |r: &FaultResult| {
        [
            r.fault.clone(),
            r.detected_s.map_or("–".to_owned(), time),
            format!("{} of {}", r.steps_after, r.steps_allowed),
            r.state.clone(),
            format!("{:.1}°", r.error_deg_during),
            format!("{:.1}°", r.error_deg_after),
            if r.ok { "yes" } else { "NO" }.to_owned(),
        ]
    };
    let header = "fault|detected|steps|state|error during|after|ok";
    let mut text = format!("{}\n", output::table(header, 1..6, rows.iter().map(row)));
    let failed = rows.iter().filter(|r| !r.ok);
    text.extend(
        failed
            .clone()
            .map(|r| format!("{}: {} · {}\n", r.fault, r.why, r.message)),
    );
    text += &format!("{} faults, {} failed\n", rows.len(), failed.count());
    output::answer(json, &json!({ "rows": rows }), text)
}
