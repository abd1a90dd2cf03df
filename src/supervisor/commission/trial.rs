//! The procedure: one channel after the other bends the tip a little, and holds it for a while.

use crate::model::arc::Geometry;
use crate::supervisor::commission::manual_motion::{Hand, HandError};
use crate::supervisor::commission::turned::{Rest, Turned};
use crate::supervisor::commission::wiring::{self, Wiring};
use nalgebra::{Vector2, Vector3};
use std::fmt::Write;

/// How to try.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrialConfig {
    /// The bending section.
    pub geometry: Geometry,
    /// Piston stroke of the wiring test, mm.
    pub stroke_mm: f64,
    /// Piston stroke of the leak test, mm.
    pub hold_mm: f64,
    /// Duration of the leak test, s; 0 leaves it out.
    pub hold_s: f64,
    /// Speed, mm/s.
    pub speed_mm_s: f64,
    /// Time after a move until its effect is taken, s.
    pub settle_s: f64,
    /// Bend below which nothing has moved, rad.
    pub dead_rad: f64,
    /// Share of the bend lost a second above which a line leaks, 1/s.
    pub leak_max_per_s: f64,
}

impl TrialConfig {
    /// The usual strokes: some degrees of bend, within a fifth of the pressure.
    #[must_use]
    pub fn new(geometry: Geometry) -> Self {
        Self {
            geometry,
            stroke_mm: 3.0,
            hold_mm: 6.0,
            hold_s: 10.0,
            speed_mm_s: 5.0,
            settle_s: 0.8,
            dead_rad: 0.012,
            leak_max_per_s: 0.005,
        }
    }
}

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// A move.
    #[error(transparent)]
    Hand(#[from] HandError),
    /// Samples do not come.
    #[error("the IMU gave {0} samples in a second of rest: check it with `retroflex doctor` first")]
    Blind(u32),
    /// Somebody moves it.
    #[error("the tip is not still although nothing drives it: fix the base, let go of the tip and start again")]
    NotStill,
}

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Findings {
    /// Bend that one stroke of each channel gave, rad.
    pub answers: [Vector2<f64>; 3],
    /// Channels that moved nothing.
    pub dead: [bool; 3],
    /// What is connected to what; `None` when nothing fits or a channel is dead.
    pub wiring: Option<Wiring>,
    /// Other wirings that fit as well.
    pub others: Vec<Wiring>,
    /// Share of the bend lost a second, 1/s; `None` where it was not tried.
    pub leak_per_s: [Option<f64>; 3],
    /// Above this a line leaks, 1/s.
    pub leak_max_per_s: f64,
}

impl Findings {
    /// Channels that leak.
    #[must_use]
    pub fn leaks(&self) -> [bool; 3] {
        self.leak_per_s.map(|l| l.is_some_and(|l| l > self.leak_max_per_s))
    }

    /// True when the machine is wired as the board says and tight.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.dead == [false; 3] && self.leaks() == [false; 3] && self.wiring.is_some_and(|w| w.is_right())
    }

    /// The findings in plain words, a line each.
    #[must_use]
    pub fn words(&self) -> String {
        let mut text = String::new();
        for i in 0..3 {
            let (deg, leak) = (self.answers[i].norm().to_degrees(), self.leak_per_s[i]);
            let hold = leak.map_or(String::new(), |l| format!(", loses {:.2} % a second", 100.0 * l.max(0.0)));
            let _ = writeln!(text, "channel {}: bends the tip by {deg:.1}°{hold}", i + 1);
        }
        for i in (0..3).filter(|i| self.dead[*i]) {
            let _ = writeln!(text, "channel {}: NOTHING MOVES: motor supply, STEP line, rack, or a line that is not connected", i + 1);
        }
        for i in (0..3).filter(|i| self.leaks()[*i]) {
            let _ =
                writeln!(text, "channel {}: LEAKS: tighten its connectors, then the seal of its piston; do not use it like this", i + 1);
        }
        match &self.wiring {
            Some(w) if w.is_right() => text.push_str("wiring: as the board says\n"),
            Some(w) => {
                let _ = writeln!(text, "wiring: WRONG: {}", w.words());
                for other in &self.others {
                    let _ = writeln!(text, "  or, which looks alike: {}", other.words());
                }
            }
            None if self.dead == [false; 3] => {
                text.push_str("wiring: NOT UNDERSTOOD: no exchange of lines, motors or axes explains what was felt\n");
            }
            None => text.push_str("wiring: not judged while a channel moves nothing\n"),
        }
        text
    }
}

