//! `retroflex gap diagnose`: diagnoses a log, prints the answer and writes it to files.

use crate::cli::calibrate::today;
use crate::cli::gap::input::{self, DrivenArgs, file_name};
use crate::cli::gap::rows::{self, RowsArgs, Settings};
use crate::cli::{ResultFile, output};
use crate::config::source;
use crate::diagnosis::diagnose;
use crate::diagnosis::rig::{Document, MapFile, table};
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::{Diagnosed, Diagnosis, SavedModel, TipProblem};
use crate::model::effects::catalogue;
use crate::report::gap::answer::summary;
use crate::report::gap::evidence::Evidence;
use crate::report::gap::page;
use crate::service::flight::cycle::fnv;
use miette::{IntoDiagnostic, Result, bail};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Arguments of `gap diagnose`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Bend log, *.csv or *.csv.gz; several logs of one unit are diagnosed together.
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Map of the columns of a log of another rig.
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["board", "calib", "html", "save"])]
    map: Option<PathBuf>,
    /// With --map: another log of the rig, on which the fitted model is evaluated; may be repeated.
    #[arg(long, value_name = "LOG", requires = "map")]
    fresh: Vec<PathBuf>,
    #[command(flatten)]
    driven: DrivenArgs,
    /// Write the diagnosis as JSON.
    #[arg(long)]
    json: Option<ResultFile>,
    /// Write the diagnosis as one printable page.
    #[arg(long)]
    html: Option<ResultFile>,
    /// Save the recalibrated and the explained model for `gap check`, `gap apply`, `gap excite --like`,
    /// `evaluate --feedforward` and `--plant model:`.
    #[arg(long, value_name = "MODEL.toml")]
    save: Option<ResultFile>,
    #[command(flatten)]
    many: RowsArgs,
    /// Seed of the block bootstrap.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Diagnoses and writes. No file is written unless all can be.
///
/// # Errors
/// A report that names the faulty input.
pub fn run(args: &Args) -> Result<()> {
    if let Some(table) = &args.many.rows {
        let settings = Settings {
            rig: args.driven.rig()?,
            lines: args.driven.lines()?,
            seed: args.seed,
        };
        return rows::run(&args.logs, &settings, &args.many, table);
    }
    if let Some(folder) = args.logs.iter().find(|log| log.is_dir()) {
        let folder = folder.display();
        bail!(
            "{folder}: this is a folder; `gap diagnose {folder} --rows rows.parquet` diagnoses every log in it"
        );
    }
    if let Some(map) = &args.map {
        let [log] = args.logs.as_slice() else {
            bail!(
                "--map: {} logs are given, 1 is allowed; `--fresh LOG` names further logs of the rig",
                args.logs.len()
            );
        };
        return run_mapped(log, map, args);
    }
    let lines = args.driven.lines()?;
    let observed = input::observe_together(&args.logs, &args.driven.rig()?)?;
    let bar = output::bar(0, "the effects are fitted,");
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    let done = diagnose(&TipProblem::new(&observed, catalogue(), &lines, args.seed));
    bar.finish_and_clear();
    for (path, text) in files(args, &observed, &done)? {
        output::write(path, &text)?;
        if path != Path::new("-") {
            eprintln!("written: {}", path.display());
        }
    }
    let text = summary(&done.document, args.save.as_deref()) + "\n";
    output::show(text, &args.json);
    Ok(())
}

/// Diagnoses a log of another rig.
fn run_mapped(log: &Path, map: &Path, args: &Args) -> Result<()> {
    let map: MapFile = source::read(map)?;
    let signals = table::read(log, &map).into_diagnostic()?;
    let other = |path: &PathBuf| Ok((file_name(path), table::read(path, &map).into_diagnostic()?));
    let others = args.fresh.iter().map(other).collect::<Result<Vec<_>>>()?;
    let document = Document::new(&map, &signals, &others, args.seed);
    let text = crate::report::gap::map::summary(&document) + "\n";
    output::answer(&args.json, &document, text)
}

/// Requested files with their contents.
fn files<'a>(
    args: &'a Args,
    observed: &Observed,
    done: &Diagnosed,
) -> Result<Vec<(&'a Path, String)>> {
    let mut out: Vec<(&Path, String)> = Vec::new();
    if let Some(path) = &args.json {
        out.push((path, json(&done.document)?));
    }
    if let Some(path) = &args.html {
        let (logs, evidence) = (listed(&args.logs, file_name), Evidence::new(observed, done));
        let made = made_from(args, observed)?;
        out.push((path, page(&logs, &done.document, &evidence, &made)));
    }
    if let Some(path) = &args.save {
        let logs = listed(&args.logs, |log| log.display().to_string());
        let model = SavedModel::new(&logs, done);
        let model = model.with_forecast(observed, done);
        out.push((path, toml::to_string(&model).into_diagnostic()?));
    }
    Ok(out)
}

/// What a diagnosis was made from and with, so that its page can be told from that of another day.
fn made_from(args: &Args, observed: &Observed) -> Result<Vec<[String; 2]>> {
    let row = |name: &str, value: String| [name.to_owned(), value];
    let version = env!("CARGO_PKG_VERSION").to_owned();
    let mut made = vec![row("retroflex", version), row("date", today())];
    for (log, part) in args.logs.iter().zip(&observed.segments) {
        let hash = fnv(std::fs::read(log).into_diagnostic()?);
        let [first, last] =
            [part.instants.start, part.instants.end - 1].map(|k| observed.instants[k].t_s);
        let duration_s = last - first;
        let shown = format!("{duration_s:.0} s, hash {hash:016x}");
        made.push(row(&file_name(log), shown));
    }
    let ([board, calib], seed) = (args.driven.named(), args.seed.to_string());
    made.extend([
        row("board", board),
        row("calibration", calib),
        row("seed", seed),
    ]);
    Ok(made)
}

fn listed(logs: &[PathBuf], name: impl Fn(&Path) -> String) -> String {
    let names = logs.iter().map(|log| name(log));
    names.collect::<Vec<_>>().join(", ")
}

/// The document as JSON. JSON cannot represent a number that is not finite, so such a number is an error.
fn json(document: &Diagnosis) -> Result<String> {
    let value = serde_json::to_value(document).into_diagnostic()?;
    if let Some(key) = not_finite(&value, "") {
        bail!(
            "{key} is not a finite number; the log may have values outside the range of any sensor: check its units"
        );
    }
    Ok(serde_json::to_string_pretty(&value).into_diagnostic()? + "\n")
}

/// Key of the first null.
fn not_finite(value: &Value, key: &str) -> Option<String> {
    let dot = if key.is_empty() { "" } else { "." };
    match value {
        Value::Null => Some(key.to_owned()),
        Value::Array(all) => {
            let mut all = (0..).zip(all);
            all.find_map(|(i, v)| not_finite(v, &format!("{key}[{i}]")))
        }
        Value::Object(all) => {
            let mut all = all.iter();
            all.find_map(|(k, v)| not_finite(v, &format!("{key}{dot}{k}")))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_number_that_is_not_finite_is_named_by_its_key() {
        assert_eq!(
            not_finite(&json!({"a": [1.0, {"b": null}]}), ""),
            Some("a[1].b".to_owned())
        );
        assert_eq!(not_finite(&json!({"a": [1.0, "x", true]}), ""), None);
    }
}
