//! `retroflex accept`: every step from a board file to a tip that bends, each by the command that a user would type, and one report of
//! what they printed.

use crate::cli::{ResultFile, demo, inputs, output};
use crate::config::Board;
use crate::drill::process::daemon::Daemon;
use crate::report::page::Page;
use crate::supervisor::commission::homing::HomingMethod;
use miette::{IntoDiagnostic, Result, bail};
use serde::Deserialize;
use serde_json::Value;
use std::io::{BufRead, BufReader, IsTerminal, stdin};
use std::mem::take;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

/// Arguments of `accept`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file, or name of a board of the program.
    #[arg(long)]
    board: PathBuf,
    /// Report, one printable page.
    #[arg(long, value_name = "FILE", default_value = "retroflex-accept.html")]
    html: ResultFile,
    /// Confirm everything beforehand: the tip hangs free with closed lines, the pistons are at their rest marks, and the emergency stop
    /// is at hand.
    #[arg(long)]
    yes: bool,
}

/// The steps; the file says what each key means.
const STEPS: &str = include_str!("accept.toml");

#[derive(Deserialize)]
struct Steps {
    step: Vec<Step>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Step {
    name: String,
    #[serde(default)]
    confirm: String,
    commands: Vec<String>,
    #[serde(default)]
    served: bool,
    #[serde(default)]
    goes_on: bool,
    #[serde(default)]
    hardware: bool,
    remedy: String,
}

/// Runs the command.
///
/// # Errors
/// A report about the input.
pub fn run(args: &Args) -> Result<bool> {
    let board = inputs::board(Some(&args.board))?;
    let asks = board.hardware().is_some() && !args.yes;
    if asks && !stdin().is_terminal() {
        bail!(
            "`accept` asks before it moves a real machine: run it on a terminal, or confirm everything beforehand with --yes"
        );
    }
    let scratch = output::Scratch::new("accept")?;
    std::fs::write(scratch.0.join("schedule.csv"), demo::SCHEDULE).into_diagnostic()?;
    let program = std::env::current_exe().into_diagnostic()?;
    let shown = args.board.display().to_string();
    let mut page = Page::new(&format!("Acceptance of {shown}"));
    let mut procedure = Procedure {
        program,
        folder: &scratch.0,
        shown,
        board: &board,
        service: None,
        text: String::new(),
    };
    let version = env!("CARGO_PKG_VERSION");
    page.text(&format!("retroflex {version}. Nothing of it stays on the machine: its service had a folder of its own."));
    let (mut rows, mut texts, mut good, mut goes_on) = (Vec::new(), Vec::new(), true, true);
    let applies = |step: &Step| !step.hardware || board.hardware().is_some();
    let steps: Steps = toml::from_str(STEPS).into_diagnostic()?;
    for step in steps.step.into_iter().filter(applies) {
        let began = Instant::now();
        let agreed = goes_on && (!asks || step.confirm.is_empty() || confirmed(&step.confirm));
        let done = agreed && procedure.step(&step);
        let result = match (goes_on, agreed, done) {
            (false, ..) => "not run",
            (_, false, _) => "declined",
            (.., true) => "passed",
            _ => "FAILED",
        };
        good &= done;
        goes_on &= done || step.goes_on;
        let duration = format!("{:.0} s", began.elapsed().as_secs_f64());
        rows.push([step.name.clone(), result.to_owned(), duration]);
        texts.push((step.name, take(&mut procedure.text)));
    }
    let header = "step|result|duration";
    page.table(header, &rows);
    for (name, text) in texts {
        page.heading(&name);
        page.output(&text);
    }
    output::write(&args.html, page.html())?;
    let (table, report) = (output::table(header, 2..3, rows), args.html.display());
    output::print(format!("\n{table}\nThe report is {report}.\n"));
    Ok(good)
}

/// What the steps have in common.
struct Procedure<'a> {
    program: PathBuf,
    folder: &'a Path,
    /// The board, and its name as the operator gave it.
    board: &'a Board,
    shown: String,
    service: Option<Daemon>,
    /// What a step has printed.
    text: String,
}

impl Procedure<'_> {
    /// Runs a step; true if every command succeeds.
    fn step(&mut self, step: &Step) -> bool {
        output::print(format!("\n{}\n", step.name));
        let done = self.run(step).unwrap_or_else(|problem| {
            self.say(&problem.to_string());
            false
        });
        if !done {
            self.say(&format!("→ {}", step.remedy));
        }
        done
    }

    fn run(&mut self, step: &Step) -> Result<bool> {
        if step.served && self.service.is_none() {
            let options = ["--board", &self.shown, "--fast", "8"];
            let is_simulated = self.board.hardware().is_none();
            let options = &options[..if is_simulated { 4 } else { 2 }];
            let service = Daemon::start_with(&self.program, &self.folder.join("service"), options);
            let service = service.into_diagnostic()?;
            let is_aligned = |s: &Value| s["mode"] == "disarmed" || s["mode"] == "lost";
            let aligned = service.until(30.0, "alignment", is_aligned);
            aligned.into_diagnostic()?;
            // a service that is not aligned ends with this step
            self.service = Some(service);
        }
        for line in &step.commands {
            if let Some(service) = &self.service {
                let rest = service.until(60.0, "rest", |s| s["mode"] != "relaxing");
                rest.into_diagnostic()?;
            }
            let words: Vec<String> = line.split(' ').map(|word| self.word(word)).collect();
            if !self.command(&words)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// What a word of a command line stands for.
    fn word(&self, word: &str) -> String {
        let file = |name: &str| self.folder.join(name).display().to_string();
        let switches = self.board.homing.method == HomingMethod::Switches;
        match word {
            "BOARD" => self.shown.clone(),
            "CONFIRMED" => if switches { "--vented" } else { "--at-rest" }.to_owned(),
            "SCHEDULE" => file("schedule.csv"),
            "LOG" => file("service/state/recordings/accept.csv.gz"),
            word => word.to_owned(),
        }
    }

    /// Prints a line and keeps it for the report.
    fn say(&mut self, line: &str) {
        output::print(format!("{line}\n"));
        self.text.extend([line, "\n"]);
    }

    /// Runs a command of this program, and says what it prints. True if it succeeds.
    fn command(&mut self, words: &[String]) -> Result<bool> {
        self.say(&format!("$ retroflex {}", words.join(" ")));
        let (reader, writer) = std::io::pipe().into_diagnostic()?;
        let service = self.service.iter();
        let socket = service.map(|service| ("RETROFLEX_SOCKET", &service.sockets()[0]));
        // the pipe ends when nobody can write to it any more, so the command ends with this statement
        let mut child = Command::new(&self.program)
            .args(words)
            .envs(socket)
            .stdin(Stdio::null())
            .stdout(writer.try_clone().into_diagnostic()?)
            .stderr(writer)
            .spawn()
            .into_diagnostic()?;
        let lines = BufReader::new(reader).lines();
        for line in lines.map_while(std::io::Result::ok) {
            self.say(&line);
        }
        Ok(child.wait().into_diagnostic()?.success())
    }
}

/// Asks the operator.
fn confirmed(what: &str) -> bool {
    eprint!("\n{what}\nType `yes` to go on: ");
    let mut line = String::new();
    stdin().lock().read_line(&mut line).is_ok() && line.trim() == "yes"
}
