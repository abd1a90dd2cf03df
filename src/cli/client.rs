//! The commands that talk to a running service: thin, one request each.

use crate::cli::{Outcome, Unreachable};
use crate::service::client::Client as Connection;
use crate::service::protocol::{CalibrateAction, Failure, RecordAction, Request};
use miette::{Report, Result, miette};
use serde_json::Value;
use std::io::{BufRead, IsTerminal, Write};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Where the service is.
#[derive(Debug, Clone, clap::Args)]
pub struct At {
    /// Socket of the service; without it RETROFLEX_SOCKET or /run/retroflex/control.sock.
    #[arg(long, default_value_os_t = default_socket())]
    socket: PathBuf,
}

fn default_socket() -> PathBuf {
    std::env::var_os("RETROFLEX_SOCKET").map_or_else(|| "/run/retroflex/control.sock".into(), PathBuf::from)
}

/// Commands to a running service.
#[derive(Debug, clap::Subcommand)]
pub enum Client {
    /// Bend the tip.
    #[command(allow_negative_numbers = true)]
    Bend(BendArgs),
    /// Come to rest smoothly where the set-point is, and hold.
    Hold(Plain),
    /// Halt now, and hold.
    Stop(Plain),
    /// Back to rest at a safe rate, then de-energise.
    Relax(Plain),
    /// Energise the drivers and hold the pose that is.
    Arm(Plain),
    /// Take no more motion.
    Disarm(Plain),
    /// Take what is now for the rest.
    Zero(Plain),
    /// What the service is doing.
    Status(StatusArgs),
    /// Forget a fault whose cause is mended.
    ResetFault(Plain),
    /// Read the gains file again, without a bump.
    Reload(Plain),
    /// Begin or end a recording.
    Record(RecordArgs),
    /// Set-points from stdin, `BEND DIR` a line; when they stop, the tip stops.
    Stream(Plain),
    /// Frames as JSON lines.
    Subscribe(SubscribeArgs),
}

/// No arguments of its own.
#[derive(Debug, clap::Args)]
pub struct Plain {
    #[command(flatten)]
    at: At,
}

/// Arguments of `bend`.
#[derive(Debug, clap::Args)]
pub struct BendArgs {
    #[command(flatten)]
    at: At,
    /// Bend angle, degrees.
    bend: f64,
    /// Bend direction, degrees.
    #[arg(long, default_value_t = 0.0)]
    toward: f64,
    /// Centre length, mm; without it that at rest.
    #[arg(long)]
    length: Option<f64>,
    /// Speed of the set-point, °/s; without it that of the gains file.
    #[arg(long)]
    speed: Option<f64>,
    /// Follow the move and end when it has settled.
    #[arg(long)]
    wait: bool,
}

/// Arguments of `status`.
#[derive(Debug, clap::Args)]
pub struct StatusArgs {
    #[command(flatten)]
    at: At,
    /// As JSON.
    #[arg(long)]
    json: bool,
    /// Again and again.
    #[arg(long)]
    watch: bool,
}

/// Arguments of `record`.
#[derive(Debug, clap::Args)]
pub struct RecordArgs {
    #[command(flatten)]
    at: At,
    /// Begin or end.
    #[arg(value_enum)]
    action: Action,
    /// Name of the recording.
    name: Option<String>,
}

/// Begin or end.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Action {
    /// Begin.
    Start,
    /// End.
    Stop,
}

/// Arguments of `subscribe`.
#[derive(Debug, clap::Args)]
pub struct SubscribeArgs {
    #[command(flatten)]
    at: At,
    /// Frames a second.
    #[arg(long, default_value_t = 20.0)]
    rate: f64,
}

/// Arguments of `calibrate transmission`.
#[derive(Debug, clap::Args)]
pub struct TransmissionArgs {
    #[command(flatten)]
    at: At,
    /// Twenty-four poses with the calibration in use as prior, in place of Algorithm 1 from zero.
    #[arg(long, conflicts_with_all = ["accept", "discard"])]
    short: bool,
    /// Put what was found in use.
    #[arg(long, conflicts_with = "discard")]
    accept: bool,
    /// Forget what was found.
    #[arg(long)]
    discard: bool,
}

