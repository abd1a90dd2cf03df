//! The connection of a command to the service.

use crate::cli::{Refused, Unreachable, output};
use crate::model::Bend;
use crate::service::client::connect_within;
use crate::service::status::Status;
use crate::service::{Failure, Request, paths};
use crate::supervisor::{Mode, Refusal};
use miette::{Context, Report, Result, bail, miette};
use serde_json::Value;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

pub(super) use crate::service::client::Client as Connection;

/// Longest time after which a service that works says its status.
const ANSWER_MAX: Duration = Duration::from_secs(2);

/// Longest wait for a service that may listen on a socket.
const PROBE_MAX: Duration = Duration::from_millis(100);

/// Longest wait for pistons that brake and drivers that energise.
const BUSY_MAX: Duration = Duration::from_secs(1);
/// Largest difference between two targets that are the same, degrees: rounding.
const SAME_DEG: f64 = 0.1;

/// Address of the service.
#[derive(Debug, Clone, clap::Args)]
pub struct At {
    /// Socket of the service. Default: RETROFLEX_SOCKET, or else that of this user's service, or else the system's.
    #[arg(long)]
    socket: Option<PathBuf>,
}

impl At {
    /// The named socket, or those on which a service of this user or of the system listens.
    fn sockets(&self) -> Vec<PathBuf> {
        let named = || std::env::var_os("RETROFLEX_SOCKET").map(PathBuf::from);
        if let Some(named) = self.socket.clone().or_else(named) {
            return vec![named];
        }
        let mut live = paths::sockets();
        live.retain(|path| listens(path));
        if live.is_empty() {
            live.push(paths::default_socket());
        }
        live
    }
}

/// True if a service listens on this socket, whether it answers or hangs.
fn listens(path: &Path) -> bool {
    match connect_within(path, PROBE_MAX) {
        Ok(_) => true,
        Err(e) => e.kind() == ErrorKind::WouldBlock,
    }
}

/// A failure of the service as a report.
pub(super) fn report(f: Failure) -> Report {
    match f.code {
        1 => Refused::report(f.message),
        3 => Unreachable::report("the service", f.message),
        _ => miette!("{}", f.message),
    }
}

/// The socket of the service. Two services of which none is named are refused.
pub(super) fn socket(at: &At) -> Result<PathBuf> {
    let sockets = at.sockets();
    if let [one, other, ..] = &sockets[..] {
        let (one, other) = (one.display(), other.display());
        bail!(
            "two services are running, at {one} and {other}: name one with --socket (`retroflex stop` stops both)"
        )
    }
    Ok(sockets[0].clone())
}

/// Connects to the service, once that has answered: what is asked next may take longer.
pub(super) fn connect(at: &At) -> Result<Connection> {
    let socket = socket(at)?;
    let probe = Connection::connect_for(&socket, ANSWER_MAX);
    let answer = probe.and_then(|mut to| to.request(&Request::Status {}));
    let connection = answer.and_then(|_| Connection::connect(&socket));
    connection.map_err(report)
}

/// Stops the tip, that of every service if none is named, all at the same time.
pub(super) fn stop(at: &At) -> Result<bool> {
    let sockets = at.sockets();
    let answers: Vec<Result<Value, Failure>> = std::thread::scope(|scope| {
        let all = sockets.iter();
        let all = all.map(|socket| scope.spawn(|| Connection::stop(socket)));
        let all: Vec<_> = all.collect();
        let failed = |_| Err(Failure::unreachable("the command failed"));
        let joined = all.into_iter().map(|one| one.join().unwrap_or_else(failed));
        joined.collect()
    });
    let (mut good, mut unconfirmed) = (true, Vec::new());
    for (socket, answer) in sockets.iter().zip(answers) {
        let name = socket.display().to_string();
        match answer {
            Ok(value) => {
                if sockets.len() > 1 {
                    output::print(format!("{name}: stopped\n"));
                }
                print_result(&value);
            }
            Err(f) if f.code == 1 => {
                eprintln!("refused: {}", f.message);
                good = false;
            }
            // a message about the connection begins with its socket
            Err(f) if f.message.starts_with(&name) => unconfirmed.push(f.message),
            Err(f) => unconfirmed.push(format!("{name}: {}", f.message)),
        }
    }
    if unconfirmed.is_empty() {
        return Ok(good);
    }
    Err(Unreachable::report("the service", unconfirmed.join("; ")))
        .wrap_err("the stop is not confirmed: if the tip moves, cut the power of its motors")
}

/// Sends a request. While the drivers energise or the pistons brake, it is sent again.
pub(super) fn ask(connection: &mut Connection, request: &Request) -> Result<Value> {
    let (started, busy) = (Instant::now(), Refusal::Busy.to_string());
    loop {
        match connection.request(request) {
            Err(f) if f.message == busy && started.elapsed() < BUSY_MAX => {
                std::thread::sleep(BUSY_MAX / 20);
            }
            result => return result.map_err(report),
        }
    }
}

/// The status of the service.
pub(super) fn status(connection: &mut Connection) -> Result<Status> {
    let value = connection.request(&Request::Status {}).map_err(report)?;
    read_status(&value)
}

/// A status that the service has sent.
pub(super) fn read_status(value: &Value) -> Result<Status> {
    Status::of(value).map_err(|e| Unreachable::report("the service", format!("its status: {e}")))
}

/// Polls the status until `done` returns a result.
pub(super) fn poll<T>(
    connection: &mut Connection,
    period_ms: u64,
    mut done: impl FnMut(&Status) -> Option<T>,
) -> Result<T> {
    loop {
        std::thread::sleep(Duration::from_millis(period_ms));
        if let Some(result) = done(&status(connection)?) {
            return Ok(result);
        }
    }
}

/// Why the tip does not move as it is told.
pub(super) fn halted(s: &Status) -> Option<String> {
    match s.mode {
        _ if s.stopped => Some("stopped".to_owned()),
        Some(Mode::Tracking | Mode::Holding) => None,
        _ => {
            let mode = s.mode_name().unwrap_or_default();
            Some(s.fault.clone().unwrap_or(format!("mode {mode}")))
        }
    }
}

/// True if another command has given the tip another target than this one.
pub(super) fn is_led_elsewhere(s: &Status, target: Bend) -> bool {
    let off = s.target.unwrap_or_default().bend().0 - target.0;
    off.norm().to_degrees() > SAME_DEG
}

/// Sends a request and prints its result, unless that is empty.
pub(super) fn ask_and_print(connection: &mut Connection, request: &Request) -> Result<()> {
    print_result(&ask(connection, request)?);
    Ok(())
}

fn print_result(value: &Value) {
    if let Some(remark) = value["remark"].as_str() {
        eprintln!("note: {remark}");
    }
    if value.as_object().is_some_and(|map| !map.is_empty()) {
        output::print(words(value));
    }
}

/// A result in words: the recording or the gains file that it names.
pub(super) fn words(value: &Value) -> String {
    let replay = match value["replayable"].as_bool() {
        Some(true) => ", can be replayed",
        Some(false) => ", cannot be replayed, because it did not begin disarmed at rest",
        None => "",
    };
    let file = value["path"].as_str();
    match (file, value["rows"].as_u64(), value["gains"].as_str()) {
        (Some(path), None, _) => format!("recording {path}\n"),
        (Some(path), Some(rows), _) => format!("{path}: {rows} rows{replay}\n"),
        (None, _, Some(gains)) => format!("{gains} is in use\n"),
        _ => format!("{value}\n"),
    }
}
