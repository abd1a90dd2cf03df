//! The table of faults in flight.

use crate::drill::bench::bend;
use crate::drill::spec::Bound::{self, Brakes, Continues, Copes, Freezes, Holds};
use crate::drill::spec::Detector::{self, Trip};
use crate::drill::spec::{Injection, Spec};
use crate::primitives::{Mm, ReadFault as Read};
use crate::simulation::plant::{BURST_PER_S, ImuFaults, Plant};
use crate::supervisor::{
    Alarm, Bend, HealthCause, Mode, Order, Refusal, Shape, SuspicionKind, TripCause,
};

/// Channel of the faults that concern one channel.
const CHANNEL: usize = 1;
/// A single wrong sample: rate, °/s, and force, g.
const SPIKE: Option<(f64, f64)> = Some((400.0, 2.0));
/// Duration of a lasting fault, s: longer than it is observed.
const LASTING_S: f64 = 10.0;
const MOVING: &[&str] = &["holding", "tracking"];
const HELD: &[&str] = &["holding", "faulted"];
const FAULTED: &[&str] = &["faulted"];
const ANY: &[&str] = &["holding", "tracking", "faulted"];

/// Every fault in flight.
pub fn specs() -> Vec<Spec> {
    [
        sensor_faults(),
        plant_faults(),
        timing_faults(),
        base_imu_faults(),
        order_faults(),
        stops(),
        environment_faults(),
    ]
    .concat()
}

fn sensor(
    name: &'static str,
    injection: Injection,
    causes: &'static [HealthCause],
    bound: Bound,
) -> Spec {
    let states = if bound == Holds { HELD } else { MOVING };
    Spec::new(name, injection, Detector::Sensor(causes), bound, states)
}

fn plant(name: &'static str, fault: fn(&mut Plant), kinds: &'static [SuspicionKind]) -> Spec {
    Spec::new(name, lasting(fault), Detector::Residual(kinds), Copes, ANY)
}

fn lasting(fault: fn(&mut Plant)) -> Injection {
    Injection::Plant(fault, LASTING_S)
}

/// Turns the base about an axis that is neither the tip's nor perpendicular to it.
fn turn_base(plant: &mut Plant, angle_deg: f64) {
    plant.turn_base([0.3, 0.2, 1.0], angle_deg, 0.6);
}

fn sensor_faults() -> Vec<Spec> {
    use HealthCause::{BrownOut, Frozen, NotFinite, Saturated, Spike, WrongId};
    use HealthCause::{Nack, ShortRead, StaleTimestamp, StuckBus};
    let nack = Injection::Bus(Read::Nack, 0.02);
    let bus = |fault| Injection::Bus(fault, LASTING_S);
    let no_data: &[HealthCause] = &[Nack, StuckBus, ShortRead, StaleTimestamp];
    let frozen = lasting(|p| p.faults.imu.frozen = true);
    let nan = lasting(|p| p.faults.imu.nan = true);
    let spike = Injection::Plant(|p| p.faults.imu.spike = SPIKE, 0.05);
    let saturated = lasting(|p| p.faults.imu.saturated = true);
    let biased = lasting(|p| p.faults.imu.rate_deg_s = [2.0, -2.0, 1.0]);
    vec![
        sensor("i2c_nack", nack, no_data, Continues),
        sensor("i2c_stuck", bus(Read::Bus), no_data, Holds),
        sensor("i2c_wrong_id", bus(Read::WrongId), &[WrongId], Holds),
        sensor("i2c_brown_out", bus(Read::BrownOut), &[BrownOut], Holds),
        sensor("sample_frozen", frozen, &[Frozen], Holds),
        sensor("sample_nan", nan, &[NotFinite], Holds),
        sensor("sample_spike", spike, &[Spike, Saturated], Continues),
        sensor("sample_saturated", saturated, &[Saturated, Spike], Holds),
        Spec::new("sample_biased", biased, Detector::Bias, Copes, ANY).then_zero(),
    ]
}

