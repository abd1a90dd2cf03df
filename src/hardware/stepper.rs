//! The step thread: a thin shell around [`StepCore`], and the loop's handle on it.
//!
//! ```text
//!  loop thread                                     step thread (SCHED_FIFO, locked memory)
//!  Motion::tick ─▶ Segment ─▶ Stepper::feed ═ring═▶ StepCore::poll ─▶ Pins::write / wait
//!  Stepper::order ════════════════════════════ring═▶ StepCore::order
//!  Stepper::sync ◀═ring════════════════════════════ Report
//! ```
//!
//! Three wait-free rings join the threads; neither ever waits for the other. The shell decides
//! nothing: it reads the clock, asks the core, writes pins, waits. So the whole behaviour is tested
//! on the core with a clock of the test's own, and this file only with real time.

use crate::hardware::pins::{PinError, Pins};
use crate::hardware::rt::{self, Clock, Monotonic, RtRequest, RtStatus};
use crate::motion::config::{ConfigError, MotionConfig, StepperConfig};
use crate::motion::histogram::Histogram;
use crate::motion::limits::MotionLimits;
use crate::motion::lines::{Levels, PulseTiming};
use crate::motion::pulse::{PulseAction, StepCore};
use crate::motion::queue::{self, FeedError, Feeder, TimedSegment};
use crate::motion::report::{StepperFault, StepperMode, StepperOrder, StepperReport};
use crate::motion::segment::Segment;
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

/// Segments the ring holds: at 1 kHz a quarter of a second.
const SEGMENTS: usize = 256;
/// Orders the ring holds.
const ORDERS: usize = 32;
/// Reports the ring holds.
const REPORTS: usize = 64;
/// A report is sent this often while something changes, ns …
const REPORT_NS: u64 = 1_000_000;
/// … and this often anyhow.
const HEARTBEAT_NS: u64 = 100_000_000;
/// EN may take this long to reach its level, ns.
const ENABLE_SETTLES_NS: u64 = 500_000;

/// Why the step thread could not be started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A value of the configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The operating system gave no thread.
    #[error("the step thread could not be started: {0}")]
    Thread(#[from] std::io::Error),
    /// The thread died before it could say what it was granted.
    #[error("the step thread died as it started")]
    Died,
}

/// What the step thread has done, told at its end.
#[derive(Debug)]
pub struct Summary {
    /// Its last report.
    pub report: StepperReport,
    /// From the time a wait should have ended to the clock reading after it.
    pub wake: Histogram,
    /// How far intervals between steps were off.
    pub interval_error: Histogram,
    /// What the pins said when they failed.
    pub pin_error: Option<PinError>,
}

/// The shell: everything the thread owns.
#[derive(Debug)]
pub struct Shell<P, C> {
    core: StepCore,
    pins: P,
    clock: C,
    segments: rtrb::Consumer<TimedSegment>,
    orders: rtrb::Consumer<StepperOrder>,
    reports: rtrb::Producer<StepperReport>,
    input_period_ns: u64,
    next_input_ns: u64,
    last_report: Option<(u64, Key)>,
    wake: Histogram,
    pin_error: Option<PinError>,
    words: Arc<OnceLock<String>>,
    enabled: bool,
}

/// What makes a report worth sending before the heartbeat.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Key {
    mode: StepperMode,
    epoch: u32,
    counted: [i32; 3],
    energised: bool,
    inputs: crate::motion::lines::Inputs,
}

impl<P: Pins, C: Clock> Shell<P, C> {
    /// One round: orders, inputs, one action of the core. False when there is nothing left to do.
    pub fn turn(&mut self) -> bool {
        let now_ns = self.clock.now_ns();
        while let Ok(order) = self.orders.pop() {
            self.core.order(order);
        }
        if self.orders.is_abandoned() {
            // The loop is gone without a word: as if it had said goodbye.
            self.core.order(StepperOrder::Finish);
        }
        if now_ns >= self.next_input_ns {
            self.next_input_ns = now_ns + self.input_period_ns;
            match self.pins.read() {
                Ok(inputs) => self.core.observe(inputs),
                Err(error) => self.pins_failed(error),
            }
        }
        match self.core.poll(now_ns, &mut self.segments) {
            PulseAction::Write(levels) => match self.write(&levels) {
                Ok(()) => self.core.wrote(self.clock.now_ns()),
                Err(error) => self.pins_failed(error),
            },
            PulseAction::WaitUntil(until_ns) => {
                self.report(now_ns);
                if self.core.is_finished() {
                    return false;
                }
                self.clock.wait_until(until_ns);
                self.wake.record(self.clock.now_ns().saturating_sub(until_ns));
            }
        }
        true
    }

