//! Shared by the commands that move a machine manually: opening it, its clock, and its errors.

use crate::cli::{Unreachable, inputs};
use crate::config::Board;
use crate::hardware::lock::HardwareLock;
use crate::hardware::machine::{Hardware, HardwareError, MachineConfig};
use crate::hardware::pins::{self, BoardPins, PinsConfig};
use crate::hardware::rt;
use crate::primitives::Seconds;
use crate::simulation::lockstep::Lockstep;
use crate::simulation::sim::Sim;
use crate::supervisor::Machine;
use crate::supervisor::commission::manual_motion::{ManualMotion, ManualMotionError};
use miette::{IntoDiagnostic, Result, bail, miette};
use std::path::Path;
use std::sync::atomic::Ordering;

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
    let Some(machine) = simulated(&board, 0, 0)? else {
        let file = path.display();
        bail!("{file}: there is neither a [pins] nor a [plant] table, so there is nothing to move");
    };
    Ok((board, machine))
}

/// The pins of a board, and the lock that keeps other processes from them.
///
/// # Errors
/// As for [`open`].
pub fn open_pins(
    path: &Path,
    board: &Board,
    wiring: &PinsConfig,
) -> Result<(HardwareLock, BoardPins)> {
    let refused = |e| hardware_error(path, e);
    let lock = HardwareLock::take().map_err(|device| refused(HardwareError::InUse(device)))?;
    let pins = pins::open(wiring, board.drive.microsteps).map_err(|e| refused(e.into()))?;
    Ok((lock, pins))
}

/// The plant of a board, if it describes one.
///
/// # Errors
/// A report about the plant.
pub fn simulated(board: &Board, seed: u64, noise: u64) -> Result<Option<Box<dyn Machine>>> {
    let Some(plant) = &board.plant else {
        return Ok(None);
    };
    let sim = Sim::new(plant, seed, noise, plant.period_s).into_diagnostic()?;
    Ok(Some(Box::new(Lockstep::new(sim, &board.drive_limits()))))
}

/// Leaves out the sensors, which are not needed to turn a motor.
pub fn without_sensors(config: &mut MachineConfig) {
    (config.imu, config.base_imu) = (None, None);
}

/// Converts an error of the hardware into a report with the right exit code.
pub fn hardware_error(path: &Path, error: HardwareError) -> miette::Report {
    if error.is_config() {
        return miette!("{}: {error}", path.display());
    }
    let what = match &error {
        HardwareError::Pins(_) | HardwareError::InUse(_) => "the GPIO",
        HardwareError::Stepper(_) | HardwareError::Thread(..) => "the scheduler",
        _ => "the IMU",
    };
    Unreachable::report(what, error)
}

/// Runs `work` with manual control of the machine, in real time unless the machine is simulated. A signal that ends a process ends the
/// motion. The drivers are released when the machine is dropped, whatever the outcome.
///
/// # Errors
/// `report` of the error of `work`.
pub fn with_manual_control<T, E>(
    machine: &mut dyn Machine,
    report: impl FnOnce(E) -> miette::Report,
    work: impl FnOnce(&mut ManualMotion<'_>) -> Result<T, E>,
) -> Result<T> {
    let stop = inputs::ended()?;
    let simulated = machine.is_simulated();
    let zero_ns = rt::monotonic_ns();
    let mut wait = move |next: Seconds| {
        if stop.load(Ordering::Relaxed) {
            return None;
        }
        if simulated {
            return Some(next);
        }
        rt::sleep_until_ns(zero_ns + (next.0 * 1e9) as u64);
        Some(Seconds((rt::monotonic_ns() - zero_ns) as f64 * 1e-9))
    };
    work(&mut ManualMotion::new(machine, &mut wait)).map_err(report)
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
