//! `retroflex drill`: every fault, in mid-motion; `--soak HOURS`: all of them, at random, for long.

use crate::cli::{CommandOutcome, inputs, output};
use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::drill::bench::Make;
use crate::drill::process::Harm;
use crate::drill::run::{Allowance, fly};
use crate::drill::{Row, list, process, soak};
use crate::service::memory::Store;
use comfy_table::{CellAlignment, ColumnConstraint, Table, Width, presets};
use miette::{IntoDiagnostic, Result, miette};
use serde_json::json;
use std::path::PathBuf;

/// Arguments of `drill`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Write the rows as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Only the faults whose name contains this.
    #[arg(long)]
    only: Option<String>,
    /// How often the process is killed.
    #[arg(long, default_value_t = 200)]
    kills: u32,
    /// Leave out the faults of the process, which take real time.
    #[arg(long)]
    in_flight: bool,
    /// Only the faults of the process.
    #[arg(long, conflicts_with = "in_flight")]
    process: bool,
    /// In place of the drill, hours of random commands and faults.
    #[arg(long)]
    soak: Option<f64>,
    /// Seed of the soak.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Work with the memory in this folder, to be killed at it.
    #[arg(long, hide = true)]
    exercise: Option<PathBuf>,
    /// What an exercise does to its own disk.
    #[arg(long, hide = true, requires = "exercise")]
    harm: Option<Harm>,
    /// Say what the memory in this folder holds.
    #[arg(long, hide = true)]
    recall: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// A report that says what was wrong with the input.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let make = twin()?;
    if let Some(folder) = &args.exercise {
        process::exercise(&make, folder, args.harm).into_diagnostic()?;
        return Ok(CommandOutcome::Good);
    }
    if let Some(folder) = &args.recall {
        return recall(folder);
    }
    output::check(&[("--json", args.json.as_deref())], &[])?;
    if let Some(hours) = args.soak {
        return soak_for(args, &make, hours);
    }
    let rows = rows(args, &make)?;
    if rows.is_empty() {
        return Err(miette!("--only {}: no fault has that in its name", args.only.as_deref().unwrap_or("")));
    }
    output::json(args.json.as_deref(), &json!({ "rows": rows }))?;
    show(&rows, args.json.as_deref());
    Ok(if rows.iter().all(|r| r.ok) { CommandOutcome::Good } else { CommandOutcome::NotGoodEnough })
}

/// The paper twin with the paper's calibration.
fn twin() -> Result<Make> {
    let board: Board = inputs::board(None)?;
    let calibration: Calibration = inputs::calibration(None)?;
    Ok(Make { board, calibration, gains: Gains::default() })
}

fn rows(args: &Args, make: &Make) -> Result<Vec<Row>> {
    let wanted = |name: &str| args.only.as_ref().is_none_or(|only| name.contains(only.as_str()));
    let mut rows = Vec::new();
    let allowance = Allowance::new(make).into_diagnostic()?;
    let specs = list::specs();
    let bar = output::bar(specs.len() as u64, "fault {pos} of {len}");
    for spec in specs.iter().filter(|s| wanted(s.name) && !args.process) {
        rows.push(fly(make, spec, &allowance).into_diagnostic()?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    if !args.in_flight && (args.only.is_none() || rows.is_empty()) {
        let program = std::env::current_exe().into_diagnostic()?;
        let scratch = Scratch::new()?;
        let process = process::rows(make, &program, &scratch.0, args.kills).into_diagnostic()?;
        rows.extend(process.into_iter().filter(|r| wanted(&r.fault)));
    }
    Ok(rows)
}

/// A folder of our own that goes away.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Result<Self> {
        let path = std::env::temp_dir().join(format!("retroflex-drill-{}", std::process::id()));
        std::fs::create_dir(&path).into_diagnostic()?;
        Ok(Self(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // whatever is left of it is the system's to clear away
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn recall(folder: &std::path::Path) -> Result<CommandOutcome> {
    let (_, recall) = Store::open(folder).into_diagnostic()?;
    let Some((memory, kept)) = recall.memory.and_then(|m| m.kept.map(|k| (m.armed, k))) else {
        println!("recalled nothing");
        return Ok(CommandOutcome::NotGoodEnough);
    };
    let [a, b, c] = kept.steps.0;
    println!("recalled {} {a} {b} {c} .", i32::from(memory));
    Ok(CommandOutcome::Good)
}

fn soak_for(args: &Args, make: &Make, hours: f64) -> Result<CommandOutcome> {
    if !(0.001..=10_000.0).contains(&hours) {
        return Err(miette!("--soak {hours}: give 0.001 to 10000 simulated hours"));
    }
    eprintln!("seed {}", args.seed);
    let bar = output::bar(1000, "soak {percent} %");
    let result = soak::run(make, hours, args.seed, &mut |h| bar.set_position((1000.0 * h / hours) as u64));
    bar.finish_and_clear();
    let soak = result.into_diagnostic()?;
    output::json(args.json.as_deref().or(Some(std::path::Path::new("-"))), &soak)?;
    Ok(if soak.ok { CommandOutcome::Good } else { CommandOutcome::NotGoodEnough })
}

fn show(rows: &[Row], json: Option<&std::path::Path>) {
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header(["fault", "noticed", "steps after", "state", "error during", "after", "ok", "said"]);
    for r in rows {
        let noticed =
            r.detected_s.map_or_else(|| "–".to_owned(), |s| if s < 1.0 { format!("{:.0} ms", s * 1e3) } else { format!("{s:.1} s") });
        let said = if r.ok { r.message.clone() } else { format!("{} · {}", r.why, r.message) };
        table.add_row([
            r.fault.clone(),
            noticed,
            format!("{} of {}", r.steps_after, r.steps_allowed),
            r.state.clone(),
            format!("{:.1}°", r.error_deg_during),
            format!("{:.1}°", r.error_deg_after),
            if r.ok { "yes" } else { "NO" }.to_owned(),
            said,
        ]);
    }
    for column in table.column_iter_mut().skip(1).take(5) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    if let Some(column) = table.column_mut(7) {
        column.set_constraint(ColumnConstraint::UpperBoundary(Width::Fixed(80)));
    }
    let bad = rows.iter().filter(|r| !r.ok).count();
    let text = format!("{table}\n{} faults, {bad} not survived as promised\n", rows.len());
    output::show(&text, json);
}
