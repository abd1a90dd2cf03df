//! The safety gate: the last thing between the controller and the step generator.
//!
//! It is told what is wanted and what is felt, and lets the wanted counts through as long as every one
//! of its limits holds. The first that does not latches a [`TripCause`]; from then on the controller is not
//! listened to, and the gate itself brakes and stands, goes back to zero slowly, or releases the
//! drivers: whichever the board file names for the cause. Only [`Gate::reset`] opens it again.
//!
//! It shares nothing with the controller but the numbers it is handed, works from counts (what really
//! goes out) and keeps its own speeds: the counts of the last window against those of the window before,
//! `v = (n_k − n_{k−W})/W`, `a = (v_k − v_{k−W})/W`, each with the grain of one microstep allowed for.

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "what is no number is beyond every limit")]

use crate::primitives::units::Steps;
use serde::{Deserialize, Serialize};

/// What the gate can trip on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TripCause {
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The step generator raised an alarm.
    StepGenerator,
    /// A tick came too late.
    Late,
    /// Motion was wanted with the drivers not armed.
    Unarmed,
    /// A piston would leave its travel.
    Travel,
    /// A piston would be too fast.
    Rate,
    /// A piston would be pushed off too hard.
    Acceleration,
    /// A line would be compressed too far.
    Pressure,
    /// No usable orientation for too long.
    Stale,
    /// The two orientation filters disagree.
    Disagreement,
    /// The tip is not where it was led.
    Following,
}

/// How the gate leaves motion after a cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SafeState {
    /// Brake within the limits and stand, energised: the tip keeps its pressure.
    #[default]
    Hold,
    /// Brake, go back to zero slowly, then release.
    Relax,
    /// Release the drivers at once: the air pushes the pistons back.
    Release,
}

/// Limits and safe states; lengths in mm, angles in rad, times in s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GateLimits {
    /// Piston travel per microstep.
    pub step_mm: f64,
    /// Time of a tick that is in time.
    pub tick_s: f64,
    /// Greatest travel either way.
    pub travel_mm: f64,
    /// Greatest speed, mm/s.
    pub speed_mm_s: f64,
    /// Greatest acceleration, mm/s².
    pub acceleration_mm_s2: f64,
    /// Greatest length of air that a piston may compress or stretch (pressure over kPa per mm).
    pub squeeze_mm: f64,
    /// Greatest distance of the felt bend from the set-point at rest …
    pub following_rad: f64,
    /// … and more of it per rad/s of the set-point's recent speed …
    pub following_s: f64,
    /// … that may last no longer than this.
    pub following_for_s: f64,
    /// Greatest age of the last usable orientation.
    pub stale_s: f64,
    /// Greatest time between two ticks.
    pub late_s: f64,
    /// Braking of the gate's own, mm/s².
    pub brake_mm_s2: f64,
    /// Speed of the way back to zero, mm/s.
    pub relax_mm_s: f64,
    /// The safe state of every cause.
    pub on: SafeStates,
}

/// The safe state of every cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SafeStates {
    /// Emergency stop pressed. Default `release`.
    pub emergency_stop: SafeState,
    /// Alarm of the step generator. Default `hold`.
    pub step_generator: SafeState,
    /// Late tick. Default `hold`.
    pub late: SafeState,
    /// Motion while not armed. Default `hold`.
    pub unarmed: SafeState,
    /// Travel. Default `hold`.
    pub travel: SafeState,
    /// Speed. Default `hold`.
    pub rate: SafeState,
    /// Acceleration. Default `hold`.
    pub acceleration: SafeState,
    /// Pressure. Default `relax`.
    pub pressure: SafeState,
    /// Stale orientation. Default `hold`.
    pub stale: SafeState,
    /// Filters disagree. Default `hold`.
    pub disagreement: SafeState,
    /// Following error. Default `hold`.
    pub following: SafeState,
}

impl Default for SafeStates {
    fn default() -> Self {
        let hold = SafeState::Hold;
        Self {
            emergency_stop: SafeState::Release,
            step_generator: hold,
            late: hold,
            unarmed: hold,
            travel: hold,
            rate: hold,
            acceleration: hold,
            pressure: SafeState::Relax,
            stale: hold,
            disagreement: hold,
            following: hold,
        }
    }
}

