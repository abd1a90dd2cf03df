//! `retroflex drill`: injects every fault; `--soak HOURS` injects them at random for a long time.

use crate::cli::inputs::within;
use crate::cli::{CommandOutcome, inputs, output};
use crate::config::gains::Gains;
use crate::drill::bench::BenchConfig;
use crate::drill::process::{self, Harm, Repeats};
use crate::drill::row::Row;
use crate::drill::run::{Allowance, fly};
use crate::drill::{list, soak};
use crate::service::store::Store;
use comfy_table::{ColumnConstraint, Width};
use miette::{IntoDiagnostic, Result, miette};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Arguments of `drill`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Write the rows as JSON; `-` is standard output.
    #[arg(long)]
    json: Option<PathBuf>,
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
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let config = simulation()?;
    if let Some(folder) = &args.exercise {
        process::exercise(&config, folder, args.harm).into_diagnostic()?;
        return Ok(CommandOutcome::Good);
    }
    if let Some(folder) = &args.recall {
        return recall(folder);
    }
    output::check(&[("--json", args.json.as_deref())], &[])?;
    if let Some(hours) = args.soak {
        return run_soak(args, &config, hours);
    }
    let rows = rows(args, &config)?;
    if rows.is_empty() {
        return Err(miette!("--only {}: no fault has a name that contains this text", args.only.as_deref().unwrap_or("")));
    }
    output::json(args.json.as_deref(), &json!({ "rows": rows }))?;
    show(&rows, args.json.as_deref());
    Ok(outcome(rows.iter().all(|r| r.ok)))
}

fn outcome(good: bool) -> CommandOutcome {
    if good { CommandOutcome::Good } else { CommandOutcome::NotGoodEnough }
}

/// The simulated machine of the paper with the paper's calibration.
fn simulation() -> Result<BenchConfig> {
    Ok(BenchConfig { board: inputs::board(None)?, calibration: inputs::calibration(None)?, gains: Gains::default() })
}

fn rows(args: &Args, config: &BenchConfig) -> Result<Vec<Row>> {
    let selected = |name: &str| args.only.as_ref().is_none_or(|only| name.contains(only.as_str()));
    let mut rows = Vec::new();
    let allowance = Allowance::new(config).into_diagnostic()?;
    let specs: Vec<_> = list::specs().into_iter().filter(|s| selected(s.name) && !args.process).collect();
    let bar = output::bar(specs.len() as u64, "fault {pos} of {len}");
    for spec in &specs {
        rows.push(fly(config, spec, &allowance).into_diagnostic()?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    if !args.in_flight && (args.only.is_none() || rows.is_empty()) {
        let program = std::env::current_exe().into_diagnostic()?;
        let scratch = output::Scratch::new("drill")?;
        let process =
            process::rows(config, &program, &scratch.0, Repeats { kills: args.kills, tries: args.tries }, &selected).into_diagnostic()?;
        rows.extend(process);
    }
    Ok(rows)
}

fn recall(folder: &Path) -> Result<CommandOutcome> {
    let (_, recall) = Store::open(folder).into_diagnostic()?;
    let position = recall.memory.as_ref().and_then(|m| Some(format!("armed {}, steps {:?}", m.armed, m.restart?.steps.0)));
    println!("recalled {} . {}", recall.sequence, position.as_deref().unwrap_or("nothing"));
    Ok(outcome(position.is_some()))
}

fn run_soak(args: &Args, config: &BenchConfig, hours: f64) -> Result<CommandOutcome> {
    eprintln!("seed {}", args.seed);
    let bar = output::bar(1000, "soak {percent} %");
    let result = soak::run(config, hours, args.seed, &mut |h| bar.set_position((1000.0 * h / hours) as u64));
    bar.finish_and_clear();
    let soak = result.into_diagnostic()?;
    output::json(args.json.as_deref().or(Some(Path::new("-"))), &soak)?;
    Ok(outcome(soak.ok))
}

fn show(rows: &[Row], json: Option<&Path>) {
    let time = |s: f64| if s < 1.0 { format!("{:.0} ms", s * 1e3) } else { format!("{s:.1} s") };
    let cells = rows.iter().map(|r| {
        [
            r.fault.clone(),
            r.detected_s.map_or_else(|| "–".to_owned(), time),
            format!("{} of {}", r.steps_after, r.steps_allowed),
            r.state.clone(),
            format!("{:.1}°", r.error_deg_during),
            format!("{:.1}°", r.error_deg_after),
            if r.ok { "yes" } else { "NO" }.to_owned(),
            if r.ok { r.message.clone() } else { format!("{} · {}", r.why, r.message) },
        ]
    });
    let header = ["fault", "detected", "steps after", "state", "error during", "after", "ok", "message"];
    let mut table = output::table(&header, 1..6, cells);
    if let Some(column) = table.column_mut(7) {
        column.set_constraint(ColumnConstraint::UpperBoundary(Width::Fixed(80)));
    }
    let failed = rows.iter().filter(|r| !r.ok).count();
    output::show(&format!("{table}\n{} faults, {failed} failed\n", rows.len()), json);
}