fn plant_faults() -> Vec<Spec> {
    use SuspicionKind::{Burst, Contact, Inverted, Leak, LostSteps, NoResponse, Strong, Weak};
    let loss: fn(&mut Plant) = |p| p.slip(CHANNEL, 160);
    let inverted: fn(&mut Plant) = |p| p.faults.drive_gain[CHANNEL] = -1.0;
    let disabled: fn(&mut Plant) = |p| p.faults.drive_gain[CHANNEL] = 0.0;
    let stop: fn(&mut Plant) = |p| p.faults.stop_mm[CHANNEL] = Some(11.5);
    let by_hand = [
        plant("step_loss", loss, &[LostSteps, Weak, Leak, Contact]),
        plant("dir_inverted", inverted, &[Inverted, NoResponse]),
        plant("en_stuck", disabled, &[NoResponse, Weak]),
        // only a move that goes far reaches the stop
        plant("end_stop", stop, &[NoResponse, Weak]).toward(78.0, 62.0),
    ];
    let leak: fn(&mut Plant) = |p| p.faults.leak_per_s[CHANNEL] = 0.1;
    let burst: fn(&mut Plant) = |p| p.faults.leak_per_s[CHANNEL] = BURST_PER_S;
    let bubble: fn(&mut Plant) = |p| p.faults.compliance[CHANNEL] = 1.8;
    let blocked: fn(&mut Plant) = |p| p.faults.blocked[CHANNEL] = true;
    let half: fn(&mut Plant) = |p| p.faults.bellow_gain[CHANNEL] = 0.5;
    let double: fn(&mut Plant) = |p| p.faults.bellow_gain[CHANNEL] = 2.0;
    let lines = [
        plant("leak", leak, &[Leak, Weak]),
        plant("burst", burst, &[Burst, NoResponse]),
        plant("air_bubble", bubble, &[Weak, Leak]),
        plant("blocked_line", blocked, &[NoResponse, Weak]),
        plant("gain_half", half, &[Weak, Burst, NoResponse]),
        plant("gain_double", double, &[Strong]),
    ];
    let rows = by_hand.into_iter().map(Spec::by_hand).chain(lines);
    rows.map(Spec::then_zero).collect()
}

fn timing_faults() -> Vec<Spec> {
    use TripCause::Late;
    let stall = Injection::Stall;
    let late = |name, s| Spec::new(name, stall(s), Detector::LateCycle, Continues, MOVING);
    let jump = Injection::ClockJump(10.0, LASTING_S);
    let stamps: &[HealthCause] = &[HealthCause::JumpingTimestamp, HealthCause::StaleTimestamp];
    vec![
        late("stall_1ms", 0.001),
        late("stall_10ms", 0.01),
        Spec::new("stall_100ms", stall(0.1), Trip(&[Late]), Holds, FAULTED),
        sensor("clock_jump", jump, stamps, Holds),
    ]
}

fn order_faults() -> Vec<Spec> {
    use TripCause::{EmergencyStop, Pressure, StepGenerator, Temperature};
    let length = Mm(20.0);
    let to = |bend| Injection::Orders(Order::Bend(Shape { bend, length }, None), None);
    let refused = |name, injection, expected| {
        let detector = Detector::Refusal(expected);
        Spec::new(name, injection, detector, Continues, MOVING)
    };
    let nan = to(Bend([f64::NAN, 0.1].into()));
    let far = to(Bend::from_deg(170.0, 0.0));
    let unreachable = to(Bend::from_deg(110.0, 0.0));
    let contradictory = Injection::Orders(Order::Relax, Some(bend(40.0, 0.0)));
    let (stop, stopped) = (Injection::EmergencyStop, Trip(&[EmergencyStop]));
    let alarm = |name, alarm, causes, bound| {
        let spec = Spec::new(name, Injection::Alarm(alarm), Trip(causes), bound, FAULTED);
        spec.within(0.002)
    };
    let steps: &[TripCause] = &[StepGenerator];
    let line = |name, kpa| alarm(name, Alarm::Pressure { kpa }, &[Pressure], Copes);
    let temp_c = 42.0;
    vec![
        refused("command_nan", nan, |r| r == Refusal::NotANumber),
        refused("command_out_of_range", far, |r| r == Refusal::TooFar),
        Spec {
            bound: Copes,
            states: &["relaxing", "disarmed"],
            ..refused("command_contradictory", contradictory, |r| {
                matches!(r, Refusal::Mode(_))
            })
        },
        Spec::new("emergency_stop", stop, stopped, Freezes, FAULTED).then_zero(),
        alarm("step_thread_underrun", Alarm::Underrun, steps, Holds),
        alarm("step_thread_silent", Alarm::Silent, steps, Holds),
        line("line_overpressure", 45.0),
        line("pressure_sensor_silent", f64::NAN),
        alarm("tip_hot", Alarm::Hot { temp_c }, &[Temperature], Holds),
        refused("command_unreachable", unreachable, |r| {
            matches!(r, Refusal::Unreachable(_))
        })
        .within(0.002),
    ]
}