impl SafeStates {
    /// The safe state of a cause.
    #[must_use]
    pub fn of(&self, cause: TripCause) -> SafeState {
        match cause {
            TripCause::EmergencyStop => self.emergency_stop,
            TripCause::StepGenerator => self.step_generator,
            TripCause::Late => self.late,
            TripCause::Unarmed => self.unarmed,
            TripCause::Travel => self.travel,
            TripCause::Rate => self.rate,
            TripCause::Acceleration => self.acceleration,
            TripCause::Pressure => self.pressure,
            TripCause::Stale => self.stale,
            TripCause::Disagreement => self.disagreement,
            TripCause::Following => self.following,
        }
    }
}

/// What the gate is told at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GateInput {
    /// Time since the last tick, s.
    pub dt_s: f64,
    /// Counts that the controller wants next.
    pub wanted: Steps,
    /// The drivers are armed.
    pub armed: bool,
    /// Bellow length changes that go with the felt bend, mm; `None` when nothing is felt.
    pub estimated_bellow_mm: Option<[f64; 3]>,
    /// Set-point less felt bend and the set-point itself, rad; `None` when there is nothing to follow.
    pub following: Option<Following>,
    /// Age of the last usable orientation, s.
    pub stale_s: f64,
    /// The two filters have disagreed for long.
    pub disagree: bool,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The step generator raised an alarm.
    pub alarm: bool,
}

/// Set-point and felt bend vectors, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Following {
    /// Where the tip is led.
    pub setpoint: [f64; 2],
    /// Where it is.
    pub estimate: [f64; 2],
}

/// What the gate lets through.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GateOutput {
    /// Counts to send.
    pub steps: Steps,
    /// The drivers may be on.
    pub energise: bool,
    /// What tripped in this very tick.
    pub tripped: Option<TripCause>,
    /// A way back to zero has ended.
    pub rested: bool,
}

/// What the gate does with the steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doing {
    Passing,
    Standing,
    Returning,
    Released,
}

/// Ticks of one window of the gate's own speeds.
const WINDOW: usize = 16;

/// The gate.
#[derive(Debug, Clone, PartialEq)]
pub struct Gate {
    limits: GateLimits,
    doing: Doing,
    latched: Option<TripCause>,
    /// Emergency stop and alarm in the tick before: what stays is said once.
    stood: [bool; 2],
    /// Counts let through, newest at `head`.
    sent: [Steps; 2 * WINDOW],
    /// Time that each took, s.
    took_s: [f64; 2 * WINDOW],
    head: usize,
    /// Where the gate's own motion stands.
    at_mm: [f64; 3],
    speed_mm_s: [f64; 3],
    setpoint: Option<[f64; 2]>,
    recent_rad_s: f64,
    astray_s: f64,
}

impl Gate {
    /// A gate that passes, with the pistons at rest at these counts.
    #[must_use]
    pub fn new(limits: &GateLimits, at: &Steps) -> Self {
        let mut gate = Self {
            limits: *limits,
            doing: Doing::Passing,
            latched: None,
            stood: [false; 2],
            sent: [*at; 2 * WINDOW],
            took_s: [limits.tick_s; 2 * WINDOW],
            head: 0,
            at_mm: [0.0; 3],
            speed_mm_s: [0.0; 3],
            setpoint: None,
            recent_rad_s: 0.0,
            astray_s: 0.0,
        };
        gate.settle(at);
        gate
    }

    /// What has tripped and was not reset.
    #[must_use]
    pub fn latched(&self) -> Option<TripCause> {
        self.latched
    }

    /// On its way back to zero.
    #[must_use]
    pub fn is_returning(&self) -> bool {
        self.doing == Doing::Returning
    }

