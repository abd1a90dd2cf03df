//! A pilot on a built-in plant that can be broken at its sensor, its lines and its clock.

use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::supervisor::assemble;
use crate::control::tick::{Command, RestartState};
use crate::estimation::fusion::health::{ImuReading, ReadFault as BusFault};
use crate::model::bend::Bend;
use crate::motion::lines::Inputs;
use crate::primitives::frames::{Base, Rotation, Tip};
use crate::primitives::units::{Mm, Seconds, Steps};
use crate::simulation::lockstep::Lockstep;
use crate::simulation::plant::{Channel, InjectedFault, PlantError};
use crate::simulation::sim::Sim;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::cycle::runner::Runner;
use crate::supervisor::cycle::{CycleOutput, Supervisor, SupervisorConfig};
use crate::supervisor::machine::{Alarm, Machine, Sensed};
use crate::supervisor::machine::{MachineError, MachineInfo};

/// A machine that can be broken from outside its plant.
#[derive(Debug)]
pub struct Breakable {
    inner: Lockstep<Sim>,
    /// Every transfer fails like this.
    pub bus: Option<BusFault>,
    /// Stamps of samples are off by so much, s.
    pub stamps_off_s: f64,
    /// The emergency stop is pressed.
    pub pressed: bool,
    /// The step thread complains, and stands where it is until the alarm is taken back.
    pub alarm: Option<Alarm>,
    stands_at: Steps,
}

impl Breakable {
    /// Nothing is broken yet.
    #[must_use]
    pub fn new(sim: Sim) -> Self {
        Self { inner: Lockstep::new(sim), bus: None, stamps_off_s: 0.0, pressed: false, alarm: None, stands_at: Steps::default() }
    }

    /// Breaks something in the plant.
    pub fn inject(&mut self, fault: InjectedFault) {
        self.inner.world.plant_mut().inject(fault);
    }

    /// Puts the racks back to their marks by hand and vents the lines, with the pistons at rest: steps and air that
    /// were lost are made up for.
    pub fn put_back(&mut self) {
        self.inner.world.plant_mut().vent();
        let step_mm = self.info().step_mm;
        let Some(play_output_mm) = self.inner.world.last().map(|out| out.truth.play_output_mm) else { return };
        for channel in Channel::ALL {
            let microsteps = (play_output_mm[channel.index()] / step_mm).round() as i32;
            self.inject(InjectedFault::StepLoss { channel, microsteps });
        }
    }

    /// Mends everything; consequences stay.
    pub fn mend(&mut self) {
        self.inner.world.plant_mut().clear();
        (self.bus, self.stamps_off_s, self.pressed) = (None, 0.0, false);
    }
}

impl Machine for Breakable {
    fn info(&self) -> &MachineInfo {
        self.inner.info()
    }
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        let wanted = if self.alarm.is_some() { self.stands_at } else { *wanted };
        let mut sensed = self.inner.turn(now, &wanted)?;
        self.stands_at = sensed.counted;
        if let (Some(fault), ImuReading::Sample(..)) = (self.bus, sensed.imu) {
            sensed.imu = ImuReading::Failed(fault);
        }
        if let ImuReading::Sample(sample, quality) = &mut sensed.imu {
            sample.t.0 += self.stamps_off_s;
            // as a driver sees it in the counts
            let chip = &self.inner.world.unit().imu;
            quality.gyro_load = sample.gyro_rad_s.amax().to_degrees() / chip.gyro_range_deg_s;
            quality.acc_load = sample.acc_m_s2.amax() / (chip.acc_range_g * 9.80665);
        }
        sensed.inputs = Inputs { emergency_stop: self.pressed, ..sensed.inputs };
        sensed.alarm = self.alarm;
        Ok(sensed)
    }
    fn energise(&mut self, on: bool) {
        self.inner.energise(on);
    }
    fn recount(&mut self, counted: &Steps) {
        self.inner.recount(counted);
    }
    fn clear(&mut self) {
        self.alarm = None;
    }
    fn is_simulated(&self) -> bool {
        true
    }
    fn remarks(&self) -> Vec<String> {
        self.inner.remarks()
    }
}

