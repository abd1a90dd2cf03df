//! How much of each backlash a nudge of the feedback may jump: learned from what the jumps did.
//!
//! At a resting set-point the feedback now and then turns a piston round. A jump over a gap that is
//! believed too wide (rubber hysteresis passes for backlash in an identification) throws the tip past
//! its target, the feedback turns the same piston back, and the loop hunts for ever. A piston that
//! turns twice within a short time is the mark of that, whatever the period: its share shrinks. A
//! single turn after which the error stays where it was has fallen short: it takes another small bite
//! of the gap at once, and its share grows by that. Every channel has a gap of its own, and so a share
//! of its own.

use nalgebra::Vector2;

/// Least share that a reversal jumps.
const SHARE_MIN: f64 = 0.05;
/// Two turns of one piston within this time are hunting, s.
const HUNTING_S: f64 = 0.6;
/// Factor on hunting.
const SHRINK: f64 = 0.7;
/// What is added when a jump has fallen short.
const BITE: f64 = 0.08;
/// Part of the error that is left when a jump has fallen short.
const SHORT: f64 = 0.8;

/// One channel: the share learned so far, the time since it last turned, and the jump that is watched.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    share: f64,
    since_turn_s: f64,
    watched: Option<(Vector2<f64>, f64)>,
}

/// What a jump is given before it counts as short.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patience {
    /// Time after which the tip has answered a jump, s.
    pub answer_s: f64,
    /// Error below which it is not worth another bite, rad.
    pub worth_rad: f64,
}

/// What is learned of the three channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BacklashAdaptation {
    channels: [Channel; 3],
}

impl Default for BacklashAdaptation {
    fn default() -> Self {
        Self { channels: [Channel { share: 0.9, since_turn_s: f64::INFINITY, watched: None }; 3] }
    }
}

impl BacklashAdaptation {
    /// Share of the gap that a nudge of channel `i` (0 to 2) jumps, 0.05..=1.
    #[must_use]
    pub fn share(&self, i: usize) -> f64 {
        self.channels[i].share
    }

    /// One tick at a resting set-point: which pistons turned round, and what is the error to the target
    /// (rad)? Returns the further share of its gap that each channel is to jump now.
    pub fn step(&mut self, turned: [bool; 3], error: &Vector2<f64>, patience: &Patience, dt_s: f64) -> [f64; 3] {
        let mut increments = [0.0; 3];
        for ((channel, turned), increment) in self.channels.iter_mut().zip(turned).zip(&mut increments) {
            *increment = channel.step(turned, error, patience, dt_s);
        }
        increments
    }

    /// The set-point moves: what happens now says nothing about a jump.
    pub fn forget(&mut self) {
        for c in &mut self.channels {
            *c = Channel { share: c.share, since_turn_s: f64::INFINITY, watched: None };
        }
    }
}

impl Channel {
    fn step(&mut self, turned: bool, error: &Vector2<f64>, patience: &Patience, dt_s: f64) -> f64 {
        let &Patience { answer_s, worth_rad } = patience;
        self.since_turn_s += dt_s;
        if turned {
            let hunting = self.since_turn_s < HUNTING_S + answer_s;
            self.since_turn_s = 0.0;
            self.watched = if hunting { None } else { Some((*error, 0.0)) };
            if hunting {
                self.share = (self.share * SHRINK).max(SHARE_MIN);
            }
        } else if let Some((before, age_s)) = &mut self.watched {
            *age_s += dt_s;
            if *age_s >= answer_s {
                let left = error.dot(before) / before.norm_squared().max(1e-12);
                // others may have moved the tip meanwhile: the watch goes on from here
                (*before, *age_s) = (*error, 0.0);
                let short = (SHORT..1.0 / SHORT).contains(&left) && error.norm() > worth_rad;
                if short && self.share < 1.0 {
                    let increment = BITE.min(1.0 - self.share);
                    self.share += increment;
                    return increment;
                }
            }
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATIENT: Patience = Patience { answer_s: 0.1, worth_rad: 0.005 };
    const QUIET: [bool; 3] = [false; 3];
    const TURN: [bool; 3] = [false, true, false];

    #[test]
    fn a_piston_that_turns_to_and_fro_shrinks_the_share_at_any_period() {
        for period in [4, 18, 40] {
            let mut r = BacklashAdaptation::default();
            for k in 0..600 {
                r.step(if k % period == 0 { TURN } else { QUIET }, &Vector2::new(0.01, 0.0), &PATIENT, 0.01);
            }
            assert!(r.share(1) < 0.1, "{period} {}", r.share(1));
            assert_eq!([r.share(0), r.share(2)], [0.9; 2], "the others have gaps of their own");
        }
    }

    #[test]
    fn one_turn_that_moves_nothing_grows_it() {
        let mut r = BacklashAdaptation::default();
        r.channels[1].share = 0.5;
        r.step(TURN, &Vector2::new(0.01, 0.0), &PATIENT, 0.01);
        let mut bitten = 0.0;
        for _ in 0..50 {
            bitten += r.step(QUIET, &Vector2::new(0.01, 0.0), &PATIENT, 0.01)[1];
        }
        // four or five answers fit into that time
        assert!(r.share(1) > 0.8 && r.share(1) <= 0.9);
        assert!((r.share(1) - 0.5 - bitten).abs() < 1e-12, "what it takes now it takes next time");
    }

    #[test]
    fn one_turn_that_did_its_work_changes_nothing() {
        let mut r = BacklashAdaptation::default();
        r.step(TURN, &Vector2::new(0.01, 0.0), &PATIENT, 0.01);
        for _ in 0..50 {
            r.step(QUIET, &Vector2::new(0.001, 0.0), &PATIENT, 0.01);
        }
        assert_eq!(r.share(1), 0.9);
    }

    #[test]
    fn a_moving_setpoint_ends_the_watch() {
        let mut r = BacklashAdaptation::default();
        r.step(TURN, &Vector2::new(0.01, 0.0), &PATIENT, 0.01);
        r.forget();
        r.step(TURN, &Vector2::new(0.01, 0.0), &PATIENT, 0.01);
        assert_eq!(r.share(1), 0.9);
    }
}
