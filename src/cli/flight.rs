//! Flight logs as the commands read and write them.

use crate::primitives::file::why_unreadable;
use crate::service::flight::file::{FlightFile, io_error};
use crate::service::flight::read::{Ending, parse};
use crate::service::record::flight_path;
use mcap::{McapError, Message};
use miette::{Result, bail, miette};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// The flight log of a path: the file itself, or the one beside a bend log.
///
/// # Errors
/// A report about a file that does not exist.
pub fn flight_of(log: &Path) -> Result<PathBuf> {
    if log.is_dir() || !log.exists() {
        let why = why_unreadable(log, &std::io::ErrorKind::NotFound.into());
        bail!("{}: {why}", log.display());
    }
    let flight = flight_path(log);
    let is_bend_log = log.extension().is_some_and(|e| e == "csv" || e == "gz");
    let why = "there is no such file; a bend log has a flight log beside it only if it was recorded with `retroflex run --record LOG`, or with `retroflex record start` while disarmed at rest";
    if flight.exists() {
        Ok(flight)
    } else if is_bend_log {
        Err(miette!("{}: {why}", flight.display()))
    } else {
        Ok(log.to_owned())
    }
}

/// Reads the messages of a log, each with its time since the first one, s. Returns how the log ends and where it is damaged.
///
/// # Errors
/// What is wrong with the file or, from the visitor, with a message, with the name of the file.
pub fn read(
    path: &Path,
    visit: &mut dyn FnMut(f64, &Message<'_>) -> Result<(), String>,
) -> Result<Ending> {
    let named = |problem: String| miette!("{}: {problem}", path.display());
    let file = File::open(path).map_err(|e| named(why_unreadable(path, &e)))?;
    let mut begin_ns = None;
    let read = parse(BufReader::new(file), &mut |message| {
        let now_ns = message.log_time;
        let since_ns = now_ns.saturating_sub(*begin_ns.get_or_insert(now_ns));
        visit(since_ns as f64 * 1e-9, &message)
    });
    read.map_err(named)
}

/// The message about a log that cannot be written, which `shown` names.
pub fn unwritable(shown: &str) -> impl Fn(McapError) -> String {
    move |e| format!("{shown}: {}", io_error(e))
}

/// Writes a log. `work` fills it and says how the log that it comes from ends. If anything fails, no log is left.
///
/// # Errors
/// Those of `work`, and what is wrong with the file, which `shown` names.
pub fn write(
    out: &Path,
    shown: &str,
    work: impl FnOnce(FlightFile) -> Result<(FlightFile, Ending)>,
) -> Result<Ending> {
    let failed = |e| miette!("{}", unwritable(shown)(e));
    let file = FlightFile::create(out, 0).map_err(failed)?;
    let done = work(file).and_then(|(mut file, ending)| {
        file.state_damage(&ending.damage).map_err(failed)?;
        file.finish().map_err(failed).map(|()| ending)
    });
    done.inspect_err(|_| {
        // it holds nothing of use
        let _ = std::fs::remove_file(out);
    })
}