    /// The gate moves by itself or has not come to rest yet.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.is_returning() || (self.doing == Doing::Standing && self.speed_mm_s != [0.0; 3])
    }

    /// Forgets the cause and passes again, with the pistons at rest at these counts.
    pub fn reset(&mut self, at: &Steps) {
        self.latched = None;
        self.doing = Doing::Passing;
        self.settle(at);
    }

    /// The step generator came to rest at these counts, whatever it was sent. A latched cause stays latched.
    pub fn recount(&mut self, at: &Steps) {
        self.settle(at);
        self.at_mm = at.0.map(|n| f64::from(n) * self.limits.step_mm);
    }

    /// Brakes and goes back to zero slowly. A latched cause stays latched.
    pub fn relax(&mut self) {
        self.take_over();
        self.doing = Doing::Returning;
    }

    /// Brakes and stands. A latched cause stays latched.
    pub fn stand(&mut self) {
        self.take_over();
        self.doing = Doing::Standing;
    }

    /// One tick.
    pub fn pass(&mut self, told: &GateInput) -> GateOutput {
        self.follow_setpoint(told);
        let tripped = self.judge(told);
        if let Some(cause) = tripped {
            self.latched = Some(self.latched.unwrap_or(cause));
            self.take_over();
            self.doing = match (self.doing, self.limits.on.of(cause)) {
                // drivers that were let go are not switched on again by a milder cause
                (Doing::Released, _) | (_, SafeState::Release) => Doing::Released,
                (_, SafeState::Hold) => Doing::Standing,
                (_, SafeState::Relax) => Doing::Returning,
            };
        }
        self.stood = [told.emergency_stop, told.alarm];
        let mut rested = false;
        match self.doing {
            Doing::Passing => self.send(told.wanted, told.dt_s),
            Doing::Standing => self.go(told.dt_s, |_, _| 0.0),
            Doing::Returning => {
                let GateLimits { brake_mm_s2, relax_mm_s, .. } = self.limits;
                self.go(told.dt_s, |at_mm, dt_s| {
                    let to_go = at_mm.abs();
                    -at_mm.signum() * relax_mm_s.min((brake_mm_s2 * to_go).sqrt()).min(to_go / dt_s)
                });
                rested = self.arrive();
            }
            Doing::Released => self.speed_mm_s = [0.0; 3],
        }
        GateOutput { steps: self.sent[self.head], energise: self.doing != Doing::Released, tripped, rested }
    }

    /// The first limit that does not hold. What the machine complains of counts at any time, what the
    /// controller wants only while it is listened to.
    fn judge(&self, told: &GateInput) -> Option<TripCause> {
        // while it passes nothing bad may stand; afterwards what is new counts
        let passing = self.doing == Doing::Passing;
        let bad = [told.emergency_stop && (passing || !self.stood[0]), told.alarm && (passing || !self.stood[1])];
        let causes = [TripCause::EmergencyStop, TripCause::StepGenerator];
        let broken = causes.into_iter().zip(bad).find(|(_, bad)| *bad).map(|(cause, _)| cause);
        if !passing {
            return broken;
        }
        // what is no number is late, too
        let late = !(told.dt_s <= self.limits.late_s);
        let blind = told.armed && told.stale_s > self.limits.stale_s;
        let torn = told.armed && told.disagree;
        let astray = told.armed && self.astray_s > self.limits.following_for_s;
        broken
            .or_else(|| late.then_some(TripCause::Late))
            .or_else(|| self.judge_motion(told))
            .or_else(|| blind.then_some(TripCause::Stale))
            .or_else(|| torn.then_some(TripCause::Disagreement))
            .or_else(|| astray.then_some(TripCause::Following))
    }

    /// What is wrong with the counts that are wanted.
    fn judge_motion(&self, told: &GateInput) -> Option<TripCause> {
        let l = &self.limits;
        let last = self.sent[self.head];
        if !told.armed {
            return (told.wanted != last).then_some(TripCause::Unarmed);
        }
        for i in 0..3 {
            let at_mm = f64::from(told.wanted.0[i]) * l.step_mm;
            if at_mm.abs() > l.travel_mm {
                return Some(TripCause::Travel);
            }
            let (speed, acceleration) = self.motion(i, told);
            if speed.over(l.speed_mm_s) {
                return Some(TripCause::Rate);
            }
            if acceleration.over(l.acceleration_mm_s2) {
                return Some(TripCause::Acceleration);
            }
            if let Some(estimate) = told.estimated_bellow_mm
                && (at_mm - estimate[i]).abs() > l.squeeze_mm
                && told.wanted.0[i] != last.0[i]
            {
                return Some(TripCause::Pressure);
            }
        }
        None
    }

    /// Speed over the last window and its change since the one before, with their grain.
    fn motion(&self, i: usize, told: &GateInput) -> (Grained, Grained) {
        let (mid, old) = (self.back(WINDOW - 1), self.back(2 * WINDOW - 1));
        let mm = |a: i32, b: i32| (f64::from(a) - f64::from(b)) * self.limits.step_mm;
        let now_s = told.dt_s + self.took(0, WINDOW - 1);
        let then_s = self.took(WINDOW - 1, 2 * WINDOW - 1);
        let (now, then) = (mm(told.wanted.0[i], self.sent[mid].0[i]) / now_s, mm(self.sent[mid].0[i], self.sent[old].0[i]) / then_s);
        let (now_grain, then_grain) = (self.limits.step_mm / now_s, self.limits.step_mm / then_s);
        let between_s = (now_s + then_s) / 2.0;
        let acceleration = Grained { value: (now - then) / between_s, grain: (now_grain + then_grain) / between_s };
        (Grained { value: now, grain: now_grain }, acceleration)
    }

    fn back(&self, ticks: usize) -> usize {
        (self.head + self.sent.len() - ticks) % self.sent.len()
    }

    /// Time that the ticks from `from` to before `to` ticks back took, s.
    fn took(&self, from: usize, to: usize) -> f64 {
        (from..to).map(|k| self.took_s[self.back(k)]).sum()
    }

    /// How long the felt bend has been further from the set-point than its speed explains.
    fn follow_setpoint(&mut self, told: &GateInput) {
        let Some(Following { setpoint, estimate }) = told.following else {
            (self.setpoint, self.recent_rad_s, self.astray_s) = (None, 0.0, 0.0);
            return;
        };
        let from = self.setpoint.replace(setpoint).unwrap_or(setpoint);
        let speed = distance(&setpoint, &from) / told.dt_s;
        self.recent_rad_s = speed.max(self.recent_rad_s * (-told.dt_s / self.limits.following_s).exp());
        let allowed = self.limits.following_rad + self.limits.following_s * self.recent_rad_s;
        // what is no number is no bend either
        let follows = distance(&setpoint, &estimate) <= allowed;
        self.astray_s = if follows { 0.0 } else { self.astray_s + told.dt_s };
    }

    /// From here on the gate moves by itself, starting with the speed that there is.
    fn take_over(&mut self) {
        if self.doing != Doing::Passing {
            return;
        }
        let window_s = self.took(0, WINDOW);
        let (now, then) = (self.sent[self.head], self.sent[self.back(WINDOW)]);
        for i in 0..3 {
            self.at_mm[i] = f64::from(now.0[i]) * self.limits.step_mm;
            self.speed_mm_s[i] = f64::from(now.0[i] - then.0[i]) * self.limits.step_mm / window_s;
        }
    }

    /// Own motion: each piston towards the speed that is wanted where it is.
    fn go(&mut self, dt_s: f64, wanted: impl Fn(f64, f64) -> f64) {
        // a late tick is no reason for a jump
        let dt_s = dt_s.max(0.0).min(self.limits.tick_s * 2.0);
        let change = self.limits.brake_mm_s2 * dt_s;
        for i in 0..3 {
            let v = self.speed_mm_s[i];
            self.speed_mm_s[i] = v + (wanted(self.at_mm[i], dt_s) - v).clamp(-change, change);
            let at_mm = self.at_mm[i] + self.speed_mm_s[i] * dt_s;
            self.at_mm[i] = at_mm.clamp(-self.limits.travel_mm, self.limits.travel_mm);
        }
        let steps = self.at_mm.map(|mm| (mm / self.limits.step_mm).round() as i32);
        self.send(Steps(steps), dt_s);
    }

    /// Once no piston is a step from zero they are at zero; true then, and released.
    fn arrive(&mut self) -> bool {
        let there = self.sent[self.head] == Steps::default();
        if there {
            self.speed_mm_s = [0.0; 3];
            self.at_mm = [0.0; 3];
            self.doing = Doing::Released;
        }
        there
    }

    fn send(&mut self, steps: Steps, dt_s: f64) {
        self.head = (self.head + 1) % self.sent.len();
        self.sent[self.head] = steps;
        self.took_s[self.head] = dt_s.max(0.0);
    }

    /// At rest here for as long as it remembers.
    fn settle(&mut self, at: &Steps) {
        self.sent = [*at; 2 * WINDOW];
        self.took_s = [self.limits.tick_s; 2 * WINDOW];
        self.speed_mm_s = [0.0; 3];
        (self.setpoint, self.recent_rad_s, self.astray_s) = (None, 0.0, 0.0);
    }
}

/// A quotient of counts, and what one count makes of it.
#[derive(Debug, Clone, Copy)]
struct Grained {
    value: f64,
    grain: f64,
}

impl Grained {
    /// Beyond the limit by more than its grain explains; what is no number is.
    fn over(self, limit: f64) -> bool {
        !(self.value.abs() - self.grain <= limit)
    }
}

fn distance(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
