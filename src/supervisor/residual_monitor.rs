//! From "the tip is not where the pistons should have put it" to a cause, in plain words.
//!
//! The pistons as they stand should give a bend (transmission model, then lag); what is felt differs
//! from it by the *unexplained* bend `u`. Because the difference is taken against what the pistons did,
//! it stays visible while feedback makes up for it. A fault of one channel moves `u` along that
//! channel's spoke: with `x` mm on bellow j, `Δu = −(2/3r) x s_j`, so the direction names the channel and
//! the sign, and `x` as a share of what bellow j should have done names the kind:
//!
//! | share of the way | in motion since onset | share of all, sudden | slow |
//! |---|---|---|---|
//! | −2 | turns the wrong way | | |
//! | −1 | does not answer | lost its pressure | leaks |
//! | between | gives less, or lost steps | softer (air), or gives less | leaks |
//! | above 0 | gives more | gives more, or is pushed | warms, or is pushed |
//!
//! One IMU cannot tell a switched-off driver from a kinked line: what looks alike is named together.

use crate::model::arc::Geometry;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// When something is called unexplained.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ResidualConfig {
    /// Unexplained bend that is worth a word while the set-point rests, degrees. Default 4.5. Larger
    /// overlooks larger leaks and hears less of creep.
    pub rest_deg: f64,
    /// Unexplained bend that is worth a word while it moves, degrees. Default 12: backlash and lag that
    /// are not quite as believed make 10 of them. Larger overlooks larger faults.
    pub motion_deg: f64,
    /// … both more by so much per degree that the pistons have led the tip since. Default 0.3: a
    /// tip whose cable pulls taut on one side gives a third less there. Larger overlooks a line that answers weakly.
    pub share: f64,
    /// How long it must stand, s. Default 0.1. Larger overlooks knocks and says leaks later.
    pub for_s: f64,
    /// A leap of the unexplained bend within 64 turns that is called sudden, degrees; twice what the
    /// pistons led the tip meanwhile is allowed besides: no way of theirs to turn explains more. Default 3.5. Larger overlooks larger bursts.
    pub leap_deg: f64,
}

impl Default for ResidualConfig {
    fn default() -> Self {
        Self { rest_deg: 4.5, motion_deg: 12.0, share: 0.30, for_s: 0.1, leap_deg: 3.5 }
    }
}

/// What it looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SuspicionKind {
    /// A line slowly loses air.
    Leak,
    /// A line lost its pressure at once.
    Burst,
    /// A line gives less than it did: air in it, softer, or steps lost.
    Weak,
    /// A line gives more than it did.
    Strong,
    /// A piston turns the wrong way.
    Inverted,
    /// A line does not answer its piston.
    NoResponse,
    /// Something holds or pushes the tip.
    Contact,
    /// Steps were lost, or the drive slipped.
    LostSteps,
}

/// A cause with its channel and size.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Suspicion {
    /// What it looks like.
    pub kind: SuspicionKind,
    /// The channel, 1 to 3; `None` where all take part.
    pub channel: Option<u8>,
    /// Share of the bellow's way that is missing (below 0) or too much.
    pub share: f64,
    /// Size of the unexplained bend, degrees.
    pub deg: f64,
}

impl std::fmt::Display for Suspicion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let line = self.channel.map_or_else(|| "the tip".to_owned(), |c| format!("line {c}"));
        let percent = (self.share.abs() * 100.0).min(999.0);
        match self.kind {
            SuspicionKind::Leak => write!(f, "{line} loses air slowly ({percent:.0} % so far): look for a leak at its connectors"),
            SuspicionKind::Burst => write!(f, "{line} lost its pressure at once: a hose came off or a bellow is torn; relax and replace"),
            SuspicionKind::Weak => write!(f, "{line} gives {percent:.0} % less than it did: air in the line, a soft bellow, or lost steps"),
            SuspicionKind::Strong => {
                write!(f, "{line} gives {percent:.0} % more than it did: calibrate again, or something pushes the tip")
            }
            SuspicionKind::Inverted => write!(f, "{line} moves the wrong way: check the motor's plug and `invert_dir`"),
            SuspicionKind::NoResponse => write!(f, "{line} does not answer its piston: driver off, kinked line or end stop"),
            SuspicionKind::Contact => write!(f, "{line} is held or pushed by {:.0}° by something outside", self.deg),
            SuspicionKind::LostSteps => {
                write!(f, "{line} is off by a constant {:.1}°: its motor lost steps; `relax`, then `zero`", self.deg)
            }
        }
    }
}

