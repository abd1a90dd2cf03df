//! The commissioning procedure: each channel in turn bends the tip a little and holds it.

use crate::model::Geometry;
use crate::supervisor::commission::manual_motion::{ManualMotion, ManualMotionError};
use crate::supervisor::commission::rotation::TipRotation;
use crate::supervisor::commission::wiring::{self, Wiring};
use nalgebra::{Vector2, Vector3};
use std::fmt::Write;

crate::constants! {
    /// The procedure.
    const TRIAL: TrialConstants;
    /// Piston stroke of the leak test, mm.
    hold_mm = 6.0;
    /// Speed of every move, mm/s.
    speed_mm_s = 5.0;
    /// Time between the end of a move and the measurement, s.
    settle_s = 0.8;
    /// Bend below which a channel counts as dead, rad.
    dead_rad = 0.012;
    /// Relative loss of bend per second above which a line leaks, 1/s.
    leak_max_per_s = 0.005;
    /// Largest measured rate of a tip at rest, noise included, rad/s.
    still_max_rad_s = 0.06;
}

/// Parameters of the procedure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrialConfig {
    /// The bending section.
    pub geometry: Geometry,
    /// Piston stroke of the wiring test, mm: 3 bends the tip by a few degrees at less than a fifth of the permitted pressure.
    pub stroke_mm: f64,
    /// Duration of the leak test, s; 0 skips it.
    pub hold_s: f64,
}

/// Why the procedure has no result.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// A move ended early.
    #[error(transparent)]
    Motion(#[from] ManualMotionError),
    /// Too few samples arrive.
    #[error(
        "the IMU delivered only {0} samples in one second; check it with `retroflex doctor` first"
    )]
    Blind(u32),
    /// The tip moves although the pistons stand.
    #[error(
        "the tip moves although the pistons stand: fix the base, release the tip and start again"
    )]
    NotStill,
}

/// Result of the procedure.
#[derive(Debug, Clone, PartialEq)]
pub struct Findings {
    /// Bend caused by one stroke of each channel, rad.
    pub answers: [Vector2<f64>; 3],
    /// Channels that did not move the tip.
    pub dead: [bool; 3],
    /// The simplest wiring, and others that fit equally well; none if no hypothesis fits or a channel is dead.
    pub wirings: Vec<Wiring>,
    /// Relative loss of bend per second, 1/s; `None` if not measured.
    pub leak_per_s: [Option<f64>; 3],
}

impl Findings {
    /// Channels that leak.
    pub fn leaks(&self) -> [bool; 3] {
        self.leak_per_s
            .map(|l| l.is_some_and(|l| l > TRIAL.leak_max_per_s))
    }

    /// True if the wiring agrees with the board file and no line leaks.
    pub fn is_good(&self) -> bool {
        self.dead == [false; 3]
            && self.leaks() == [false; 3]
            && self.wirings.first().is_some_and(Wiring::is_right)
    }

    /// The findings as text, one per line.
    pub fn report(&self) -> String {
        let mut text = String::new();
        for i in 0..3 {
            let (deg, leak) = (self.answers[i].norm().to_degrees(), self.leak_per_s[i]);
            let loses = |l: f64| format!(", loses {:.2} % per second", 100.0 * l.max(0.0));
            let hold = leak.map_or(String::new(), loses);
            let _ = writeln!(text, "channel {}: bends the tip by {deg:.1}°{hold}", i + 1);
        }
        for i in (0..3).filter(|i| self.dead[*i]) {
            let _ = writeln!(
                text,
                "channel {}: NO MOTION: check the motor supply, the STEP line, the rack, and whether the line is connected",
                i + 1
            );
        }
        for i in (0..3).filter(|i| self.leaks()[*i]) {
            let _ = writeln!(
                text,
                "channel {}: LEAK: tighten its connectors, then the seal of its piston; do not use the tip in this state",
                i + 1
            );
        }
        match self.wirings.split_first() {
            Some((w, _)) if w.is_right() => text.push_str("wiring: agrees with the board file\n"),
            Some((w, others)) => {
                let _ = writeln!(text, "wiring: WRONG: {}", w.differences());
                for other in others {
                    let _ = writeln!(text, "  or, indistinguishable: {}", other.differences());
                }
            }
            None if self.dead == [false; 3] => {
                text.push_str("wiring: UNKNOWN: no exchange of lines, motors or axes explains the measured bends\n");
            }
            None => text.push_str("wiring: not tested, because a channel does not move the tip\n"),
        }
        text
    }
}

