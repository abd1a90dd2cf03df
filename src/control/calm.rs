//! Calm corrections

use nalgebra::Vector2;

/// knob
pub fn knob(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

/// State
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Calm {
    arrived_s: f64,
    usual: Vector2<f64>,
    disturbed: bool,
    swing: Vector2<f64>,
    swing2: f64,
    reached: Vector2<f64>,
}

impl Calm {
    /// One tick.
    pub fn step(&mut self, moving: bool, unexplained: &Vector2<f64>, response_s: f64, own: bool, dt_s: f64) {
        let after = knob("CALM_AFTER", 0.5);
        let change = unexplained - std::mem::replace(&mut self.usual, *unexplained);
        if moving {
            self.arrived_s = 0.0;
            return;
        }
        self.arrived_s += dt_s;
        if self.arrived_s < after + knob("CALM_R", 1.0) * response_s {
            return;
        }
        self.swing = self.swing * (1.0 - dt_s / knob("CALM_TAU", 2.0)) + change;
        self.swing2 += (self.swing.norm_squared() - self.swing2) * dt_s / knob("CALM_MEM", 4.0);
        self.disturbed = !own && self.swing2 > knob("CALM_DIST", 1.0).to_radians().powi(2);
    }

    /// The model now predicts a bend that differs by `shift`, rad.
    pub fn shift(&mut self, shift: &Vector2<f64>) {
        self.usual += shift;
    }

    /// Calm.
    pub fn holds(&self) -> bool {
        self.arrived_s >= knob("CALM_AFTER", 0.5) && !self.disturbed
    }

    /// Feedback
    pub fn limit(&mut self, before: &Vector2<f64>, wanted: &Vector2<f64>, error: f64, lag_s: f64, dt_s: f64) -> Vector2<f64> {
        let lag_s = lag_s.max(dt_s);
        let mut to = *wanted;
        if self.holds() {
            let speed = knob("CALM_V", 1.0).to_radians() + knob("CALM_K", 10.0) * (error - knob("CALM_E", 4.0).to_radians()).max(0.0);
            let most = (speed * lag_s).max((before - self.reached).norm());
            to = self.reached + (to - self.reached).cap_magnitude(most);
        }
        self.reached += (to - self.reached) * (dt_s / lag_s).min(1.0);
        to
    }
}
