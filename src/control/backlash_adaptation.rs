//! Learns how much of the backlash a reversal by feedback may cross.
//!
//! While the set-point rests, the feedback sometimes reverses a piston. If the assumed backlash is too wide (hysteresis of
//! the rubber looks like backlash to an identification), crossing all of it moves the tip past its target, the feedback
//! reverses the same piston again, and the loop hunts. Two reversals of a piston within a short time, on two sides of the
//! target, indicate hunting at any period: the share to cross shrinks. A single reversal that leaves the error unchanged
//! fell short: the piston crosses a further increment at once, and the share grows by it. Each channel has its own backlash
//! and share. Where the feedback can correct nothing, every second reversal is hunting.

use nalgebra::Vector2;

/// Share before any reversal, and the smallest.
const SHARE_INITIAL: f64 = 0.7;
const SHARE_MIN: f64 = 0.05;
/// Two reversals of one piston within this time, plus its response time, indicate hunting, s.
const HUNTING_S: f64 = 0.6;
/// Factor on the share after hunting.
const SHRINK: f64 = 0.7;
/// Increment of the share after a reversal that fell short: it turns the tip of the paper by 0.3° if it was not needed.
const INCREMENT: f64 = 0.03;
/// Remaining fraction of the error above which a reversal fell short.
const SHORT: f64 = 0.8;

/// One channel: the learned share, the time since its last reversal and the error there, and error and age of the reversal
/// under observation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    share: f64,
    since_reversal_s: f64,
    reversed_at: Vector2<f64>,
    observed: Option<(Vector2<f64>, f64)>,
}

/// When a reversal counts as too short.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patience {
    /// Time within which the tip responds to a reversal, s.
    pub answer_s: f64,
    /// Error below which no further increment is worthwhile, rad.
    pub worth_rad: f64,
}

/// The learned shares of the three channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BacklashAdaptation {
    channels: [Channel; 3],
}

impl Default for BacklashAdaptation {
    fn default() -> Self {
        Self {
            channels: [Channel::of_share(SHARE_INITIAL); 3],
        }
    }
}

impl BacklashAdaptation {
    /// Share of the backlash that a reversal of channel `i` (0 to 2) crosses, 0.05..=1.
    pub fn share(&self, i: usize) -> f64 {
        self.channels[i].share
    }

    /// One tick at a resting set-point with the pistons that `reversed` and the error that the feedback can correct, rad.
    /// Returns the further share of its backlash that each channel crosses now.
    pub fn step(
        &mut self,
        reversed: [bool; 3],
        error: &Vector2<f64>,
        patience: &Patience,
        dt_s: f64,
    ) -> [f64; 3] {
        let mut increments = [0.0; 3];
        for ((channel, reversed), increment) in
            self.channels.iter_mut().zip(reversed).zip(&mut increments)
        {
            *increment = channel.step(reversed, error, patience, dt_s);
        }
        increments
    }

    /// Ends the observation because the set-point moves. The shares stay.
    pub fn forget(&mut self) {
        for c in &mut self.channels {
            *c = Channel::of_share(c.share);
        }
    }
}

impl Channel {
    fn of_share(share: f64) -> Self {
        Self {
            share,
            since_reversal_s: f64::INFINITY,
            reversed_at: Vector2::zeros(),
            observed: None,
        }
    }

    fn step(
        &mut self,
        reversed: bool,
        error: &Vector2<f64>,
        patience: &Patience,
        dt_s: f64,
    ) -> f64 {
        let &Patience {
            answer_s,
            worth_rad,
        } = patience;
        self.since_reversal_s += dt_s;
        if reversed {
            let hunting =
                self.since_reversal_s < HUNTING_S + answer_s && error.dot(&self.reversed_at) <= 0.0;
            (self.since_reversal_s, self.reversed_at) = (0.0, *error);
            self.observed = if hunting { None } else { Some((*error, 0.0)) };
            if hunting {
                self.share = (self.share * SHRINK).max(SHARE_MIN);
            }
        } else if let Some((before, age_s)) = &mut self.observed {
            *age_s += dt_s;
            if *age_s >= answer_s {
                let left = error.dot(before) / before.norm_squared().max(1e-12);
                // other channels may have moved the tip in the meantime: the observation continues from here
                (*before, *age_s) = (*error, 0.0);
                let short = (SHORT..1.0 / SHORT).contains(&left) && error.norm() > worth_rad;
                if short && self.share < 1.0 {
                    let increment = INCREMENT.min(1.0 - self.share);
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

    const PATIENT: Patience = Patience {
        answer_s: 0.1,
        worth_rad: 0.005,
    };
    const QUIET: [bool; 3] = [false; 3];
    const REVERSAL: [bool; 3] = [false, true, false];

    #[test]
    fn hunting_shrinks_the_share_at_any_period() {
        for period in [4, 18, 40] {
            let mut r = BacklashAdaptation::default();
            for k in 0..1000 {
                let side = if k / period % 2 == 0 { 0.01 } else { -0.01 };
                r.step(
                    if k % period == 0 { REVERSAL } else { QUIET },
                    &Vector2::new(side, 0.0),
                    &PATIENT,
                    0.01,
                );
            }
            assert!(r.share(1) < 0.1, "{period} {}", r.share(1));
            assert_eq!(
                [r.share(0), r.share(2)],
                [SHARE_INITIAL; 2],
                "the other channels keep their shares"
            );
        }
    }

    #[test]
    fn a_reversal_that_falls_short_grows_the_share() {
        let mut r = BacklashAdaptation::default();
        r.channels[1].share = 0.5;
        r.step(REVERSAL, &Vector2::new(0.01, 0.0), &PATIENT, 0.01);
        let mut crossed = 0.0;
        for _ in 0..50 {
            crossed += r.step(QUIET, &Vector2::new(0.01, 0.0), &PATIENT, 0.01)[1];
        }
        // four or five response times fit into that time
        assert!(r.share(1) > 0.5 + 3.5 * INCREMENT && r.share(1) <= SHARE_INITIAL);
        assert!(
            (r.share(1) - 0.5 - crossed).abs() < 1e-12,
            "the next reversal crosses what this one crossed in total"
        );
    }

    #[test]
    fn a_successful_reversal_keeps_the_share() {
        let mut r = BacklashAdaptation::default();
        r.step(REVERSAL, &Vector2::new(0.01, 0.0), &PATIENT, 0.01);
        for _ in 0..50 {
            r.step(QUIET, &Vector2::new(0.001, 0.0), &PATIENT, 0.01);
        }
        assert_eq!(r.share(1), SHARE_INITIAL);
    }

    #[test]
    fn without_an_error_that_can_be_corrected_the_share_only_shrinks() {
        let mut r = BacklashAdaptation::default();
        for k in 0..100 {
            r.step(
                if k % 20 == 0 { REVERSAL } else { QUIET },
                &Vector2::zeros(),
                &PATIENT,
                0.01,
            );
        }
        assert!(r.share(1) < 0.2, "{}", r.share(1));
    }

    #[test]
    fn a_moving_setpoint_ends_the_observation() {
        let mut r = BacklashAdaptation::default();
        r.step(REVERSAL, &Vector2::new(0.01, 0.0), &PATIENT, 0.01);
        r.forget();
        r.step(REVERSAL, &Vector2::new(-0.01, 0.0), &PATIENT, 0.01);
        assert_eq!(r.share(1), SHARE_INITIAL);
    }
}
