//! What the commands that move a machine by hand share: opening it, its clock, and how to end.

use crate::cli::Unreachable;
use crate::config::board::Board;
use crate::config::source;
use crate::hardware::machine::{Hardware, HardwareError, MachineConfig};
use crate::hardware::pins::OpenError;
use crate::hardware::rt;
use crate::primitives::units::Seconds;
use crate::simulation::lockstep::Lockstep;
use crate::simulation::sim::Sim;
use crate::supervisor::commission::manual_motion::{ManualMotion, ManualMotionError};
use crate::supervisor::machine::Machine;
use miette::{IntoDiagnostic, Result, miette};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Reads a board and opens its machine: hardware where it has pins, else its plant. `prepare` may change
/// what hardware is made from.
///
/// # Errors
/// A report; [`Unreachable`] when the hardware does not answer.
pub fn open(path: &Path, prepare: impl FnOnce(&mut MachineConfig)) -> Result<(Board, Box<dyn Machine>)> {
    let board: Board = source::read(path)?;
    if let Some(mut config) = board.hardware() {
        prepare(&mut config);
        let machine = Hardware::open(&config).map_err(|e| told(path, e))?;
        return Ok((board, Box::new(machine)));
    }
    let Some(plant) = &board.plant else {
        return Err(miette!("{}: has neither [pins] nor [plant], so there is nothing to move", path.display()));
    };
    let sim = Sim::new(&plant.make(), 0, 0, plant.period_s).into_diagnostic()?;
    Ok((board, Box::new(Lockstep::new(sim))))
}

/// A machine's refusal as a report with the right exit code.
#[must_use]
pub fn told(path: &Path, error: HardwareError) -> miette::Report {
    if error.is_config() {
        return miette!("{}: {error}", path.display());
    }
    let what = match &error {
        HardwareError::Pins(OpenError::Pin(_)) => "the GPIO",
        HardwareError::Stepper(_) | HardwareError::Thread(_) => "the scheduler",
        _ => "the IMU",
    };
    Unreachable { what: what.to_owned(), why: error.to_string() }.into()
}

/// Does something with a hand on the machine, at its own pace. SIGINT and SIGTERM end the move; then, and
/// after every other end, the drivers are released where the machine's threads end.
///
/// # Errors
/// What `work` says.
pub fn at_hand<T>(machine: &mut dyn Machine, work: impl FnOnce(&mut ManualMotion<'_>) -> Result<T>) -> Result<T> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone()).into_diagnostic()?;
    }
    let simulated = machine.is_simulated();
    let zero_ns = rt::monotonic_ns();
    let clock = || Seconds((rt::monotonic_ns() - zero_ns) as f64 * 1e-9);
    let mut wait = move |next: Seconds| {
        if stop.load(Ordering::Relaxed) {
            return None;
        }
        if simulated {
            return Some(next);
        }
        rt::sleep_until_ns(zero_ns + (next.0 * 1e9) as u64);
        Some(clock())
    };
    work(&mut ManualMotion::new(machine, &mut wait))
}

/// What ended a move, as a report: pins that fail are hardware (exit code 3).
#[must_use]
pub fn ended(error: ManualMotionError) -> miette::Report {
    match &error {
        ManualMotionError::Alarm { .. } | ManualMotionError::NotSwitched(_) | ManualMotionError::World(_) => {
            Unreachable { what: "the machine".to_owned(), why: error.to_string() }.into()
        }
        _ => miette!("{error}"),
    }
}
