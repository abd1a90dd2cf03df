//! The safety gate between the controller and the step generator.
//!
//! The gate passes the requested counts while all of its limits hold. The first violated limit latches a
//! [`TripCause`]. From then on the gate ignores the controller and either brakes and stands, returns to zero slowly, or
//! releases the drivers, as the board file states for the cause. Only [`Gate::reset`] clears the latch.
//!
//! The gate shares no state with the controller. It judges the requested position before it is sent, and speed and
//! acceleration on the counts that the machine reports: the machine paces the way to a request itself. The gate's own
//! motion begins at the counted position with the counted speed.

#![allow(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "NaN is outside every limit"
)]

mod following;
mod history;
mod limits;

pub use following::Following;
pub use limits::{GateLimits, SafeState, SafeStates, TripCause};

use crate::primitives::{Steps, lasting};
use following::FollowingError;
use history::History;

/// Input of the gate at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GateInput {
    /// Time since the last tick, s.
    pub dt_s: f64,
    /// Counts requested by the controller.
    pub wanted: Steps,
    /// Counts reported by the machine.
    pub counted: Steps,
    /// Age of these counts, s.
    pub counted_age_s: f64,
    /// The drivers are armed.
    pub armed: bool,
    /// Bellow length changes at the estimated bend, mm; `None` without an estimate.
    pub estimated_bellow_mm: Option<[f64; 3]>,
    /// Set-point and estimate; `None` if the tip need not follow.
    pub following: Option<Following>,
    /// Age of the last usable orientation, s.
    pub stale_s: f64,
    /// The two orientation filters have disagreed for long.
    pub disagree: bool,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The step generator reports an alarm.
    pub alarm: bool,
    /// A sensor measures too much pressure, or does not answer.
    pub overpressure: bool,
    /// The tip is too hot.
    pub hot: bool,
}

/// Output of the gate at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GateOutput {
    /// Counts to send.
    pub steps: Steps,
    /// The drivers may be energised.
    pub energise: bool,
    /// Cause of a trip in this tick.
    pub tripped: Option<TripCause>,
    /// A return to zero ended in this tick.
    pub rested: bool,
}

/// What determines the counts that the gate sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Motion {
    /// The controller's requests pass.
    Passing,
    /// The gate brakes and returns the pistons to the controller afterwards.
    Braking,
    /// The gate brakes and stands.
    Standing,
    /// The gate returns to zero.
    Returning,
    /// The drivers are released.
    Released,
}

/// The safety gate.
#[derive(Debug, Clone, PartialEq)]
pub struct Gate {
    limits: GateLimits,
    motion: Motion,
    latched: Option<TripCause>,
    /// Emergency stop, alarm and overpressure in the previous tick: a lasting one trips a gate that does not pass only once.
    reported: [bool; 3],
    /// Counted steps of the last ticks.
    history: History,
    /// Counts sent last.
    sent: Steps,
    /// Time for which the machine has counted what was sent, s.
    agreed_s: f64,
    /// Position of the gate's own motion, mm.
    at_mm: [f64; 3],
    speed_mm_s: [f64; 3],
    following: FollowingError,
}

impl Gate {
    /// A gate that passes, with the pistons at rest at these counts.
    pub fn new(limits: &GateLimits, at: &Steps) -> Self {
        Self {
            limits: *limits,
            motion: Motion::Passing,
            latched: None,
            reported: [false; 3],
            history: History::resting(at, limits),
            sent: *at,
            agreed_s: 0.0,
            at_mm: [0.0; 3],
            speed_mm_s: [0.0; 3],
            following: FollowingError::default(),
        }
    }

    /// The first cause since the last reset.
    pub fn latched(&self) -> Option<TripCause> {
        self.latched
    }

    /// True during a return to zero.
    pub fn is_returning(&self) -> bool {
        self.motion == Motion::Returning
    }

    /// True from [`Gate::brake`] until [`Gate::hand_over`], unless something else intervenes.
    pub fn is_braking(&self) -> bool {
        self.motion == Motion::Braking
    }

    /// True while the gate moves the pistons itself.
    pub fn is_busy(&self) -> bool {
        self.is_returning()
            || self.is_braking()
            || (self.motion == Motion::Standing && self.speed_mm_s != [0.0; 3])
    }

