//! The table of faults in flight.

use crate::control::tick::Command;
use crate::drill::bench::bend;
use crate::drill::spec::{Bound, Detector, Injection, Situation, Spec};
use crate::estimation::fusion::health::{HealthCause, ReadFault};
use crate::model::bend::Bend;
use crate::primitives::units::Mm;
use crate::simulation::plant::{Channel, InjectedFault};
use crate::supervisor::cycle::order::{Order, Refusal};
use crate::supervisor::gate::TripCause;
use crate::supervisor::machine::Alarm;
use crate::supervisor::residual_monitor::SuspicionKind;

/// Channel of the faults that concern one channel.
const CHANNEL: Channel = Channel::Two;
/// Duration of a lasting fault, s: longer than it is observed.
const LASTING_S: f64 = 10.0;
const MOVING: &[&str] = &["holding", "tracking"];
const HELD: &[&str] = &["holding", "faulted"];
const FAULTED: &[&str] = &["faulted"];
const ANY: &[&str] = &["holding", "tracking", "faulted"];

/// Every fault in flight.
#[must_use]
pub fn specs() -> Vec<Spec> {
    [sensor_faults(), plant_faults(), timing_faults(), order_faults(), stops(), environment_faults(), base_imu_faults()].concat()
}

fn sensor(name: &'static str, injection: Injection, causes: &'static [HealthCause], bound: Bound) -> Spec {
    let states = if bound == Bound::Holds { HELD } else { MOVING };
    Spec::new(name, injection, Detector::Sensor(causes), bound, states)
}

fn plant(name: &'static str, fault: InjectedFault, kinds: &'static [SuspicionKind]) -> Spec {
    Spec::new(name, Injection::Plant(fault, LASTING_S), Detector::Residual(kinds), Bound::Copes, ANY)
}

fn sensor_faults() -> Vec<Spec> {
    use Bound::{Continues, Holds};
    use HealthCause as Cause;
    let bus = |fault, duration_s| Injection::Bus(fault, duration_s);
    let lasting = |fault| Injection::Plant(fault, LASTING_S);
    let no_data: &[Cause] = &[Cause::Nack, Cause::StuckBus, Cause::ShortRead, Cause::StaleTimestamp];
    let spike = InjectedFault::Spike { gyro_deg_s: 400.0, acc_g: 2.0 };
    let bias = InjectedFault::GyroBias { deg_s: [2.0, -2.0, 1.0] };
    vec![
        sensor("i2c_nack", bus(ReadFault::Nack, 0.02), no_data, Continues),
        sensor("i2c_stuck", bus(ReadFault::Bus, LASTING_S), no_data, Holds),
        sensor("i2c_wrong_id", bus(ReadFault::WrongId, LASTING_S), &[Cause::WrongId], Holds),
        sensor("i2c_brown_out", bus(ReadFault::BrownOut, LASTING_S), &[Cause::BrownOut], Holds),
        sensor("sample_frozen", lasting(InjectedFault::FrozenSample), &[Cause::Frozen], Holds),
        sensor("sample_nan", lasting(InjectedFault::NanSample), &[Cause::NotFinite], Holds),
        sensor("sample_spike", Injection::Plant(spike, 0.05), &[Cause::Spike, Cause::Saturated], Continues),
        sensor("sample_saturated", lasting(InjectedFault::Saturation), &[Cause::Saturated, Cause::Spike], Holds),
        Spec::new("sample_biased", lasting(bias), Detector::Bias, Bound::Copes, ANY).then_zero(),
    ]
}

