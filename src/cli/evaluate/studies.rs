//! `evaluate --sweep` and `evaluate --ablate`: tables, JSON and the drawing of the envelope.

use super::args::Args;
use crate::cli::{inputs, output};
use crate::config::{Board, Gains, PlantSection, assemble};
use crate::experiment::ablation::{self, AblationRow, MECHANISMS};
use crate::experiment::sweep::{self, CONDITIONS, Condition, Study, SweepRow};
use crate::report::evaluation::settle;
use crate::report::sweep as picture;
use miette::{IntoDiagnostic, Result, bail};
use serde_json::json;
use std::time::Instant;

/// Units of a row of the sweep, and of the ablation.
const SWEEP_UNITS: u64 = 5;
const ABLATION_UNITS: u64 = 1;

/// Runs a study on the plant of `section`.
///
/// # Errors
/// A report about the input or the plant.
pub(super) fn run(
    args: &Args,
    section: &PlantSection,
    board: &Board,
    gains: &Gains,
) -> Result<bool> {
    let study = Study {
        config: assemble(board, &inputs::calibration(args.calib.as_deref())?, gains),
        make: section.clone(),
        seed: args.seed,
        units: if args.sweep {
            SWEEP_UNITS
        } else {
            ABLATION_UNITS
        },
    };
    let only = args.only.as_deref().unwrap_or_default();
    let mut conditions: Vec<Condition> = CONDITIONS.to_vec();
    conditions.retain(|c| c.name.contains(only));
    if conditions.is_empty() {
        let names = CONDITIONS.map(|c| c.name).join(", ");
        bail!("--only {only}: no condition has a name that contains this text; there are {names}");
    }
    if args.sweep {
        run_sweep(args, &study, &conditions)
    } else {
        run_ablation(args, &study, &conditions).map(|()| true)
    }
}

fn run_sweep(args: &Args, study: &Study, conditions: &[Condition]) -> Result<bool> {
    let start = Instant::now();
    let rows = sweep::rows(conditions).len() as u64;
    let bar = output::bar(rows * study.units, "units,");
    let rows = sweep::run(study, conditions, &|| bar.inc(1)).into_diagnostic()?;
    bar.finish_and_clear();
    let result = json!({ "seed": study.seed, "units": study.units, "sweep": rows });
    output::write_some(&args.svg, || Ok(picture::svg(&rows)))?;
    let (failed, all) = (rows.iter().filter(|r| !r.ok).count(), rows.len());
    let header = "condition|value|open|closed|95 %|hunting|cold|";
    let table = output::table(header, 1..7, rows.iter().map(sweep_row));
    let (units, directions) = (study.units, sweep::DIRECTIONS);
    let (took_s, with) = (start.elapsed().as_secs_f64(), calibration(args));
    let text = format!(
        "{table}\n{failed} of {all} rows fail; {units} units each, {directions} of 12 directions; {with} (in {took_s:.0} s)\n"
    );
    output::answer(&args.json, &result, text)?;
    Ok(failed == 0)
}

fn sweep_row(r: &SweepRow) -> Vec<String> {
    let deg = |x: f64| format!("{x:.2}°");
    vec![
        r.condition.to_owned(),
        r.value.to_string(),
        deg(r.open_deg),
        deg(r.closed_deg),
        deg(r.p95_deg),
        deg(r.hunting_deg),
        deg(r.cold_deg),
        if r.ok { "" } else { "FAILS" }.to_owned(),
    ]
}

fn run_ablation(args: &Args, study: &Study, conditions: &[Condition]) -> Result<()> {
    let each = sweep::rows(conditions).len();
    let all = (MECHANISMS.len() * each) as u64 * study.units;
    let bar = output::bar(all, "units,");
    let rows = ablation::run(study, &MECHANISMS, conditions, &|| bar.inc(1)).into_diagnostic()?;
    bar.finish_and_clear();
    let result = json!({ "seed": study.seed, "units": study.units, "ablate": rows });
    let header = "without|RMSE|ratio|to 1°|never|needed most by|ratio";
    let table = output::table(header, 1..5, rows.iter().map(ablation_row));
    let (units, with) = (study.units, calibration(args));
    let text = format!("{table}\nclosed loop, {each} conditions, {units} units each, {with}\n");
    output::answer(&args.json, &result, text)
}

fn ablation_row(r: &AblationRow) -> Vec<String> {
    let (condition, value, most) = r.needed;
    vec![
        r.without.to_owned(),
        format!("{:.3}°", r.bend_rmse_deg),
        format!("{:.2}", r.ratio),
        settle(r.settle_s_median),
        r.unsettled.to_string(),
        format!("{condition} {value}"),
        format!("{most:.2}"),
    ]
}

fn calibration(args: &Args) -> String {
    match &args.calib {
        Some(path) => format!("calibration {}", path.display()),
        None => "the paper's calibration for every unit".to_owned(),
    }
}