    /// True once the machine has counted what was sent for longer than a motion that is on its way can hide: right after a
    /// set-point has changed, the counts are still where they were.
    pub fn rests(&self) -> bool {
        self.agreed_s > self.limits.rest_s
    }

    /// Clears the latched cause and passes again, with the pistons at rest at these counts.
    pub fn reset(&mut self, at: &Steps) {
        self.latched = None;
        self.motion = Motion::Passing;
        self.settle(at);
    }

    /// The step generator came to rest at these counts, whatever was sent. A latched cause stays latched.
    pub fn recount(&mut self, at: &Steps) {
        self.settle(at);
        self.at_mm = self.mm(at);
    }

    /// Brakes and returns to zero slowly. A latched cause stays latched.
    pub fn relax(&mut self) {
        self.begin(Motion::Returning);
    }

    /// Brakes and stands. A latched cause stays latched.
    pub fn stand(&mut self) {
        self.begin(Motion::Standing);
    }

    /// Brakes; [`Gate::hand_over`] ends it.
    pub fn brake(&mut self) {
        self.begin(Motion::Braking);
    }

    /// Passes again once a [`Gate::brake`] has come to rest and all its steps are counted; true at that moment.
    pub fn hand_over(&mut self) -> bool {
        let over = self.is_braking() && self.speed_mm_s == [0.0; 3] && self.rests();
        if over {
            let at = self.sent;
            self.reset(&at);
        }
        over
    }

    /// One tick.
    pub fn pass(&mut self, input: &GateInput) -> GateOutput {
        self.following
            .step(&self.limits, input.following, input.dt_s);
        if self.motion == Motion::Passing && !input.armed {
            // the counts of pistons at rest may be declared anew
            self.history = History::resting(&input.counted, &self.limits);
        }
        self.history
            .push(input.counted, input.dt_s, input.counted_age_s);
        let agrees = input.counted == self.sent;
        self.agreed_s = lasting(agrees, self.agreed_s, self.elapsed_s(input.dt_s));
        let tripped = self.check(input);
        if let Some(cause) = tripped {
            self.latched = Some(self.latched.unwrap_or(cause));
            self.begin(match (self.motion, self.limits.on.of(cause)) {
                // a milder cause does not switch released drivers on again
                (Motion::Released, _) | (_, SafeState::Release) => Motion::Released,
                (_, SafeState::Hold) => Motion::Standing,
                (_, SafeState::Relax) => Motion::Returning,
            });
        }
        self.reported = [input.emergency_stop, input.alarm, input.overpressure];
        let mut rested = false;
        match self.motion {
            Motion::Passing => self.send(input.wanted),
            Motion::Braking | Motion::Standing => self.go(input.dt_s, |_, _| 0.0),
            Motion::Returning => {
                let (brake_mm_s2, relax_mm_s) = (self.limits.brake_mm_s2, self.limits.relax_mm_s);
                self.go(input.dt_s, |at_mm, dt_s| {
                    let to_go = at_mm.abs();
                    let braking = (brake_mm_s2 * to_go).sqrt();
                    -at_mm.signum() * relax_mm_s.min(braking).min(to_go / dt_s)
                });
                rested = self.arrive();
            }
            Motion::Released => {
                self.speed_mm_s = [0.0; 3];
                self.send(input.counted);
            }
        }
        GateOutput {
            steps: self.sent,
            energise: self.motion != Motion::Released,
            tripped,
            rested,
        }
    }

    /// The first violated limit. Causes of the machine count at any time, those of the controller only while it is
    /// passed.
    fn check(&self, input: &GateInput) -> Option<TripCause> {
        let passing = self.motion == Motion::Passing;
        let reports = [
            (input.emergency_stop, TripCause::EmergencyStop),
            (input.alarm, TripCause::StepGenerator),
            (input.overpressure, TripCause::Pressure),
        ];
        for ((now, cause), before) in reports.into_iter().zip(self.reported) {
            if now && (passing || !before) {
                return Some(cause);
            }
        }
        if !passing {
            return None;
        }
        if input.hot {
            return Some(TripCause::Temperature);
        }
        // NaN is late
        if !(input.dt_s <= self.limits.late_s) {
            return Some(TripCause::Late);
        }
        self.check_motion(input)
            .or_else(|| self.check_estimate(input))
    }