/// What the watch sees at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualInput {
    /// Time since the last tick, s.
    pub dt_s: f64,
    /// Bend that the pistons as they stand should give, rad.
    pub given: Vector2<f64>,
    /// Bend that they should give if there were no play, rad: a gap is never quite where it is believed.
    pub gapless: Vector2<f64>,
    /// Felt bend, rad.
    pub estimate: Vector2<f64>,
    /// Lag and dead time of the line together, s.
    pub answer_s: f64,
    /// The set-point moves.
    pub moving: bool,
    /// The controller found the tip held by something.
    pub blocked: bool,
}

/// The watch's memory.
#[derive(Debug, Clone, PartialEq)]
pub struct ResidualMonitor {
    config: ResidualConfig,
    r_mm: f64,
    /// Bend that the pistons should have given by now.
    model: Option<Vector2<f64>>,
    /// Unexplained bend when all was well, and what the pistons gave then.
    base: Vector2<f64>,
    base_given: Vector2<f64>,
    /// Set-point at rest for this long, s.
    rested_s: f64,
    settled: bool,
    path_rad: f64,
    last_given: Vector2<f64>,
    last_gapless: Option<Vector2<f64>>,
    /// Unexplained bend since, smoothed.
    smooth: Vector2<f64>,
    /// The last turns: unexplained bend and how far the pistons led the tip.
    lately: [(Vector2<f64>, f64); LATELY],
    head: usize,
    filled: usize,
    /// The last leap, and how long ago it was, s.
    leap: Vector2<f64>,
    leapt_s: f64,
    /// Most that the pistons led the tip within as many turns lately, rad.
    led_rad: f64,
    said_s: f64,
    beyond_s: f64,
    /// For how long it has been half of what is worth a word, s.
    rising_s: f64,
    /// What is said began all at once.
    abrupt: bool,
    said: Option<Suspicion>,
}

/// Rest of the set-point after which what stays unexplained is the new normal, s.
const SETTLE_S: f64 = 0.6;
/// Turns within which a leap is a leap.
const LATELY: usize = 64;
/// How long a leap, and what the pistons did before it, is remembered, s.
const LEAP_MEMORY_S: f64 = 0.3;
/// Share of all it did that a line has lost which lost its pressure: half of what is left is the line's answer, still
/// under way when it is weighed.
const LOST: f64 = -0.7;
/// How long a new suspicion is weighed on, s.
const WEIGH_S: f64 = 0.4;
/// What comes from half a word to a word within this, and the line's answer, is no leak: one that is slow
/// takes seconds, s.
const ABRUPT_S: f64 = 0.25;
/// Smoothing of the unexplained bend, s.
const SMOOTH_S: f64 = 0.03;

impl ResidualMonitor {
    /// Nothing seen yet.
    #[must_use]
    pub fn new(config: &ResidualConfig, r_mm: f64) -> Self {
        let zero = Vector2::zeros();
        Self {
            config: *config,
            r_mm,
            model: None,
            base: zero,
            base_given: zero,
            rested_s: 0.0,
            settled: false,
            path_rad: 0.0,
            last_given: zero,
            last_gapless: None,
            smooth: zero,
            lately: [(zero, 0.0); LATELY],
            head: 0,
            filled: 0,
            leap: zero,
            leapt_s: f64::INFINITY,
            led_rad: 0.0,
            said_s: 0.0,
            beyond_s: 0.0,
            rising_s: 0.0,
            abrupt: false,
            said: None,
        }
    }

