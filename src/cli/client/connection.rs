//! The connection of a command to the service.

use crate::cli::output::print;
use crate::cli::{CommandOutcome, Unreachable};
use crate::service::client::Client as Connection;
use crate::service::paths;
use crate::service::protocol::{Failure, Request};
use miette::{Report, Result, miette};
use serde_json::Value;
use std::path::PathBuf;

/// Address of the service.
#[derive(Debug, Clone, clap::Args)]
pub struct At {
    /// Socket of the service. Default: RETROFLEX_SOCKET, or else that of this user's service, or else the system's.
    #[arg(long, default_value_os_t = default_socket())]
    socket: PathBuf,
}

fn default_socket() -> PathBuf {
    std::env::var_os("RETROFLEX_SOCKET").map_or_else(paths::default_socket, PathBuf::from)
}

/// A failure of the service as a report.
pub(super) fn report(f: Failure) -> Report {
    if f.code == 3 { Unreachable { what: "the service".to_owned(), why: f.message }.into() } else { miette!("{}", f.message) }
}

/// Connects to the service.
pub(super) fn connect(at: &At) -> Result<Connection> {
    Connection::connect(&at.socket).map_err(report)
}

/// Stops the tip.
pub(super) fn stop(at: &At) -> Result<CommandOutcome> {
    Ok(printed(answer(Connection::stop(&at.socket))?))
}

/// Sends a request. A refusal is printed on standard error and yields `None`; every other failure is an error.
pub(super) fn ask(connection: &mut Connection, request: &Request) -> Result<Option<Value>> {
    answer(connection.request(request))
}

fn answer(result: Result<Value, Failure>) -> Result<Option<Value>> {
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
pub(super) fn ask_and_print(connection: &mut Connection, request: &Request) -> Result<CommandOutcome> {
    Ok(printed(ask(connection, request)?))
}

fn printed(result: Option<Value>) -> CommandOutcome {
    let Some(value) = result else { return CommandOutcome::NotGoodEnough };
    if let Some(remark) = value["remark"].as_str() {
        eprintln!("note: {remark}");
    }
    if value.as_object().is_some_and(|map| !map.is_empty()) {
        print(&format!("{value}\n"));
    }
    CommandOutcome::Good
}
