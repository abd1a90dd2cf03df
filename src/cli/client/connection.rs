//! The connection of a command to the service.

use crate::cli::output::print;
use crate::cli::{CommandOutcome, Unreachable};
use crate::service::client::Client as Connection;
use crate::service::protocol::{Failure, Request};
use miette::{Report, Result, miette};
use serde_json::Value;
use std::path::PathBuf;

/// Address of the service.
#[derive(Debug, Clone, clap::Args)]
pub struct At {
    /// Socket of the service. Default: RETROFLEX_SOCKET, or else /run/retroflex/control.sock.
    #[arg(long, default_value_os_t = default_socket())]
    socket: PathBuf,
}

fn default_socket() -> PathBuf {
    std::env::var_os("RETROFLEX_SOCKET").map_or_else(|| "/run/retroflex/control.sock".into(), PathBuf::from)
}

/// A failure of the service as a report.
pub(super) fn report(f: Failure) -> Report {
    if f.code == 3 { Unreachable { what: "the service".to_owned(), why: f.message }.into() } else { miette!("{}", f.message) }
}

/// Connects to the service.
pub(super) fn connect(at: &At) -> Result<Connection> {
    Connection::connect(&at.socket).map_err(report)
}

/// Sends a request. A refusal is printed on standard error and yields `None`; every other failure is an error.
pub(super) fn ask(connection: &mut Connection, request: &Request) -> Result<Option<Value>> {
    match connection.request(request) {
        Ok(value) => Ok(Some(value)),
        Err(f) if f.code == 1 => {
            eprintln!("refused: {}", f.message);
            Ok(None)
        }
        Err(f) => Err(report(f)),
    }
}

/// Sends a request and prints its result, unless that is empty.
pub(super) fn ask_and_print(connection: &mut Connection, request: &Request) -> Result<CommandOutcome> {
    let Some(value) = ask(connection, request)? else { return Ok(CommandOutcome::NotGoodEnough) };
    if value.as_object().is_some_and(|map| !map.is_empty()) {
        print(&words(&value));
    }
    Ok(CommandOutcome::Good)
}

/// A result in words: the recording or the gains file that it names.
pub(super) fn words(value: &Value) -> String {
    let file = value["path"].as_str();
    match (file, value["rows"].as_u64(), value["gains"].as_str()) {
        (Some(path), None, _) => format!("recording {path}\n"),
        (Some(path), Some(rows), _) => {
            let replay = if value["replayable"] == true { ", can be replayed" } else { "" };
            format!("{path}: {rows} rows{replay}\n")
        }
        (None, _, Some(gains)) => format!("{gains} is in use\n"),
        _ => format!("{value}\n"),
    }
}
