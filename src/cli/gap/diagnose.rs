//! `retroflex gap diagnose`: diagnoses a log, prints the answer and writes it to files.

use crate::cli::gap::rows::{self, RowsArgs, Settings};
use crate::cli::gap::{input, map};
use crate::cli::{CommandOutcome, inputs, output};
use crate::diagnosis::diagnose;
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::{Diagnosed, Diagnosis, EffectEntry, LogEntry, SavedModel, TipProblem};
use crate::model::effects::catalogue;
use crate::report::gap::evidence::Evidence;
use crate::report::gap::{page, words};
use miette::{IntoDiagnostic, Result, miette};
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
    /// Board file of the machine; default: the machine of the paper.
    #[arg(long, value_name = "FILE.toml")]
    board: Option<PathBuf>,
    /// Calibration the log was driven with.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// Write the diagnosis as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Write the diagnosis as one printable page.
    #[arg(long)]
    html: Option<PathBuf>,
    /// Save the recalibrated and the explained model for `gap check`, `gap apply`, `gap excite --like`,
    /// `evaluate --feedforward` and `--plant model:`.
    #[arg(long, value_name = "MODEL.toml")]
    save: Option<PathBuf>,
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
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let lines = || inputs::calibration(args.calib.as_deref()).map(|calib| calib.lines());
    if let Some(table) = &args.many.rows {
        let settings = Settings {
            rig: input::rig(args.board.as_deref())?,
            lines: lines()?,
            seed: args.seed,
        };
        return rows::run(&args.logs, &settings, &args.many, table);
    }
    if let Some(folder) = args.logs.iter().find(|log| log.is_dir()) {
        let folder = folder.display();
        return Err(miette!(
            "{folder}: this is a folder; `gap diagnose {folder} --rows rows.parquet` diagnoses every log in it"
        ));
    }
    let results = [
        ("--json", args.json.as_deref()),
        ("--html", args.html.as_deref()),
        ("--save", args.save.as_deref()),
    ];
    let inputs = args
        .logs
        .iter()
        .chain(&args.fresh)
        .chain(&args.map)
        .chain(&args.board)
        .chain(&args.calib);
    output::check(&results, &inputs.map(PathBuf::as_path).collect::<Vec<_>>())?;
    if let Some(map) = &args.map {
        let [log] = args.logs.as_slice() else {
            return Err(miette!(
                "--map: {} logs are given, 1 is allowed; `--fresh LOG` names further logs of the rig",
                args.logs.len()
            ));
        };
        return map::run(log, map, &args.fresh, args.json.as_deref(), args.seed);
    }
    let lines = lines()?;
    let observed = input::observe_together(&args.logs, &input::rig(args.board.as_deref())?)?;
    let bar = output::bar(0, "the effects are fitted,");
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    let catalogue = catalogue();
    let done = diagnose(&TipProblem::new(&observed, &catalogue, &lines, args.seed));
    bar.finish_and_clear();
    for (path, text) in files(args, &observed, &done)? {
        output::write(path, &text)?;
    }
    let answer = summary(&done.document, args.save.as_deref()) + "\n";
    output::show(&answer, args.json.as_deref());
    Ok(CommandOutcome::Good)
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
        let name = |log: &PathBuf| {
            log.file_name()
                .map_or_else(String::new, |n| n.to_string_lossy().into_owned())
        };
        out.push((
            path,
            page(
                &listed(&args.logs, name),
                &done.document,
                &Evidence::new(observed, done),
            ),
        ));
    }
    if let Some(path) = &args.save {
        let catalogue = catalogue();
        let model = SavedModel::new(
            &listed(&args.logs, |log| log.display().to_string()),
            &catalogue,
            done,
        )
        .with_forecast(observed, &catalogue, done);
        out.push((path, toml::to_string(&model).into_diagnostic()?));
    }
    Ok(out)
}

fn listed(logs: &[PathBuf], name: impl Fn(&PathBuf) -> String) -> String {
    logs.iter().map(name).collect::<Vec<_>>().join(", ")
}

/// The document as JSON. JSON cannot represent a number that is not finite, so such a number is an error.
fn json(document: &Diagnosis) -> Result<String> {
    let value = serde_json::to_value(document).into_diagnostic()?;
    if let Some(key) = not_finite(&value, "") {
        return Err(miette!(
            "{key} is not a finite number; the log may have values outside the range of any sensor: check its units"
        ));
    }
    Ok(serde_json::to_string_pretty(&value).into_diagnostic()? + "\n")
}

/// Key of the first null.
fn not_finite(value: &serde_json::Value, key: &str) -> Option<String> {
    match value {
        serde_json::Value::Null => Some(key.to_owned()),
        serde_json::Value::Array(all) => all
            .iter()
            .enumerate()
            .find_map(|(i, v)| not_finite(v, &format!("{key}[{i}]"))),
        serde_json::Value::Object(all) => all.iter().find_map(|(k, v)| {
            not_finite(
                v,
                &if key.is_empty() {
                    k.clone()
                } else {
                    format!("{key}.{k}")
                },
            )
        }),
        _ => None,
    }
}

/// Number of effects in the table: the probable ones, and at least three.
fn shown(d: &Diagnosis) -> usize {
    d.effects
        .iter()
        .take_while(|e| e.probability >= 0.01)
        .count()
        .clamp(3, 6)
}

fn summary(d: &Diagnosis, saved: Option<&Path>) -> String {
    let row = |e: &EffectEntry| {
        [
            e.name.to_owned(),
            e.stage.to_owned(),
            format!("{:.2}", e.probability),
            format!("{:.2}°", e.gap_before_deg),
            format!("{:.2}°", e.gap_after_deg),
            format!("{:.0} %", e.closed * 100.0),
            format!(
                "{:.0} to {:.0} %",
                e.closed_ci95[0] * 100.0,
                e.closed_ci95[1] * 100.0
            ),
        ]
    };
    let header = [
        "effect", "stage", "prob.", "before", "after", "closed", "95 %",
    ];
    let table = output::table(&header, 2..7, d.effects.iter().take(shown(d)).map(row));
    let names = if d.verdict.names.is_empty() {
        String::new()
    } else {
        format!(": {}", d.verdict.names.join(" and "))
    };
    let mut out = vec![
        words::opening(d),
        format!("verdict {}{names}", d.verdict.kind.name()),
        words::headline(d),
        words::place(d),
    ];
    for e in d
        .effects
        .iter()
        .filter(|e| d.verdict.names.contains(&e.name))
    {
        let values: Vec<String> = e.params.iter().map(words::value).collect();
        out.push(format!("{}: {}", words::plain(e.name), values.join("; ")));
    }
    out.extend(words::limits(d));
    if let several @ [_, _, ..] = d.logs.as_slice() {
        let row = |l: &LogEntry| {
            [
                l.file.clone(),
                format!("{:.2}°", l.recalibrated_deg),
                format!("{:.2}°", l.explained_deg),
            ]
        };
        out.push(
            output::table(
                &["log", "recalibrated", "explained"],
                1..3,
                several.iter().map(row),
            )
            .to_string(),
        );
    }
    out.push(table.to_string());
    let next = |advice: &String| match saved {
        Some(path) => format!(
            "next: {}",
            advice.replace("model.toml", &path.display().to_string())
        ),
        None if advice.contains("gap check") => {
            format!("next: {advice} `--save model.toml` writes the model.")
        }
        None => format!("next: {advice}"),
    };
    out.extend(words::next(d).iter().map(next));
    out.join("\n")
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