/// What a bench is made from.
#[derive(Debug, Clone)]
pub struct Make {
    /// The board with its plant.
    pub board: Board,
    /// The calibration of that plant.
    pub calibration: Calibration,
    /// The gains.
    pub gains: Gains,
}

/// A pilot, a machine and the time.
pub struct Bench {
    /// Both at work.
    pub runner: Runner<Breakable>,
    /// Time, s.
    pub now_s: f64,
    period_s: f64,
    /// The orientation that is called straight now.
    rest: Option<Rotation<Base, Tip>>,
    truth: Option<Rotation<Base, Tip>>,
}

impl Make {
    /// A unit of the board's plant.
    ///
    /// # Errors
    /// [`PlantError`].
    pub fn sim(&self, unit: u64, noise: u64) -> Result<Sim, PlantError> {
        let section = self.board.plant.clone().unwrap_or_default();
        Sim::new(&section.make(), unit, noise, section.period_s)
    }

    /// What a pilot of it runs on.
    #[must_use]
    pub fn supervisor(&self, info: &MachineInfo) -> SupervisorConfig {
        assemble(&self.board, &self.calibration, &self.gains, info)
    }

    /// A bench at rest, nothing aligned.
    ///
    /// # Errors
    /// [`PlantError`].
    pub fn bench(&self, unit: u64, noise: u64) -> Result<Bench, PlantError> {
        let machine = Breakable::new(self.sim(unit, noise)?);
        Ok(self.bench_on(machine, None, 0.0))
    }

    /// A bench on a machine that is there already, as after a restart.
    #[must_use]
    pub fn bench_on(&self, machine: Breakable, kept: Option<RestartState>, now_s: f64) -> Bench {
        let config = self.supervisor(machine.info());
        let period_s = machine.info().period_s;
        Bench { runner: Runner::new(machine, Supervisor::new(config, kept)), now_s, period_s, rest: None, truth: None }
    }
}

impl Bench {
    /// One turn.
    ///
    /// # Errors
    /// The plant's.
    pub fn turn(&mut self, order: Option<Order>) -> Result<CycleOutput, MachineError> {
        self.now_s += self.period_s;
        let turned = self.runner.turn(Seconds(self.now_s), order)?;
        self.truth = turned.sensed.truth.or(self.truth);
        Ok(turned)
    }

    /// Turns for so long; the last one.
    ///
    /// # Errors
    /// The plant's.
    pub fn run(&mut self, seconds: f64) -> Result<CycleOutput, MachineError> {
        let mut last = self.turn(None)?;
        for _ in 1..(seconds / self.period_s).round() as u64 {
            last = self.turn(None)?;
        }
        Ok(last)
    }

    /// Time passes and nobody turns.
    pub fn stall(&mut self, seconds: f64) {
        self.now_s += seconds;
    }

    /// Turns until something holds, at most so long; whether it came to hold.
    ///
    /// # Errors
    /// The plant's.
    pub fn until(&mut self, seconds: f64, holds: impl Fn(&CycleOutput) -> bool) -> Result<bool, MachineError> {
        for _ in 0..(seconds / self.period_s).round() as u64 {
            if holds(&self.turn(None)?) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// What is straight from now on: the true orientation of this moment.
    pub fn call_straight(&mut self) {
        self.rest = self.truth;
    }

    /// True bend, from what is called straight.
    #[must_use]
    pub fn true_bend(&self) -> Bend {
        let truth = self.truth.unwrap_or_else(Rotation::identity);
        match &self.rest {
            // base and tip frame coincide at the new rest
            Some(rest) => Bend::from_rotation(&Rotation::assert_frames(rest.quat().inverse() * truth.quat())),
            None => Bend::from_rotation(&truth),
        }
    }

    /// Period of a turn, s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        self.period_s
    }
}

/// An order to bend, degrees.
#[must_use]
pub fn bend(bend_deg: f64, dir_deg: f64) -> Order {
    Order::Bend(Command { bend: Bend::from_deg(bend_deg, dir_deg), length: Mm(20.0) }, None)
}
