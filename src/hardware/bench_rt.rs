//! How late is this machine? The step thread under load, measured on itself.
//!
//! The real thread ([`Stepper`]) with the real queue drives three channels at a steady rate; the pins
//! are the mock's or real ones. Meanwhile other threads may keep every processor busy. Measured are
//! the lateness of waking up, the lateness of every step (deadline to end of the write) and the error
//! of every interval between steps. The loop's part, planning and queueing a tick, is timed as well.

use crate::hardware::pins::{PinError, Pins};
use crate::hardware::rt::{self, RtRequest, RtStatus};
use crate::hardware::stepper::{StartError, Stepper, Sync};
use crate::motion::Motion;
use crate::motion::config::{MotionConfig, StepperConfig};
use crate::motion::histogram::Histogram;
use crate::motion::limits::MotionLimits;
use crate::motion::lines::{Inputs, Levels};
use crate::motion::report::{StepperFault, StepperMode};
use crate::report::chart::{Axis, Chart, Series, Stroke, sheet};
use crate::report::svg::Ink;
use comfy_table::{CellAlignment, Table};
use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// What to measure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RtBenchConfig {
    /// Steps a second and channel.
    pub rate_hz: f64,
    /// How long at that rate, s.
    pub duration_s: f64,
    /// Length of a control tick, s.
    pub tick_s: f64,
    /// Threads that keep processors busy meanwhile.
    pub load_threads: usize,
    /// The step thread's configuration.
    pub stepper: StepperConfig,
}

impl Default for RtBenchConfig {
    fn default() -> Self {
        Self {
            rate_hz: 4000.0,
            duration_s: 10.0,
            tick_s: 2e-3,
            load_threads: 0,
            stepper: StepperConfig { step_interval_min_us: 50.0, ..StepperConfig::default() },
        }
    }
}

/// What was found.
#[derive(Debug, Clone)]
pub struct RtBench {
    /// What was asked.
    pub config: RtBenchConfig,
    /// What the kernel granted.
    pub status: RtStatus,
    /// Steps pulsed, all channels.
    pub steps: u64,
    /// How long the pins were driven, ramps included, s.
    pub elapsed_s: f64,
    /// Lateness of waking up.
    pub wake: Histogram,
    /// Lateness of steps.
    pub lateness: Histogram,
    /// Error of intervals between steps.
    pub interval_error: Histogram,
    /// Time to plan and queue one tick.
    pub tick: Histogram,
    /// The fault that ended the run early.
    pub fault: Option<StepperFault>,
    /// How often the queue ran dry.
    pub dry: u32,
}

/// Pins whose drivers stay without current, so that a bench pulses real lines and no motor turns.
#[derive(Debug)]
pub struct NoCurrent<P>(pub P);

impl<P: Pins> Pins for NoCurrent<P> {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        self.0.write(&Levels { enable: false, ..*levels })
    }
    fn read(&mut self) -> Result<Inputs, PinError> {
        self.0.read()
    }
}

/// Percentiles shown.
const QUANTILES: [(&str, f64); 5] = [("50 %", 0.5), ("90 %", 0.9), ("99 %", 0.99), ("99.9 %", 0.999), ("99.99 %", 0.9999)];

/// Microstep of the bench, mm; any will do.
const STEP_MM: f64 = 0.01;