    /// The first limit that the requested or the counted steps violate.
    fn check_motion(&self, input: &GateInput) -> Option<TripCause> {
        let l = &self.limits;
        if !input.armed {
            return (input.wanted != self.sent).then_some(TripCause::Unarmed);
        }
        for i in 0..3 {
            let at_mm = f64::from(input.wanted.0[i]) * l.step_mm;
            if at_mm.abs() > l.travel_mm {
                return Some(TripCause::Travel);
            }
            if self.history.speed(i).exceeds(l.speed_mm_s) {
                return Some(TripCause::Rate);
            }
            if self.history.acceleration(i).exceeds(l.acceleration_mm_s2) {
                return Some(TripCause::Acceleration);
            }
            if let Some(estimate) = input.estimated_bellow_mm
                && (at_mm - estimate[i]).abs() > l.squeeze_mm
                && input.wanted.0[i] != self.sent.0[i]
            {
                return Some(TripCause::Pressure);
            }
        }
        None
    }

    /// What speaks against the estimate of an armed tip.
    fn check_estimate(&self, input: &GateInput) -> Option<TripCause> {
        let stale = (input.stale_s > self.limits.stale_s).then_some(TripCause::Stale);
        let disagree = input.disagree.then_some(TripCause::Disagreement);
        let astray = (self.following.exceeded_s > self.limits.following_for_s)
            .then_some(TripCause::Following);
        stale.or(disagree).or(astray).filter(|_| input.armed)
    }

    /// Position at these counts, mm.
    fn mm(&self, counts: &Steps) -> [f64; 3] {
        counts.0.map(|n| f64::from(n) * self.limits.step_mm)
    }

    /// Time that the gate counts for a tick, s: a late one causes no jump and proves no rest.
    fn elapsed_s(&self, dt_s: f64) -> f64 {
        dt_s.max(0.0).min(self.limits.tick_s * 2.0)
    }

    /// Changes what determines the counts. The gate's own motion starts with the counted speed, where the machine can begin
    /// to brake.
    fn begin(&mut self, motion: Motion) {
        if self.motion == Motion::Passing {
            self.speed_mm_s = std::array::from_fn(|i| self.history.speed(i).value);
            let counted_mm = self.mm(&self.history.newest());
            let reacts = |i: usize| self.speed_mm_s[i] * self.limits.react_s;
            self.at_mm = std::array::from_fn(|i| counted_mm[i] + reacts(i));
        }
        self.motion = motion;
    }

    /// Moves each piston at the speed that `wanted` states for its position (mm) and the duration of the tick (s).
    fn go(&mut self, dt_s: f64, wanted: impl Fn(f64, f64) -> f64) {
        let dt_s = self.elapsed_s(dt_s);
        let change = self.limits.brake_mm_s2 * dt_s;
        for i in 0..3 {
            let v = self.speed_mm_s[i];
            self.speed_mm_s[i] = v + (wanted(self.at_mm[i], dt_s) - v).clamp(-change, change);
            let at_mm = self.at_mm[i] + self.speed_mm_s[i] * dt_s;
            self.at_mm[i] = at_mm.clamp(-self.limits.travel_mm, self.limits.travel_mm);
        }
        let step_mm = self.limits.step_mm;
        self.send(Steps(self.at_mm.map(|mm| (mm / step_mm).round() as i32)));
    }

    /// Sends these counts. The machine cannot have reached new ones yet.
    fn send(&mut self, counts: Steps) {
        if self.sent != counts {
            (self.sent, self.agreed_s) = (counts, 0.0);
        }
    }

    /// Releases the drivers once all pistons are counted at zero; true at that moment.
    fn arrive(&mut self) -> bool {
        let there = self.sent == Steps::default() && self.rests();
        if there {
            (self.speed_mm_s, self.at_mm) = ([0.0; 3], [0.0; 3]);
            self.motion = Motion::Released;
        }
        there
    }

    /// The pistons have rested at these counts for as long as the gate remembers.
    fn settle(&mut self, at: &Steps) {
        self.history = History::resting(at, &self.limits);
        self.send(*at);
        self.speed_mm_s = [0.0; 3];
        self.following = FollowingError::default();
    }
}
