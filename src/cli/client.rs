//! The commands that talk to a running service: thin, one request each.

use crate::cli::{CommandOutcome, Unreachable};
use crate::service::client::Client as Connection;
use crate::service::protocol::{Failure, RecordAction, Request};
use args::{Action, BendArgs, PlayArgs, RecordArgs, StatusArgs, SubscribeArgs};
use miette::{Report, Result, miette};
use serde_json::Value;
use std::io::Write;
use std::path::PathBuf;

pub mod args;
pub mod follow;
pub mod play;
pub mod status;

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
    /// Run a schedule of `gap excite`: its poses, speeds and holds.
    Play(PlayArgs),
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

/// Runs a command.
///
/// # Errors
/// A report with the service's words.
pub fn run(command: &Client) -> Result<CommandOutcome> {
    match command {
        Client::Bend(args) => follow::bend(args),
        Client::Hold(p) => plain(&p.at, &Request::Hold {}),
        Client::Stop(p) => plain(&p.at, &Request::Stop {}),
        Client::Relax(p) => plain(&p.at, &Request::Relax {}),
        Client::Arm(p) => plain(&p.at, &Request::Arm {}),
        Client::Disarm(p) => plain(&p.at, &Request::Disarm {}),
        Client::Zero(p) => then_aligned(&p.at, &Request::Zero {}),
        Client::ResetFault(p) => plain(&p.at, &Request::ResetFault {}),
        Client::Reload(p) => plain(&p.at, &Request::Reload {}),
        Client::Status(args) => status::status(args),
        Client::Record(args) => {
            let request = |action| Request::Record { action, name: args.name.clone() };
            match args.action {
                // at rest the service finds the rest anew, so that the recording can be replayed from it
                Action::Start => then_aligned(&args.at, &request(RecordAction::Start)),
                Action::Stop => plain(&args.at, &request(RecordAction::Stop)),
            }
        }
        Client::Play(args) => play::play(args),
        Client::Stream(p) => status::stream(&p.at),
        Client::Subscribe(args) => status::subscribe(args),
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

fn outcome(value: Option<&Value>) -> CommandOutcome {
    if value.is_some() { CommandOutcome::Good } else { CommandOutcome::NotGoodEnough }
}

fn plain(at: &At, request: &Request) -> Result<CommandOutcome> {
    said(&mut connect(at)?, request)
}

/// A request after which the service looks for the rest.
fn then_aligned(at: &At, request: &Request) -> Result<CommandOutcome> {
    let mut connection = connect(at)?;
    let outcome = said(&mut connection, request)?;
    if outcome == CommandOutcome::Good { follow::aligned(&mut connection) } else { Ok(outcome) }
}

/// One request and its result as a line.
fn said(connection: &mut Connection, request: &Request) -> Result<CommandOutcome> {
    let value = settle(ask(connection, request))?;
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
