//! `retroflex demo`: the service on the simulated tip, a leak, its diagnosis and its remedy, each step by the command that
//! a user would type.

use crate::cli::{CommandOutcome, Unreachable, output};
use crate::drill::process::daemon::Daemon;
use miette::{IntoDiagnostic, Result, miette};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The simulation runs this many times faster than real time.
const PACE: &str = "8";
/// The line that leaks, from 1, and its rate, 1/s.
const LEAK: (usize, f64) = (2, 0.03);
/// Poses that show a leak: bends in three directions, held for some seconds, in rows of `gap excite`.
const SCHEDULE: &str = "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s
0,0,20,5,20
40,0,20,1,20
40,120,20,1,20
40,240,20,1,20
60,240,20,10,20
0,0,20,3,20
60,120,20,10,20
20,120,20,1,20
60,0,20,10,20
30,300,21,1,12
60,60,21,8,12
0,0,20,4,20
";

/// Arguments of `demo`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Report of the diagnosis, one printable page.
    #[arg(long, value_name = "FILE", default_value = "retroflex-demo.html")]
    html: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// A report that names the step that failed.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    output::check(&[("--html", Some(&args.html))], &[])?;
    // before half a minute is spent
    let report = std::fs::File::options().append(true).create(true).open(&args.html);
    report.map_err(|e| miette!("--html {}: {e}; name a file in a folder in which you may write", args.html.display()))?;
    let scratch = output::Scratch::new("demo")?;
    let demo = Demo { program: std::env::current_exe().into_diagnostic()?, folder: &scratch.0 };
    std::fs::write(demo.file("schedule.csv"), SCHEDULE).into_diagnostic()?;
    output::print(&format!("A simulated tip, {PACE} times faster than real time. Every line after `$` is a command that you can type.\n"));
    {
        let service = demo.serve("healthy", None)?;
        demo.step("The tip moves.", &["arm"], Some(&service))?;
        demo.step("", &["bend", "60", "--toward", "90", "--wait"], Some(&service))?;
        demo.step("", &["status"], Some(&service))?;
    }
    let found = demo.diagnose(
        &format!("Line {} now leaks. A schedule of poses is played and recorded.", LEAK.0),
        "leaky",
        Some(LEAK.0),
        &args.html,
    )?;
    let Some(line) = leaking(&found) else {
        output::print("The diagnosis does not name the leak.\n");
        return Ok(CommandOutcome::NotGoodEnough);
    };
    let sealed = Some(LEAK.0).filter(|leak| *leak != line);
    let second = demo.file("mended.html");
    let after = demo.diagnose(&format!("The remedy: line {line} is sealed. The same schedule again."), "mended", sealed, &second)?;
    let good = after["verdict"]["names"].as_array().is_some_and(|names| names.iter().all(|n| n != "leak"));
    let end = if good { "The leak is gone." } else { "The leak is still there." };
    output::print(&format!("\n{end} The report of the leaky tip is {}.\n", args.html.display()));
    Ok(if good { CommandOutcome::Good } else { CommandOutcome::NotGoodEnough })
}

/// The line that leaks according to a diagnosis, from 1.
fn leaking(diagnosis: &Value) -> Option<usize> {
    if !diagnosis["verdict"]["names"].as_array()?.iter().any(|n| n == "leak") {
        return None;
    }
    let leak = diagnosis["effects"].as_array()?.iter().find(|e| e["name"] == "leak")?;
    let rates = leak["params"].as_array()?.iter().filter(|p| p["name"] == "rate");
    let rates = rates.filter_map(|p| Some((p["channel"].as_u64()?, p["value"].as_f64()?)));
    let largest = rates.max_by(|a, b| a.1.total_cmp(&b.1))?;
    usize::try_from(largest.0).ok()
}

struct Demo<'a> {
    program: PathBuf,
    folder: &'a Path,
}

impl Demo<'_> {
    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Starts a service on the simulated tip, of which one line may leak.
    fn serve(&self, name: &str, leak: Option<usize>) -> Result<Daemon> {
        let rates: Vec<String> = (1..=3).map(|line| if leak == Some(line) { LEAK.1 } else { 0.0 }.to_string()).collect();
        let board = self.file(&format!("{name}.toml"));
        let text = format!("base = \"demo\"\n[plant.effects.leak]\nrate_per_s = [{}]\n", rates.join(", "));
        std::fs::write(&board, text).into_diagnostic()?;
        let path = board.display().to_string();
        let options = ["--board", path.as_str(), "--fast", PACE];
        let service = Daemon::start_with(&self.program, &self.file(name), &options).map_err(|e| miette!("the simulated tip: {e}"))?;
        service.until(30.0, "alignment", |s| s["mode"] == "disarmed").into_diagnostic()?;
        Ok(service)
    }

    /// Prints a command and runs it; its failure ends the demonstration.
    fn step(&self, about: &str, words: &[&str], service: Option<&Daemon>) -> Result<()> {
        let folder = format!("{}/", self.folder.display());
        let about = if about.is_empty() { String::new() } else { format!("\n{about}\n") };
        output::print(&format!("{about}$ retroflex {}\n", words.join(" ").replace(&folder, "")));
        let socket = service.map_or(self.folder, |s| s.sockets()[0].as_path());
        let done = Command::new(&self.program).args(words).env("RETROFLEX_SOCKET", socket).status().into_diagnostic()?;
        match done.code() {
            Some(0) => Ok(()),
            Some(3) => Err(Unreachable { what: "the simulated tip".to_owned(), why: "its service has ended".to_owned() }.into()),
            _ => Err(miette!("`retroflex {}` failed; see above", words.join(" "))),
        }
    }

    /// Plays the schedule on a fresh service, and diagnoses the recording.
    fn diagnose(&self, about: &str, name: &str, leak: Option<usize>, html: &Path) -> Result<Value> {
        let (schedule, html, json) = (self.file("schedule.csv"), html.display().to_string(), self.file(&format!("{name}.json")));
        {
            let service = self.serve(name, leak)?;
            self.step(about, &["arm"], Some(&service))?;
            self.step("", &["play", &schedule.display().to_string(), "--record", name], Some(&service))?;
        }
        let log = self.file(&format!("{name}/state/recordings/{name}.csv.gz")).display().to_string();
        self.step("", &["gap", "diagnose", &log, "--html", &html, "--json", &json.display().to_string()], None)?;
        let text = std::fs::read_to_string(&json).into_diagnostic()?;
        serde_json::from_str(&text).into_diagnostic()
    }
}
