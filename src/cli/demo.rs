//! `retroflex demo`: the service on the simulated tip, a leak, its diagnosis and its remedy, each step by the command that
//! a user would type.

use crate::cli::{ResultFile, Unreachable, output};
use crate::drill::process::daemon::Daemon;
use miette::{IntoDiagnostic, Result, miette};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The simulation runs this many times faster than real time.
const PACE: &str = "8";
/// The line that leaks, from 1, and its rate, 1/s.
const LEAK: (usize, f64) = (2, 0.03);
/// Why a command does not reach a service of the demonstration.
const ENDED: &str = "its service has ended";
/// Poses that show a leak: bends in three directions, held for some seconds, in rows of `gap excite`.
pub const SCHEDULE: &str = include_str!("demo.csv");

/// Arguments of `demo`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Report of the diagnosis, one printable page.
    #[arg(long, value_name = "FILE", default_value = "retroflex-demo.html")]
    html: ResultFile,
}

/// Runs the command.
///
/// # Errors
/// A report that names the step that failed.
pub fn run(args: &Args) -> Result<bool> {
    let report = args.html.display();
    let scratch = output::Scratch::new("demo")?;
    let demo = Demo {
        program: std::env::current_exe().into_diagnostic()?,
        folder: &scratch.0,
    };
    std::fs::write(demo.file("schedule.csv"), SCHEDULE).into_diagnostic()?;
    output::print(format!(
        "A simulated tip, {PACE} times faster than real time. Each step shows its command after `$`; its files are temporary.\n"
    ));
    {
        let service = Some(&demo.serve("healthy", None)?);
        demo.step("The tip moves.", &["arm"], service)?;
        demo.step("", &["bend", "60", "--toward", "90", "--wait"], service)?;
        demo.step("", &["status"], service)?;
    }
    let leaks = LEAK.0;
    let about = format!("Line {leaks} now leaks. A schedule of poses is played and recorded.");
    let found = demo.diagnose(&about, "leaky", Some(leaks), &args.html)?;
    let Some(line) = leaking(&found) else {
        output::print("The diagnosis does not name the leak.\n");
        return Ok(false);
    };
    let sealed = Some(leaks).filter(|leak| *leak != line);
    let about = format!("The remedy: line {line} is sealed. The same schedule again.");
    let after = demo.diagnose(&about, "mended", sealed, &demo.file("mended.html"))?;
    let names = after["verdict"]["names"].as_array();
    let good = names.is_some_and(|names| names.iter().all(|n| n != "leak"));
    let end = if good { "gone" } else { "still there" };
    let text = format!("The leak is {end}. The report of the leaky tip is {report}.");
    output::print(format!("\n{text}\n"));
    Ok(good)
}

/// The line that leaks according to a diagnosis, from 1.
fn leaking(diagnosis: &Value) -> Option<usize> {
    let mut named = diagnosis["verdict"]["names"].as_array()?.iter();
    named.find(|n| *n == "leak")?;
    let mut effects = diagnosis["effects"].as_array()?.iter();
    let params = effects.find(|e| e["name"] == "leak")?["params"].as_array()?;
    let rates = params.iter().filter(|p| p["name"] == "rate");
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
        let rates = [1, 2, 3].map(|line| if leak == Some(line) { LEAK.1 } else { 0.0 });
        let board = self.file(&format!("{name}.toml"));
        let text = format!("base = \"demo\"\n[plant.effects.leak]\nrate_per_s = {rates:?}\n");
        std::fs::write(&board, text).into_diagnostic()?;
        let path = board.display().to_string();
        let options = ["--board", path.as_str(), "--fast", PACE];
        let service = Daemon::start_with(&self.program, &self.file(name), &options);
        let service = service.map_err(|e| miette!("the simulated tip: {e}"))?;
        let aligned = service.until(30.0, "alignment", |s| s["mode"] == "disarmed");
        aligned.into_diagnostic().map(|_| service)
    }

    /// Prints a command and runs it; its failure ends the demonstration.
    fn step(&self, about: &str, words: &[&str], service: Option<&Daemon>) -> Result<()> {
        let (folder, line) = (format!("{}/", self.folder.display()), words.join(" "));
        if !about.is_empty() {
            output::print(format!("\n{about}\n"));
        }
        output::print(format!("$ retroflex {}\n", line.replace(&folder, "")));
        let socket = service.map_or(self.folder, |s| s.sockets()[0].as_path());
        let mut command = Command::new(&self.program);
        let done = command.args(words).env("RETROFLEX_SOCKET", socket).status();
        match done.into_diagnostic()?.code() {
            Some(0) => Ok(()),
            Some(3) => Err(Unreachable::report("the simulated tip", ENDED)),
            _ => Err(miette!("`retroflex {line}` failed; see above")),
        }
    }

    /// Plays the schedule on a fresh service, and diagnoses the recording.
    fn diagnose(&self, about: &str, name: &str, leak: Option<usize>, html: &Path) -> Result<Value> {
        let path = |name: &str| self.file(name).display().to_string();
        {
            let service = Some(&self.serve(name, leak)?);
            self.step(about, &["arm"], service)?;
            let play = ["play", &path("schedule.csv"), "--record", name];
            self.step("", &play, service)?;
        }
        let log = path(&format!("{name}/state/recordings/{name}.csv.gz"));
        let (html, json) = (html.display().to_string(), path(&format!("{name}.json")));
        let words = ["gap", "diagnose", &log, "--html", &html, "--json", &json];
        self.step("", &words, None)?;
        let text = std::fs::read_to_string(&json).into_diagnostic()?;
        serde_json::from_str(&text).into_diagnostic()
    }
}