    /// What is suspected now.
    #[must_use]
    pub fn suspicion(&self) -> Option<&Suspicion> {
        self.said.as_ref()
    }

    /// Size of the unexplained bend, and how far the pistons led the tip since it was last taken for
    /// normal: straight, and along the way, rad.
    #[must_use]
    pub fn figures(&self) -> (f64, f64, f64) {
        (self.smooth.norm(), (self.last_given - self.base_given).norm(), self.path_rad)
    }

    /// Forgets everything: after a reset or a re-alignment.
    pub fn forget(&mut self) {
        *self = Self::new(&self.config, self.r_mm);
    }

    /// One tick; a suspicion that is new.
    pub fn step(&mut self, seen: &ResidualInput) -> Option<Suspicion> {
        let model = self.follow(seen);
        let unexplained = seen.estimate - model;
        let given = (seen.given - self.last_given).norm();
        self.path_rad += given;
        self.last_given = seen.given;
        let gapless = (seen.gapless - self.last_gapless.replace(seen.gapless).unwrap_or(seen.gapless)).norm();
        self.rested_s = if seen.moving { 0.0 } else { self.rested_s + seen.dt_s };
        let moves_off = seen.moving && self.settled;
        let comes_to_rest = !self.settled && self.rested_s > SETTLE_S + 4.0 * seen.answer_s;
        if (moves_off || comes_to_rest) && self.said.is_none() && self.beyond_s == 0.0 {
            (self.base, self.base_given, self.path_rad) = (unexplained, seen.given, 0.0);
            self.smooth = Vector2::zeros();
        }
        self.settled = !seen.moving && (self.settled || comes_to_rest);
        let since = unexplained - self.base;
        let keep = (-seen.dt_s / SMOOTH_S).exp();
        let before = self.smooth;
        self.smooth = since + (before - since) * keep;
        self.watch_leap(unexplained, given.max(gapless), seen.dt_s);
        self.judge(seen)
    }

    fn follow(&mut self, seen: &ResidualInput) -> Vector2<f64> {
        let keep = (-seen.dt_s / seen.answer_s.max(1e-3)).exp();
        let from = self.model.unwrap_or(seen.estimate);
        let model = seen.given + (from - seen.given) * keep;
        self.model = Some(model);
        model
    }

    /// A change of the unexplained bend that is quicker than any motion of the pistons explains.
    fn watch_leap(&mut self, unexplained: Vector2<f64>, led: f64, dt_s: f64) {
        let (then, _) = self.lately[self.head];
        self.lately[self.head] = (unexplained, led);
        self.head = (self.head + 1) % LATELY;
        self.filled = (self.filled + 1).min(LATELY + 1);
        let led: f64 = self.lately.iter().map(|(_, led)| led).sum();
        self.led_rad = led.max(self.led_rad * (-dt_s / LEAP_MEMORY_S).exp());
        self.leapt_s += dt_s;
        let leap = unexplained - then;
        let leaps = self.filled > LATELY && leap.norm() > self.config.leap_deg.to_radians() + 2.0 * self.led_rad;
        if leaps && (self.leapt_s > LEAP_MEMORY_S || leap.norm() > self.leap.norm()) {
            (self.leap, self.leapt_s) = (leap, 0.0);
        }
    }

