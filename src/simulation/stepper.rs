//! The step core in simulated time: its pulses take no time and are never late.

use crate::motion::queue::{self, Feeder, SyncStatus, TimedSegment};
use crate::motion::{DriveLimits, Segment, StepGenerator};
use crate::motion::{Inputs, PulseAction, PulseTiming, StepCore, StepperOrder, StepperReport};

/// Capacity of the queue of segments; far more than any lead.
const SEGMENTS: usize = 64;
/// Shortest time by which a wait advances the clock, ns.
const WAIT_MIN_NS: u64 = 1000;

/// A step generator without pins and threads.
#[derive(Debug)]
pub struct SimulatedStepper {
    core: StepCore,
    feeder: Feeder,
    segments: rtrb::Consumer<TimedSegment>,
    report: StepperReport,
}

impl SimulatedStepper {
    /// At rest at zero with the drivers off.
    pub fn new(motion: &DriveLimits, step_mm: f64) -> Self {
        let (feeder, segments) = queue::ring(SEGMENTS, (motion.lead_s * 1e9).round() as u64);
        let timing = PulseTiming {
            late_ns: u64::MAX / 4,
            poll_ns: u64::from(u32::MAX),
            ..PulseTiming::default()
        };
        let core = StepCore::new(timing, &motion.limits, step_mm);
        Self {
            feeder,
            segments,
            report: core.report(0),
            core,
        }
    }

    /// Makes the steps that are due before `until_ns`, which is later than all times before; returns their sum per channel.
    pub fn run(&mut self, now_ns: u64, until_ns: u64, inputs: Inputs) -> [i32; 3] {
        // one reading alone may be a disturbance
        self.core.observe(inputs);
        self.core.observe(inputs);
        let before = self.report.counted.0;
        let mut at_ns = now_ns;
        while at_ns < until_ns {
            match self.core.poll(at_ns, &mut || self.segments.pop().ok()) {
                PulseAction::Write(_) => self.core.wrote(at_ns),
                PulseAction::WaitUntil(next_ns) => at_ns = next_ns.max(at_ns + WAIT_MIN_NS),
            }
        }
        self.report = self.core.report(until_ns);
        std::array::from_fn(|i| self.report.counted.0[i].wrapping_sub(before[i]))
    }

    /// Stops at once, as after a failure of the pins.
    pub fn fail(&mut self) {
        self.core.pins_failed();
    }
}

impl StepGenerator for SimulatedStepper {
    fn sync(&mut self, now_ns: u64) -> SyncStatus {
        self.feeder.sync(&self.report, now_ns)
    }

    fn feed(&mut self, segment: &Segment, now_ns: u64) -> bool {
        self.feeder.push(segment, now_ns)
    }

    fn lead_ns(&self, now_ns: u64) -> i64 {
        self.feeder.lead_ns(now_ns)
    }

    fn order(&mut self, order: StepperOrder) -> bool {
        self.core.order(order);
        self.report = self.core.report(self.report.t_ns);
        true
    }

    fn latest(&self) -> Option<&StepperReport> {
        Some(&self.report)
    }

    fn is_energised(&self) -> bool {
        self.report.energised
    }
}
