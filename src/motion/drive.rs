//! The loop's side of motion: takes piston targets, feeds segments to a step generator and returns counts.
//!
//! Every update tops the queue up to its lead. A loop that is late once catches up at the next update; a loop that has
//! stopped leaves the step generator to brake. Hardware and simulation run the same drive: there the step generator is a
//! thread with pins, here the step core alone in simulated time.

use crate::motion::queue::Feeder;
use crate::motion::{
    DriveState, Motion, MotionLimits, MotionState, StepperFault, StepperMode, StepperOrder,
    StepperReport,
};
use crate::primitives::Steps;

/// Most segments queued in one update.
const TOP_UP_MAX: u32 = 16;
/// A single underrun is braked within the limits and motion resumes: no step is lost and no action is needed. This number
/// of underruns …
const UNDERRUNS: usize = 4;
/// … within this time, ns, is an alarm.
const UNDERRUNS_WITHIN_NS: u64 = 5_000_000_000;

/// Limits of motion, and how far it is planned ahead of the clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveLimits {
    /// Limits of each channel.
    pub limits: MotionLimits,
    /// Time by which motion is queued ahead of the clock, s.
    pub lead_s: f64,
}

impl DriveLimits {
    /// The longest way of a piston from the counted position to rest, mm: through the queued motion and the longest stop.
    pub fn braking_mm(&self) -> f64 {
        self.limits.speed_max_mm_s * self.lead_s + self.limits.longest_stop_mm()
    }

    /// Time from an order to brake until the mean of the deceleration begins, s: the queued motion and half the time in
    /// which the jerk limit builds the deceleration up.
    pub fn react_s(&self) -> f64 {
        self.lead_s + self.limits.acceleration_max_mm_s2 / (2.0 * self.limits.jerk_max_mm_s3)
    }

    /// Longest time for which a motion towards a count of the present shows in no step of `step_mm`, s: the queued motion, and
    /// half a step to and fro, each from rest by the limit of the jerk (d = j t³/6) and then of the acceleration (d = a t²/2).
    pub fn rest_s(&self, step_mm: f64) -> f64 {
        let l = &self.limits;
        let (a, j) = (l.acceleration_max_mm_s2, l.jerk_max_mm_s3);
        let half_step_s = (3.0 * step_mm / j).cbrt() + (step_mm / a).sqrt();
        self.lead_s + 2.0 * half_step_s
    }
}

/// What a drive needs of a step generator: a queue of segments, orders and reports.
pub trait StepGenerator {
    /// Reads the reports and returns what the drive must do before the next segment, as [`Feeder::sync`].
    ///
    /// # Errors
    /// The state of a drive that must feed nothing.
    fn sync(&mut self, now_ns: u64) -> Result<Option<[f64; 3]>, DriveState>;

    /// The queue of segments.
    fn feeder(&mut self) -> &mut Feeder;

    /// Sends an order that bypasses the queue of segments. Returns false if too many orders are waiting.
    fn order(&mut self, order: StepperOrder) -> bool;

    /// The last report; `None` before the first.
    fn latest(&self) -> Option<&StepperReport>;

    /// Whether the drivers are energised, by the last report; before the first one, as they were found.
    fn is_energised(&self) -> bool;
}

/// Motion and a step generator.
#[derive(Debug)]
pub struct Drive<G> {
    generator: G,
    motion: Motion,
    period_s: f64,
    lead_ns: i64,
    step_mm: f64,
    on: bool,
    /// The drivers were found energised and no order has changed that.
    keeps: bool,
    /// Positions to declare, mm, and, once that is ordered, the epoch before the order.
    rebase: Option<([f64; 3], Option<u32>)>,
    state: DriveState,
    /// The emergency stop has just stopped the step generator.
    pub stopped: bool,
    /// Number of underruns, and the times of the last ones, ns, newest last.
    underruns: u32,
    underran_ns: [Option<u64>; UNDERRUNS],
    /// The queue ran empty during motion several times in close succession, until [`Drive::clear`].
    pub starved: bool,
}

impl<G: StepGenerator> Drive<G> {
    /// A drive with the drivers off and the pistons at zero. `period_s` is the period of the updates.
    pub fn new(generator: G, config: &DriveLimits, step_mm: f64, period_s: f64) -> Self {
        Self {
            keeps: generator.is_energised(),
            generator,
            motion: Motion::new(&config.limits),
            period_s,
            lead_ns: (config.lead_s * 1e9).round() as i64,
            step_mm,
            on: false,
            rebase: None,
            state: DriveState::Off,
            stopped: false,
            underruns: 0,
            underran_ns: [None; UNDERRUNS],
            starved: false,
        }
    }

