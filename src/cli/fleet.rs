//! `retroflex fleet`: what the rows of many diagnoses tell about the lots of a fleet and about its next unit.

use crate::cli::gap::rows::read;
use crate::cli::{CommandOutcome, output};
use crate::config::Calibration;
use crate::diagnosis::fleet::row::{self, Row};
use crate::diagnosis::fleet::{Finding, GAINS, Lot, Spread, Survey};
use crate::log::columns;
use crate::report::bars::{self, Bar};
use crate::report::page::Page;
use crate::report::svg::Ink;
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
    merged: Option<PathBuf>,
    /// Write a calibration file for a new unit: the gains of the fleet and their spread, with which `calibrate transmission --short`
    /// needs fewer poses.
    #[arg(long, value_name = "CALIB.toml")]
    prior: Option<PathBuf>,
    /// Write the result as JSON; `-` is standard output.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Write the result as one printable page.
    #[arg(long)]
    html: Option<PathBuf>,
}

/// Surveys the rows.
///
/// # Errors
/// A report that names the faulty file.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let (json, html) = (args.json.as_deref(), args.html.as_deref());
    let results = [
        ("--merged", args.merged.as_deref()),
        ("--prior", args.prior.as_deref()),
        ("--json", json),
        ("--html", html),
    ];
    output::check(
        &results,
        &args.tables.iter().map(PathBuf::as_path).collect::<Vec<_>>(),
    )?;
    let mut rows: BTreeMap<String, Row> = BTreeMap::new();
    for table in &args.tables {
        for row in read(table)? {
            let log = row.log.clone();
            if rows.get(&log).is_some_and(|known| *known != row) {
                bail!(
                    "{}: {log} has another row in another table; diagnose it again, with the same settings everywhere",
                    table.display()
                );
            }
            rows.insert(log, row);
        }
    }
    let rows: Vec<Row> = rows.into_values().collect();
    let survey = Survey::new(&rows);
    let prior = args.prior.as_ref().map(|_| prior(&survey)).transpose()?;
    if let Some(path) = &args.merged {
        output::write(
            path,
            columns::write(&row::table(&rows), &[]).into_diagnostic()?,
        )?;
    }
    if let (Some(path), Some(prior)) = (&args.prior, &prior) {
        output::write(path, toml::to_string(prior).into_diagnostic()?)?;
    }
    output::json(json, &survey)?;
    if let Some(path) = html {
        output::write(path, page(&survey).html())?;
    }
    output::show(&summary(&survey), json);
    Ok(CommandOutcome::Good)
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
    let (value, sigma) = (
        |k: usize| rounded(gains[k].median),
        |k: usize| rounded(gains[k].sigma),
    );
    let mut prior = Calibration::default();
    let transmission = &mut prior.transmission;
    for i in 0..3 {
        transmission.k_epsilon[i] = value(i);
        transmission.k_epsilon_sigma[i] = sigma(i);
        transmission.k_lambda_mm[i] = value(3 + i);
        transmission.k_lambda_sigma_mm[i] = sigma(3 + i);
    }
    transmission.source = format!(
        "median and spread of the {} sound ones of {} logs",
        gains[0].n, survey.lots[0].logs
    );
    prior.dynamics.lag_s = value(6);
    Ok(prior)
}

/// A finding in words.
fn words(f: &Finding) -> String {
    let (here, elsewhere) = match f.what.starts_with("k_") || f.what == "lag_s" {
        true => (format!("{:.3}", f.here), format!("{:.3}", f.elsewhere)),
        false => (
            format!("{:.0} %", f.here * 100.0),
            format!("{:.0} %", f.elsewhere * 100.0),
        ),
    };
    let lot = f
        .lot
        .as_ref()
        .map_or("each lot".to_owned(), |lot| format!("lot {lot}"));
    let sides = if f.drifts {
        ["the later half of ", "the earlier"]
    } else {
        ["", "the others"]
    };
    format!(
        "{}: {here} in {}{lot}, {elsewhere} in {} (p = {:.1e})",
        f.what, sides[0], sides[1], f.p
    )
}

fn summary(survey: &Survey) -> String {
    let row = |lot: &Lot| {
        let shares: Vec<String> = lot
            .shares
            .iter()
            .take(4)
            .map(|(name, share)| format!("{name} {:.0} %", share * 100.0))
            .collect();
        [lot.name.clone(), lot.logs.to_string(), shares.join(", ")]
    };
    let mut text = format!(
        "{}\n",
        output::table(
            &["lot", "logs", "verdicts"],
            1..2,
            survey.lots.iter().map(row)
        )
    );
    for (name, Spread { n, median, sigma }) in &survey.gains {
        text +=
            &format!("{name}: {median:.3} ± {sigma:.3} for the next unit, from {n} sound logs\n");
    }
    if survey.findings.is_empty() {
        text += "no lot differs from the others, and nothing drifts\n";
    }
    survey
        .findings
        .iter()
        .for_each(|f| text += &format!("{}\n", words(f)));
    if survey.refused > 0 {
        text += &format!(
            "{} logs cannot be diagnosed; the column `refused` says why\n",
            survey.refused
        );
    }
    text
}

fn page(survey: &Survey) -> Page {
    let mut page = Page::new("Fleet");
    page.heading("Findings");
    page.output(&summary(survey));
    page.quiet("p is the probability of a difference as large by chance, corrected for the number of comparisons; from 0.01 on nothing is claimed.");
    page.heading("Verdicts by lot");
    let bar = |(name, share): &(String, f64)| Bar {
        name: name.clone(),
        share: *share,
        interval: None,
        strong: true,
    };
    let chart = |lot: &Lot| {
        let bars: Vec<Bar> = lot.shares.iter().map(bar).collect();
        (
            bars::svg(&lot.name, Ink::GREEN, &bars),
            format!("{} logs", lot.logs),
        )
    };
    page.charts(&survey.lots.iter().map(chart).collect::<Vec<_>>());
    page
}
