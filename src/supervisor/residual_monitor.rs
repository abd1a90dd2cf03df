//! Attributes the difference between predicted and estimated bend to a cause.
//!
//! The counted steps predict a bend (transmission model, then lag). The estimated bend minus this prediction is the
//! *residual* `u`. Because the prediction follows the steps that were made, the residual stays visible while feedback
//! compensates for its cause. A fault of one channel moves `u` along the spoke of that channel: with `x` mm at bellow j,
//! `Δu = −(2/3r) x s_j`. The direction of `u` therefore identifies the channel and the sign, and `x` relative to the
//! predicted motion of bellow j identifies the kind:
//!
//! | share | of the motion since onset | of the deflection, sudden | of the deflection, gradual |
//! |---|---|---|---|
//! | −2 | inverted | | |
//! | −1 | no response | burst | leak |
//! | between | weak, or lost steps | weak | leak |
//! | above 0 | strong | strong, or contact | strong (warming), or contact |
//!
//! One IMU cannot distinguish a driver that is off from a kinked line; the message of a suspicion names all causes with
//! the same signature.

pub use crate::supervisor::suspicion::{Suspicion, SuspicionKind};

use crate::model::Geometry;
use crate::parameters;
use crate::primitives::lasting;
use nalgebra::{Vector2, Vector3};

parameters! {
    /// Residual monitor: when a difference between predicted and estimated bend is reported.
    pub struct ResidualConfig: Copy {
        /// Unexplained bend that is reported while the set-point is constant. A larger value misses larger leaks and reports
        /// less creep.
        rest_deg: f64 = 4.5, "deg", 0.2..=45.0, "4.5 is above what creep makes";
        /// Unexplained bend that is reported while the set-point moves: backlash and lag that differ from the calibration make
        /// 10° of it. A larger value misses larger faults.
        motion_deg: f64 = 12.0, "deg", 0.2..=90.0, "12 is above what backlash and lag make";
        /// Increase of both thresholds per degree that the pistons have commanded since: a tip whose cable pulls taut on one
        /// side follows a third less there. A larger value misses a line that responds weakly.
        share: f64 = 0.35, "", 0.0..=2.0, "0.35 is above the error of the gains and what a taut cable takes";
        /// Time for which the threshold must be exceeded. A larger value ignores knocks and reports leaks later.
        for_s: f64 = 0.1, "s", 0.0..=10.0, "0.1 ignores a knock";
        /// Change of the unexplained bend within 64 turns of the loop that counts as sudden; twice the bend commanded meanwhile
        /// is allowed besides. A larger value misses larger bursts.
        jump_deg: f64 = 3.5, "deg", 0.2..=90.0, "3.5 is above what a motion makes";
    }
}

/// Input of the monitor at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualInput {
    /// Time since the last tick, s.
    pub dt_s: f64,
    /// Bend that the counted steps cause according to the transmission model, rad.
    pub predicted: Vector2<f64>,
    /// The same without play, rad: the model's position within the backlash is uncertain.
    pub gapless: Vector2<f64>,
    /// Estimated bend, rad.
    pub estimate: Vector2<f64>,
    /// Lag plus dead time of the line, s.
    pub answer_s: f64,
    /// The set-point moves.
    pub moving: bool,
    /// The controller has detected an obstruction.
    pub blocked: bool,
}

crate::constants! {
    /// How the residual is followed and classified.
    const MONITOR: MonitorConstants;
    /// Time at rest after which the remaining residual becomes the baseline, s.
    settle_s = 0.6;
    /// Time for which a jump, and the motion of the pistons before it, is remembered, s.
    jump_memory_s = 0.3;
    /// Share of its deflection that a line without pressure has lost: less than 1, because part of the line's response is still pending
    /// when the suspicion is classified.
    lost = -0.7;
    /// Time for which a new suspicion is updated, s.
    update_s = 0.4;
    /// A residual that grows from half the threshold to the threshold within this time, plus the lag of the line, is not a leak, s. A leak
    /// takes seconds.
    abrupt_s = 0.25;
    /// Time constant for smoothing the residual, s.
    smooth_s = 0.03;
    /// Predicted motion of a bellow below which its share is undefined, mm.
    motion_min_mm = 0.8;
    /// Deflection of a bellow below which its share is undefined, mm.
    deflection_min_mm = 0.5;
}