fn plant_faults() -> Vec<Spec> {
    use SuspicionKind::{Burst, Contact, Inverted, Leak, LostSteps, NoResponse, Strong, Weak};
    let channel = CHANNEL;
    let end_stop = plant("end_stop", InjectedFault::EndStop { channel, at_mm: 11.5 }, &[NoResponse, Weak]);
    let rows = [
        plant("step_loss", InjectedFault::StepLoss { channel, microsteps: 160 }, &[LostSteps, Weak, Leak, Contact]).by_hand(),
        plant("dir_inverted", InjectedFault::Inverted { channel }, &[Inverted, NoResponse]).by_hand(),
        plant("en_stuck", InjectedFault::Disabled { channel }, &[NoResponse, Weak]).by_hand(),
        // only a move that goes far reaches the stop
        Spec { target: (78.0, 62.0), ..end_stop.by_hand() },
        plant("leak", InjectedFault::Leak { channel, rate_per_s: 0.1 }, &[Leak, Weak]),
        plant("burst", InjectedFault::Burst { channel }, &[Burst, NoResponse]),
        plant("air_bubble", InjectedFault::AirBubble { channel, factor: 1.8 }, &[Weak, Leak]),
        plant("blocked_line", InjectedFault::Blocked { channel }, &[NoResponse, Weak]),
        plant("gain_half", InjectedFault::Gain { channel, factor: 0.5 }, &[Weak, Burst, NoResponse]),
        plant("gain_double", InjectedFault::Gain { channel, factor: 2.0 }, &[Strong]),
    ];
    rows.map(Spec::then_zero).to_vec()
}

fn timing_faults() -> Vec<Spec> {
    let stall = |name, seconds, detector, bound, states| Spec::new(name, Injection::Stall(seconds), detector, bound, states);
    let jump: &[HealthCause] = &[HealthCause::JumpingTimestamp, HealthCause::StaleTimestamp];
    vec![
        stall("stall_1ms", 0.001, Detector::LateCycle, Bound::Continues, MOVING),
        stall("stall_10ms", 0.01, Detector::LateCycle, Bound::Continues, MOVING),
        stall("stall_100ms", 0.1, Detector::Trip(&[TripCause::Late]), Bound::Holds, FAULTED),
        sensor("clock_jump", Injection::ClockJump(10.0, LASTING_S), jump, Bound::Holds),
    ]
}

fn order_faults() -> Vec<Spec> {
    let to = |bend| Order::Bend(Command { bend, length: Mm(20.0) }, None);
    let refused = |name, injection, expected, bound, states| Spec::new(name, injection, Detector::Refusal(expected), bound, states);
    let nan = Injection::Order(to(Bend([f64::NAN, 0.1].into())));
    let far = Injection::Order(to(Bend::from_deg(170.0, 0.0)));
    let contradictory = Injection::Orders(Order::Relax, bend(40.0, 0.0));
    let stop = Detector::Trip(&[TripCause::EmergencyStop]);
    let alarm = |name, alarm, cause, bound| Spec::new(name, Injection::Alarm(alarm), Detector::Trip(cause), bound, FAULTED).within(0.002);
    let (steps, pressure): (&[TripCause], &[TripCause]) = (&[TripCause::StepGenerator], &[TripCause::Pressure]);
    let unreachable = Injection::Order(to(Bend::from_deg(110.0, 0.0)));
    vec![
        refused("command_nan", nan, |r| r == Refusal::NotANumber, Bound::Continues, MOVING),
        refused("command_out_of_range", far, |r| r == Refusal::TooFar, Bound::Continues, MOVING),
        refused("command_contradictory", contradictory, |r| matches!(r, Refusal::Mode(_)), Bound::Copes, &["relaxing", "disarmed"]),
        Spec::new("emergency_stop", Injection::EmergencyStop, stop, Bound::Freezes, FAULTED).then_zero(),
        alarm("step_thread_underrun", Alarm::Underrun, steps, Bound::Holds),
        alarm("step_thread_silent", Alarm::Silent, steps, Bound::Holds),
        alarm("line_overpressure", Alarm::Pressure { kpa: 45.0 }, pressure, Bound::Copes),
        alarm("pressure_sensor_silent", Alarm::Pressure { kpa: f64::NAN }, pressure, Bound::Copes),
        alarm("tip_hot", Alarm::Hot { temp_c: 42.0 }, &[TripCause::Temperature], Bound::Holds),
        refused("command_unreachable", unreachable, |r| matches!(r, Refusal::Unreachable(_)), Bound::Continues, MOVING).within(0.002),
    ]
}

