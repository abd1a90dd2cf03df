//! `retroflex bench rt`: timing of the step thread on this machine.

use crate::cli::{inputs, manual_motion, output, within};
use crate::hardware::StepperMode;
use crate::hardware::bench_rt::{self, NoCurrent, RtBench, RtBenchConfig};
use crate::hardware::pins::{self, Backend, PinsConfig};
use crate::report::table;
use clap::builder::TypedValueParser;
use miette::{IntoDiagnostic, Result, bail};
use std::path::{Path, PathBuf};

/// Header of the table, and the quantiles in it.
const HEADER: &str = "µs|mean|50 %|99 %|99.9 %|99.99 %|longest|count";
const QUANTILES: [f64; 4] = [0.5, 0.99, 0.999, 0.9999];

commands! {
    /// Measurements of this machine.
    pub enum Bench;

    /// Measure the lateness of the step thread: wake-up, step and interval.
    Rt(Rt) => run,
}

/// Arguments of `bench rt`.
#[derive(Debug, clap::Args)]
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
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(0..=1024).map(usize::from))]
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
        stepper: bench_rt::stepper(),
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
    output::print(format!("through {through}\n{}\n", shown(&bench)));
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
    let mut config = base;
    config.stepper = board.stepper;
    config.stepper.step_interval_min_us = (0.2e6 / base.rate_hz).clamp(least_us, most_us);
    let through = format!("{:?} on {}", wiring.backend, board.machine.name).to_lowercase();
    let bench = bench_rt::run(&config, NoCurrent(pins)).into_diagnostic()?;
    Ok((bench, through))
}

/// Percentiles in µs and the granted real-time settings as a table.
fn shown(bench: &RtBench) -> String {
    let (steps, report) = (&bench.steps, &bench.steps.report);
    let rows = [
        ("wake-up lateness", &steps.wake),
        ("step lateness", &report.lateness),
        ("step interval error", &steps.interval_error),
        ("plan and queue a tick", &bench.tick),
    ];
    let rows = rows.map(|(name, h)| {
        let us = |ns: f64| format!("{:.1}", ns * 1e-3);
        let mut row = vec![name.to_string(), us(h.mean_ns())];
        row.extend(QUANTILES.map(|q| us(h.quantile_ns(q) as f64)));
        row.extend([us(h.max_ns() as f64), h.count().to_string()]);
        row
    });
    let table = table(HEADER, 1..8, rows);
    let count = report.lateness.count();
    let rate = count as f64 / bench.elapsed_s;
    let mut text = format!(
        "{table}\n{count} steps in {:.1} s on three channels ({rate:.0} per second), {} load threads, {} underruns",
        bench.elapsed_s, bench.config.load_threads, report.underruns
    );
    for (name, grant) in &bench.status {
        text += &format!("\n{name}: {grant}");
    }
    if let StepperMode::Faulted(fault) = report.mode {
        text += &format!("\nFAULT: {fault}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::pins::{PinError, Pins};
    use crate::motion::{Inputs, Levels, StepperConfig};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    /// Pins that count the edges of the step lines.
    #[derive(Clone, Default)]
    struct Counting(Levels, Arc<AtomicU64>);

    impl Pins for Counting {
        fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
            let edges = (0..3).filter(|&c| levels.step[c] != self.0.step[c]).count();
            self.1.fetch_add(edges as u64, Ordering::Relaxed);
            self.0 = *levels;
            Ok(())
        }
        fn read(&mut self) -> Result<Inputs, PinError> {
            Ok(Inputs::default())
        }
    }

    /// A short run without hardware. The test asserts no times.
    #[test]
    fn the_table_and_the_drawing_show_the_steps_that_were_pulsed() {
        let stepper = StepperConfig {
            priority: 0,
            late_max_us: 100_000.0,
            lead_ms: 60.0,
            ..bench_rt::stepper()
        };
        let config = RtBenchConfig {
            rate_hz: 2000.0,
            duration_s: 0.4,
            load_threads: 0,
            stepper,
        };
        let pins = Counting::default();
        let bench = bench_rt::run(&config, pins.clone()).unwrap();
        let steps = bench.steps.report.lateness.count();
        assert!(
            steps > 300 && !matches!(bench.steps.report.mode, StepperMode::Faulted(_)),
            "{}",
            shown(&bench)
        );
        assert_eq!(pins.1.load(Ordering::Relaxed), 2 * steps);
        let table = shown(&bench);
        for words in [
            "step lateness",
            "99.9 %",
            "SCHED_FIFO: not requested",
            &format!("{steps} steps in"),
        ] {
            assert!(table.contains(words), "{table}");
        }
    }
}
