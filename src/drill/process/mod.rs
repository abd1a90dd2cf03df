//! Faults of the process, injected into real child processes: they are killed, stopped, deprived of their disk and
//! loaded by misbehaving clients.

mod attack;
mod attacks;
mod clients;
pub mod daemon;
mod disk;
mod hang;
mod kills;
mod plan;
mod restart;

pub use attacks::rows as attacks;
pub use daemon::Daemon;
pub use disk::{Harm, exercise};
pub use kills::rows as kills;
pub use plan::Plan;

use crate::drill::row::FaultResult;
use std::io;
use std::path::Path;

/// The selected rows about the process.
///
/// # Errors
/// The operating system's, if the service of the client rows cannot be started.
pub fn rows(plan: &Plan<'_>) -> io::Result<Vec<FaultResult>> {
    let Plan {
        config,
        program,
        scratch,
        selected,
        ..
    } = *plan;
    let folder = |name: &str| scratch.join(name);
    type Single<'a> = (&'static str, &'a dyn Fn(&Path) -> io::Result<FaultResult>);
    let single: [Single<'_>; 6] = [
        ("sigstop", &|folder| restart::stopped(program, folder)),
        ("disk_full", &|folder| disk::full(program, folder)),
        ("read_only_fs", &|folder| disk::read_only(program, folder)),
        ("restart_while_bent", &|_| restart::while_bent(config)),
        ("stale_calibration", &|folder| {
            restart::stale(program, folder)
        }),
        ("wrong_board_file", &|folder| {
            restart::wrong_board(program, folder)
        }),
    ];
    let mut rows = Vec::new();
    for (name, run) in single.into_iter().filter(|(name, _)| selected(name)) {
        rows.push(run(&folder(name)).unwrap_or_else(|e| not_run(name, &e)));
    }
    rows.extend(kills::rows(plan)?);
    let of_clients = clients::NAMES.into_iter().filter(|name| selected(name));
    if of_clients.clone().count() > 0 {
        match clients::rows(program, &folder("clients")) {
            Ok(all) => rows.extend(all.into_iter().filter(|r| selected(&r.fault))),
            Err(e) => rows.extend(of_clients.map(|name| not_run(name, &e))),
        }
    }
    rows.extend(attacks::rows(plan)?);
    Ok(rows)
}

/// The row of a fault that could not be injected.
fn not_run(name: &str, e: &io::Error) -> FaultResult {
    let mut row = FaultResult::new(name, "runs at all");
    row.fail(format!("could not be run: {e}"));
    row
}
