//! How much of the backlash a nudge of the feedback may jump: learned from what the jumps did.
//!
//! At a resting set-point the feedback now and then turns a piston round. A jump over a gap that is
//! believed too wide (rubber hysteresis passes for backlash in an identification) throws the tip past
//! its target, the feedback turns round again, and the loop hunts for ever. Each jump is therefore
//! watched: thrown past the target, the share shrinks; fallen short, it grows again.

use nalgebra::Vector2;

/// Least share that a reversal jumps.
const SHARE_MIN: f64 = 0.1;
/// Overshoot, as a fraction of the error before the jump, that counts.
const OVERSHOT: f64 = -0.35;
/// Error left, as a fraction, that counts as fallen short.
const SHORT: f64 = 0.8;

/// The watch over one jump, and the share learned so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Share of the gap that a nudge jumps, 0.1..=1.
    pub share: f64,
    watched: Option<(Vector2<f64>, f64)>,
}

impl Default for Reach {
    fn default() -> Self {
        Self { share: 0.9, watched: None }
    }
}

impl Reach {
    /// One tick at a resting set-point: did a piston turn round, and what is the error to the target
    /// (rad)? `answer_s` is the time after which the tip has answered a jump.
    pub fn step(&mut self, turned: bool, error: &Vector2<f64>, answer_s: f64, dt_s: f64) {
        if let Some((before, age_s)) = self.watched {
            let age_s = age_s + dt_s;
            self.watched = Some((before, age_s));
            if age_s >= answer_s {
                self.judge(&before, error);
                self.watched = None;
            }
        } else if turned {
            self.watched = Some((*error, 0.0));
        }
    }

    /// The set-point moves: what happens now says nothing about a jump.
    pub fn forget(&mut self) {
        self.watched = None;
    }

    fn judge(&mut self, before: &Vector2<f64>, now: &Vector2<f64>) {
        let left = now.dot(before) / before.norm_squared().max(1e-12);
        if left < OVERSHOT {
            self.share *= 0.7;
        } else if left > SHORT {
            self.share *= 1.1;
        }
        self.share = self.share.clamp(SHARE_MIN, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(ratio: f64, times: usize) -> f64 {
        let mut r = Reach::default();
        let e = Vector2::new(0.01, 0.0);
        for _ in 0..times {
            r.step(true, &e, 0.1, 0.01);
            for _ in 0..12 {
                r.step(false, &(e * ratio), 0.1, 0.01);
            }
        }
        r.share
    }

    #[test]
    fn shrinks_on_overshoot_and_grows_when_short() {
        assert!(after(-1.0, 10) <= SHARE_MIN + 1e-9);
        assert_eq!(after(0.1, 10), Reach::default().share);
        assert_eq!(after(1.0, 10), 1.0);
    }

    #[test]
    fn a_moving_setpoint_ends_the_watch() {
        let mut r = Reach::default();
        r.step(true, &Vector2::new(0.01, 0.0), 0.1, 0.01);
        r.forget();
        r.step(false, &Vector2::new(-0.1, 0.0), 0.1, 1.0);
        assert_eq!(r, Reach::default());
    }
}
