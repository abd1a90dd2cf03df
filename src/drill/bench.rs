//! A supervisor on a simulated plant, with fault injection at sensor, lines and clock.

use crate::primitives::{Base, ImuReading, Mm, ReadFault, Rotation, Seconds, Steps, Tip};
use crate::simulation::lockstep::Lockstep;
use crate::simulation::plant::{Plant, PlantConfig, PlantError};
use crate::simulation::sim::Sim;
use crate::supervisor::{
    Alarm, Bend, CycleOutput, Machine, MachineError, MachineInfo, Order, RestartState, Runner,
    Sensed, Shape, Supervisor, SupervisorConfig,
};

/// A simulated machine with fault injection.
#[derive(Debug)]
pub struct FaultyMachine {
    inner: Lockstep<Sim>,
    /// Every transfer fails with this fault.
    pub bus: Option<ReadFault>,
    /// Offset of the sensor time stamps, s.
    pub stamp_offset_s: f64,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// Alarm of the step thread. The pistons stand still until it is cleared.
    pub alarm: Option<Alarm>,
}

impl FaultyMachine {
    /// The plant, for faults of its own.
    pub fn plant(&mut self) -> &mut Plant {
        &mut self.inner.world.plant
    }

    /// Puts the racks back to their marks by hand and vents the lines while the pistons are at zero. This restores lost
    /// steps and lost air.
    pub fn restore_racks(&mut self) {
        self.plant().vent();
        let step_mm = self.info().step_mm;
        let Some(out) = self.inner.world.last else {
            return;
        };
        let lost_mm = out.truth.play_output_mm;
        for channel in 0..3 {
            let microsteps = (lost_mm[channel] / step_mm).round() as i32;
            self.plant().slip(channel, microsteps);
        }
    }

    /// Removes every fault. Consequences such as lost steps remain.
    pub fn clear_faults(&mut self) {
        self.plant().clear();
        (self.bus, self.stamp_offset_s, self.emergency_stop) = (None, 0.0, false);
        self.alarm = self.alarm.filter(Alarm::is_of_steps);
    }
}

impl Machine for FaultyMachine {
    fn info(&self) -> &MachineInfo {
        self.inner.info()
    }
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        if self.alarm.is_some_and(|alarm| alarm.is_of_steps()) {
            self.inner.fail();
        }
        self.inner.inputs.emergency_stop = self.emergency_stop;
        let mut sensed = self.inner.turn(now, wanted)?;
        if let (Some(fault), ImuReading::Sample(..)) = (self.bus, sensed.imu) {
            sensed.imu = ImuReading::Failed(fault);
        }
        if let ImuReading::Sample(sample, quality) = &mut sensed.imu {
            sample.t.0 += self.stamp_offset_s;
            // share of the measuring range, as a driver computes it from the raw counts
            let chip = &self.inner.world.plant.config.imu;
            quality.gyro_load = sample.gyro_rad_s.amax().to_degrees() / chip.gyro_range_deg_s;
            quality.acc_load = sample.acc_m_s2.amax() / (chip.acc_range_g * 9.80665);
        }
        sensed.alarm = self.alarm.or(sensed.alarm);
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
        self.inner.clear();
    }
    fn is_simulated(&self) -> bool {
        true
    }
    fn remarks(&self) -> Vec<String> {
        self.inner.remarks()
    }
}

/// The configuration of a bench.
#[derive(Debug, Clone)]
pub struct BenchConfig {
    /// The plant.
    pub plant: PlantConfig,
    /// The supervisor on it.
    pub supervisor: SupervisorConfig,
}

/// A supervisor and a machine in simulated time.
pub struct Bench {
    /// Supervisor and machine.
    pub runner: Runner<FaultyMachine>,
    /// Time, s.
    pub now_s: f64,
    /// Period of a cycle, s.
    pub period_s: f64,
    /// True orientation at the last alignment.
    straight: Option<Rotation<Base, Tip>>,
    truth: Option<Rotation<Base, Tip>>,
}

