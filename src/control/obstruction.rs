//! Detects a tip that does not follow its pistons: an obstacle, a blocked line, the end of its reach, or a motor that is off.
//!
//! While the set-point rests, the loop moves the pistons on until the tip is on target. If they have pushed considerably towards the
//! target and the tip has followed by less than a given fraction, more pressure does not help: the loop presses no harder, learns
//! nothing but what it needs to stand there, and reports an obstruction. A new target restarts the detection. So does a tip that
//! moves against the push, because a weak line or an approaching obstacle causes that; whether pushing helps then shows from the new
//! position.

use crate::parameters;
use crate::primitives::lasting;
use nalgebra::Vector2;

parameters! {
    /// Obstruction detection: a tip that does not follow its pistons.
    pub struct ObstructionConfig: Copy {
        /// Bend by which the pistons push at a constant set-point before a tip that does not follow counts as obstructed. A larger
        /// value pushes harder against an obstacle.
        push_deg: f64 = 10.0, "deg", 0.5..=90.0, "10 is more than a reversal of the backlash needs";
        /// Smallest fraction of that push that a free tip follows. A larger value takes a soft line for an obstacle.
        follow_min: f64 = 0.2, "", 0.0..=0.9, "with one line pinched a tip still follows a third";
        /// Error below which no obstruction is reported. A larger value hides obstacles that cost little.
        error_deg: f64 = 1.0, "deg", 0.05..=45.0, "1 is the error that matters";
        /// Pressure with which an obstructed tip is pressed, beyond that which its bend needs. A larger value presses harder
        /// on what the tip touches.
        press_kpa: f64 = 12.0, "kPa", 0.0..=40.0, "12 is what a free tip needs for about 35°";
    }
}

/// What pushes the tip, and what it does, rad.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Push {
    /// Bend that the pistons make by the nominal model.
    pub given: Vector2<f64>,
    /// Estimated bend.
    pub estimate: Vector2<f64>,
    /// Target minus estimate.
    pub error: Vector2<f64>,
}

/// The detector.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ObstructionDetector {
    /// Bend from the pistons and estimate at the start of the observation, rad.
    start: Option<(Vector2<f64>, Vector2<f64>)>,
    /// Time for which the tip has not followed, s.
    pushed_s: f64,
    /// Error with which the tip was last found not to follow, rad.
    found: f64,
    /// The tip does not follow.
    pub blocked: bool,
}

impl ObstructionDetector {
    /// One tick. An answer takes up to `answer_s`.
    pub fn step(
        &mut self,
        config: &ObstructionConfig,
        moving: bool,
        push: &Push,
        answer_s: f64,
        dt_s: f64,
    ) {
        if moving {
            *self = Self::default();
            return;
        }
        let (given, estimate, error) = (&push.given, &push.estimate, &push.error);
        let (given0, estimate0) = *self.start.get_or_insert((*given, *estimate));
        let (push, followed) = (given - given0, estimate - estimate0);
        let size = push.norm();
        let withdraws = push.dot(error) < 0.0;
        let pushes = size > config.push_deg.to_radians()
            && followed.dot(&push) < config.follow_min * size * size;
        self.pushed_s = lasting(pushes, self.pushed_s, dt_s);
        if self.blocked {
            // on target, or the tip has moved away: then more push helps
            let free = config.error_deg.to_radians();
            self.blocked = error.norm() > free && error.norm() < self.found + RECEDED_RAD;
        } else if withdraws || followed.dot(&push) < -size * BACK_RAD {
            self.start = Some((*given, *estimate));
        } else if self.pushed_s > answer_s && error.norm() > config.error_deg.to_radians() {
            (self.blocked, self.found) = (true, error.norm());
        }
    }
}

/// Motion away from the target after which an obstructed tip counts as free, rad (5°): an obstruction that is pressed less gives way a
/// little.
const RECEDED_RAD: f64 = 0.087;
/// Motion against the push that exceeds the noise, rad (0.2°).
const BACK_RAD: f64 = 0.0035;

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: ObstructionConfig = ObstructionConfig {
        push_deg: 8.0,
        follow_min: 0.25,
        error_deg: 1.0,
        press_kpa: 12.0,
    };

    fn push(compliance: f64) -> bool {
        let mut s = ObstructionDetector::default();
        for i in 0..100 {
            let f = Vector2::new(0.005 * f64::from(i), 0.0);
            let estimate = f * compliance;
            s.step(
                &CONFIG,
                false,
                &Push {
                    given: f,
                    estimate,
                    error: Vector2::new(1.2, 0.0) - estimate,
                },
                0.05,
                0.005,
            );
        }
        s.blocked
    }

    #[test]
    fn an_obstacle_is_distinguished_from_a_soft_line() {
        assert!(push(0.05));
        assert!(!push(0.5));
    }

    #[test]
    fn a_tip_that_sinks_is_not_obstructed_until_it_stops_following() {
        // sinks by 20° while the push grows as much, then follows with the given compliance
        let after = |compliance: f64| {
            let mut s = ObstructionDetector::default();
            for i in 0..200 {
                let f = Vector2::new(0.005 * f64::from(i), 0.0);
                let sunk = Vector2::new(-0.005 * f64::from(i.min(70)), 0.0);
                let estimate = sunk + f.map(|f| (f - 0.35).max(0.0) * compliance);
                s.step(
                    &CONFIG,
                    false,
                    &Push {
                        given: f,
                        estimate,
                        error: Vector2::new(1.2, 0.0) - estimate,
                    },
                    0.05,
                    0.005,
                );
            }
            s.blocked
        };
        assert!(!after(0.6), "a sinking tip is not obstructed");
        assert!(after(0.05), "the tip sank and then does not follow");
    }

    #[test]
    fn a_new_target_restarts_the_detection() {
        let mut s = ObstructionDetector {
            blocked: true,
            ..ObstructionDetector::default()
        };
        s.step(&CONFIG, true, &Push::default(), 0.05, 0.005);
        assert!(!s.blocked);
    }
}