/// Ticks within which a change of the residual counts as a jump.
const JUMP_TICKS: usize = 64;

/// Detects a change of the residual that is faster than any motion of the pistons explains.
#[derive(Debug, Clone, PartialEq)]
struct JumpDetector {
    /// Residual and path of the predicted bend of the last ticks, rad.
    recent: [(Vector2<f64>, f64); JUMP_TICKS],
    head: usize,
    filled: usize,
    /// The last jump, rad, and its age, s.
    jump: Vector2<f64>,
    age_s: f64,
    /// Largest recent path of the predicted bend within the window, rad.
    path_rad: f64,
}

impl Default for JumpDetector {
    fn default() -> Self {
        let zero = Vector2::zeros();
        Self {
            recent: [(zero, 0.0); JUMP_TICKS],
            head: 0,
            filled: 0,
            jump: zero,
            age_s: f64::INFINITY,
            path_rad: 0.0,
        }
    }
}

impl JumpDetector {
    fn step(&mut self, threshold_rad: f64, residual: Vector2<f64>, path_rad: f64, dt_s: f64) {
        let (then, _) = self.recent[self.head];
        self.recent[self.head] = (residual, path_rad);
        self.head = (self.head + 1) % JUMP_TICKS;
        self.filled = (self.filled + 1).min(JUMP_TICKS + 1);
        let path: f64 = self.recent.iter().map(|(_, path)| path).sum();
        self.path_rad = path.max(self.path_rad * (-dt_s / MONITOR.jump_memory_s).exp());
        self.age_s += dt_s;
        let change = residual - then;
        let jumps = self.filled > JUMP_TICKS && change.norm() > threshold_rad + 2.0 * self.path_rad;
        if jumps && (self.age_s > MONITOR.jump_memory_s || change.norm() > self.jump.norm()) {
            (self.jump, self.age_s) = (change, 0.0);
        }
    }

    fn is_recent(&self) -> bool {
        self.age_s < MONITOR.jump_memory_s
    }
}

/// A suspicion ends after this many consecutive moves …
const GOOD_MOVES: u8 = 2;
/// … whose residual is within this share of what the fault would leave, or of the threshold if the fault is not that of a line.
const GOOD_SHARE: f64 = 0.5;

/// A suspicion and its age.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Verdict {
    suspicion: Suspicion,
    age_s: f64,
    /// The share is that of the motion since the baseline, not of the deflection.
    of_motion: bool,
    /// The residual grew abruptly.
    abrupt: bool,
    /// Consecutive moves that ended without the residual.
    good_moves: u8,
}

impl Verdict {
    /// Residual that the suspected fault of a line leaves at a predicted bend, `moved` from the baseline, rad.
    fn residual(&self, predicted: &Vector2<f64>, moved: &Vector2<f64>) -> Option<Vector2<f64>> {
        let Suspicion { channel, share, .. } = self.suspicion;
        let spoke = Geometry::spoke(usize::from(channel?.checked_sub(1)?));
        let bend = if self.of_motion { moved } else { predicted };
        (share != 0.0).then(|| spoke * (2.0 / 3.0 * share * spoke.dot(bend)))
    }
}

/// The monitor.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ResidualMonitor {
    config: ResidualConfig,
    r_mm: f64,
    /// Predicted bend after the lag.
    model: Option<Vector2<f64>>,
    /// Residual and predicted bend when the baseline was last taken, rad.
    baseline: (Vector2<f64>, Vector2<f64>),
    /// Time for which the set-point has rested, s.
    rested_s: f64,
    settled: bool,
    /// Path of the predicted bend since the baseline, rad.
    path_rad: f64,
    last_predicted: Vector2<f64>,
    last_gapless: Option<Vector2<f64>>,
    /// Residual minus baseline, smoothed.
    smooth: Vector2<f64>,
    jump: JumpDetector,
    /// Time for which the residual has exceeded its threshold, and half of it, s.
    beyond_s: f64,
    rising_s: f64,
    verdict: Option<Verdict>,
}

