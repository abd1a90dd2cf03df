//! `retroflex gap diagnose`: diagnoses a log, prints the answer and writes it to files.

use crate::cli::calibrate::today;
use crate::cli::gap::input::{self, DrivenArgs, file_name};
use crate::cli::gap::rows::{self, RowsArgs, Settings};
use crate::cli::{ResultFile, output};
use crate::config::source;
use crate::diagnosis::diagnose;
use crate::diagnosis::rig::{Document, MapFile, RigProblem, SavedRig};
use crate::diagnosis::tip::observed::Segment;
use crate::diagnosis::tip::{SavedModel, TipProblem};
use crate::model::effects::catalogue;
use crate::report::gap::evidence::Evidence;
use crate::report::gap::map::{self, Rows};
use crate::report::gap::{page, summary};
use crate::service::flight::cycle::fnv;
use miette::{IntoDiagnostic, Result, bail};
use serde::Serialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// What progress shows.
const FITTED: &str = "the effects are fitted,";

/// Arguments of `gap diagnose`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Bend log, *.csv or *.csv.gz; several logs of one unit are diagnosed together.
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Map of the columns of the logs of another rig.
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["board", "calib"])]
    map: Option<PathBuf>,
    #[command(flatten)]
    driven: DrivenArgs,
    /// Write the diagnosis as JSON.
    #[arg(long)]
    json: Option<ResultFile>,
    /// Write the diagnosis as one printable page.
    #[arg(long)]
    html: Option<ResultFile>,
    /// Save the recalibrated and the explained model for `gap check` and, of a tip, for `gap apply`, `gap excite --like`,
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
        return run_mapped(map, args);
    }
    let (lines, rig) = (args.driven.lines()?, args.driven.rig()?);
    let mut logs = input::each(&args.logs, |path| input::observe(path, &rig))?;
    // at least one is required
    let mut observed = logs.remove(0);
    logs.into_iter().for_each(|log| observed.append(log));
    let bar = output::bar(0, FITTED);
    let done = diagnose(&TipProblem::new(&observed, catalogue(), &lines, args.seed));
    bar.finish_and_clear();
    let html = || {
        let seconds = |part: &Segment| {
            let [first, last] =
                [part.instants.start, part.instants.end - 1].map(|k| observed.instants[k].t_s);
            format!("{:.0} s", last - first)
        };
        let lengths = observed.segments.iter().map(seconds);
        let [board, calib] = args.driven.named();
        let made = made_from(args, lengths, &[("board", board), ("calibration", calib)])?;
        let (logs, evidence) = (
            listed(&args.logs, file_name),
            Evidence::new(&observed, &done),
        );
        Ok(page(&logs, &done.document, &evidence, &made))
    };
    let model = || {
        let model = SavedModel::new(&sources(args), &done).with_forecast(&observed, &done);
        toml::to_string(&model).into_diagnostic()
    };
    let text = summary(&done.document, args.save.as_deref());
    write(args, &done.document, html, model, &text)
}

/// Diagnoses logs of another rig.
fn run_mapped(map_file: &Path, args: &Args) -> Result<()> {
    let map: MapFile = source::read(map_file)?;
    let logs = input::each(&args.logs, |path| input::mapped(path, &map, map_file))?;
    let bar = output::bar(0, FITTED);
    let problem = RigProblem::new(&map, &logs, args.seed);
    let done = problem.as_ref().map(|problem| (problem, diagnose(problem)));
    bar.finish_and_clear();
    let empty = Document::empty(&map);
    let document = done.as_ref().map_or(&empty, |(_, done)| &done.document);
    let html = || {
        let rows = done
            .as_ref()
            .map(|(problem, done)| Rows::new(problem, &done.chosen));
        let lengths = logs.iter().map(|log| format!("{} rows", log.t.len()));
        let made = made_from(args, lengths, &[("map", file_name(map_file))])?;
        let logs = listed(&args.logs, file_name);
        Ok(map::page(&logs, document, &rows.unwrap_or_default(), &made))
    };
    let model = || {
        let Some((problem, done)) = &done else {
            bail!("--save: the logs do not determine a model; record the inputs one by one");
        };
        toml::to_string(&SavedRig::new(sources(args), problem, done)).into_diagnostic()
    };
    write(args, document, html, model, &map::summary(document))
}

/// Writes the requested files, none unless all can be made, and shows the answer.
fn write(
    args: &Args,
    document: &impl Serialize,
    html: impl FnOnce() -> Result<String>,
    model: impl FnOnce() -> Result<String>,
    answer: &str,
) -> Result<()> {
    let mut files: Vec<(&Path, String)> = Vec::new();
    if let Some(path) = &args.json {
        files.push((path, json(document)?));
    }
    if let Some(path) = &args.html {
        files.push((path, html()?));
    }
    if let Some(path) = &args.save {
        files.push((path, model()?));
    }
    for (path, text) in files {
        output::write(path, &text)?;
        if path != Path::new("-") {
            eprintln!("written: {}", path.display());
        }
    }
    output::show(format!("{answer}\n"), &args.json);
    Ok(())
}

/// What a diagnosis was made from and with, so that its page can be told from that of another day.
fn made_from(
    args: &Args,
    lengths: impl Iterator<Item = String>,
    with: &[(&str, String)],
) -> Result<Vec<[String; 2]>> {
    let row = |name: &str, value: String| [name.to_owned(), value];
    let version = env!("CARGO_PKG_VERSION").to_owned();
    let mut made = vec![row("retroflex", version), row("date", today())];
    for (log, length) in args.logs.iter().zip(lengths) {
        let hash = fnv(std::fs::read(log).into_diagnostic()?);
        made.push(row(&file_name(log), format!("{length}, hash {hash:016x}")));
    }
    made.extend(with.iter().map(|(name, value)| row(name, value.clone())));
    made.push(row("seed", args.seed.to_string()));
    Ok(made)
}

/// The logs as a saved model names them.
fn sources(args: &Args) -> String {
    listed(&args.logs, |log| log.display().to_string())
}

fn listed(logs: &[PathBuf], name: impl Fn(&Path) -> String) -> String {
    let names = logs.iter().map(|log| name(log));
    names.collect::<Vec<_>>().join(", ")
}

/// The document as JSON. JSON cannot represent a number that is not finite, so such a number is an error.
fn json(document: &impl Serialize) -> Result<String> {
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
