//! Any [`World`] as a [`Machine`].
//!
//! The path from the requested counts to the steps is that of the hardware: the same [`Drive`] with the same limits, lead,
//! queue and step core. What is left out: the pulses take no time and are never late, the loop takes no time between a
//! sample and its request, and the queue does not run empty when the loop is late. A world takes the counts that are made
//! by the end of each period.

use crate::motion::queue::{self, Feeder, TimedSegment};
use crate::motion::{
    Drive, DriveLimits, DriveState, Inputs, Machine, MachineError, MachineInfo, PulseAction,
    PulseTiming, Sensed, StepCore, StepGenerator, StepperOrder, StepperReport,
};
use crate::primitives::{ImuReading, Seconds, Steps};
use crate::simulation::world::World;

/// Largest number of periods that the world advances in one cycle of a late loop.
const CATCH_UP_MAX: u64 = 2000;

/// Any [`World`] as a machine.
#[derive(Debug)]
pub struct Lockstep<W> {
    /// The world.
    pub world: W,
    /// The input lines.
    pub inputs: Inputs,
    drive: Drive<SimulatedStepper>,
    period_ns: u64,
    /// Time that the world has reached, ns.
    reached_ns: u64,
    /// Steps made, from the zero of the world, whatever the drive was told to count.
    made: Steps,
}

impl<W: World> Lockstep<W> {
    /// A world at rest with its drivers off. Motion is queued for at least one period.
    pub fn new(world: W, motion: &DriveLimits) -> Self {
        let (period_s, step_mm) = (world.info().period_s, world.info().step_mm);
        let motion = DriveLimits {
            lead_s: motion.lead_s.max(period_s),
            ..*motion
        };
        let stepper = SimulatedStepper::new(&motion, step_mm);
        Self {
            world,
            inputs: Inputs::default(),
            drive: Drive::new(stepper, &motion, step_mm, period_s),
            period_ns: ((period_s * 1e9).round() as u64).max(1),
            reached_ns: 0,
            made: Steps::default(),
        }
    }

    /// The step generator stops at once, until [`Machine::clear`].
    pub fn fail(&mut self) {
        self.drive.generator_mut().fail();
    }
}

impl<W: World> Machine for Lockstep<W> {
    fn info(&self) -> &MachineInfo {
        self.world.info()
    }

    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        let late_ns = (now.0 * 1e9 - self.reached_ns as f64).max(0.0);
        let periods = ((late_ns / self.period_ns as f64).round() as u64).min(CATCH_UP_MAX);
        let (mut imu, mut base_imu, mut truth) = (ImuReading::Nothing, None, None);
        for _ in 0..periods {
            // a simulated step generator waits for a late loop
            self.drive.update(self.reached_ns, wanted);
            let from_ns = self.reached_ns;
            self.reached_ns += self.period_ns;
            let stepper = self.drive.generator_mut();
            let made = stepper.run(from_ns, self.reached_ns, self.inputs);
            for (sum, made) in self.made.0.iter_mut().zip(made) {
                *sum = sum.wrapping_add(made);
            }
            let reply = self.world.step(&self.made)?;
            if let Some(sample) = reply.imu {
                imu = ImuReading::from_world(Some(sample));
            }
            base_imu = reply.base_imu.or(base_imu);
            truth = reply.truth;
        }
        Ok(Sensed {
            imu,
            base_imu,
            truth,
            ..Sensed::of_drive(now, self.reached_ns, &self.drive)
        })
    }

    fn energise(&mut self, on: bool) {
        self.drive.energise(on);
    }

    fn recount(&mut self, counted: &Steps) {
        self.drive.rebase(counted);
    }

    fn clear(&mut self) {
        self.drive.clear();
    }

    fn is_simulated(&self) -> bool {
        true
    }

    fn remarks(&self) -> Vec<String> {
        vec![format!("plant {}", self.world.info().name)]
    }
}

/// Capacity of the queue of segments; far more than any lead.
const SEGMENTS: usize = 64;
/// Shortest time by which a wait advances the clock, ns.
const WAIT_MIN_NS: u64 = 1000;

/// The step core in simulated time: a step generator without pins and threads.
#[derive(Debug)]
struct SimulatedStepper {
    core: StepCore,
    feeder: Feeder,
    segments: rtrb::Consumer<TimedSegment>,
    report: StepperReport,
}

impl SimulatedStepper {
    /// At rest at zero with the drivers off.
    fn new(motion: &DriveLimits, step_mm: f64) -> Self {
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
    fn run(&mut self, now_ns: u64, until_ns: u64, inputs: Inputs) -> [i32; 3] {
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
    fn fail(&mut self) {
        self.core.pins_failed();
    }
}

impl StepGenerator for SimulatedStepper {
    fn sync(&mut self, now_ns: u64) -> Result<Option<[f64; 3]>, DriveState> {
        self.feeder.sync(&self.report, now_ns)
    }

    fn feeder(&mut self) -> &mut Feeder {
        &mut self.feeder
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