/// A stop in every situation; orders to move follow it a hundred times a second.
fn stops() -> Vec<Spec> {
    let stop = |name, situation, states| {
        let spec = Spec::new(name, Injection::Stop, Detector::Stopped, Bound::Brakes, states).within(0.002);
        Spec { situation, ..spec }
    };
    vec![
        stop("stop_in_motion", Situation::Moving, &["holding"]),
        stop("stop_while_held", Situation::Held, &["holding"]),
        stop("stop_while_relaxing", Situation::Relaxing, &["holding"]),
        stop("stop_while_the_gate_returns", Situation::Returning, FAULTED),
        stop("stop_while_calibrating", Situation::Calibrating, &["holding"]),
    ]
}

/// Faults of the IMU on a base that sways. Where it is lost, the loop goes on as without one.
fn base_imu_faults() -> Vec<Spec> {
    use HealthCause as Cause;
    use InjectedFault as Fault;
    let row = |name, fault: &'static Fault, lasts_s, causes| {
        let spec = Spec::new(name, Injection::Plant(Fault::OfBaseImu(fault), lasts_s), Detector::BaseImu(causes), Bound::Continues, MOVING);
        Spec { base_sway_deg: Some(5.0), ..spec.within(0.05) }
    };
    let out = row("base_imu_cable_out_in_turn", &Fault::SILENT, LASTING_S, &[Cause::StaleTimestamp]);
    let magnet = &Fault::HardIron { field_ut: [50.0, -40.0, 30.0] };
    vec![
        row("base_imu_silent", &Fault::SILENT, LASTING_S, &[Cause::StaleTimestamp]),
        row("base_imu_dropout", &Fault::SILENT, 0.3, &[Cause::StaleTimestamp]),
        row("base_imu_stuck", &Fault::FrozenSample, LASTING_S, &[Cause::Frozen]),
        row("base_imu_spike", &Fault::Spike { gyro_deg_s: 400.0, acc_g: 2.0 }, 0.05, &[Cause::Spike, Cause::Saturated]),
        row("base_imu_nan", &Fault::NanSample, LASTING_S, &[Cause::NotFinite]),
        row("base_imu_saturated", &Fault::Saturation, LASTING_S, &[Cause::Saturated, Cause::Spike]),
        row("base_imu_slow", &Fault::Slow { one_in: 50 }, LASTING_S, &[Cause::StaleTimestamp]),
        row("base_imu_magnet", magnet, LASTING_S, &[Cause::FieldDisturbed]).within(0.1),
        // the base stands before and after the turn, and is aligned again
        Spec { injection: Injection::CableOutInTurn, base_sway_deg: Some(0.0), bound: Bound::Copes, ..out.then_zero() },
    ]
}

fn environment_faults() -> Vec<Spec> {
    use SuspicionKind::{Burst, Contact, NoResponse, Strong, Weak};
    let push = Injection::Plant(InjectedFault::Push { bend_deg: 15.0, dir_deg: 0.0 }, LASTING_S);
    let pushed = Detector::Sensor(&[HealthCause::AccelDisturbed, HealthCause::Spike]);
    let magnet = Injection::Plant(InjectedFault::Magnet { field_ut: [40.0, -30.0, 20.0] }, LASTING_S);
    // about an axis that is neither the tip's nor perpendicular to it
    let base = |name, angle_deg| {
        let turn = InjectedFault::BaseTurn { axis: [0.3, 0.2, 1.0], angle_deg, over_s: 0.6 };
        Spec::new(name, Injection::Plant(turn, LASTING_S), Detector::Base, Bound::Copes, ANY).then_zero()
    };
    vec![
        plant("wall", InjectedFault::Wall { at_deg: 48.0, dir_deg: 80.0 }, &[Contact, NoResponse, Weak, Strong, Burst]),
        Spec::new("pushed", push, pushed, Bound::Copes, ANY).then_zero(),
        sensor("magnet", magnet, &[HealthCause::FieldDisturbed], Bound::Continues),
        // during a move, a small turn of the base cannot be distinguished from bending
        Spec { situation: Situation::Held, ..base("base_turned", 25.0) },
        base("base_turned_in_motion", 60.0),
    ]
}