    /// Reads the reports of the step generator and queues motion towards the counts `wanted`.
    pub fn update(&mut self, now_ns: u64, wanted: &Steps) {
        let target_mm = wanted.0.map(|n| f64::from(n) * self.step_mm);
        let before = self.state;
        self.state = match self.generator.sync(now_ns) {
            Err(state) => state,
            Ok(restart) => {
                if let Some(rest_mm) = restart {
                    self.motion.reset(rest_mm);
                }
                self.feed(now_ns, target_mm)
            }
        };
        self.stopped =
            self.state == DriveState::Faulted(StepperFault::EmergencyStop) && self.state != before;
        self.watch_underruns(now_ns);
    }

    fn feed(&mut self, now_ns: u64, target_mm: [f64; 3]) -> DriveState {
        let pausing = !self.on || self.rebase.is_some();
        if pausing && self.motion.state().iter().all(MotionState::is_rest) {
            // Nothing more is queued; when the queue is empty, the step generator rests.
            return self.pause();
        }
        for _ in 0..TOP_UP_MAX {
            if self.generator.feeder().lead_ns(now_ns) >= self.lead_ns {
                break;
            }
            let segment = if pausing {
                self.motion.brake(self.period_s)
            } else {
                self.motion.tick(target_mm, self.period_s)
            };
            if !self.generator.feeder().push(&segment, now_ns) {
                // A full ring means that the thread is stuck; its lateness will be a fault.
                return DriveState::Busy;
            }
        }
        if pausing {
            DriveState::Busy
        } else {
            DriveState::Ready
        }
    }

    /// Sends the orders that are valid only at rest.
    fn pause(&mut self) -> DriveState {
        let resting = |r: &&StepperReport| r.mode == StepperMode::Resting;
        let report = self.generator.latest().filter(resting);
        let Some((epoch, energised)) = report.map(|r| (r.epoch, r.energised)) else {
            return DriveState::Busy;
        };
        match self.rebase {
            Some((position_mm, None)) => {
                let ordered = self.generator.order(StepperOrder::Rebase(position_mm));
                self.rebase = Some((position_mm, ordered.then_some(epoch)));
            }
            Some((_, Some(before))) if before != epoch => self.rebase = None,
            Some(_) => {}
            // If the ring of orders is full, the next update tries again.
            None if energised && !self.keeps => {
                let _ = self.generator.order(StepperOrder::Release);
            }
            None if energised => {}
            None => return DriveState::Off,
        }
        DriveState::Busy
    }

    /// Raises the alarm when underruns follow one another closely.
    fn watch_underruns(&mut self, now_ns: u64) {
        let underruns = self.generator.latest().map_or(0, |report| report.underruns);
        if underruns > self.underruns {
            self.underruns = underruns;
            self.underran_ns.rotate_left(1);
            self.underran_ns[UNDERRUNS - 1] = Some(now_ns);
            self.starved |=
                self.underran_ns[0].is_some_and(|first_ns| now_ns - first_ns < UNDERRUNS_WITHIN_NS);
        }
    }

    /// Switches the drivers on at once, or off when the pistons rest.
    pub fn energise(&mut self, on: bool) {
        self.keeps = false;
        if on && !self.on {
            let _ = self.generator.order(StepperOrder::Energise);
        }
        self.on = on;
        if !on && matches!(self.state, DriveState::Faulted(_)) {
            let _ = self.generator.order(StepperOrder::Release);
        }
    }

    /// Declares the counts of the pistons as soon as they rest.
    pub fn rebase(&mut self, counted: &Steps) {
        self.rebase = Some((counted.0.map(|n| f64::from(n) * self.step_mm), None));
    }

    /// Leaves a fault whose cause has gone.
    pub fn clear(&mut self) {
        self.starved = false;
        let _ = self.generator.order(StepperOrder::Clear);
        if self.on {
            let _ = self.generator.order(StepperOrder::Energise);
        }
    }

    /// The state after the last update.
    pub fn state(&self) -> DriveState {
        self.state
    }

    /// The step generator.
    pub fn generator(&self) -> &G {
        &self.generator
    }

    /// The step generator, to run it in simulated time.
    pub fn generator_mut(&mut self) -> &mut G {
        &mut self.generator
    }
}
