//! Detects a tip that does not follow the feedback: an obstacle, a blocked line, or a motor that is off.
//!
//! While the set-point rests, the feedback grows until the tip responds. If the feedback has grown considerably and the
//! tip has followed by less than a given fraction, more pressure does not help: the integral part may only shrink, and the
//! loop reports an obstruction. A new target restarts the detection. So does a tip that moves against the feedback, because a weak
//! line or an approaching obstacle causes that; whether feedback helps then shows from the new position.

use crate::parameters;
use nalgebra::Vector2;

parameters! {
    /// Obstruction detection: a tip that does not follow its pistons.
    pub struct ObstructionConfig: Copy {
        /// Feedback that is added at a constant set-point before a tip that does not follow counts as obstructed. A larger
        /// value pushes harder against an obstacle.
        push_deg: f64 = 10.0, "deg", 0.5..=90.0, "10 is more than a reversal of the backlash needs";
        /// Smallest fraction of that feedback that a free tip follows. A larger value takes a soft line for an obstacle.
        follow_min: f64 = 0.2, "", 0.0..=0.9, "with one line pinched a tip still follows a third";
        /// Error below which no obstruction is reported. A larger value hides obstacles that cost little.
        error_deg: f64 = 1.0, "deg", 0.05..=45.0, "1 is the error that matters";
        /// Pressure with which an obstructed tip is pressed, beyond that which its bend needs. A larger value presses harder
        /// on what the tip touches.
        press_kpa: f64 = 12.0, "kPa", 0.0..=40.0, "12 is what a free tip needs for about 35°";
    }
}

/// The detector.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ObstructionDetector {
    /// Feedback and estimate at the start of the observation, rad.
    start: Option<(Vector2<f64>, Vector2<f64>)>,
    /// The tip does not follow; the integral part may only shrink.
    pub blocked: bool,
}

impl ObstructionDetector {
    /// One tick with the feedback, the estimated bend and the error, rad.
    pub fn step(
        &mut self,
        config: &ObstructionConfig,
        moving: bool,
        feedback: &Vector2<f64>,
        estimate: &Vector2<f64>,
        error: &Vector2<f64>,
    ) {
        if moving {
            *self = Self::default();
            return;
        }
        let (feedback0, estimate0) = *self.start.get_or_insert((*feedback, *estimate));
        if feedback.norm_squared() < feedback0.norm_squared() {
            // the feedback withdraws: that pushes nothing
            self.start = Some((*feedback, *estimate));
            return;
        }
        let push = feedback - feedback0;
        let size = push.norm();
        if (estimate - estimate0).dot(&push) < -size * BACK_RAD {
            self.start = Some((*feedback, *estimate));
        } else if size > config.push_deg.to_radians()
            && error.norm() > config.error_deg.to_radians()
        {
            let followed = (estimate - estimate0).dot(&push) / (size * size);
            self.blocked |= followed < config.follow_min;
        } else if error.norm() < config.error_deg.to_radians() {
            self.blocked = false;
        }
    }
}

/// Motion against the feedback that exceeds the noise, rad (0.2°).
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
                &f,
                &estimate,
                &(Vector2::new(0.4, 0.0) - estimate),
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
        // sinks by 20° while the feedback grows as much, then follows with the given compliance
        let after = |compliance: f64| {
            let mut s = ObstructionDetector::default();
            for i in 0..200 {
                let f = Vector2::new(0.005 * f64::from(i), 0.0);
                let sunk = Vector2::new(-0.005 * f64::from(i.min(70)), 0.0);
                let estimate = sunk + f.map(|f| (f - 0.35).max(0.0) * compliance);
                s.step(
                    &CONFIG,
                    false,
                    &f,
                    &estimate,
                    &(Vector2::new(0.4, 0.0) - estimate),
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
        s.step(
            &CONFIG,
            true,
            &Vector2::zeros(),
            &Vector2::zeros(),
            &Vector2::zeros(),
        );
        assert!(!s.blocked);
    }
}
