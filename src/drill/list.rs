//! The faults that strike in flight: what is done, what notices it, what is promised.

use crate::control::tick::Command;
use crate::drill::bench::{Bench, bend};
use crate::estimation::fusion::health::{HealthCause, ReadFault as Bus};
use crate::model::bend::Bend;
use crate::primitives::units::Mm;
use crate::simulation::plant::{Channel, InjectedFault};
use crate::supervisor::cycle::CycleOutput;
use crate::supervisor::cycle::order::{Order, Refusal};
use crate::supervisor::gate;
use crate::supervisor::machine::Alarm;
use crate::supervisor::residual_monitor::SuspicionKind;

/// What strikes.
#[derive(Debug, Clone, Copy)]
pub enum Strike {
    /// Transfers fail, for so long (s).
    Bus(Bus, f64),
    /// Something in the plant, for so long (s).
    Plant(InjectedFault, f64),
    /// The loop is kept from running, s.
    Stall(f64),
    /// Sensor stamps leap, s, for so long (s).
    Clock(f64, f64),
    /// The emergency stop is pressed.
    Press,
    /// The step thread complains.
    Alarm(Alarm),
    /// An order that must be refused.
    Order(Order),
    /// An order, and in the next turn one against it.
    Orders(Order, Order),
}

/// What counts as noticed.
#[derive(Debug, Clone, Copy)]
pub enum Notice {
    /// One of these causes against the sensor.
    Senses(&'static [HealthCause]),
    /// One of these suspicions, a trip, or a tip that was shaken.
    Words(&'static [SuspicionKind]),
    /// One of these trips.
    Trip(&'static [gate::TripCause]),
    /// A turn that came late.
    LateTurn,
    /// The order is refused.
    Refused(fn(Refusal) -> bool),
    /// The sensor's own bias is seen to have moved, or one of these causes is raised.
    Bias,
    /// The base is seen to have moved.
    Base,
}

/// What is promised afterwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Promise {
    /// It goes on as if nothing had been: no more steps than the move needs.
    GoesOn,
    /// It holds: no more steps than braking needs.
    Holds,
    /// It holds, or it goes on within what the move and its correction need.
    Copes,
    /// Nothing at all goes out any more.
    Freezes,
}

/// One fault in flight.
pub struct Spec {
    /// Name of the row.
    pub name: &'static str,
    /// What strikes.
    pub strike: Strike,
    /// What notices.
    pub notice: Notice,
    /// What is promised.
    pub predicted_gain: Promise,
    /// States that are right at the end.
    pub states: &'static [&'static str],
    /// The rest has to be found again before the next pose.
    pub zero: bool,
    /// A rack has to be put back to its mark by hand first.
    pub by_hand: bool,
    /// Where the move goes that it strikes: bend and direction, degrees.
    pub to: (f64, f64),
    /// It strikes once the tip holds that pose, not on the way to it.
    pub held: bool,
}

const TWO: Channel = Channel::Two;
const LASTS: f64 = 10.0;
const GOES: &[&str] = &["holding", "tracking"];
const HOLD: &[&str] = &["holding", "faulted"];
const FAULT: &[&str] = &["faulted"];

/// Every row that strikes in flight, in the order of the list of claims.
#[must_use]
pub fn specs() -> Vec<Spec> {
    let row = |name, strike, notice, predicted_gain, states, zero| Spec {
        name,
        strike,
        notice,
        predicted_gain,
        states,
        zero,
        by_hand: false,
        to: (68.0, 80.0),
        held: false,
    };
    let senses = |name, strike, causes, predicted_gain, states| row(name, strike, Notice::Senses(causes), predicted_gain, states, false);
    let words = |name, fault, kinds, zero| {
        row(name, Strike::Plant(fault, LASTS), Notice::Words(kinds), Promise::Copes, &["holding", "tracking", "faulted"], zero)
    };
    let by_hand = |spec: Spec| Spec { by_hand: true, ..spec };
    let far_out = |spec: Spec| Spec { to: (78.0, 62.0), by_hand: true, ..spec };
    let blind = &[HealthCause::Nack, HealthCause::StuckBus, HealthCause::ShortRead, HealthCause::StaleTimestamp];
    let far = Command { bend: Bend::from_deg(170.0, 0.0), length: Mm(20.0) };
    let nan = Command { bend: Bend([f64::NAN, 0.1].into()), length: Mm(20.0) };
    let spike = InjectedFault::Spike { gyro_deg_s: 400.0, acc_g: 2.0 };
    vec![
        senses("i2c_nack", Strike::Bus(Bus::Nack, 0.02), blind, Promise::GoesOn, GOES),
        senses("i2c_stuck", Strike::Bus(Bus::Bus, LASTS), blind, Promise::Holds, HOLD),
        senses("i2c_wrong_id", Strike::Bus(Bus::WrongId, LASTS), &[HealthCause::WrongId], Promise::Holds, HOLD),
        senses("i2c_brown_out", Strike::Bus(Bus::BrownOut, LASTS), &[HealthCause::BrownOut], Promise::Holds, HOLD),
        senses("sample_frozen", Strike::Plant(InjectedFault::FrozenSample, LASTS), &[HealthCause::Frozen], Promise::Holds, HOLD),
        senses("sample_nan", Strike::Plant(InjectedFault::NanSample, LASTS), &[HealthCause::NotFinite], Promise::Holds, HOLD),
        senses("sample_spike", Strike::Plant(spike, 0.05), &[HealthCause::Spike, HealthCause::Saturated], Promise::GoesOn, GOES),
        senses(
            "sample_saturated",
            Strike::Plant(InjectedFault::Saturation, LASTS),
            &[HealthCause::Saturated, HealthCause::Spike],
            Promise::Holds,
            HOLD,
        ),
        row(
            "sample_biased",
            Strike::Plant(InjectedFault::GyroBias { deg_s: [2.0, -2.0, 1.0] }, LASTS),
            Notice::Bias,
            Promise::Copes,
            &["holding", "tracking", "faulted"],
            true,
        ),
        by_hand(words(
            "step_loss",
            InjectedFault::StepLoss { channel: TWO, microsteps: 160 },
            &[SuspicionKind::LostSteps, SuspicionKind::Weak, SuspicionKind::Leak, SuspicionKind::Contact],
            true,
        )),
        by_hand(words(
            "dir_inverted",
            InjectedFault::Inverted { channel: TWO },
            &[SuspicionKind::Inverted, SuspicionKind::NoResponse],
            true,
        )),
        by_hand(words("en_stuck", InjectedFault::Disabled { channel: TWO }, &[SuspicionKind::NoResponse, SuspicionKind::Weak], true)),
        far_out(words(
            "end_stop",
            InjectedFault::EndStop { channel: TWO, at_mm: 11.5 },
            &[SuspicionKind::NoResponse, SuspicionKind::Weak],
            true,
        )),
        words("leak", InjectedFault::Leak { channel: TWO, rate_per_s: 0.1 }, &[SuspicionKind::Leak, SuspicionKind::Weak], true),
        words("burst", InjectedFault::Burst { channel: TWO }, &[SuspicionKind::Burst, SuspicionKind::NoResponse], true),
        words("air_bubble", InjectedFault::AirBubble { channel: TWO, factor: 1.8 }, &[SuspicionKind::Weak, SuspicionKind::Leak], true),
        words("blocked_line", InjectedFault::Blocked { channel: TWO }, &[SuspicionKind::NoResponse, SuspicionKind::Weak], true),
        words(
            "gain_half",
            InjectedFault::Gain { channel: TWO, factor: 0.5 },
            &[SuspicionKind::Weak, SuspicionKind::Burst, SuspicionKind::NoResponse],
            true,
        ),
        words("gain_double", InjectedFault::Gain { channel: TWO, factor: 2.0 }, &[SuspicionKind::Strong], true),
        row("stall_1ms", Strike::Stall(0.001), Notice::LateTurn, Promise::GoesOn, GOES, false),
        row("stall_10ms", Strike::Stall(0.01), Notice::LateTurn, Promise::GoesOn, GOES, false),
        row("stall_100ms", Strike::Stall(0.1), Notice::Trip(&[gate::TripCause::Late]), Promise::Holds, FAULT, false),
        senses(
            "clock_jump",
            Strike::Clock(10.0, LASTS),
            &[HealthCause::JumpingTimestamp, HealthCause::StaleTimestamp],
            Promise::Holds,
            HOLD,
        ),
        row(
            "command_nan",
            Strike::Order(Order::Bend(nan, None)),
            Notice::Refused(|r| r == Refusal::NotANumber),
            Promise::GoesOn,
            GOES,
            false,
        ),
        row(
            "command_out_of_range",
            Strike::Order(Order::Bend(far, None)),
            Notice::Refused(|r| r == Refusal::TooFar),
            Promise::GoesOn,
            GOES,
            false,
        ),
        row(
            "command_contradictory",
            Strike::Orders(Order::Relax, bend(40.0, 0.0)),
            Notice::Refused(|r| matches!(r, Refusal::Mode(_))),
            Promise::Copes,
            &["relaxing", "disarmed"],
            false,
        ),
        row("emergency_stop", Strike::Press, Notice::Trip(&[gate::TripCause::EmergencyStop]), Promise::Freezes, FAULT, true),
        row(
            "step_thread_underrun",
            Strike::Alarm(Alarm::Underrun),
            Notice::Trip(&[gate::TripCause::StepGenerator]),
            Promise::Holds,
            FAULT,
            false,
        ),
        words(
            "wall",
            InjectedFault::Wall { at_deg: 48.0, dir_deg: 80.0 },
            &[SuspicionKind::Contact, SuspicionKind::NoResponse, SuspicionKind::Weak, SuspicionKind::Strong, SuspicionKind::Burst],
            false,
        ),
        row(
            "pushed",
            Strike::Plant(InjectedFault::Push { bend_deg: 15.0, dir_deg: 0.0 }, LASTS),
            Notice::Senses(&[HealthCause::AccelDisturbed, HealthCause::Spike]),
            Promise::Copes,
            &["holding", "tracking", "faulted"],
            true,
        ),
        senses(
            "magnet",
            Strike::Plant(InjectedFault::Magnet { field_ut: [40.0, -30.0, 20.0] }, LASTS),
            &[HealthCause::FieldDisturbed],
            Promise::GoesOn,
            GOES,
        ),
        // on the way a turn that looks like bending is told from a taut cable by no one
        Spec { held: true, ..base_turned("base_turned", 25.0, 0.6) },
        base_turned("base_turned_in_motion", 60.0, 0.6),
    ]
}

/// Somebody turns the base, about an axis that is neither the tip's nor across it.
fn base_turned(name: &'static str, angle_deg: f64, over_s: f64) -> Spec {
    Spec {
        name,
        strike: Strike::Plant(InjectedFault::BaseTurn { axis: [0.3, 0.2, 1.0], angle_deg, over_s }, LASTS),
        notice: Notice::Base,
        predicted_gain: Promise::Copes,
        states: &["holding", "tracking", "faulted"],
        zero: true,
        by_hand: false,
        to: (68.0, 80.0),
        held: false,
    }
}

impl Strike {
    /// Breaks it. The order for this turn, and for the next.
    pub fn strike(&self, bench: &mut Bench) -> (Option<Order>, Option<Order>) {
        let machine = &mut bench.runner.machine;
        match *self {
            Self::Bus(fault, _) => machine.bus = Some(fault),
            Self::Plant(fault, _) => machine.inject(fault),
            Self::Stall(seconds) => bench.stall(seconds),
            Self::Clock(seconds, _) => machine.stamps_off_s = seconds,
            Self::Press => machine.pressed = true,
            Self::Alarm(alarm) => machine.alarm = Some(alarm),
            Self::Order(order) => return (Some(order), None),
            Self::Orders(first, second) => return (Some(first), Some(second)),
        }
        (None, None)
    }

