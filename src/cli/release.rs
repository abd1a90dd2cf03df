//! `retroflex release`: takes the current away from all drivers. The unit `retroflex-release.service` runs it when the
//! service has failed for good, because the drivers otherwise stay energised with nobody in control.

use crate::cli::{inputs, manual_motion, output};
use crate::hardware::Levels;
use crate::hardware::machine::HardwareError;
use crate::hardware::pins::{PinError, Pins};
use crate::hardware::rt;
use miette::{IntoDiagnostic, Result, bail};
use signal_hook::iterator::Signals;
use std::path::PathBuf;

/// Arguments of `release`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file.
    #[arg(long)]
    board: PathBuf,
    /// Keep the lines until a signal ends the program. The kernel may release the lines of a GPIO character device when the program
    /// ends, and a breakout then pulls EN to "energised".
    #[arg(long)]
    hold: bool,
}

/// Runs the command.
///
/// # Errors
/// A report: bad input, or lines that cannot be opened or do not follow.
pub fn run(args: &Args) -> Result<()> {
    let board = inputs::board(Some(&args.board))?;
    let Some(config) = &board.pins else {
        let file = args.board.display();
        bail!("{file}: there is no [pins] table, so there are no drivers to release");
    };
    let (_lock, mut pins) = manual_motion::open_pins(&args.board, &board, config)?;
    let hardware = |e: PinError| manual_motion::hardware_error(&args.board, HardwareError::Pins(e));
    pins.write(&Levels::default()).map_err(hardware)?;
    // the lines settle before they are read back
    std::thread::sleep(std::time::Duration::from_millis(10));
    pins.check_enable().map_err(hardware)?;
    output::print("drivers released: the tip goes soft, and zero must be found again\n");
    if args.hold {
        let mut signals = Signals::new(rt::ending_signals()).into_diagnostic()?;
        // outside of systemd there is nobody to notify
        let _ = sd_notify::notify(&[sd_notify::NotifyState::Ready]);
        let _ = signals.forever().next();
    }
    Ok(())
}
