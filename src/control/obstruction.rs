//! A tip that is pushed and does not come: wall, blocked line or a motor that is off.
//!
//! While the set-point rests, the feedback grows until the tip answers. If it has grown by a good
//! deal and the tip has followed by less than a fraction of it, more pressure is not the remedy: the
//! integrator is told to stop and the loop says so. A new target starts the watch again, and so does a
//! tip that goes back against the push: a line that has weakened lets it sink, a thing that comes pushes
//! it, and whether pushing helps against either is to be seen from where it came to rest.

use nalgebra::Vector2;

/// When pushing counts as futile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObstructionConfig {
    /// Feedback added since the set-point came to rest before anything is said, rad.
    pub push_rad: f64,
    /// Fraction of that push that a free tip follows at the least.
    pub follow_min: f64,
    /// Error below which nobody minds, rad.
    pub error_rad: f64,
}

/// What the watch remembers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ObstructionDetector {
    begun: Option<(Vector2<f64>, Vector2<f64>)>,
    /// The tip is held by something; the integrator stands still.
    pub blocked: bool,
}

impl ObstructionDetector {
    /// One tick with the feedback in the command, the felt bend and the error, all rad.
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
        let (feedback0, felt0) = *self.begun.get_or_insert((*feedback, *estimate));
        let push = feedback - feedback0;
        let size = push.norm();
        if (estimate - felt0).dot(&push) < -size * BACK_RAD {
            self.begun = Some((*feedback, *estimate));
        } else if size > config.push_rad && error.norm() > config.error_rad {
            let followed = (estimate - felt0).dot(&push) / (size * size);
            self.blocked |= followed < config.follow_min;
        } else if error.norm() < config.error_rad {
            self.blocked = false;
        }
    }
}

/// Way back that is more than noise, rad (0.2°).
const BACK_RAD: f64 = 0.0035;

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: ObstructionConfig = ObstructionConfig { push_rad: 0.14, follow_min: 0.25, error_rad: 0.017 };

    fn push(compliance: f64) -> bool {
        let mut s = ObstructionDetector::default();
        for i in 0..100 {
            let f = Vector2::new(0.005 * f64::from(i), 0.0);
            let estimate = f * compliance;
            s.step(&CONFIG, false, &f, &estimate, &(Vector2::new(0.4, 0.0) - estimate));
        }
        s.blocked
    }

    #[test]
    fn a_wall_is_told_from_a_soft_line() {
        assert!(push(0.05));
        assert!(!push(0.5));
    }

    #[test]
    fn a_line_that_weakens_lets_the_tip_sink_and_is_pushed_on() {
        // sinks by 20° while feedback grows as much, then follows with 0.6, or not at all
        let after = |compliance: f64| {
            let mut s = ObstructionDetector::default();
            for i in 0..200 {
                let f = Vector2::new(0.005 * f64::from(i), 0.0);
                let sunk = Vector2::new(-0.005 * f64::from(i.min(70)), 0.0);
                let estimate = sunk + f.map(|f| (f - 0.35).max(0.0) * compliance);
                s.step(&CONFIG, false, &f, &estimate, &(Vector2::new(0.4, 0.0) - estimate));
            }
            s.blocked
        };
        assert!(!after(0.6), "sinking is not standing still");
        assert!(after(0.05), "it sank and then stands");
    }

    #[test]
    fn a_new_target_starts_again() {
        let mut s = ObstructionDetector { blocked: true, ..ObstructionDetector::default() };
        s.step(&CONFIG, true, &Vector2::zeros(), &Vector2::zeros(), &Vector2::zeros());
        assert!(!s.blocked);
    }
}
