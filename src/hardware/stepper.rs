//! The step thread, a thin shell around [`StepCore`], and the loop's handle on it.
//!
//! ```text
//!  loop thread                                     step thread (SCHED_FIFO, locked memory)
//!  Motion::tick ─▶ Segment ─▶ Feeder::push  ═ring═▶ StepCore::poll ─▶ Pins::write / wait
//!  Stepper::order ════════════════════════════ring═▶ StepCore::order
//!  Stepper::sync ◀═ring════════════════════════════ StepperReport
//! ```
//!
//! Three wait-free rings join the threads; neither thread waits for the other. The shell makes no
//! decisions: it reads the clock, polls the core, writes pins and waits. The tests therefore cover the
//! behaviour on the core with a simulated clock, and only this file with real time.

use crate::hardware::pins::{PinError, Pins};
use crate::hardware::rt::{self, RtRequest, RtStatus, monotonic_ns};
use crate::motion::queue::{self, Feeder, TimedSegment};
use crate::motion::{
    DriveState, EmergencyStop, Histogram, Levels, MotionLimits, PulseAction, StepCore,
    StepGenerator, StepperConfig, StepperOrder, StepperReport,
};
use crate::primitives::Invalid;
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

/// Capacity of the ring of segments: a quarter of a second at 1 kHz.
const SEGMENTS: usize = 256;
/// Capacity of the ring of orders.
const ORDERS: usize = 32;
/// Capacity of the ring of reports.
const REPORTS: usize = 64;
/// Least time between two reports while something changes, ns.
const REPORT_NS: u64 = 1_000_000;
/// Longest time between two reports, ns.
const HEARTBEAT_NS: u64 = 100_000_000;
/// A thread that has not reported for this long hangs, ns.
const SILENT_NS: u64 = 3 * HEARTBEAT_NS;
/// Time for EN to reach its level, ns.
const ENABLE_SETTLES_NS: u64 = 500_000;

/// Why the step thread could not be started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The configuration is invalid.
    #[error(transparent)]
    Config(#[from] Invalid),
    /// The operating system created no thread.
    #[error("the step thread could not be started: {0}")]
    Thread(#[from] std::io::Error),
    /// The thread ended before it reported its real-time settings.
    #[error("the step thread ended as it started")]
    Died,
}

/// The results of the step thread at its end.
#[derive(Debug)]
pub struct Summary {
    /// Its last report.
    pub report: StepperReport,
    /// Time from the end of each wait to the clock reading after it.
    pub wake: Histogram,
    /// Deviation of intervals between steps.
    pub interval_error: Histogram,
}

/// The state of the thread.
#[derive(Debug)]
struct Shell<P> {
    core: StepCore,
    pins: P,
    spin_ns: u64,
    segments: rtrb::Consumer<TimedSegment>,
    orders: rtrb::Consumer<StepperOrder>,
    reports: rtrb::Producer<StepperReport>,
    input_period_ns: u64,
    next_input_ns: u64,
    last_report: Option<StepperReport>,
    wake: Histogram,
    pin_error_text: Arc<OnceLock<String>>,
    enabled: bool,
}

impl<P: Pins> Shell<P> {
    /// Repeats [`Shell::run_once`] until the core has finished.
    fn run(mut self) -> Summary {
        while self.run_once() {}
        Summary {
            report: self.core.report(monotonic_ns()),
            wake: self.wake,
            interval_error: self.core.interval_error,
        }
    }

    /// One cycle: orders, inputs and one action of the core. Returns false when the core has finished.
    fn run_once(&mut self) -> bool {
        let now_ns = monotonic_ns();
        while let Ok(order) = self.orders.pop() {
            self.core.order(order);
        }
        if self.orders.is_abandoned() {
            // The loop has dropped its handle.
            self.core.order(StepperOrder::Finish);
        }
        if now_ns >= self.next_input_ns {
            self.next_input_ns = now_ns + self.input_period_ns;
            match self.pins.read() {
                Ok(inputs) => self.core.observe(inputs),
                Err(error) => self.pins_failed(&error),
            }
        }
        match self.core.poll(now_ns, &mut || self.segments.pop().ok()) {
            PulseAction::Write(levels) => match self.write(&levels) {
                Ok(()) => self.core.wrote(monotonic_ns()),
                Err(error) => self.pins_failed(&error),
            },
            PulseAction::WaitUntil(until_ns) => {
                self.report(now_ns);
                if self.core.is_finished() {
                    return false;
                }
                rt::wait_until_ns(until_ns, self.spin_ns);
                self.wake.record(monotonic_ns().saturating_sub(until_ns));
            }
        }
        true
    }

    /// Writes the levels, and after a change of EN checks that the line follows.
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        self.pins.write(levels)?;
        if levels.enable == self.enabled {
            return Ok(());
        }
        self.enabled = levels.enable;
        let give_up_ns = monotonic_ns() + ENABLE_SETTLES_NS;
        loop {
            match self.pins.check_enable() {
                Err(PinError::EnableStuck { .. }) if monotonic_ns() < give_up_ns => {
                    std::hint::spin_loop()
                }
                result => return result,
            }
        }
    }

    /// Keeps the first failure; later ones follow from it.
    fn pins_failed(&mut self, error: &PinError) {
        self.core.pins_failed();
        let _ = self.pin_error_text.set(error.to_string());
    }

    /// Sends a report if one is due. If the ring is full, the report is lost; the next one replaces it.
    fn report(&mut self, now_ns: u64) {
        let last = self.last_report.as_ref();
        let age_ns = last.map_or(u64::MAX, |last| now_ns.saturating_sub(last.t_ns));
        if age_ns < REPORT_NS {
            return;
        }
        let report = self.core.report(now_ns);
        let changed = last.is_none_or(|last| report.differs_from(last));
        if (changed || age_ns >= HEARTBEAT_NS) && self.reports.push(report).is_ok() {
            self.last_report = Some(report);
        }
    }
}

