//! How much of the backlash a nudge of the feedback may jump: learned from what the jumps did.
//!
//! At a resting set-point the feedback now and then turns a piston round. A jump over a gap that is
//! believed too wide (rubber hysteresis passes for backlash in an identification) throws the tip past
//! its target, the feedback turns the same piston back, and the loop hunts for ever. A piston that
//! turns twice within a short time is the mark of that, whatever the period: the share shrinks. A
//! single turn after which the error stays where it was has fallen short: the share grows a little.

use nalgebra::Vector2;

/// Least share that a reversal jumps.
const SHARE_MIN: f64 = 0.05;
/// Two turns of one piston within this time are hunting, s.
const HUNTING_S: f64 = 0.6;
/// Factor on hunting, and on falling short.
const SHRINK: f64 = 0.7;
const GROW: f64 = 1.05;
/// Part of the error that is left when a jump has fallen short.
const SHORT: f64 = 0.8;

/// Time since each piston last turned, and the share learned so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Share of the gap that a nudge jumps, 0.05..=1.
    pub share: f64,
    since_turn_s: [f64; 3],
    watched: Option<(Vector2<f64>, f64)>,
}

impl Default for Reach {
    fn default() -> Self {
        Self { share: 0.9, since_turn_s: [f64::INFINITY; 3], watched: None }
    }
}

impl Reach {
    /// One tick at a resting set-point: which pistons turned round, and what is the error to the target
    /// (rad)? `answer_s` is the time after which the tip has answered a jump.
    pub fn step(&mut self, turned: [bool; 3], error: &Vector2<f64>, answer_s: f64, dt_s: f64) {
        let mut hunting = false;
        for (since_s, turned) in self.since_turn_s.iter_mut().zip(turned) {
            *since_s += dt_s;
            if turned {
                hunting |= *since_s < HUNTING_S + answer_s;
                *since_s = 0.0;
            }
        }
        if hunting {
            self.share = (self.share * SHRINK).max(SHARE_MIN);
            self.watched = None;
        } else if turned.contains(&true) {
            self.watched = Some((*error, 0.0));
        } else if let Some((before, age_s)) = &mut self.watched {
            *age_s += dt_s;
            if *age_s >= answer_s {
                let left = error.dot(before) / before.norm_squared().max(1e-12);
                if (SHORT..1.0 / SHORT).contains(&left) {
                    self.share = (self.share * GROW).min(1.0);
                }
                self.watched = None;
            }
        }
    }

    /// The set-point moves: what happens now says nothing about a jump.
    pub fn forget(&mut self) {
        self.watched = None;
        self.since_turn_s = [f64::INFINITY; 3];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUIET: [bool; 3] = [false; 3];
    const TURN: [bool; 3] = [false, true, false];

    #[test]
    fn a_piston_that_turns_to_and_fro_shrinks_the_share_at_any_period() {
        for period in [4, 18, 40] {
            let mut r = Reach::default();
            for k in 0..600 {
                r.step(if k % period == 0 { TURN } else { QUIET }, &Vector2::new(0.01, 0.0), 0.1, 0.01);
            }
            assert!(r.share < 0.1, "{period} {}", r.share);
        }
    }

    #[test]
    fn one_turn_that_moves_nothing_grows_it() {
        let mut r = Reach { share: 0.5, ..Reach::default() };
        r.step(TURN, &Vector2::new(0.01, 0.0), 0.1, 0.01);
        for _ in 0..50 {
            r.step(QUIET, &Vector2::new(0.01, 0.0), 0.1, 0.01);
        }
        assert!(r.share > 0.5 && r.share < 0.6);
    }

    #[test]
    fn one_turn_that_did_its_work_changes_nothing() {
        let mut r = Reach::default();
        r.step(TURN, &Vector2::new(0.01, 0.0), 0.1, 0.01);
        for _ in 0..50 {
            r.step(QUIET, &Vector2::new(0.001, 0.0), 0.1, 0.01);
        }
        assert_eq!(r.share, Reach::default().share);
    }

    #[test]
    fn a_moving_setpoint_ends_the_watch() {
        let mut r = Reach::default();
        r.step(TURN, &Vector2::new(0.01, 0.0), 0.1, 0.01);
        r.forget();
        r.step(TURN, &Vector2::new(0.01, 0.0), 0.1, 0.01);
        assert_eq!(r.share, Reach::default().share);
    }
}