/// Runs a command.
///
/// # Errors
/// A report with the service's words.
pub fn run(command: &Client) -> Result<Outcome> {
    match command {
        Client::Bend(args) => bend(args),
        Client::Hold(p) => plain(&p.at, &Request::Hold {}),
        Client::Stop(p) => plain(&p.at, &Request::Stop {}),
        Client::Relax(p) => plain(&p.at, &Request::Relax {}),
        Client::Arm(p) => plain(&p.at, &Request::Arm {}),
        Client::Disarm(p) => plain(&p.at, &Request::Disarm {}),
        Client::Zero(p) => plain(&p.at, &Request::Zero {}),
        Client::ResetFault(p) => plain(&p.at, &Request::ResetFault {}),
        Client::Reload(p) => plain(&p.at, &Request::Reload {}),
        Client::Status(args) => status(args),
        Client::Record(args) => {
            let action = if matches!(args.action, Action::Start) { RecordAction::Start } else { RecordAction::Stop };
            plain(&args.at, &Request::Record { action, name: args.name.clone() })
        }
        Client::Stream(p) => stream(&p.at),
        Client::Subscribe(args) => subscribe(args),
    }
}

/// The end of a request that was not carried out.
enum Ended {
    Refused(String),
    Report(Report),
}

fn ask(connection: &mut Connection, request: &Request) -> std::result::Result<Value, Ended> {
    connection.ask(request).map_err(|f| match f.code {
        1 => Ended::Refused(f.words),
        _ => Ended::Report(report(f)),
    })
}

fn report(f: Failure) -> Report {
    if f.code == 3 { Unreachable { what: "the service".to_owned(), why: f.words }.into() } else { miette!("{}", f.words) }
}

fn connect(at: &At) -> Result<Connection> {
    Connection::connect(&at.socket).map_err(report)
}

/// Refusals are an answer: said on stderr, exit code 1.
fn settle(answer: std::result::Result<Value, Ended>) -> Result<Option<Value>> {
    match answer {
        Ok(value) => Ok(Some(value)),
        Err(Ended::Refused(words)) => {
            eprintln!("refused: {words}");
            Ok(None)
        }
        Err(Ended::Report(report)) => Err(report),
    }
}

fn outcome(value: Option<&Value>) -> Outcome {
    if value.is_some() { Outcome::Good } else { Outcome::NotGoodEnough }
}

fn plain(at: &At, request: &Request) -> Result<Outcome> {
    let value = settle(ask(&mut connect(at)?, request))?;
    if let Some(Value::Object(map)) = &value
        && !map.is_empty()
    {
        say(&format!("{}\n", Value::Object(map.clone())));
    }
    Ok(outcome(value.as_ref()))
}

