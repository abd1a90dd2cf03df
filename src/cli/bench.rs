//! `retroflex bench rt`: timing of the step thread on this machine.

use crate::cli::{inputs, manual_motion, output, within};
use crate::hardware::bench_rt::{self, NoCurrent, RtBench, RtBenchConfig};
use crate::hardware::pins::{self, Backend, PinsConfig};
use clap::Args;
use miette::{IntoDiagnostic, Result, bail};
use std::path::{Path, PathBuf};

commands! {
    /// Measurements of this machine.
    pub enum Bench;

    /// Measure the lateness of the step thread: wake-up, step and interval.
    Rt(Rt) => run,
}

/// Arguments of `bench rt`.
#[derive(Debug, Args)]
pub struct Rt {
    /// Pulse the pins of this board, with the drivers disabled; the default is a mock.
    #[arg(long)]
    board: Option<PathBuf>,
    /// Steps per second on each of the three channels.
    #[arg(long, default_value_t = 4000.0, value_parser = within(10.0..=20_000.0, "steps/s"))]
    rate: f64,
    /// Duration, s.
    #[arg(long, default_value_t = 10.0, value_parser = within(0.2..=3600.0, "s"))]
    seconds: f64,
    /// Number of threads that load the processors meanwhile.
    #[arg(long, default_value_t = 0)]
    load: usize,
}

/// Runs the command.
///
/// # Errors
/// A report that says what is wrong with the input, or that the pins are not available.
pub fn run(args: &Rt) -> Result<bool> {
    let base = RtBenchConfig {
        rate_hz: args.rate,
        duration_s: args.seconds,
        load_threads: args.load,
        ..RtBenchConfig::default()
    };
    let (bench, through) = match &args.board {
        Some(path) => on_board(path, base)?,
        None => {
            let mock = PinsConfig {
                backend: Backend::Mock,
                ..PinsConfig::default()
            };
            let pins = pins::open(&mock, 16).into_diagnostic()?;
            let bench = bench_rt::run(&base, pins).into_diagnostic()?;
            (bench, "the mock".to_owned())
        }
    };
    output::print(format!("through {through}\n{}\n", bench.table()));
    Ok(bench.is_good())
}

/// The bench on the pins of a board, and what it went through.
fn on_board(path: &Path, base: RtBenchConfig) -> Result<(RtBench, String)> {
    let board = inputs::board(Some(path))?;
    let file = path.display();
    let Some(wiring) = &board.pins else {
        bail!(
            "{file}: there is no [pins] table, so there is nothing to pulse; omit --board to use the mock"
        );
    };
    if wiring.channels.iter().any(|c| c.enable.is_none()) {
        bail!(
            "{file}: the EN input of a channel is hard-wired, so its motor would run; wire EN to a line and name it in pins.channels"
        );
    }
    let (_lock, pins) = manual_motion::open_pins(path, &board, wiring)?;
    // no motor turns, so only the pulse widths limit the rate; a fifth of the period leaves room to catch up
    let least_us = board.stepper.pulse_high_us + board.stepper.pulse_low_us;
    let most_us = board.stepper.step_interval_min_us.max(least_us);
    let step_interval_min_us = (0.2e6 / base.rate_hz).clamp(least_us, most_us);
    let mut config = base;
    config.stepper = board.stepper;
    config.stepper.step_interval_min_us = step_interval_min_us;
    let through = format!("{:?} on {}", wiring.backend, board.machine.name).to_lowercase();
    let bench = bench_rt::run(&config, NoCurrent(pins)).into_diagnostic()?;
    Ok((bench, through))
}
