//! Every sensor fault, injected during motion into register-level fakes behind their drivers: detection time, policy,
//! error, and continuity of the estimate.
//!
//! `cargo test --release --test library sensor_faults -- --nocapture` prints the table.

use crate::fake_imu::{FakeBus, FakeIcm20948};
use crate::tip::TipPlant;
use nalgebra::Vector3;
use retroflex::config::assemble;
use retroflex::config::board::Board;
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::control::tick::{Frame, Input, LoopConfig, LoopState, tick};
use retroflex::estimation::fusion::health::{HealthAction, HealthCause};
use retroflex::hardware::imu::ImuRecovery;
use retroflex::hardware::imu::icm20948::{self, Icm20948};
use retroflex::model::Shape;
use retroflex::model::bend::Bend;
use retroflex::primitives::ImuReading;
use retroflex::primitives::units::{Mm, Seconds};

const DT_S: f64 = 0.002;
const ADDRESS: u8 = 0x68;

/// A fault of the sensor and the required response.
struct Case {
    name: &'static str,
    lasts_s: f64,
    cause: HealthCause,
    /// The mildest accepted action.
    action: HealthAction,
    /// Largest true bend error during the fault, degrees.
    error_max_deg: f64,
}

/// A closed loop whose sensor is a fake chip on a bus.
struct Chip {
    plant: TipPlant,
    config: LoopConfig,
    state: LoopState,
    input: Input,
    bus: FakeBus,
    imu: ImuRecovery<Icm20948<FakeBus>>,
    /// Name of the fault applied to a sample between chip and loop.
    corrupt: Option<&'static str>,
    held: Option<ImuReading>,
}

impl Chip {
    fn new() -> Self {
        let plant = TipPlant::new(7, 50.0, DT_S);
        let mut config = assemble(
            &Board::default(),
            &Calibration::default(),
            &Gains::default(),
        );
        config.lines = plant.lines;
        let bus = FakeBus::new();
        bus.machine().attach(FakeIcm20948::new(ADDRESS, 3));
        let chip = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
        let mut imu = ImuRecovery::new(Box::new(chip));
        imu.start(&mut bus.delay()).unwrap();
        let state = LoopState::new(&config);
        Self {
            plant,
            config,
            state,
            input: Input {
                dt_s: DT_S,
                ..Input::default()
            },
            bus,
            imu,
            corrupt: None,
            held: None,
        }
    }

    fn tick(&mut self) -> Frame {
        let frame = tick(&self.config, &mut self.state, &self.input);
        let steps = self.plant.step(&frame.steps);
        let now = Seconds(self.plant.t_s);
        let reading = self.read(now);
        self.input = Input {
            t: now,
            dt_s: DT_S,
            imu: reading,
            steps,
            ..Input::default()
        };
        frame
    }

    /// Reads the chip as the sensor thread does.
    fn read(&mut self, now: Seconds) -> ImuReading {
        self.bus.machine().set_motion(&self.plant.motion());
        self.bus.machine().advance(DT_S);
        let reading = self.imu.read(&mut self.bus.delay(), now);
        self.corrupted(reading)
    }

    /// Applies the faults between chip and loop.
    fn corrupted(&mut self, reading: ImuReading) -> ImuReading {
        let (Some(name), ImuReading::Sample(mut sample, quality)) = (self.corrupt, reading) else {
            self.held = Some(reading);
            return reading;
        };
        match name {
            "not a number" => sample.acc_m_s2.y = f64::NAN,
            "stale stamp" => return self.held.unwrap_or(reading),
            "stamp jumps ahead" => sample.t = Seconds(sample.t.0 + 0.4),
            "stamp runs back" => sample.t = Seconds(sample.t.0 - 0.3),
            "silence" => return ImuReading::Nothing,
            _ => {}
        }
        ImuReading::Sample(sample, quality)
    }

    /// Starts or ends the fault called `name`.
    fn fault(&mut self, name: &'static str, on: bool) {
        let mut machine = self.bus.machine();
        match name {
            "nack" => machine.nack(ADDRESS, if on { u32::MAX } else { 0 }),
            "short read" if on => machine.shorten(ADDRESS, 9),
            "stuck bus" => machine.stuck = on,
            "wrong chip" => {
                machine.spoil(ADDRESS, |q| q.wrong_id = on.then_some(0x12));
                if on {
                    machine.brown_out();
                }
            }
            "brown-out" if on => machine.brown_out(),
            "frozen" => machine.spoil(ADDRESS, |q| q.frozen = on),
            "spike" if on => machine.spoil(ADDRESS, |q| q.spike = Some(30_000)),
            "saturated" => machine.spoil(ADDRESS, |q| q.saturate = on),
            "field overflow" => machine.spoil(ADDRESS, |q| q.mag_overflow = on),
            "magnetometer dead" => machine.spoil(ADDRESS, |q| q.mag_dead = on),
            _ => {}
        }
        drop(machine);
        match name {
            "iron nearby" => {
                self.plant.field = if on {
                    crate::tip::Field::HardIron(60.0)
                } else {
                    crate::tip::Field::Clean
                }
            }
            "shaken" => {
                self.plant.push = if on {
                    Vector3::new(0.0, 6.0, 2.0)
                } else {
                    Vector3::zeros()
                }
            }
            _ => self.corrupt = on.then_some(name),
        }
    }

