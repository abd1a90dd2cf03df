//! `retroflex fleet`: what the rows of many diagnoses tell about the lots of a fleet and about its next unit.

use crate::cli::gap::rows::read;
use crate::cli::{ResultFile, output};
use crate::config::Calibration;
use crate::diagnosis::fleet::row::FleetRow;
use crate::diagnosis::fleet::{GAINS, Survey, row};
use crate::log::columns;
use crate::report::fleet::{page, summary};
use miette::{IntoDiagnostic, Result, bail, miette};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Least value and least standard deviation in a prior.
const LEAST: f64 = 0.001;
/// Fewest sound logs of a prior.
const SOUND_MIN: usize = 3;

/// Arguments of `fleet`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Tables of `gap diagnose --rows`; those of several shards are merged.
    #[arg(required = true, value_name = "ROWS.parquet")]
    tables: Vec<PathBuf>,
    /// Write the merged table.
    #[arg(long, value_name = "ROWS.parquet")]
    merged: Option<ResultFile>,
    /// Write a calibration file for a new unit: the gains of the fleet and their spread, with which `calibrate transmission --short`
    /// needs fewer poses.
    #[arg(long, value_name = "CALIB.toml")]
    prior: Option<ResultFile>,
    /// Write the result as JSON; `-` is standard output.
    #[arg(long)]
    json: Option<ResultFile>,
    /// Write the result as one printable page.
    #[arg(long)]
    html: Option<ResultFile>,
}

/// Surveys the rows.
///
/// # Errors
/// A report that names the faulty file.
pub fn run(args: &Args) -> Result<()> {
    let mut rows: BTreeMap<String, FleetRow> = BTreeMap::new();
    for table in &args.tables {
        for row in read(table)? {
            let (log, file) = (row.log.clone(), table.display());
            if rows.get(&log).is_some_and(|known| *known != row) {
                bail!(
                    "{file}: {log} has another row in another table; diagnose it again, with the same settings everywhere"
                );
            }
            rows.insert(log, row);
        }
    }
    let rows: Vec<FleetRow> = rows.into_values().collect();
    let survey = Survey::new(&rows);
    output::write_some(&args.prior, || {
        toml::to_string(&prior(&survey)?).into_diagnostic()
    })?;
    output::write_some(&args.merged, || {
        columns::write(&row::table(&rows), &[]).into_diagnostic()
    })?;
    output::write_some(&args.html, || Ok(page(&survey).html()))?;
    output::answer(&args.json, &survey, summary(&survey))
}

/// A calibration file of the fleet's gains and their spread.
fn prior(survey: &Survey) -> Result<Calibration> {
    let mut gains = Vec::new();
    for name in GAINS {
        let gain = survey.gains.get(name);
        let sound = gain.map_or(0, |g| g.n);
        let gain = gain.filter(|_| sound >= SOUND_MIN).ok_or_else(|| {
            miette!("--prior: {sound} logs of these tables are without an effect, and a prior needs {SOUND_MIN}; the paper's gains are a better start")
        })?;
        gains.push(*gain);
    }
    let rounded = |x: f64| ((x * 1e4).round() / 1e4).max(LEAST);
    let value = |k: usize| rounded(gains[k].median);
    let sigma = |k: usize| rounded(gains[k].sigma);
    let mut prior = Calibration::default();
    let transmission = &mut prior.transmission;
    for i in 0..3 {
        transmission.k_epsilon[i] = value(i);
        transmission.k_epsilon_sigma[i] = sigma(i);
        transmission.k_lambda_mm[i] = value(3 + i);
        transmission.k_lambda_sigma_mm[i] = sigma(3 + i);
    }
    let (sound, logs) = (gains[0].n, survey.lots[0].logs);
    transmission.source = format!("median and spread of the {sound} sound ones of {logs} logs");
    prior.dynamics.lag_s = value(6);
    Ok(prior)
}
