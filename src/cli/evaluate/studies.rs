//! `evaluate --sweep` and `evaluate --ablate`: tables, JSON and the drawing of the envelope.

use crate::cli::{CommandOutcome, inputs, output};
use crate::config::assemble;
use crate::config::{Board, Gains, PlantSection};
use crate::experiment::ablation::{self, AblationRow, MECHANISMS};
use crate::experiment::sweep::{self, CONDITIONS, Condition, Study, SweepRow};
use crate::report::evaluation::settle;
use crate::report::sweep as picture;
use miette::{IntoDiagnostic, Result, bail};
use serde_json::json;
use std::path::Path;
use std::time::Instant;

/// Units of a row of the sweep, and of the ablation.
const SWEEP_UNITS: u64 = 5;
const ABLATION_UNITS: u64 = 10;

/// What the command line asks of a study.
pub(super) struct Request<'a> {
    /// The sweep; otherwise the ablation.
    pub sweep: bool,
    /// Text that the names of the conditions contain.
    pub only: Option<&'a str>,
    pub calib: Option<&'a Path>,
    pub json: Option<&'a Path>,
    pub svg: Option<&'a Path>,
    pub seed: u64,
}

/// Runs a study on the plant of `section`.
///
/// # Errors
/// A report about the input or the plant.
pub(super) fn run(
    request: &Request<'_>,
    section: &PlantSection,
    board: &Board,
    gains: &Gains,
) -> Result<CommandOutcome> {
    let units = if request.sweep {
        SWEEP_UNITS
    } else {
        ABLATION_UNITS
    };
    let study = Study {
        config: assemble(board, &inputs::calibration(request.calib)?, gains),
        make: section.make(),
        period_s: section.period_s,
        seed: request.seed,
        units,
    };
    match request.sweep {
        true => run_sweep(request, &study),
        false => run_ablation(request, &study),
    }
}

fn run_sweep(request: &Request<'_>, study: &Study) -> Result<CommandOutcome> {
    let start = Instant::now();
    let only = request.only.unwrap_or_default();
    let mut conditions: Vec<Condition> = CONDITIONS.to_vec();
    conditions.retain(|c| c.name.contains(only));
    if conditions.is_empty() {
        let names = CONDITIONS.map(|c| c.name).join(", ");
        bail!("--only {only}: no condition has a name that contains this text; there are {names}");
    }
    let rows: usize = conditions.iter().map(|c| c.values.len()).sum();
    let bar = output::bar(rows as u64 * study.units, "units,");
    let rows = sweep::run(study, &conditions, &|| bar.inc(1)).into_diagnostic()?;
    bar.finish_and_clear();
    let result = json!({ "seed": study.seed, "units": study.units, "sweep": rows });
    output::json(request.json, &result)?;
    if let Some(path) = request.svg {
        output::write(path, picture::svg(&rows))?;
    }
    let (failed, all) = (rows.iter().filter(|r| !r.ok).count(), rows.len());
    let header = [
        "condition",
        "value",
        "open",
        "closed",
        "95 %",
        "hunting",
        "cold",
        "",
    ];
    let table = output::table(&header, 1..7, rows.iter().map(sweep_row));
    let (units, directions, took_s) = (
        study.units,
        sweep::DIRECTIONS,
        start.elapsed().as_secs_f64(),
    );
    let with = calibration(request);
    let text = format!(
        "{table}\n{failed} of {all} rows fail; {units} units each, {directions} of 12 directions; {with} (in {took_s:.0} s)\n"
    );
    output::show(&text, request.json);
    Ok(CommandOutcome::from(failed == 0))
}

fn sweep_row(r: &SweepRow) -> Vec<String> {
    let deg = |x: f64| format!("{x:.2}°");
    let verdict = if r.ok { "" } else { "FAILS" };
    let numbers = [
        r.open_deg,
        r.closed_deg,
        r.p95_deg,
        r.hunting_deg,
        r.cold_deg,
    ]
    .map(deg);
    let [open, closed, p95, hunting, cold] = numbers;
    vec![
        r.condition.to_owned(),
        r.value.to_string(),
        open,
        closed,
        p95,
        hunting,
        cold,
        verdict.to_owned(),
    ]
}

fn run_ablation(request: &Request<'_>, study: &Study) -> Result<CommandOutcome> {
    let bar = output::bar(MECHANISMS.len() as u64 * study.units, "units,");
    let rows = ablation::run(study, &MECHANISMS, &|| bar.inc(1)).into_diagnostic()?;
    bar.finish_and_clear();
    let result = json!({ "seed": study.seed, "units": study.units, "ablate": rows });
    output::json(request.json, &result)?;
    let columns = "without,bend RMSE,worst unit,median to 1°,95 % to 1°,never to 1°,peak to peak";
    let columns: Vec<&str> = columns.split(',').collect();
    let table = output::table(&columns, 1..columns.len(), rows.iter().map(ablation_row));
    let (units, with) = (study.units, calibration(request));
    output::show(
        &format!("{table}\nclosed loop, {units} units, {with}\n"),
        request.json,
    );
    Ok(CommandOutcome::Good)
}

fn ablation_row(r: &AblationRow) -> Vec<String> {
    vec![
        r.without.to_owned(),
        format!("{:.3}°", r.bend_rmse_deg),
        format!("{:.3}°", r.worst_deg),
        settle(r.settle_s_median),
        settle(r.settle_s_p95),
        r.unsettled.to_string(),
        format!("{:.2}°", r.peak_to_peak_max_deg),
    ]
}

fn calibration(request: &Request<'_>) -> String {
    match request.calib {
        Some(path) => format!("calibration {}", path.display()),
        None => "the paper's calibration for every unit".to_owned(),
    }
}