impl ResidualMonitor {
    /// A monitor without history, for a tip whose bellows lie at the radius `r_mm`.
    pub fn new(config: &ResidualConfig, r_mm: f64) -> Self {
        Self {
            config: *config,
            r_mm,
            ..Self::default()
        }
    }

    /// The present suspicion.
    pub fn suspicion(&self) -> Option<&Suspicion> {
        self.verdict.as_ref().map(|v| &v.suspicion)
    }

    /// Forgets everything, after a reset or an alignment.
    pub fn forget(&mut self) {
        *self = Self::new(&self.config, self.r_mm);
    }

    /// One tick; returns a new suspicion.
    pub fn step(&mut self, input: &ResidualInput) -> Option<Suspicion> {
        // the bend from the pistons after a first-order lag
        let keep = (-input.dt_s / input.answer_s.max(1e-3)).exp();
        let from = self.model.unwrap_or(input.estimate);
        let model = input.predicted + (from - input.predicted) * keep;
        self.model = Some(model);
        let residual = input.estimate - model;
        let moved = (input.predicted - self.last_predicted).norm();
        self.path_rad += moved;
        self.last_predicted = input.predicted;
        let before = self.last_gapless.replace(input.gapless);
        let gapless = (input.gapless - before.unwrap_or(input.gapless)).norm();
        self.rested_s = lasting(!input.moving, self.rested_s, input.dt_s);
        let departs = input.moving && self.settled;
        let settles = !self.settled && self.rested_s > MONITOR.settle_s + 4.0 * input.answer_s;
        if (departs || settles) && self.verdict.is_none() && self.beyond_s == 0.0 {
            (self.baseline, self.path_rad) = ((residual, input.predicted), 0.0);
            self.smooth = Vector2::zeros();
        }
        self.settled = !input.moving && (self.settled || settles);
        if settles {
            self.acquit(input);
        }
        let since = residual - self.baseline.0;
        let keep = (-input.dt_s / MONITOR.smooth_s).exp();
        self.smooth = since + (self.smooth - since) * keep;
        let threshold_rad = self.config.jump_deg.to_radians();
        let path_rad = moved.max(gapless);
        self.jump
            .step(threshold_rad, residual, path_rad, input.dt_s);
        self.assess(input)
    }

    /// Withdraws a suspicion after moves that ended as predicted without the fault. A pose in which the fault would show little says
    /// nothing.
    fn acquit(&mut self, input: &ResidualInput) {
        let Some(verdict) = &mut self.verdict else {
            return;
        };
        let moved = input.predicted - self.baseline.1;
        let rest = self.config.rest_deg.to_radians();
        let allowed = rest + self.config.share * moved.norm();
        let expected = verdict.residual(&input.predicted, &moved);
        let good = match expected {
            Some(expected) if expected.norm() < rest => return,
            Some(expected) => {
                let found = self.smooth.dot(&expected) / expected.norm_squared();
                found < GOOD_SHARE && self.smooth.norm() < allowed
            }
            None => self.smooth.norm() < GOOD_SHARE * allowed,
        };
        verdict.good_moves = if good { verdict.good_moves + 1 } else { 0 };
        if verdict.good_moves >= GOOD_MOVES {
            self.forget();
        }
    }