/// A stop in every situation; orders to move follow it a hundred times a second.
fn stops() -> Vec<Spec> {
    let stop = |name, mode, states| {
        let spec = Spec::new(name, Injection::Stop, Detector::Stopped, Brakes, states);
        spec.within(0.002).when(mode)
    };
    let held: &[&str] = &["holding"];
    vec![
        stop("stop_in_motion", Mode::Tracking, held),
        stop("stop_while_held", Mode::Holding, held),
        stop("stop_while_relaxing", Mode::Relaxing, held),
        stop("stop_while_the_gate_returns", Mode::Faulted, FAULTED),
        stop("stop_while_calibrating", Mode::Calibrating, held),
    ]
}

/// Faults of the IMU on a base that sways. Where it is lost, the loop goes on as without one.
fn base_imu_faults() -> Vec<Spec> {
    use HealthCause::{FieldDisturbed, Frozen, NotFinite, Saturated, Spike, StaleTimestamp};
    let row = |name, fault: fn(&mut Plant), lasts_s, causes| {
        let (injection, detector) = (Injection::Plant(fault, lasts_s), Detector::BaseImu(causes));
        let spec = Spec::new(name, injection, detector, Continues, MOVING);
        spec.on_swaying_base(5.0).within(0.05)
    };
    let (late, loud): (&[HealthCause], &[HealthCause]) = (&[StaleTimestamp], &[Saturated, Spike]);
    let silent: fn(&mut Plant) = |p| p.faults.base_imu.slow = ImuFaults::SILENT;
    let slow: fn(&mut Plant) = |p| p.faults.base_imu.slow = Some((50, 0));
    let frozen: fn(&mut Plant) = |p| p.faults.base_imu.frozen = true;
    let nan: fn(&mut Plant) = |p| p.faults.base_imu.nan = true;
    let saturated: fn(&mut Plant) = |p| p.faults.base_imu.saturated = true;
    let spike: fn(&mut Plant) = |p| p.faults.base_imu.spike = SPIKE;
    let magnet: fn(&mut Plant) = |p| p.faults.base_imu.field_ut = [50.0, -40.0, 30.0].into();
    let cable_out_in_turn: fn(&mut Plant) = |p| {
        turn_base(p, 25.0);
        p.faults.base_imu.slow = ImuFaults::SILENT;
    };
    let out = row(
        "base_imu_cable_out_in_turn",
        cable_out_in_turn,
        LASTING_S,
        late,
    );
    vec![
        row("base_imu_silent", silent, LASTING_S, late),
        row("base_imu_dropout", silent, 0.3, late),
        row("base_imu_stuck", frozen, LASTING_S, &[Frozen]),
        row("base_imu_spike", spike, 0.05, loud),
        row("base_imu_nan", nan, LASTING_S, &[NotFinite]),
        row("base_imu_saturated", saturated, LASTING_S, loud),
        row("base_imu_slow", slow, LASTING_S, late),
        row("base_imu_magnet", magnet, LASTING_S, &[FieldDisturbed]).within(0.1),
        // the base stands before and after the turn, and is aligned again
        Spec {
            bound: Copes,
            ..out.then_zero().on_swaying_base(0.0)
        },
    ]
}

fn environment_faults() -> Vec<Spec> {
    use HealthCause::{AccelDisturbed, FieldDisturbed, Spike};
    use SuspicionKind::{Burst, Contact, NoResponse, Strong, Weak};
    let shaken = Detector::Sensor(&[AccelDisturbed, Spike]);
    let push = lasting(|p| p.faults.push = Bend::from_deg(15.0, 0.0));
    let magnet = lasting(|p| p.faults.magnet_ut = [40.0, -30.0, 20.0].into());
    let base = |name, turn| Spec::new(name, lasting(turn), Detector::Base, Copes, ANY).then_zero();
    let wall: fn(&mut Plant) = |p| p.put_wall(48.0, 80.0);
    vec![
        plant("wall", wall, &[Contact, NoResponse, Weak, Strong, Burst]),
        Spec::new("pushed", push, shaken, Copes, ANY).then_zero(),
        sensor("magnet", magnet, &[FieldDisturbed], Continues),
        // during a move, a small turn of the base cannot be distinguished from bending
        base("base_turned", |p| turn_base(p, 25.0)).when(Mode::Holding),
        base("base_turned_in_motion", |p| turn_base(p, 60.0)),
    ]
}
