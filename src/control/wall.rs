//! A tip that is pushed and does not come: wall, blocked line or a motor that is off.
//!
//! While the set-point rests, the feedback grows until the tip answers. If it has grown by a good
//! deal and the tip has followed by less than a fraction of it, more pressure is not the remedy: the
//! integrator is told to stop and the loop says so. A new target starts the watch again.

use nalgebra::Vector2;

/// When pushing counts as futile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WallConfig {
    /// Feedback added since the set-point came to rest before anything is said, rad.
    pub push_rad: f64,
    /// Fraction of that push that a free tip follows at the least.
    pub follow_min: f64,
    /// Error below which nobody minds, rad.
    pub error_rad: f64,
}

/// What the watch remembers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WallState {
    begun: Option<(Vector2<f64>, Vector2<f64>)>,
    /// The tip is held by something; the integrator stands still.
    pub blocked: bool,
}

impl WallState {
    /// One tick with the feedback in the command, the felt bend and the error, all rad.
    pub fn step(&mut self, config: &WallConfig, moving: bool, feedback: &Vector2<f64>, felt: &Vector2<f64>, error: &Vector2<f64>) {
        if moving {
            *self = Self::default();
            return;
        }
        let (feedback0, felt0) = *self.begun.get_or_insert((*feedback, *felt));
        let push = feedback - feedback0;
        let size = push.norm();
        if size > config.push_rad && error.norm() > config.error_rad {
            let followed = (felt - felt0).dot(&push) / (size * size);
            self.blocked |= followed < config.follow_min;
        } else if error.norm() < config.error_rad {
            self.blocked = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: WallConfig = WallConfig { push_rad: 0.14, follow_min: 0.25, error_rad: 0.017 };

    fn push(compliance: f64) -> bool {
        let mut s = WallState::default();
        for i in 0..100 {
            let f = Vector2::new(0.005 * f64::from(i), 0.0);
            let felt = f * compliance;
            s.step(&CONFIG, false, &f, &felt, &(Vector2::new(0.4, 0.0) - felt));
        }
        s.blocked
    }

    #[test]
    fn a_wall_is_told_from_a_soft_line() {
        assert!(push(0.05));
        assert!(!push(0.5));
    }

    #[test]
    fn a_new_target_starts_again() {
        let mut s = WallState { blocked: true, ..WallState::default() };
        s.step(&CONFIG, true, &Vector2::zeros(), &Vector2::zeros(), &Vector2::zeros());
        assert!(!s.blocked);
    }
}