/// The loop's handle on the step thread.
#[derive(Debug)]
pub struct Stepper {
    feeder: Feeder,
    orders: rtrb::Producer<StepperOrder>,
    reports: rtrb::Consumer<StepperReport>,
    latest: Option<StepperReport>,
    /// What the kernel granted to the thread.
    pub status: RtStatus,
    pin_error_text: Arc<OnceLock<String>>,
    energised: bool,
    started_ns: u64,
    thread: Option<JoinHandle<Summary>>,
}

impl Stepper {
    /// Starts the thread, which owns the pins.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn start(
        pins: impl Pins + 'static,
        config: &StepperConfig,
        motion: &MotionLimits,
        step_mm: f64,
        emergency_stop: EmergencyStop,
    ) -> Result<Self, StartError> {
        let timing = config.timing(emergency_stop)?;
        config.validate_rate(motion, step_mm)?;
        motion.validate()?;
        let (feeder, segments) = queue::ring(SEGMENTS, (config.lead_ms * 1e6) as u64);
        let (orders, orders_out) = rtrb::RingBuffer::new(ORDERS);
        let (reports_in, reports) = rtrb::RingBuffer::new(REPORTS);
        let pin_error_text = Arc::new(OnceLock::new());
        let energised = pins.found_energised();
        let mut core = StepCore::new(timing, motion, step_mm);
        if energised {
            core = core.found_energised(monotonic_ns());
        }
        let shell = Shell {
            core,
            pins,
            spin_ns: (config.spin_us * 1e3) as u64,
            segments,
            orders: orders_out,
            reports: reports_in,
            input_period_ns: timing.poll_ns,
            next_input_ns: 0,
            last_report: None,
            wake: Histogram::default(),
            pin_error_text: pin_error_text.clone(),
            enabled: energised,
        };
        let request = RtRequest {
            priority: config.priority,
            cpu: config.cpu,
        };
        let (thread, status) = rt::start("steps", request, move || shell.run())?;
        Ok(Self {
            feeder,
            orders,
            reports,
            latest: None,
            status,
            pin_error_text,
            energised,
            started_ns: monotonic_ns(),
            thread: Some(thread),
        })
    }

    /// Brakes within the limits, releases the drivers, ends the thread and returns its results; `None` if the thread has
    /// panicked.
    pub fn finish(mut self) -> Option<Summary> {
        self.join()
    }

    /// The message of the first failure of the pins.
    pub fn pin_error(&self) -> Option<&str> {
        self.pin_error_text.get().map(String::as_str)
    }

    fn join(&mut self) -> Option<Summary> {
        // A full ring of orders is retried until the thread has taken one, or has ended.
        while self.orders.push(StepperOrder::Finish).is_err() && !self.orders.is_abandoned() {
            std::thread::yield_now();
        }
        self.thread.take()?.join().ok()
    }
}

impl StepGenerator for Stepper {
    fn sync(&mut self, now_ns: u64) -> Result<Option<[f64; 3]>, DriveState> {
        while let Ok(report) = self.reports.pop() {
            self.latest = Some(report);
        }
        if self.reports.is_abandoned() {
            return Err(DriveState::Dead);
        }
        let latest = self.latest.as_ref();
        let heard_ns = latest.map_or(self.started_ns, |report| report.t_ns);
        if now_ns.saturating_sub(heard_ns) > SILENT_NS {
            return Err(DriveState::Silent);
        }
        let report = latest.ok_or(DriveState::Busy)?;
        self.feeder.sync(report, now_ns)
    }

    fn feeder(&mut self) -> &mut Feeder {
        &mut self.feeder
    }

    fn order(&mut self, order: StepperOrder) -> bool {
        self.orders.push(order).is_ok()
    }

    fn latest(&self) -> Option<&StepperReport> {
        self.latest.as_ref()
    }

    fn is_energised(&self) -> bool {
        self.latest.as_ref().map_or(self.energised, |r| r.energised)
    }
}

impl Drop for Stepper {
    /// As [`Stepper::finish`], without the results.
    fn drop(&mut self) {
        let _ = self.join();
    }
}