    /// Rounds until finished; the summary and the pins at the end.
    pub fn run(mut self) -> (Summary, P) {
        while self.turn() {}
        let report = self.core.report(self.clock.now_ns());
        let interval_error = *self.core.interval_error();
        (Summary { report, wake: self.wake, interval_error, pin_error: self.pin_error }, self.pins)
    }

    /// Writes, and after EN was switched makes sure that it followed.
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        self.pins.write(levels)?;
        if levels.enable == self.enabled {
            return Ok(());
        }
        self.enabled = levels.enable;
        let give_up_ns = self.clock.now_ns() + ENABLE_SETTLES_NS;
        loop {
            match self.pins.check_enable() {
                Err(PinError::EnableStuck { .. }) if self.clock.now_ns() < give_up_ns => std::hint::spin_loop(),
                verdict => return verdict,
            }
        }
    }

    fn pins_failed(&mut self, error: PinError) {
        self.core.pins_failed();
        // only the first failure is told; later ones follow from it
        let _ = self.words.set(error.to_string());
        self.pin_error.get_or_insert(error);
    }

    /// Sends a report when one is due. A full ring loses it: the next one says the same and more.
    fn report(&mut self, now_ns: u64) {
        let due = match &self.last_report {
            None => true,
            Some((t_ns, _)) if now_ns < t_ns + REPORT_NS => false,
            Some((t_ns, _)) if now_ns >= t_ns + HEARTBEAT_NS => true,
            Some((_, key)) => *key != self.key(),
        };
        if due && self.reports.push(self.core.report(now_ns)).is_ok() {
            self.last_report = Some((now_ns, self.key()));
        }
    }

    fn key(&self) -> Key {
        Key {
            mode: self.core.mode(),
            epoch: self.core.epoch(),
            counted: self.core.counted().0,
            energised: self.core.is_energised(),
            inputs: self.core.inputs(),
        }
    }
}

/// What the loop has to know before it plans the next tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sync {
    /// Feed on.
    Ready,
    /// Motion was broken off and the pistons rest here (mm): reset the motion to it, then feed on.
    Restart([f64; 3]),
    /// Braking: feed nothing yet.
    Busy,
    /// At a fault: feed nothing until it is cleared.
    Faulted(StepperFault),
    /// The thread is gone.
    Dead,
}

/// The loop's handle on the step thread.
#[derive(Debug)]
pub struct Stepper<P> {
    feeder: Feeder,
    orders: rtrb::Producer<StepperOrder>,
    reports: rtrb::Consumer<StepperReport>,
    latest: Option<StepperReport>,
    status: RtStatus,
    words: Arc<OnceLock<String>>,
    energised: bool,
    thread: Option<JoinHandle<(Summary, P)>>,
}