/// Runs the bench on these pins; gives them back with the result.
///
/// # Errors
/// [`StartError`]: a rate the configuration forbids, or no thread.
pub fn run<P: Pins + 'static>(config: &RtBenchConfig, pins: P) -> Result<(RtBench, P), StartError> {
    let speed = config.rate_hz * STEP_MM;
    let motion_config = MotionConfig {
        speed_max_mm_s: speed,
        acceleration_max_mm_s2: speed * 10.0,
        jerk_max_mm_s3: speed * 200.0,
        travel_max_mm: (speed * (config.duration_s + 2.0)).min(1000.0),
        retarget_min_mm: 0.0,
    };
    let busy = Load::start(config.load_threads);
    let mut stepper = Stepper::start(pins, &config.stepper, &motion_config, STEP_MM)?;
    let status = stepper.status().clone();
    let begun_ns = rt::monotonic_ns();
    // The loop runs below the step thread, as in the service.
    let wish = RtRequest { priority: (config.stepper.priority - 10).max(0), cpu: None };
    let tick = std::thread::scope(|scope| {
        let control = scope.spawn(|| {
            let (_status, _guard) = rt::enter(&wish);
            drive(config, &motion_config, &mut stepper)
        });
        control.join().unwrap_or(Err(StartError::Died))
    })?;
    let elapsed_s = (rt::monotonic_ns() - begun_ns) as f64 * 1e-9;
    let (summary, pins) = stepper.finish().ok_or(StartError::Died)?;
    drop(busy);
    let fault = if let StepperMode::Faulted(fault) = summary.report.mode { Some(fault) } else { None };
    let bench = RtBench {
        config: *config,
        status,
        steps: summary.report.lateness.count(),
        elapsed_s,
        wake: summary.wake,
        lateness: summary.report.lateness,
        interval_error: summary.interval_error,
        tick,
        fault,
        dry: summary.report.dry,
    };
    Ok((bench, pins))
}

/// The loop's part: to and fro between the ends of travel, a tick at a time, at absolute times.
fn drive<P: Pins + 'static>(
    config: &RtBenchConfig,
    motion_config: &MotionConfig,
    stepper: &mut Stepper<P>,
) -> Result<Histogram, StartError> {
    let mut motion = Motion::new(&MotionLimits::try_from(motion_config)?);
    let mut times = Histogram::default();
    let tick_ns = (config.tick_s * 1e9) as u64;
    let mut next_ns = rt::monotonic_ns();
    let end_ns = next_ns + (config.duration_s * 1e9) as u64;
    let mut side = 1.0;
    while next_ns < end_ns {
        let now_ns = rt::monotonic_ns();
        next_ns += tick_ns;
        match stepper.sync(now_ns) {
            Sync::Ready => {}
            Sync::Restart(rest_mm) => motion.reset(rest_mm),
            Sync::Faulted(_) | Sync::Dead => break,
            Sync::Busy => {
                rt::sleep_until_ns(next_ns);
                continue;
            }
        }
        if motion.state()[0].is_rest() && motion.state()[0].position_mm.abs() > 0.5 * motion_config.travel_max_mm {
            side = -side;
        }
        let target = [side * motion_config.travel_max_mm; 3];
        let segment = motion.tick(target, config.tick_s);
        // A refused tick shows as a dry queue in the result.
        let _ = stepper.feed(&segment, now_ns);
        times.record(rt::monotonic_ns() - now_ns);
        rt::sleep_until_ns(next_ns);
    }
    Ok(times)
}

/// Threads that keep processors busy until dropped.
pub(crate) struct Load {
    stop: Arc<AtomicBool>,
    threads: Vec<std::thread::JoinHandle<()>>,
}

impl Load {
    pub(crate) fn start(threads: usize) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let work = |stop: Arc<AtomicBool>| {
            let mut block = vec![1.0_f64; 1 << 16];
            while !stop.load(Ordering::Relaxed) {
                for x in &mut block {
                    *x = (*x * 1.000_001).sin() + 1.0;
                }
                std::hint::black_box(&block);
            }
        };
        let threads = (0..threads)
            .map(|_| {
                let stop = stop.clone();
                std::thread::spawn(move || work(stop))
            })
            .collect();
        Self { stop, threads }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

impl RtBench {
    /// True when no step was so late as to be a fault and the queue never ran dry.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.fault.is_none() && self.dry == 0
    }

