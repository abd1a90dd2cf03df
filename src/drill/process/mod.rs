//! Faults of the process, injected into real child processes: they are killed, stopped, deprived of their disk and
//! loaded by misbehaving clients.

mod attack;
mod attacks;
mod clients;
pub mod daemon;
mod disk;
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
    let (program, selected) = (plan.program, plan.selected);
    let folder = |name: &str| plan.scratch.join(name);
    type Row = fn(&Plan<'_>, &Path) -> io::Result<FaultResult>;
    let single: [(&str, Row); 6] = [
        ("sigstop", restart::stopped),
        ("disk_full", disk::full),
        ("read_only_fs", disk::read_only),
        ("restart_while_bent", restart::while_bent),
        ("stale_calibration", restart::stale),
        ("wrong_board_file", restart::wrong_board),
    ];
    let mut rows = Vec::new();
    for (name, run) in single.into_iter().filter(|(name, _)| selected(name)) {
        rows.push(run(plan, &folder(name)).unwrap_or_else(|e| not_run(name, &e)));
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