/// Runs the procedure on all channels. Afterwards the pistons are at zero and the drivers are released.
///
/// # Errors
/// [`TrialError`]; the drivers then remain in the safe state of the machine.
pub fn run(
    drive: &mut ManualMotion<'_>,
    config: &TrialConfig,
    progress: &mut dyn FnMut(&str),
) -> Result<Findings, TrialError> {
    progress("measuring the gyroscope bias");
    gyro_bias(drive)?;
    drive.energise(true)?;
    let mut answers = [Vector2::zeros(); 3];
    let (stroke_mm, hold_s) = (config.stroke_mm, config.hold_s);
    for (i, answer) in answers.iter_mut().enumerate() {
        progress(&format!("channel {}: stroke of {stroke_mm} mm", i + 1));
        *answer = stroke(drive, i, stroke_mm, 0.0)?.0;
    }
    let dead = answers.map(|a| a.norm() < TRIAL.dead_rad);
    let mut leak_per_s = [None; 3];
    for i in (0..3).filter(|i| hold_s > 0.0 && !dead[*i]) {
        progress(&format!("channel {}: holding for {hold_s} s", i + 1));
        leak_per_s[i] = Some(stroke(drive, i, TRIAL.hold_mm, hold_s)?.1);
    }
    drive.energise(false)?;
    let each_longer = [Vector3::x(), Vector3::y(), Vector3::z()];
    let expected = each_longer.map(|q_mm| config.geometry.shape(&q_mm).bend.0);
    let wirings = match dead {
        [false, false, false] => wiring::identify(&answers, &expected),
        _ => Vec::new(),
    };
    Ok(Findings {
        answers,
        dead,
        wirings,
        leak_per_s,
    })
}

/// Measures the gyroscope bias over one second, rad/s.
fn gyro_bias(drive: &mut ManualMotion<'_>) -> Result<Vector3<f64>, TrialError> {
    let mut rotation = TipRotation::default();
    drive.stand(1.0, &mut |s| rotation.add(s))?;
    let mean_rad_s = rotation.mean_rad_s();
    if rotation.samples < SAMPLES_MIN {
        Err(TrialError::Blind(rotation.samples))
    } else if rotation.max_rad_s - mean_rad_s.norm() <= TRIAL.still_max_rad_s {
        Ok(mean_rad_s)
    } else {
        Err(TrialError::NotStill)
    }
}

/// Fewest samples for a bias.
const SAMPLES_MIN: u32 = 20;

/// Moves one channel out, waits and returns; gives the bend, rad, and its relative loss during the wait, 1/s.
fn stroke(
    drive: &mut ManualMotion<'_>,
    channel: usize,
    mm: f64,
    hold_s: f64,
) -> Result<(Vector2<f64>, f64), TrialError> {
    let mut rotation = TipRotation::new(gyro_bias(drive)?);
    let mut target = [0.0; 3];
    target[channel] = mm;
    drive.go(target, TRIAL.speed_mm_s, &mut |s| {
        rotation.add(s);
        false
    })?;
    drive.stand(TRIAL.settle_s, &mut |s| rotation.add(s))?;
    let bend = rotation.bend().0;
    drive.stand(hold_s, &mut |s| rotation.add(s))?;
    let left = rotation.bend().0.norm() / bend.norm().max(f64::MIN_POSITIVE);
    let lost = -left.max(1e-6).ln();
    let lost_per_s = if hold_s > 0.0 { lost / hold_s } else { 0.0 };
    drive.go([0.0; 3], TRIAL.speed_mm_s, &mut |_| false)?;
    drive.stand(TRIAL.settle_s, &mut |_| ())?;
    Ok((bend, lost_per_s))
}
