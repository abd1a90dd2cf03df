//! Faults of the process, injected into real child processes: they are killed, stopped, deprived of their disk and
//! loaded by misbehaving clients.

mod clients;
pub mod daemon;
mod disk;
mod restart;

pub use daemon::Daemon;
pub use disk::{Harm, exercise};

use crate::drill::bench::BenchConfig;
use crate::drill::row::Row;
use std::io;
use std::path::Path;

/// Every row about the process. `program` is this program, `scratch` an empty folder, `kills` the number of kills.
///
/// # Errors
/// The operating system's, if the service of the client rows cannot be started.
pub fn rows(config: &BenchConfig, program: &Path, scratch: &Path, kills: u32) -> io::Result<Vec<Row>> {
    let row = |name: &str, result: io::Result<Row>| {
        result.unwrap_or_else(|e| {
            let mut row = Row::new(name);
            row.fail(format!("could not be run: {e}"));
            row
        })
    };
    let mut rows = vec![
        row("sigkill", restart::killed(config, program, &scratch.join("kill"), kills)),
        row("sigstop", restart::stopped(program, &scratch.join("stop"))),
        row("disk_full", disk::full(program, &scratch.join("full"))),
        row("read_only_fs", disk::read_only(program, &scratch.join("readonly"))),
        row("restart_while_bent", restart::while_bent(config)),
        row("stale_calibration", restart::stale_calibration(program, &scratch.join("stale"))),
        row("wrong_board_file", restart::wrong_board(program, &scratch.join("board"))),
    ];
    rows.extend(clients::rows(program, &scratch.join("clients"))?);
    Ok(rows)
}
