//! `retroflex accept`: every step from a board file to a tip that bends, each by the command that a user would type, and one report of
//! what they printed.

use crate::cli::{CommandOutcome, demo, inputs, output};
use crate::config::sections::HomingMethod;
use crate::drill::process::daemon::Daemon;
use crate::report::page::Page;
use miette::{IntoDiagnostic, Result, bail, miette};
use std::io::{BufRead, BufReader, IsTerminal, stdin};
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
    html: PathBuf,
    /// Confirm everything beforehand: the tip hangs free with closed lines, the pistons are at their rest marks, and the emergency stop
    /// is at hand.
    #[arg(long)]
    yes: bool,
}

struct Step {
    name: &'static str,
    /// What the operator confirms first; nothing is asked if it is empty.
    confirm: &'static str,
    /// Command lines. BOARD, SCHEDULE and LOG stand for files, PINS for the option of a board with pins, CONFIRMED for that of `home`.
    commands: &'static [&'static str],
    /// The commands are for the running service.
    served: bool,
    /// Nothing is done after it if it fails.
    required: bool,
    remedy: &'static str,
}

const STEPS: [Step; 10] = [
    Step {
        name: "the computer and its devices",
        confirm: "",
        commands: &["doctor --board BOARD"],
        served: false,
        required: false,
        remedy: "every FAIL above names its remedy",
    },
    Step {
        name: "the timing of the steps",
        confirm: "",
        commands: &["bench rt --alone --seconds 5 PINS"],
        served: false,
        required: false,
        remedy: "see docs/hardware.md: a kernel with PREEMPT_RT, a processor of its own",
    },
    Step {
        name: "every motor turns",
        confirm: "The tip hangs free, and the emergency stop is at hand. Each piston in turn will move 2 mm towards a longer bellow and back.",
        commands: &["jog --board BOARD --channel 1 --mm 2", "jog --board BOARD --channel 2 --mm 2", "jog --board BOARD --channel 3 --mm 2"],
        served: false,
        required: true,
        remedy: "check the motor supply, the wiring of that driver and [pins] of the board file",
    },
    Step {
        name: "zero",
        confirm: "The pistons are at their rest marks; or, with home switches, the tip is removed or its lines are vented.",
        commands: &["home --board BOARD CONFIRMED"],
        served: false,
        required: true,
        remedy: "check the switches and [homing] of the board file",
    },
    Step {
        name: "wiring and tightness",
        confirm: "The tip is mounted, its lines are closed, and it hangs free. It will nod on each channel.",
        commands: &["commission --board BOARD"],
        served: false,
        required: true,
        remedy: "`retroflex commission --write` corrects the board file; seal a line that leaks",
    },
    Step {
        name: "the service",
        confirm: "The tip is straight and still. The service starts; then the tip bends by up to 60° for some minutes.",
        commands: &["zero --straight", "arm", "status"],
        served: true,
        required: true,
        remedy: "the status names what is missing",
    },
    Step {
        name: "the gains of this tip",
        confirm: "",
        commands: &["calibrate transmission --short", "calibrate transmission --accept"],
        served: true,
        required: true,
        remedy: "look for an obstacle or a leak, then begin again",
    },
    Step {
        name: "a bend",
        confirm: "",
        commands: &["bend 45 --toward 90 --wait", "status", "bend 0 --wait", "relax"],
        served: true,
        required: true,
        remedy: "the status names the cause",
    },
    Step {
        name: "a schedule, recorded",
        confirm: "",
        commands: &["arm", "play SCHEDULE --record accept", "relax", "status"],
        served: true,
        required: true,
        remedy: "the status names the cause",
    },
    Step {
        name: "the gap between model and machine",
        confirm: "",
        commands: &["gap diagnose LOG"],
        served: false,
        required: true,
        remedy: "the recording is damaged",
    },
];

