//! The connection of a command to the service.

use crate::cli::output::print;
use crate::cli::{CommandOutcome, Unreachable};
use crate::service::client::Client as Connection;
use crate::service::paths;
use crate::service::protocol::{Failure, Request};
use miette::{Context, Report, Result, bail, miette};
use serde_json::Value;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::time::Duration;

/// Longest time after which a service that works says its status.
const ANSWER_MAX: Duration = Duration::from_secs(2);

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
        live.retain(|path| UnixStream::connect(path).is_ok());
        if live.is_empty() {
            vec![paths::default_socket()]
        } else {
            live
        }
    }
}

/// A failure of the service as a report.
pub(super) fn report(f: Failure) -> Report {
    match f.code {
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
    let answer = Connection::connect_for(&socket, ANSWER_MAX)
        .and_then(|mut to| to.request(&Request::Status {}));
    answer
        .and_then(|_| Connection::connect(&socket))
        .map_err(report)
}

/// Stops the tip, that of every service if none is named.
pub(super) fn stop(at: &At) -> Result<CommandOutcome> {
    let advice = "the stop is not confirmed: if the tip moves, cut the power of its motors";
    let stop = |socket: &PathBuf| {
        answered(Connection::stop(socket))
            .map(printed)
            .wrap_err(advice)
    };
    let stopped: Vec<_> = at.sockets().iter().map(stop).collect();
    let outcomes: Vec<CommandOutcome> = stopped.into_iter().collect::<Result<_>>()?;
    Ok(outcomes
        .iter()
        .all(|one| *one == CommandOutcome::Good)
        .into())
}

/// Sends a request. A refusal is printed on standard error and yields `None`; every other failure is an error.
pub(super) fn ask(connection: &mut Connection, request: &Request) -> Result<Option<Value>> {
    answered(connection.request(request))
}

/// The status of the service.
pub(super) fn status(connection: &mut Connection) -> Result<Value> {
    connection.request(&Request::Status {}).map_err(report)
}

/// The result of a request. A refusal is printed on standard error and yields `None`; every other failure is an error.
pub(super) fn answered(result: Result<Value, Failure>) -> Result<Option<Value>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(f) if f.code == 1 => {
            eprintln!("refused: {}", f.message);
            Ok(None)
        }
        Err(f) => Err(report(f)),
    }
}

/// Sends a request and prints its result, unless that is empty.
pub(super) fn ask_and_print(
    connection: &mut Connection,
    request: &Request,
) -> Result<CommandOutcome> {
    Ok(printed(ask(connection, request)?))
}

fn printed(result: Option<Value>) -> CommandOutcome {
    let Some(value) = result else {
        return CommandOutcome::NotGoodEnough;
    };
    if let Some(remark) = value["remark"].as_str() {
        eprintln!("note: {remark}");
    }
    if value.as_object().is_some_and(|map| !map.is_empty()) {
        print(words(&value));
    }
    CommandOutcome::Good
}

/// A result in words: the recording or the gains file that it names.
pub(super) fn words(value: &Value) -> String {
    let file = value["path"].as_str();
    match (file, value["rows"].as_u64(), value["gains"].as_str()) {
        (Some(path), None, _) => format!("recording {path}\n"),
        (Some(path), Some(rows), _) => {
            let replay = if value["replayable"] == true {
                ", can be replayed"
            } else {
                ""
            };
            format!("{path}: {rows} rows{replay}\n")
        }
        (None, _, Some(gains)) => format!("{gains} is in use\n"),
        _ => format!("{value}\n"),
    }
}
