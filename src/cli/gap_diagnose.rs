//! `retroflex gap diagnose`: a log in, an answer in words, and the files that hold it.

use crate::cli::CommandOutcome;
use crate::cli::gap::{PAPER, observe};
use crate::cli::gap_map;
use crate::cli::output::{self, write};
use crate::config::calib::Calibration;
use crate::config::source;
use crate::diagnosis::diagnose::{Diagnosed, Diagnosis, diagnose};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::saved::SavedModel;
use crate::model::effects::catalogue;
use crate::report::gap::evidence::Evidence;
use crate::report::gap::{page, words};
use miette::{IntoDiagnostic, Result, miette};
use std::path::{Path, PathBuf};

/// Arguments of `gap diagnose`.
#[derive(Debug, clap::Args)]
pub struct DiagnoseArgs {
    /// Bend log, *.csv or *.csv.gz.
    log: PathBuf,
    /// The log is of another rig: what its columns are.
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["calib", "html", "save"])]
    map: Option<PathBuf>,
    /// With --map: another log of the rig, on which the fitted model is tried as it is; may be repeated.
    #[arg(long, value_name = "LOG", requires = "map")]
    fresh: Vec<PathBuf>,
    /// Calibration the log was driven with.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// Write the diagnosis as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Write the diagnosis as one page to look at and to print.
    #[arg(long)]
    html: Option<PathBuf>,
    /// Keep the recalibrated and the explained model for `gap check` and `gap excite --like`.
    #[arg(long, value_name = "MODEL.toml")]
    save: Option<PathBuf>,
    /// Seed of the block bootstrap.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Diagnoses and writes; nothing is written unless everything can be.
///
/// # Errors
/// A report that names what is wrong with the input.
pub fn run(args: &DiagnoseArgs) -> Result<CommandOutcome> {
    let results = [("--json", args.json.as_deref()), ("--html", args.html.as_deref()), ("--save", args.save.as_deref())];
    let mut inputs = vec![args.log.as_path()];
    inputs.extend(args.fresh.iter().chain(&args.map).chain(&args.calib).map(PathBuf::as_path));
    output::check(&results, &inputs)?;
    if let Some(map) = &args.map {
        return gap_map::run(&args.log, map, &args.fresh, args.json.as_deref(), args.seed);
    }
    let calibration: Option<Calibration> = args.calib.as_deref().map(source::read).transpose()?;
    let lines = calibration.map_or(PAPER, |c| c.lines());
    let observed = observe(&args.log)?;
    let done = diagnose(&observed, &catalogue(), &lines, args.seed);
    for (path, text) in files(args, &observed, &done)? {
        write(path, &text)?;
    }
    eprintln!("{}", summary(&done.document));
    Ok(CommandOutcome::Good)
}

/// Every file that was asked for, with its text.
fn files<'a>(args: &'a DiagnoseArgs, observed: &Observed, done: &Diagnosed) -> Result<Vec<(&'a Path, String)>> {
    let mut out: Vec<(&Path, String)> = Vec::new();
    if let Some(path) = &args.json {
        out.push((path, json(&done.document)?));
    }
    if let Some(path) = &args.html {
        let name = args.log.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        out.push((path, page(&name, &done.document, &Evidence::new(observed, done))));
    }
    if let Some(path) = &args.save {
        let equivalent = &done.document.verdict.equivalent;
        let model = SavedModel::new(&args.log.display().to_string(), &catalogue(), &done.found, &done.chosen, equivalent);
        out.push((path, toml::to_string(&model).into_diagnostic()?));
    }
    Ok(out)
}

/// The document as JSON, which has no word for a figure that is not finite.
fn json(document: &Diagnosis) -> Result<String> {
    let value = serde_json::to_value(document).into_diagnostic()?;
    if let Some(key) = not_finite(&value, "") {
        return Err(miette!("{key} is not a finite number; the log may hold values far outside what a sensor can give: check its units"));
    }
    Ok(serde_json::to_string_pretty(&value).into_diagnostic()? + "\n")
}

/// First key whose value is null.
fn not_finite(value: &serde_json::Value, key: &str) -> Option<String> {
    match value {
        serde_json::Value::Null => Some(key.to_owned()),
        serde_json::Value::Array(all) => all.iter().enumerate().find_map(|(i, v)| not_finite(v, &format!("{key}[{i}]"))),
        serde_json::Value::Object(all) => {
            all.iter().find_map(|(k, v)| not_finite(v, &if key.is_empty() { k.clone() } else { format!("{key}.{k}") }))
        }
        _ => None,
    }
}

/// Effects that are shown: the probable ones, and at least three.
fn shown(d: &Diagnosis) -> usize {
    d.effects.iter().take_while(|e| e.probability >= 0.01).count().clamp(3, 6)
}

fn summary(d: &Diagnosis) -> String {
    let rows = d.effects.iter().take(shown(d)).map(|e| {
        [
            e.name.to_owned(),
            e.stage.to_owned(),
            format!("{:.2}", e.probability),
            format!("{:.2}°", e.gap_before_deg),
            format!("{:.2}°", e.gap_after_deg),
            format!("{:.0} %", e.closed * 100.0),
            format!("{:.0} to {:.0} %", e.closed_ci95[0] * 100.0, e.closed_ci95[1] * 100.0),
        ]
    });
    let table = output::table(&["effect", "stage", "probability", "gap before", "after", "closed", "95 %"], 2..7, rows);
    let names = if d.verdict.names.is_empty() { String::new() } else { format!(": {}", d.verdict.names.join(" and ")) };
    let mut out = vec![format!("verdict {}{names}", d.verdict.kind), words::headline(d), words::place(d)];
    for e in d.effects.iter().filter(|e| d.verdict.names.contains(&e.name)) {
        let values: Vec<String> = e.params.iter().map(words::value).collect();
        out.push(format!("{}: {}", words::plain(e.name), values.join("; ")));
    }
    out.extend(words::doubts(d));
    out.push(table.to_string());
    out.extend(words::next(d).iter().map(|n| format!("next: {n}")));
    out.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_figure_that_is_not_finite_is_found_by_its_key() {
        assert_eq!(not_finite(&json!({"a": [1.0, {"b": null}]}), ""), Some("a[1].b".to_owned()));
        assert_eq!(not_finite(&json!({"a": [1.0, "x", true]}), ""), None);
    }
}