/// A reader that has gone away is no failure of ours.
fn say(text: &str) {
    let mut out = std::io::stdout();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

fn bend(args: &BendArgs) -> Result<Outcome> {
    let mut connection = connect(&args.at)?;
    let request = Request::Bend { bend_deg: args.bend, dir_deg: args.toward, length_mm: args.length, speed_deg_s: args.speed };
    let value = settle(ask(&mut connection, &request))?;
    if value.is_none() || !args.wait {
        return Ok(outcome(value.as_ref()));
    }
    let (begun, live) = (Instant::now(), std::io::stderr().is_terminal());
    loop {
        std::thread::sleep(Duration::from_millis(50));
        let Some(s) = settle(ask(&mut connection, &Request::Status {}))? else { return Ok(Outcome::NotGoodEnough) };
        let felt = s["felt"]["bend_deg"].as_f64().unwrap_or(0.0);
        let line =
            format!("{:>5.1} s  {}  felt {felt:.1}° of {:.1}°", begun.elapsed().as_secs_f64(), s["mode"].as_str().unwrap_or(""), args.bend);
        if live {
            eprint!("\r{line}   ");
        }
        let why = match s["mode"].as_str().unwrap_or("") {
            "holding" if s["settled"] == true => {
                eprintln!(
                    "{}{line}{}",
                    if live { "\r" } else { "" },
                    s["short"].as_str().map_or_else(|| ": settled".to_owned(), |why| format!(": {why}"))
                );
                return Ok(if s["blocked"] == true { Outcome::NotGoodEnough } else { Outcome::Good });
            }
            "tracking" | "holding" if begun.elapsed() < Duration::from_secs(60) => continue,
            "faulted" => s["fault"].as_str().unwrap_or("a fault").to_owned(),
            other => format!("mode {other}"),
        };
        eprintln!(
            "{}not settled: {why}{}",
            if live { "\n" } else { "" },
            s["suspicion"].as_str().map_or_else(String::new, |x| format!("; {x}"))
        );
        return Ok(Outcome::NotGoodEnough);
    }
}

fn status(args: &StatusArgs) -> Result<Outcome> {
    let mut connection = connect(&args.at)?;
    loop {
        let Some(s) = settle(ask(&mut connection, &Request::Status {}))? else { return Ok(Outcome::NotGoodEnough) };
        if args.json {
            say(&format!("{s}\n"));
        } else {
            say(&readable(&s));
        }
        if !args.watch {
            return Ok(Outcome::Good);
        }
        std::thread::sleep(Duration::from_millis(500));
    }
}

fn readable(s: &Value) -> String {
    let text = |v: &Value| v.as_str().map_or_else(|| v.to_string(), str::to_owned);
    let pose = |v: &Value| {
        v["bend_deg"].as_f64().map_or_else(|| "–".to_owned(), |b| format!("{b:.1}° at {:.0}°", v["dir_deg"].as_f64().unwrap_or(0.0)))
    };
    let mut lines = vec![
        format!("mode      {}{}", text(&s["mode"]), if s["energised"] == true { ", energised" } else { "" }),
        format!("felt      {}   target {}", pose(&s["felt"]), pose(&s["target"])),
        format!("pistons   {} mm", s["piston_mm"]),
        format!("tip       {}   calibration {}", text(&s["tip"]), text(&s["calibration"])),
        format!(
            "loop      {} turns, {} late, the latest {} µs, {} frames lost",
            s["turns"], s["late_turns"], s["latest_us"], s["lost_frames"]
        ),
    ];
    for (name, key) in [
        ("fault", "fault"),
        ("short", "short"),
        ("base", "base"),
        ("suspected", "suspicion"),
        ("alarm", "alarm"),
        ("running", "calibrating"),
    ] {
        if !s[key].is_null() {
            lines.push(format!("{name:<9} {}", text(&s[key])));
        }
    }
    for advice in s["senses"]["advice"].as_array().into_iter().flatten() {
        lines.push(format!("sensor    {}", text(advice)));
    }
    for grant in s["real_time"].as_array().into_iter().flatten() {
        lines.push(format!("real time {}: {}", text(&grant["what"]), text(&grant["grant"])));
    }
    if !s["memory"]["error"].is_null() {
        lines.push(format!("memory    {}", text(&s["memory"]["error"])));
    }
    lines.join("\n") + "\n"
}

fn stream(at: &At) -> Result<Outcome> {
    let mut connection = connect(at)?;
    for line in std::io::stdin().lock().lines() {
        let line = line.map_err(|e| miette!("stdin: {e}"))?;
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|w| w.parse().ok()).collect();
        let [bend_deg, dir_deg] = numbers[..] else { return Err(miette!("stdin: `{line}`: expected BEND DIR, two numbers in degrees")) };
        if settle(ask(&mut connection, &Request::Stream { bend_deg, dir_deg, length_mm: None }))?.is_none() {
            return Ok(Outcome::NotGoodEnough);
        }
    }
    Ok(Outcome::Good)
}

fn subscribe(args: &SubscribeArgs) -> Result<Outcome> {
    let mut connection = connect(&args.at)?;
    if settle(ask(&mut connection, &Request::Subscribe { rate_hz: args.rate }))?.is_none() {
        return Ok(Outcome::NotGoodEnough);
    }
    let mut out = std::io::stdout();
    loop {
        let value = connection.line().map_err(report)?;
        if writeln!(out, "{value}").is_err() {
            return Ok(Outcome::Good);
        }
    }
}

/// `calibrate transmission`: begins it and follows it to its end.
///
/// # Errors
/// A report with the service's words.
pub fn transmission(args: &TransmissionArgs) -> Result<Outcome> {
    let mut connection = connect(&args.at)?;
    let action = match (args.accept, args.discard, args.short) {
        (true, ..) => CalibrateAction::Accept,
        (_, true, _) => CalibrateAction::Discard,
        (.., true) => CalibrateAction::Short,
        _ => CalibrateAction::Full,
    };
    let begun = settle(ask(&mut connection, &Request::Calibrate { action }))?;
    if begun.is_none() || args.accept || args.discard {
        return Ok(outcome(begun.as_ref()));
    }
    let mut shown = String::new();
    loop {
        std::thread::sleep(Duration::from_millis(200));
        let Some(s) = settle(ask(&mut connection, &Request::Status {}))? else { return Ok(Outcome::NotGoodEnough) };
        if let Some(progress) = s["calibrating"].as_str() {
            if progress != shown {
                progress.clone_into(&mut shown);
                eprintln!("{progress}");
            }
            continue;
        }
        if s["proposed"].is_null() {
            eprintln!("nothing was found: see the service's log");
            return Ok(Outcome::NotGoodEnough);
        }
        say(&format!("{}\n", s["proposed"]));
        eprintln!("`retroflex calibrate transmission --accept` puts it in use, `--discard` forgets it");
        return Ok(Outcome::Good);
    }
}