    fn command(&mut self, bend_deg: f64, dir_deg: f64) {
        self.input.command = Some(Shape {
            bend: Bend::from_deg(bend_deg, dir_deg),
            length: Mm(20.0),
        });
    }

    fn error_deg(&self, frame: &Frame) -> f64 {
        (frame.setpoint.bend.0 - self.plant.bend().0)
            .norm()
            .to_degrees()
    }
}

#[derive(Debug, Default)]
struct Observed {
    detected_s: Option<f64>,
    worst: Option<HealthAction>,
    during_deg: f64,
    after_deg: f64,
    estimate_jump_deg: f64,
    target_jump_mm: f64,
    stopped: bool,
    recovered_s: f64,
}

fn run(case: &Case) -> Observed {
    let mut chip = Chip::new();
    while chip.tick().estimate.is_none() {
        assert!(chip.plant.t_s < 6.0, "{}", chip.state.fusion.waiting_for());
    }
    for (bend, dir, ticks) in [
        (30.0, 0.0, 750),
        (50.0, 90.0, 750),
        (20.0, 200.0, 750),
        (60.0, 20.0, 200),
    ] {
        chip.command(bend, dir);
        for _ in 0..ticks {
            chip.tick();
        }
    }
    chip.command(45.0, 130.0);
    let mut before = chip.tick();
    let (mut observed, start) = (Observed::default(), chip.plant.t_s + 0.2);
    for _ in 0..2500 {
        let t = chip.plant.t_s;
        if t >= start && t < start + DT_S {
            chip.fault(case.name, true);
        }
        if t >= start + case.lasts_s && t < start + case.lasts_s + DT_S {
            chip.fault(case.name, false);
        }
        let frame = chip.tick();
        observe(&mut observed, &chip, case, &before, &frame, t - start);
        before = frame;
    }
    observed.after_deg = chip.error_deg(&before);
    assert!(
        before.senses.in_force.is_empty(),
        "{}: still {}",
        case.name,
        before.senses.in_force
    );
    observed
}

fn observe(
    observed: &mut Observed,
    chip: &Chip,
    case: &Case,
    before: &Frame,
    frame: &Frame,
    since_s: f64,
) {
    if frame.senses.in_force.contains(case.cause) {
        observed.detected_s = observed.detected_s.or(Some(since_s));
        observed.recovered_s = since_s;
    }
    if since_s < 0.0 {
        return;
    }
    observed.worst = observed.worst.max(Some(frame.senses.action));
    observed.stopped |= frame.senses.held;
    if since_s < case.lasts_s + 0.3 {
        observed.during_deg = observed.during_deg.max(chip.error_deg(frame));
    }
    let (now, then) = (
        frame.estimate.unwrap().bend.0,
        before.estimate.unwrap().bend.0,
    );
    // the motion of the tip within a tick is no jump
    let jump = (now - then).norm() - 120f64.to_radians() * DT_S;
    observed.estimate_jump_deg = observed.estimate_jump_deg.max(jump.to_degrees());
    if before.senses.held && !frame.senses.held {
        observed.target_jump_mm = observed
            .target_jump_mm
            .max((frame.piston_target_mm - before.piston_target_mm).amax());
    }
}

