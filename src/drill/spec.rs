//! One fault in flight: how it is injected, what must detect it, and what is allowed afterwards.

use crate::drill::bench::Bench;
use crate::named;
use crate::primitives::ReadFault;
use crate::simulation::plant::Plant;
use crate::supervisor::{
    Alarm, CauseSet, CycleOutput, HealthCause, Mode, Order, Refusal, SuspicionKind, TripCause,
};

/// Longest time until a detection unless a row states its own, s: the whole observation.
const WITHIN_S: f64 = 7.0;

/// What is injected.
#[derive(Debug, Clone, Copy)]
pub enum Injection {
    /// Every transfer fails for this long, s.
    Bus(ReadFault, f64),
    /// A fault of the plant, for this long, s.
    Plant(fn(&mut Plant), f64),
    /// The loop is delayed by this time, s.
    Stall(f64),
    /// Sensor time stamps jump by the first number, for as long as the second, s.
    ClockJump(f64, f64),
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The step thread raises an alarm.
    Alarm(Alarm),
    /// An order, and in the next cycle a contradictory one, if there is one.
    Orders(Order, Option<Order>),
    /// A stop, followed by orders to move as long as it is observed.
    Stop,
}

/// What counts as detection.
#[derive(Debug, Clone, Copy)]
pub enum Detector {
    /// One of these causes against the sensor.
    Sensor(&'static [HealthCause]),
    /// A suspicion of the residual monitor, a trip, or an acceleration of the tip. If there is a suspicion in the end,
    /// it must be one of these.
    Residual(&'static [SuspicionKind]),
    /// One of these trips.
    Trip(&'static [TripCause]),
    /// A late cycle.
    LateCycle,
    /// The latch of a stop.
    Stopped,
    /// The refusal of the order.
    Refusal(fn(Refusal) -> bool),
    /// A moved gyroscope bias, or any cause against the sensor.
    Bias,
    /// A moved base, a suspicion or a trip.
    Base,
    /// One of these causes against the IMU on the base.
    BaseImu(&'static [HealthCause]),
}

named! {
    /// Bound on the microsteps after the detection.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Bound {
        /// The move continues: what it needs.
        Continues = "the move continues",
        /// The pistons are held: what braking needs.
        Holds = "the pistons are held",
        /// The pistons are held or the move continues with a correction.
        Copes = "the pistons are held or the move is corrected",
        /// What braking needs, with the sensor in order.
        Brakes = "the pistons brake",
        /// No microstep at all.
        Freezes = "the pistons stand",
    }
}

/// One fault in flight.
#[derive(Debug, Clone, Copy)]
pub struct Spec {
    /// Name of the row.
    pub name: &'static str,
    /// The fault.
    pub injection: Injection,
    /// What must detect it.
    pub detector: Detector,
    /// Microsteps allowed after the detection.
    pub bound: Bound,
    /// Allowed final states.
    pub states: &'static [&'static str],
    /// The rest pose must be aligned again before the next pose.
    pub zero: bool,
    /// A rack must be put back to its mark by hand.
    pub by_hand: bool,
    /// Bend and direction of the move during which the fault is injected, degrees.
    pub target: (f64, f64),
    /// Mode in which it is injected: in a move, at a held pose, on the return to rest, on the return of a gate that has tripped,
    /// or in a calibration.
    pub mode: Mode,
    /// Longest time until the detection, s.
    pub within_s: f64,
    /// The base carries an IMU, and sways by so much, degrees.
    pub base_sway_deg: Option<f64>,
}

impl Spec {
    /// A fault in the middle of the standard move.
    pub fn new(
        name: &'static str,
        injection: Injection,
        detector: Detector,
        bound: Bound,
        states: &'static [&'static str],
    ) -> Self {
        Self {
            name,
            injection,
            detector,
            bound,
            states,
            zero: false,
            by_hand: false,
            target: (68.0, 80.0),
            mode: Mode::Tracking,
            within_s: WITHIN_S,
            base_sway_deg: None,
        }
    }

    /// With a bound of its own on the time until the detection, s.
    pub fn within(self, within_s: f64) -> Self {
        Self { within_s, ..self }
    }

    /// What the row requires, in words.
    pub fn words(&self, steps: i64, after_deg: f64) -> String {
        let (within_s, bound, states) = (self.within_s, self.bound, self.states.join(" or "));
        format!(
            "detected within {within_s} s; then {bound}, at most {steps} microsteps; ends {states}; next pose within {after_deg}°"
        )
    }

    /// With a new alignment before the next pose.
    pub fn then_zero(self) -> Self {
        Self { zero: true, ..self }
    }

    /// With another bend and direction of the move, degrees.
    pub fn toward(self, bend_deg: f64, dir_deg: f64) -> Self {
        let target = (bend_deg, dir_deg);
        Self { target, ..self }
    }

    /// With another mode.
    pub fn when(self, mode: Mode) -> Self {
        Self { mode, ..self }
    }

    /// With a rack put back by hand.
    pub fn by_hand(self) -> Self {
        Self {
            by_hand: true,
            ..self
        }
    }

    /// With an IMU on a base that sways by so much, degrees.
    pub fn on_swaying_base(mut self, sway_deg: f64) -> Self {
        self.base_sway_deg = Some(sway_deg);
        self
    }
}

impl Injection {
    /// Injects the fault. Returns the orders for this cycle and the next.
    pub fn apply(&self, bench: &mut Bench) -> [Option<Order>; 2] {
        let machine = &mut bench.runner.machine;
        match *self {
            Self::Bus(fault, _) => machine.bus = Some(fault),
            Self::Plant(inject, _) => inject(machine.plant()),
            Self::Stall(seconds) => bench.now_s += seconds,
            Self::ClockJump(seconds, _) => machine.stamp_offset_s = seconds,
            Self::EmergencyStop => machine.emergency_stop = true,
            Self::Alarm(alarm) => machine.alarm = Some(alarm),
            Self::Orders(first, second) => return [Some(first), second],
            Self::Stop => return [Some(Order::Stop), None],
        }
        [None, None]
    }