/// Runs the command.
///
/// # Errors
/// A report about the input.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    output::check(&[("--html", Some(&args.html))], &[&args.board])?;
    let board = inputs::board(Some(&args.board))?;
    let simulated = board.hardware().is_none();
    let asks = !simulated && !args.yes;
    if asks && !stdin().is_terminal() {
        bail!("`accept` asks before it moves a real machine: run it on a terminal, or confirm everything beforehand with --yes");
    }
    let scratch = output::Scratch::new("accept")?;
    let folder = &scratch.0;
    std::fs::write(folder.join("schedule.csv"), demo::SCHEDULE).into_diagnostic()?;
    let path = |name: &str| folder.join(name).display().to_string();
    let shown = args.board.display().to_string();
    let word = |word: &str| match word {
        "BOARD" => vec![shown.clone()],
        "PINS" if board.pins.is_some() => vec!["--board".to_owned(), shown.clone()],
        "PINS" => vec![],
        "CONFIRMED" => vec![if board.homing.method == HomingMethod::Switches { "--vented" } else { "--at-rest" }.to_owned()],
        "SCHEDULE" => vec![path("schedule.csv")],
        "LOG" => vec![path("service/state/recordings/accept.csv.gz")],
        word => vec![word.to_owned()],
    };
    let program = std::env::current_exe().into_diagnostic()?;
    let mut page = Page::new(&format!("Acceptance of {shown}"));
    let (mut rows, mut transcript, mut service) = (Vec::new(), Vec::new(), None);
    let (mut good, mut goes_on) = (true, true);
    for step in &STEPS {
        let began = Instant::now();
        let mut text = String::new();
        let agreed = goes_on && (!asks || step.confirm.is_empty() || confirmed(step.confirm));
        let done = if agreed {
            output::print(format!("\n{}\n", step.name));
            if step.served && service.is_none() {
                let paced = if simulated { &["--fast", "8"][..] } else { &[] };
                service = Some(serve(&program, &folder.join("service"), &[&["--board", shown.as_str()], paced].concat())?);
            }
            if let Some(service) = &service {
                service.until(60.0, "rest", |s| s["mode"] != "relaxing").into_diagnostic()?;
            }
            let socket = service.as_ref().map(|service: &Daemon| service.sockets()[0].as_path());
            let mut done = true;
            for line in step.commands {
                let words: Vec<String> = line.split(' ').flat_map(word).collect();
                done = done && command(&program, &words, socket, &mut text)?;
            }
            done
        } else {
            false
        };
        let result = match (goes_on, agreed, done) {
            (false, ..) => "not run",
            (_, false, _) => "declined",
            (.., true) => "passed",
            _ => "FAILED",
        };
        if agreed && !done {
            text += &format!("→ {}\n", step.remedy);
            eprintln!("{}: {result}; {}", step.name, step.remedy);
        }
        good &= done;
        goes_on &= done || !step.required;
        rows.push([step.name.to_owned(), result.to_owned(), format!("{:.0} s", began.elapsed().as_secs_f64())]);
        transcript.push((step.name, text));
    }
    page.text(&format!(
        "retroflex {}. Nothing of it stays on the machine: its service had a folder of its own.",
        env!("CARGO_PKG_VERSION")
    ));
    page.table(&["step", "result", "duration"], &rows);
    for (name, text) in transcript {
        page.heading(name);
        page.output(&text);
    }
    output::write(&args.html, page.html())?;
    let table = output::table(&["step", "result", "duration"], 2..3, rows);
    output::print(format!("\n{table}\nThe report is {}.\n", args.html.display()));
    Ok(good.into())
}

/// Asks the operator.
fn confirmed(what: &str) -> bool {
    eprint!("\n{what}\nType `yes` to go on: ");
    let mut line = String::new();
    stdin().lock().read_line(&mut line).is_ok() && line.trim() == "yes"
}

fn serve(program: &Path, folder: &Path, options: &[&str]) -> Result<Daemon> {
    let service = Daemon::start_with(program, folder, options).map_err(|e| miette!("the service: {e}"))?;
    service
        .until(30.0, "alignment", |s| s["mode"] == "disarmed" || s["mode"] == "lost")
        .map_err(|e| miette!("the service: {e}; keep the tip still"))?;
    Ok(service)
}

/// Runs a command line, and prints and keeps what it prints. True if it succeeds.
fn command(program: &Path, words: &[String], socket: Option<&Path>, text: &mut String) -> Result<bool> {
    let mut say = |line: &str| {
        output::print(format!("{line}\n"));
        text.extend([line, "\n"]);
    };
    say(&format!("$ retroflex {}", words.join(" ")));
    let (reader, writer) = std::io::pipe().into_diagnostic()?;
    let mut command = Command::new(program);
    command.args(words).stdin(Stdio::null()).stdout(writer.try_clone().into_diagnostic()?).stderr(writer);
    command.envs(socket.map(|socket| ("RETROFLEX_SOCKET", socket)));
    let mut child = command.spawn().into_diagnostic()?;
    // the pipe ends when nobody can write to it any more
    drop(command);
    for line in BufReader::new(reader).lines().map_while(std::io::Result::ok) {
        say(&line);
    }
    Ok(child.wait().into_diagnostic()?.success())
}