    fn judge(&mut self, seen: &ResidualInput) -> Option<Suspicion> {
        let net = (seen.given - self.base_given).norm();
        let (least_deg, moved) = if self.settled { (self.config.rest_deg, net) } else { (self.config.motion_deg, net.max(self.path_rad)) };
        let allowed = least_deg.to_radians() + self.config.share * moved;
        let sudden = self.leapt_s < LEAP_MEMORY_S;
        let beyond = self.smooth.norm() > allowed;
        self.beyond_s = if beyond || sudden { self.beyond_s + seen.dt_s } else { 0.0 };
        self.rising_s = if self.smooth.norm() > 0.5 * allowed { self.rising_s + seen.dt_s } else { 0.0 };
        if self.said.is_some() {
            // more of it tells more, for a while
            self.said_s += seen.dt_s;
            let now = self.name(seen, moved, sudden);
            if self.said_s < WEIGH_S && beyond && self.said.is_none_or(|before| now.deg > before.deg) {
                self.said = Some(now);
            }
            return None;
        }
        if self.beyond_s < self.config.for_s {
            return None;
        }
        self.said_s = 0.0;
        self.abrupt = sudden || self.rising_s - self.beyond_s < ABRUPT_S + seen.answer_s;
        self.said = Some(self.name(seen, moved, sudden));
        self.said
    }

    /// The channel whose spoke the unexplained bend lies along, and what its size says.
    fn name(&self, seen: &ResidualInput, moved: f64, sudden: bool) -> Suspicion {
        let u = if sudden { self.leap } else { self.smooth };
        let along: [f64; 3] = std::array::from_fn(|j| u.dot(&Geometry::spoke(j)));
        let j = (0..3).fold(0, |best, j| if along[j].abs() > along[best].abs() { j } else { best });
        let x_mm = -1.5 * self.r_mm * along[j];
        let bellow = |bend: &Vector2<f64>| -self.r_mm * Geometry::spoke(j).dot(bend);
        let (way_mm, all_mm) = (bellow(&(seen.given - self.base_given)), bellow(&seen.given));
        let deg = u.norm().to_degrees();
        let of = |kind, share| Suspicion { kind, channel: Some(j as u8 + 1), share, deg };
        let led = !sudden && moved > u.norm() && way_mm.abs() > 0.8;
        let share = x_mm / way_mm;
        // along one spoke it is one line, whatever the controller makes of it
        let of_one_line = along[j].abs() > 0.9 * u.norm();
        if led && of_one_line && share < -0.7 {
            return of(if share < -1.5 { SuspicionKind::Inverted } else { SuspicionKind::NoResponse }, share);
        }
        if self.settled && of_one_line && all_mm.abs() > 0.5 && x_mm / all_mm < LOST {
            return of(SuspicionKind::Burst, x_mm / all_mm);
        }
        if seen.blocked && !sudden {
            return Suspicion { kind: SuspicionKind::Contact, channel: None, share: -1.0, deg };
        }
        if led {
            return match share {
                s if s < -0.7 => of(SuspicionKind::NoResponse, s),
                s if s < 0.0 => of(SuspicionKind::Weak, s),
                s => of(SuspicionKind::Strong, s),
            };
        }
        if all_mm.abs() < 0.5 {
            // a channel near its own rest has nothing to lose: what moves it came from outside or the drive
            return if sudden {
                of(SuspicionKind::LostSteps, 0.0)
            } else {
                Suspicion { kind: SuspicionKind::Contact, channel: None, share: 0.0, deg }
            };
        }
        match (x_mm / all_mm, sudden || self.abrupt) {
            (s, true) if s < -0.75 => of(SuspicionKind::Burst, s),
            (s, true) if s < 0.0 => of(SuspicionKind::Weak, s),
            (s, false) if s < 0.0 => of(SuspicionKind::Leak, s),
            (s, _) => of(SuspicionKind::Strong, s),
        }
    }
}

/// Bellow length changes that a bend goes with, mm, at rest length: for the gate.
#[must_use]
pub fn bellows(geometry: &Geometry, bend: &Vector2<f64>, stretch_mm: f64) -> Vector3<f64> {
    Vector3::from_fn(|i, _| stretch_mm - geometry.r_mm * Geometry::spoke(i).dot(bend))
}