    /// Time until the fault ends by itself, s.
    pub fn duration_s(&self) -> f64 {
        match *self {
            Self::Bus(_, s) | Self::Plant(_, s) | Self::ClockJump(_, s) => s,
            _ => f64::INFINITY,
        }
    }
}

impl Detector {
    /// The message of a cycle that detects the fault.
    pub fn detects(&self, output: &CycleOutput) -> Option<String> {
        let said = |met: bool, text: &str| met.then(|| text.to_owned());
        let suspicion = || Some(output.suspicion.filter(|_| output.suspects)?.to_string());
        let trip = |causes: &[TripCause]| {
            let among = |cause: &TripCause| causes.is_empty() || causes.contains(cause);
            Some(output.tripped.filter(among)?.advice().to_owned())
        };
        let raised = |raised: CauseSet, causes: &[HealthCause], of: &str| {
            let found = causes.iter().find(|c| raised.contains(**c))?;
            Some(format!("{of}{found}: {}", found.advice()))
        };
        let bias = "the gyroscope bias has changed since the alignment: `zero` when convenient";
        match self {
            Self::Sensor(causes) => raised(output.raised, causes, ""),
            Self::Residual(_) => suspicion().or_else(|| trip(&[])).or_else(|| {
                let shaken = HealthCause::AccelDisturbed;
                said(output.raised.contains(shaken), shaken.advice())
            }),
            Self::BaseImu(causes) => raised(output.base_raised, causes, "IMU on the base, "),
            Self::Trip(causes) => trip(causes),
            Self::Stopped => said(output.stopped, "stopped: `retroflex arm` first"),
            Self::LateCycle => {
                let late_ms = (output.dt_s - 1e-3) * 1e3;
                (output.dt_s > 0.0015).then(|| format!("a cycle came {late_ms:.0} ms late"))
            }
            Self::Refusal(expected) => {
                let refusal = output.answer?.err().filter(|refusal| expected(*refusal))?;
                Some(refusal.to_string())
            }
            Self::Bias if output.bias_moved => said(true, bias),
            Self::Bias if output.frame.senses.disagrees => {
                said(true, "the two orientation filters disagree")
            }
            Self::Bias => (!output.raised.is_empty()).then(|| output.raised.to_string()),
            Self::Base => {
                let moved = output.frame.base_moved;
                let turned = said(moved, "the base has turned: relax, then zero");
                turned.or_else(suspicion).or_else(|| trip(&[]))
            }
        }
    }

    /// True unless the final suspicion names something else.
    pub fn accepts(&self, output: &CycleOutput) -> bool {
        match (self, &output.suspicion) {
            (Self::Residual(kinds), Some(s)) => kinds.contains(&s.kind),
            _ => true,
        }
    }
}