impl<P: Pins + 'static> Stepper<P> {
    /// Starts the thread. It owns the pins until [`Stepper::finish`].
    ///
    /// # Errors
    /// [`StartError`].
    pub fn start(pins: P, config: &StepperConfig, motion: &MotionConfig, step_mm: f64) -> Result<Self, StartError> {
        let timing = PulseTiming::try_from(config)?;
        config.validate_rate(motion, step_mm)?;
        let limits = MotionLimits::try_from(motion)?;
        let (feeder, segments) = queue::ring(SEGMENTS, (config.lead_ms * 1e6) as u64);
        let (orders, orders_out) = rtrb::RingBuffer::new(ORDERS);
        let (reports_in, reports) = rtrb::RingBuffer::new(REPORTS);
        let words = Arc::new(OnceLock::new());
        let energised = pins.found_energised();
        let core = StepCore::new(timing, &limits, step_mm);
        let shell = Shell {
            core: if energised { core.found_energised(rt::monotonic_ns()) } else { core },
            pins,
            clock: Monotonic { spin_ns: (config.spin_us * 1e3) as u64 },
            segments,
            orders: orders_out,
            reports: reports_in,
            input_period_ns: timing.poll_ns,
            next_input_ns: 0,
            last_report: None,
            wake: Histogram::default(),
            pin_error: None,
            words: words.clone(),
            enabled: energised,
        };
        let wish = RtRequest { priority: config.priority, cpu: config.cpu };
        let (tell, told) = std::sync::mpsc::channel();
        let thread = std::thread::Builder::new().name("steps".into()).spawn(move || {
            let (status, _guard) = rt::enter(&wish);
            // The starter may have given up waiting; that is no reason to stop here.
            let _ = tell.send(status);
            shell.run()
        })?;
        let status = told.recv().map_err(|_| StartError::Died)?;
        Ok(Self { feeder, orders, reports, latest: None, status, words, energised, thread: Some(thread) })
    }

    /// Ends the thread: brakes within the limits, releases the drivers. Gives back the pins.
    ///
    /// `None` if the thread has panicked.
    #[must_use]
    pub fn finish(mut self) -> Option<(Summary, P)> {
        self.join()
    }
}

impl<P> Stepper<P> {
    /// The drivers are energised, as the thread reported last; before its first report, as they were found.
    #[must_use]
    pub fn is_energised(&self) -> bool {
        self.latest.as_ref().map_or(self.energised, |r| r.energised)
    }

    /// Takes in the thread's reports and says what the loop is to do.
    pub fn sync(&mut self, now_ns: u64) -> Sync {
        while let Ok(report) = self.reports.pop() {
            self.latest = Some(report);
        }
        if self.reports.is_abandoned() {
            return Sync::Dead;
        }
        let Some(report) = &self.latest else { return Sync::Busy };
        match report.mode {
            StepperMode::Faulted(fault) => Sync::Faulted(fault),
            _ if self.feeder.epoch() == Some(report.epoch) => Sync::Ready,
            StepperMode::Resting => {
                self.feeder.begin(report.epoch, now_ns);
                Sync::Restart(report.rest_mm)
            }
            StepperMode::Following | StepperMode::Stopping => Sync::Busy,
        }
    }

    /// Queues the motion of the next tick.
    ///
    /// # Errors
    /// [`FeedError`]; nothing was queued.
    pub fn feed(&mut self, segment: &Segment, now_ns: u64) -> Result<(), FeedError> {
        self.feeder.push(segment, now_ns)
    }

    /// How far queued motion reaches ahead, ns.
    #[must_use]
    pub fn lead_ns(&self, now_ns: u64) -> i64 {
        self.feeder.lead_ns(now_ns)
    }

    /// Gives an order past the queue of segments. False when 32 orders are waiting already.
    #[must_use]
    pub fn order(&mut self, order: StepperOrder) -> bool {
        self.orders.push(order).is_ok()
    }

    /// The report [`Stepper::sync`] took in last; `None` before the first.
    #[must_use]
    pub fn latest(&self) -> Option<&StepperReport> {
        self.latest.as_ref()
    }

    /// What the pins said when they first failed.
    #[must_use]
    pub fn pin_words(&self) -> Option<&str> {
        self.words.get().map(String::as_str)
    }

    /// What the kernel granted the thread.
    #[must_use]
    pub fn status(&self) -> &RtStatus {
        &self.status
    }

    fn join(&mut self) -> Option<(Summary, P)> {
        // If the ring of orders is full, dropping it (by the caller) still ends the thread.
        while self.orders.push(StepperOrder::Finish).is_err() && !self.orders.is_abandoned() {
            std::thread::yield_now();
        }
        self.thread.take()?.join().ok()
    }
}

impl<P> Drop for Stepper<P> {
    /// As [`Stepper::finish`], with nobody to hear the summary.
    fn drop(&mut self) {
        let _ = self.join();
    }
}