/// Tries all channels; drivers are on during it and off after it, pistons at zero.
///
/// # Errors
/// [`TrialError`]; the drivers are then left to the machine's own safe state.
pub fn run(hand: &mut Hand<'_>, config: &TrialConfig, say: &mut dyn FnMut(&str)) -> Result<Findings, TrialError> {
    say("feeling the rest");
    rest(hand)?;
    hand.energise(true)?;
    let mut answers = [Vector2::zeros(); 3];
    for (channel, answer) in answers.iter_mut().enumerate() {
        say(&format!("channel {}: a stroke of {} mm", channel + 1, config.stroke_mm));
        *answer = stroke(hand, config, channel, config.stroke_mm, 0.0)?.0;
    }
    let dead = answers.map(|a| a.norm() < config.dead_rad);
    let mut leak_per_s = [None; 3];
    for channel in (0..3).filter(|i| config.hold_s > 0.0 && !dead[*i]) {
        say(&format!("channel {}: holding for {} s", channel + 1, config.hold_s));
        leak_per_s[channel] = Some(stroke(hand, config, channel, config.hold_mm, config.hold_s)?.1);
    }
    hand.energise(false)?;
    let expected = [0, 1, 2].map(|i| {
        let mut q = Vector3::zeros();
        q[i] = 1.0;
        config.geometry.shape(&q).bend.0
    });
    let judged = if dead == [false; 3] { wiring::judge(&answers, &expected) } else { None };
    let (wiring, others) = judged.map_or((None, Vec::new()), |(w, o)| (Some(w), o));
    Ok(Findings { answers, dead, wiring, others, leak_per_s, leak_max_per_s: config.leak_max_per_s })
}

/// The gyroscope's bias over a second of rest.
fn rest(hand: &mut Hand<'_>) -> Result<Vector3<f64>, TrialError> {
    let mut rest = Rest::default();
    hand.stand(1.0, &mut |s| rest.see(s))?;
    match rest.bias_rad_s(STILL_MAX_RAD_S) {
        Some(bias) => Ok(bias),
        None if rest.samples() < 20 => Err(TrialError::Blind(rest.samples())),
        None => Err(TrialError::NotStill),
    }
}

/// Fastest that a still tip seems to turn, noise included, rad/s.
const STILL_MAX_RAD_S: f64 = 0.06;

/// One channel out, a wait, and back: the bend it gave, and the share of it that a wait costs a second.
fn stroke(hand: &mut Hand<'_>, config: &TrialConfig, channel: usize, mm: f64, hold_s: f64) -> Result<(Vector2<f64>, f64), TrialError> {
    let mut turned = Turned::new(rest(hand)?);
    let mut target = [0.0; 3];
    target[channel] = mm;
    hand.go(target, config.speed_mm_s, &mut |s| {
        turned.see(s);
        false
    })?;
    hand.stand(config.settle_s, &mut |s| turned.see(s))?;
    let bend = turned.bend().0;
    hand.stand(hold_s, &mut |s| turned.see(s))?;
    let left = turned.bend().0.norm() / bend.norm().max(f64::MIN_POSITIVE);
    let lost_per_s = if hold_s > 0.0 { -left.max(1e-6).ln() / hold_s } else { 0.0 };
    hand.go([0.0; 3], config.speed_mm_s, &mut |_| false)?;
    hand.stand(config.settle_s, &mut |_| ())?;
    Ok((bend, lost_per_s))
}