impl BenchConfig {
    /// A simulated unit of the plant, without faults; `unit` and `noise` are seeds.
    ///
    /// # Errors
    /// [`PlantError`].
    pub fn machine(&self, unit: u64, noise: u64) -> Result<FaultyMachine, PlantError> {
        let sim = Sim::new(&self.plant, unit, noise, self.plant.period_s)?;
        Ok(FaultyMachine {
            inner: Lockstep::new(sim, &self.supervisor.tick.motion),
            bus: None,
            stamp_offset_s: 0.0,
            emergency_stop: false,
            alarm: None,
        })
    }

    /// A bench at rest before the alignment.
    ///
    /// # Errors
    /// [`PlantError`].
    pub fn bench(&self, unit: u64, noise: u64) -> Result<Bench, PlantError> {
        Ok(self.bench_on(self.machine(unit, noise)?, None, 0.0))
    }

    /// A bench with an existing machine, as after a restart.
    pub fn bench_on(
        &self,
        machine: FaultyMachine,
        restart: Option<RestartState>,
        now_s: f64,
    ) -> Bench {
        Bench {
            now_s,
            period_s: machine.info().period_s,
            runner: Runner::new(machine, Supervisor::new(self.supervisor.clone(), restart)),
            straight: None,
            truth: None,
        }
    }
}

impl Bench {
    /// Runs one cycle.
    ///
    /// # Errors
    /// [`MachineError`].
    pub fn turn(&mut self, order: Option<Order>) -> Result<CycleOutput, MachineError> {
        self.now_s += self.period_s;
        let output = self.runner.turn(Seconds(self.now_s), order)?;
        self.truth = output.sensed.truth.or(self.truth);
        Ok(output)
    }

    /// Runs for a time, s. Returns the last output.
    ///
    /// # Errors
    /// [`MachineError`].
    pub fn run(&mut self, seconds: f64) -> Result<CycleOutput, MachineError> {
        let mut last = self.turn(None)?;
        for _ in 1..(seconds / self.period_s).round() as u64 {
            last = self.turn(None)?;
        }
        Ok(last)
    }

    /// Runs until `holds`, at most for a time, s. Returns whether it came to hold.
    ///
    /// # Errors
    /// [`MachineError`].
    pub fn until(
        &mut self,
        seconds: f64,
        holds: impl Fn(&CycleOutput) -> bool,
    ) -> Result<bool, MachineError> {
        for _ in 0..(seconds / self.period_s).round() as u64 {
            if holds(&self.turn(None)?) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Takes the present true orientation as straight.
    pub fn set_straight(&mut self) {
        self.straight = self.truth;
    }

    /// True bend relative to the straight orientation.
    pub fn true_bend(&self) -> Bend {
        let mut truth = self.truth.unwrap_or_else(Rotation::identity);
        if let Some(straight) = &self.straight {
            // base and tip frame coincide in the new rest pose
            truth = Rotation::assert_frames(straight.quat().inverse() * truth.quat());
        }
        Bend::from_rotation(&truth)
    }

    /// Distance of the true bend from a pose, degrees.
    pub fn error_deg(&self, bend_deg: f64, dir_deg: f64) -> f64 {
        let target = Bend::from_deg(bend_deg, dir_deg);
        (self.true_bend().0 - target.0).norm().to_degrees()
    }

    /// Arms, and waits for the drivers.
    ///
    /// # Errors
    /// [`MachineError`].
    pub fn arm(&mut self) -> Result<CycleOutput, MachineError> {
        self.turn(Some(Order::Arm))?;
        self.run(0.05)
    }
}

/// An order to bend; angles in degrees.
pub fn bend(bend_deg: f64, dir_deg: f64) -> Order {
    let (bend, length) = (Bend::from_deg(bend_deg, dir_deg), Mm(20.0));
    Order::Bend(Shape { bend, length }, None)
}

/// Microsteps between two positions, all channels.
pub fn distance(a: &Steps, b: &Steps) -> i64 {
    let pairs = a.0.into_iter().zip(b.0);
    pairs
        .map(|(a, b)| (i64::from(a) - i64::from(b)).abs())
        .sum()
}