    /// How long it lasts before it passes by itself, s.
    #[must_use]
    pub fn lasts_s(&self) -> f64 {
        match *self {
            Self::Bus(_, s) | Self::Plant(_, s) | Self::Clock(_, s) => s,
            _ => f64::INFINITY,
        }
    }
}

impl Notice {
    /// Whether this turn notices; what is said then.
    #[must_use]
    pub fn sees(&self, turned: &CycleOutput) -> Option<String> {
        let trip = |causes: &[gate::TripCause]| {
            turned.tripped.filter(|c| causes.is_empty() || causes.contains(c)).map(|c| crate::service::status::words(c).to_owned())
        };
        match self {
            Self::Senses(causes) => {
                let found = causes.iter().find(|c| turned.raised.contains(**c))?;
                Some(format!("{found}: {}", found.advice()))
            }
            Self::Words(_) => match turned.suspicion.filter(|_| turned.suspects) {
                Some(s) => Some(s.to_string()),
                None => trip(&[]).or_else(|| {
                    turned.raised.contains(HealthCause::AccelDisturbed).then(|| HealthCause::AccelDisturbed.advice().to_owned())
                }),
            },
            Self::Trip(causes) => trip(causes),
            Self::LateTurn => (turned.dt_s > 0.0015).then(|| format!("a turn came {:.0} ms late", (turned.dt_s - 1e-3) * 1e3)),
            Self::Refused(right) => match turned.answer {
                Some(Err(refusal)) if right(refusal) => Some(refusal.to_string()),
                _ => None,
            },
            Self::Bias => {
                let seen = turned.bias_moved.then(|| "the gyroscope's bias has moved since the rest: `zero` when convenient".to_owned());
                seen.or_else(|| turned.frame.senses.disagrees.then(|| "the two orientation filters disagree".to_owned()))
                    .or_else(|| (!turned.raised.is_empty()).then(|| turned.raised.to_string()))
            }
            Self::Base => {
                let moved = turned.frame.base_moved.then(|| "the base has turned: relax, then zero".to_owned());
                moved.or_else(|| turned.suspicion.filter(|_| turned.suspects).map(|s| s.to_string())).or_else(|| trip(&[]))
            }
        }
    }

    /// Whether what is suspected in the end is one of what it may be called.
    #[must_use]
    pub fn names_it(&self, turned: &CycleOutput) -> bool {
        match (self, &turned.suspicion) {
            (Self::Words(kinds), Some(s)) => kinds.contains(&s.kind),
            _ => true,
        }
    }
}
