//! Shared by the commands that move a machine manually: opening it, its clock, and its errors.

use crate::cli::{Unreachable, inputs};
use crate::config::Board;
use crate::hardware::machine::{Hardware, HardwareError, MachineConfig};
use crate::hardware::pins::OpenError;
use crate::hardware::rt;
use crate::primitives::Seconds;
use crate::simulation::lockstep::Lockstep;
use crate::simulation::sim::Sim;
use crate::supervisor::Machine;
use crate::supervisor::commission::manual_motion::{ManualMotion, ManualMotionError};
use miette::{IntoDiagnostic, Result, bail, miette};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Reads a board file and opens its machine: the hardware if it has pins, else its plant. `prepare` can adjust the hardware
/// configuration.
///
/// # Errors
/// A report; [`Unreachable`] when the hardware does not answer.
pub fn open(
    path: &Path,
    prepare: impl FnOnce(&mut MachineConfig),
) -> Result<(Board, Box<dyn Machine>)> {
    let board = inputs::board(Some(path))?;
    if let Some(mut config) = board.hardware() {
        prepare(&mut config);
        let machine = Hardware::open(&config).map_err(|e| hardware_error(path, e))?;
        return Ok((board, Box::new(machine)));
    }
    let Some(plant) = &board.plant else {
        let file = path.display();
        bail!("{file}: there is neither a [pins] nor a [plant] table, so there is nothing to move");
    };
    let sim = Sim::new(&plant.make(), 0, 0, plant.period_s).into_diagnostic()?;
    let machine = Lockstep::new(sim, &board.drive_limits());
    Ok((board, Box::new(machine)))
}

/// Converts an error of the hardware into a report with the right exit code.
pub fn hardware_error(path: &Path, error: HardwareError) -> miette::Report {
    if error.is_config() {
        return miette!("{}: {error}", path.display());
    }
    let what = match &error {
        HardwareError::Pins(OpenError::Pin(_)) | HardwareError::InUse(_) => "the GPIO",
        HardwareError::Stepper(_) | HardwareError::Thread(_) => "the scheduler",
        _ => "the IMU",
    };
    Unreachable::report(what, error)
}

/// Runs `work` with manual control of the machine, in real time unless the machine is simulated. A signal that ends a process ends the
/// motion. The drivers are released when the machine is dropped, whatever the outcome.
///
/// # Errors
/// The error of `work`.
pub fn with_manual_control<T>(
    machine: &mut dyn Machine,
    work: impl FnOnce(&mut ManualMotion<'_>) -> Result<T>,
) -> Result<T> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in rt::ending_signals() {
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

/// Converts the reason that ended a motion into a report; failing pins count as hardware (exit code 3).
pub fn motion_error(error: ManualMotionError) -> miette::Report {
    match &error {
        ManualMotionError::EmergencyStop
        | ManualMotionError::Cancelled
        | ManualMotionError::NotArrived(..) => miette!("{error}"),
        _ => Unreachable::report("the machine", error),
    }
}