#[test]
fn every_fault_is_detected_handled_and_recovered_from() {
    use HealthAction::{CoastOnGyro, GravityOnly, Hold, Skip};
    let case = |name, lasts_s, cause, action, error_max_deg| Case {
        name,
        lasts_s,
        cause,
        action,
        error_max_deg,
    };
    let cases = [
        case("nack", 0.02, HealthCause::Nack, Skip, 12.0),
        case("short read", 0.02, HealthCause::ShortRead, Skip, 12.0),
        case("stuck bus", 0.4, HealthCause::StuckBus, Hold, 25.0),
        case("wrong chip", 0.4, HealthCause::WrongId, Hold, 25.0),
        case("brown-out", 0.02, HealthCause::BrownOut, Hold, 25.0),
        case("frozen", 0.4, HealthCause::Frozen, Hold, 25.0),
        case("not a number", 0.03, HealthCause::NotFinite, Skip, 12.0),
        case("spike", 0.02, HealthCause::Spike, Skip, 12.0),
        case("saturated", 0.2, HealthCause::Saturated, Hold, 25.0),
        case("stale stamp", 0.1, HealthCause::StaleTimestamp, Skip, 12.0),
        case(
            "stamp jumps ahead",
            0.03,
            HealthCause::JumpingTimestamp,
            Skip,
            12.0,
        ),
        case(
            "stamp runs back",
            0.03,
            HealthCause::JumpingTimestamp,
            Skip,
            12.0,
        ),
        case("silence", 0.5, HealthCause::StaleTimestamp, Hold, 25.0),
        case(
            "field overflow",
            0.8,
            HealthCause::MagOverflow,
            GravityOnly,
            12.0,
        ),
        case(
            "magnetometer dead",
            0.8,
            HealthCause::MagSilent,
            GravityOnly,
            12.0,
        ),
        case(
            "iron nearby",
            0.8,
            HealthCause::FieldDisturbed,
            GravityOnly,
            12.0,
        ),
        case(
            "shaken",
            0.8,
            HealthCause::AccelDisturbed,
            CoastOnGyro,
            12.0,
        ),
    ];
    println!(
        "fault               detected   policy         pistons  error during  after   estimate jump  target jump  over after"
    );
    for c in &cases {
        let s = run(c);
        println!(
            "{:18} {:8.3} s  {:13} {:>8} {:10.2}° {:8.2}° {:8.2}° {:9.2} mm {:8.2} s",
            c.name,
            s.detected_s.unwrap_or(f64::NAN),
            format!("{:?}", s.worst.unwrap()),
            if s.stopped { "stopped" } else { "go on" },
            s.during_deg,
            s.after_deg,
            s.estimate_jump_deg,
            s.target_jump_mm,
            s.recovered_s,
        );
        let detected = s
            .detected_s
            .unwrap_or_else(|| panic!("{} was not detected", c.name));
        assert!(
            (0.0..0.35).contains(&detected),
            "{}: detected after {detected} s",
            c.name
        );
        assert!(s.worst >= Some(c.action), "{}: {:?}", c.name, s.worst);
        assert!(
            s.during_deg < c.error_max_deg && s.after_deg < 1.0,
            "{}: {s:?}",
            c.name
        );
        assert!(
            s.estimate_jump_deg < 1.0 && s.target_jump_mm < 0.2,
            "{}: {s:?}",
            c.name
        );
    }
}

/// Largest error of the estimated bend from `after_s` to 2 s after a jump of the tip by `jump_deg` within `over_s`,
/// with a healthy sensor; degrees.
fn jump(chip: &mut Chip, jump_deg: f64, over_s: f64, after_s: f64) -> f64 {
    let from = chip.plant.aside;
    let displacement = Bend::from_deg(jump_deg, 80.0).0;
    let start = chip.plant.t_s;
    let mut worst = 0.0_f64;
    while chip.plant.t_s - start < 2.0 {
        // a smooth step: its rate rises and falls
        let x = ((chip.plant.t_s - start) / over_s).clamp(0.0, 1.0);
        chip.plant.aside = from + displacement * (x * x * (3.0 - 2.0 * x));
        let frame = chip.tick();
        if chip.plant.t_s - start > after_s {
            worst = worst.max(
                (frame.estimate.unwrap().bend.0 - chip.plant.bend().0)
                    .norm()
                    .to_degrees(),
            );
        }
    }
    worst
}

#[test]
fn the_estimate_reacquires_the_tip_after_a_jump() {
    for (jump_deg, over_s) in [
        (40.0, 0.002),
        (25.0, 0.02),
        (5.0, 0.02),
        (9.0, 0.04),
        (20.0, 0.1),
    ] {
        for tilt in [20.0, 50.0, 90.0] {
            let mut chip = Chip::new();
            chip.plant = TipPlant::new(7, tilt, DT_S);
            chip.config.lines = chip.plant.lines;
            chip.state = LoopState::new(&chip.config);
            while chip.tick().estimate.is_none() {}
            for (bend, dir) in [(30.0, 0.0), (50.0, 90.0), (20.0, 200.0), (45.0, 130.0)] {
                chip.command(bend, dir);
                for _ in 0..750 {
                    chip.tick();
                }
            }
            let off = jump(&mut chip, jump_deg, over_s, 1.5);
            println!(
                "base at {tilt}°: {jump_deg}° in {over_s} s: error at most {off:.2}° from 1.5 s on"
            );
            assert!(off < 0.8, "{off}");
        }
    }
}