    /// The rows of the result.
    fn rows(&self) -> [(&'static str, &Histogram); 4] {
        [
            ("wake-up lateness", &self.wake),
            ("step lateness", &self.lateness),
            ("step interval error", &self.interval_error),
            ("plan and queue a tick", &self.tick),
        ]
    }

    /// Percentiles in µs, and what was granted, as a table.
    #[must_use]
    pub fn table(&self) -> String {
        let mut table = Table::new();
        let mut header = vec!["µs".to_string(), "mean".into()];
        header.extend(QUANTILES.iter().map(|q| q.0.to_string()));
        header.extend(["longest".into(), "count".into()]);
        table.set_header(header);
        for (name, h) in self.rows() {
            let us = |ns: f64| format!("{:.1}", ns * 1e-3);
            let mut row = vec![name.to_string(), us(h.mean_ns())];
            row.extend(QUANTILES.iter().map(|q| us(h.quantile_ns(q.1) as f64)));
            row.extend([us(h.max_ns() as f64), h.count().to_string()]);
            table.add_row(row);
        }
        for column in table.column_iter_mut().skip(1) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        let mut text = table.to_string();
        let _ = write!(
            text,
            "\n{} steps in {:.1} s on three channels ({:.0} a second), {} load threads, queue ran dry {} times",
            self.steps,
            self.elapsed_s,
            self.steps as f64 / self.elapsed_s,
            self.config.load_threads,
            self.dry
        );
        for (name, grant) in self.status.rows() {
            let _ = write!(text, "\n{name}: {grant}");
        }
        if let Some(fault) = &self.fault {
            let _ = write!(text, "\nFAULT: {fault}");
        }
        text
    }

    /// Histograms of wake-up, step lateness and interval error as one SVG drawing, with logarithmic axes.
    #[must_use]
    pub fn svg(&self) -> String {
        let charts: Vec<Chart> = self.rows()[..3].iter().map(|(name, h)| histogram(name, h, self.config.stepper.late_max_us)).collect();
        sheet("Lateness of the step thread", &charts, 3)
    }
}

/// A histogram of times; `late_max_us` is marked as the limit of a fault.
fn histogram(name: &str, h: &Histogram, late_max_us: f64) -> Chart {
    let x = |ns: f64| (ns.max(100.0) * 1e-3).log10();
    let y = |n: u32| (f64::from(n) + 1.0).log10();
    let most = h.filled().map(|b| b.2).max().unwrap_or(1).max(10);
    let outline: Vec<(f64, f64)> = h
        .filled()
        .flat_map(|(from, until, n)| [(from, 0), (from, n), (until, n), (until, 0)].map(|(ns, n)| (x(ns as f64), y(n))))
        .collect();
    let times = ["0.1 µs", "1 µs", "10 µs", "100 µs", "1 ms", "10 ms", "100 ms"];
    let counts = (0..9).map(|k| 10u32.pow(k)).take_while(|n| *n <= most);
    let limit = x(late_max_us * 1e3);
    Chart {
        title: format!("{name}, {} times", h.count()),
        x: Axis {
            label: "time".to_owned(),
            low: -1.0,
            high: 5.0,
            ticks: times.iter().enumerate().map(|(k, t)| (k as f64 - 1.0, (*t).to_owned())).collect(),
        },
        y: Axis { label: "count".to_owned(), low: 0.0, high: y(most), ticks: counts.map(|n| (y(n), n.to_string())).collect() },
        series: vec![
            Series::band(Ink::BLUE, outline.iter().map(|&(x, y)| (x, 0.0, y)).collect()),
            Series { name: None, ..Series::line("", Ink::BLUE, Stroke::Solid, outline) },
            Series::line("limit of a fault", Ink::RED, Stroke::Dashed, vec![(limit, 0.0), (limit, y(most))]),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::pins::map::LineMap;
    use crate::hardware::pins::{MockPins, PinsConfig};

    /// A short run on the mock: what is shown is what was pulsed. No time is asserted.
    #[test]
    fn shows_what_was_pulsed() {
        let stepper = StepperConfig { priority: 0, late_max_us: 100_000.0, lead_ms: 60.0, ..RtBenchConfig::default().stepper };
        let config = RtBenchConfig { rate_hz: 2000.0, duration_s: 0.4, stepper, ..RtBenchConfig::default() };
        let map = LineMap::new(&PinsConfig::default(), 16).unwrap();
        let (bench, pins) = run(&config, MockPins::new(map, 100_000)).unwrap();
        assert!(bench.steps > 300 && bench.fault.is_none(), "{}", bench.table());
        assert!(pins.record().len() as u64 > 2 * bench.steps && pins.dropped() == 0);
        let table = bench.table();
        for words in ["step lateness", "99.9 %", "SCHED_FIFO: not asked", &format!("{} steps in", bench.steps)] {
            assert!(table.contains(words), "{table}");
        }
        let svg = bench.svg();
        assert!(svg.starts_with("<svg") && svg.matches("limit of a fault").count() == 3 && !svg.contains("NaN"));
    }
}