    fn assess(&mut self, input: &ResidualInput) -> Option<Suspicion> {
        let net = (input.predicted - self.baseline.1).norm();
        let (least_deg, moved) = if self.settled {
            (self.config.rest_deg, net)
        } else {
            (self.config.motion_deg, net.max(self.path_rad))
        };
        let allowed = least_deg.to_radians() + self.config.share * moved;
        let sudden = self.jump.is_recent();
        let beyond = self.smooth.norm() > allowed;
        let rising = self.smooth.norm() > 0.5 * allowed;
        self.beyond_s = lasting(beyond || sudden, self.beyond_s, input.dt_s);
        self.rising_s = lasting(rising, self.rising_s, input.dt_s);
        if let Some(mut verdict) = self.verdict {
            // a larger residual identifies the cause better
            verdict.age_s += input.dt_s;
            let (now, of_motion) = self.classify(input, moved, sudden, verdict.abrupt);
            // the reaction of the loop is motion that is not answered yet: it lets a line look less responsive than it is
            let then = verdict.suspicion;
            let same = now.share * then.share >= 0.0
                && (now.kind, then.kind) != (SuspicionKind::NoResponse, SuspicionKind::Weak);
            if verdict.age_s < MONITOR.update_s && beyond && same && now.deg > verdict.suspicion.deg
            {
                (verdict.suspicion, verdict.of_motion) = (now, of_motion);
            }
            self.verdict = Some(verdict);
            return None;
        }
        if self.beyond_s < self.config.for_s {
            return None;
        }
        let abrupt = sudden || self.rising_s - self.beyond_s < MONITOR.abrupt_s + input.answer_s;
        let (suspicion, of_motion) = self.classify(input, moved, sudden, abrupt);
        self.verdict = Some(Verdict {
            suspicion,
            age_s: 0.0,
            of_motion,
            abrupt,
            good_moves: 0,
        });
        Some(suspicion)
    }

    /// Channel and kind of the fault that explains the residual, and whether its share is that of the motion since the baseline; `moved` is
    /// that motion, rad.
    fn classify(
        &self,
        input: &ResidualInput,
        moved: f64,
        sudden: bool,
        abrupt: bool,
    ) -> (Suspicion, bool) {
        use SuspicionKind::{Burst, Contact, Inverted, Leak, LostSteps, NoResponse, Strong, Weak};
        let u = if sudden { self.jump.jump } else { self.smooth };
        let along = Vector3::from_fn(|j, _| u.dot(&Geometry::spoke(j)));
        let j = along.iamax();
        let x_mm = -1.5 * self.r_mm * along[j];
        let bellow_mm = |bend: &Vector2<f64>| -self.r_mm * Geometry::spoke(j).dot(bend);
        let motion_mm = bellow_mm(&(input.predicted - self.baseline.1));
        let deflection_mm = bellow_mm(&input.predicted);
        let of = |kind, share| Suspicion {
            kind,
            channel: Some(j as u8 + 1),
            share,
            deg: u.norm().to_degrees(),
        };
        let contact = |share| Suspicion {
            channel: None,
            ..of(Contact, share)
        };
        let (of_motion, of_deflection) = (x_mm / motion_mm, x_mm / deflection_mm);
        // what begins abruptly at rest is judged by the deflection: the motion since is the loop's answer
        let in_motion = !(self.settled && abrupt)
            && (!sudden && moved > u.norm() && motion_mm.abs() > MONITOR.motion_min_mm);
        let deflected = deflection_mm.abs() > MONITOR.deflection_min_mm;
        // a residual along one spoke has its cause in one line, even if the controller reports an obstruction
        let one_line = along[j].abs() > 0.9 * u.norm();
        let suspicion = if in_motion && one_line && of_motion < MONITOR.lost {
            let inverted = of_motion < -1.5;
            of(if inverted { Inverted } else { NoResponse }, of_motion)
        } else if self.settled && one_line && deflected && of_deflection < MONITOR.lost {
            of(Burst, of_deflection)
        } else if input.blocked && !sudden {
            contact(-1.0)
        } else if in_motion {
            match of_motion {
                share if share < MONITOR.lost => of(NoResponse, share),
                share if share < 0.0 => of(Weak, share),
                share => of(Strong, share),
            }
        } else if deflection_mm.abs() < MONITOR.deflection_min_mm {
            // an undeflected channel has no pressure to lose: the cause is the drive or a contact
            if sudden {
                of(LostSteps, 0.0)
            } else {
                contact(0.0)
            }
        } else {
            match (of_deflection, sudden || abrupt) {
                (share, true) if share < -0.75 => of(Burst, share),
                (share, true) if share < 0.0 => of(Weak, share),
                (share, false) if share < 0.0 => of(Leak, share),
                (share, _) => of(Strong, share),
            }
        };
        // no other share is computed from the motion
        (suspicion, suspicion.share == of_motion)
    }
}
