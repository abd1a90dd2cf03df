//! PI feedback on the bend vector, with the reference passed through a model of the line.
//!
//! The tip follows a command `b_c` after a dead time T and a lag τ. An error relative to the set-point itself would charge
//! the integrator during every move. The error is therefore relative to the bend that the model predicts,
//!
//! `e = D L [b_a − f] − b̂`,
//!
//! where `b_a` is the bend that the counted steps cause according to the transmission model, `f = I + K_p e` the feedback
//! contained in it, `L` the lag, `D` the dead time and `b̂` the estimated bend. Because `b_a` follows the steps made and
//! not the command, a piston at its speed or travel limit does not wind up the integrator. This is the observer form of
//! anti-windup (Åström & Hägglund 2006, §3.5); for the plant `e^{−Ts}/(1+τs)` it is internal-model control (Rivera,
//! Morari & Skogestad 1986).
//!
//! Gains follow from the dynamics by Skogestad's rule (2003): `K_p = τ/(τ_c+T)`, `K_i = 1/(τ_c+T)`.
//! The integrator stores bend, not error, so a change of gains does not move the tip.

use nalgebra::Vector2;

/// Lag and dead time from the pistons to the estimated bend.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dynamics {
    /// First-order lag τ, s.
    pub lag_s: f64,
    /// Dead time T, s.
    pub delay_s: f64,
}

/// Gains of the loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PiGains {
    /// Proportional gain K_p, rad per rad.
    pub kp: f64,
    /// Integral gain K_i, 1/s.
    pub ki: f64,
}

impl PiGains {
    /// Gains by Skogestad's rule for the closed-loop time constant `tau_c_s`. K_p is bounded, because it amplifies the
    /// noise of the estimate.
    #[must_use]
    pub fn skogestad(dynamics: &Dynamics, tau_c_s: f64, kp_max: f64) -> Self {
        // the loop cannot be faster than the dead time allows
        let horizon = tau_c_s.max(dynamics.delay_s) + dynamics.delay_s;
        let kp = (dynamics.lag_s / horizon).min(kp_max);
        let ki = if kp < kp_max { 1.0 / horizon } else { kp_max / dynamics.lag_s };
        Self { kp, ki }
    }
}

/// Length of the delay line: 0.5 s at a period of 1 ms, 5 s at 10 ms.
const LINE: usize = 512;

/// Reference model: dead time, then first-order lag.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceModel {
    line: [Vector2<f64>; LINE],
    head: usize,
    lagged: Vector2<f64>,
}

impl Default for ReferenceModel {
    fn default() -> Self {
        Self { line: [Vector2::zeros(); LINE], head: 0, lagged: Vector2::zeros() }
    }
}

impl ReferenceModel {
    /// A model that has rested at `at`, rad.
    #[must_use]
    pub fn resting(at: Vector2<f64>) -> Self {
        Self { line: [at; LINE], head: 0, lagged: at }
    }

    /// One tick with the present command, rad; returns the predicted bend, rad.
    pub fn step(&mut self, commanded: Vector2<f64>, dynamics: &Dynamics, dt_s: f64) -> Vector2<f64> {
        self.head = (self.head + 1) % LINE;
        self.line[self.head] = commanded;
        let back = ((dynamics.delay_s / dt_s).round() as usize).min(LINE - 1);
        let delayed = self.line[(self.head + LINE - back) % LINE];
        // exact for an input that is constant over the tick
        let keep = (-dt_s / dynamics.lag_s.max(1e-4)).exp();
        self.lagged = delayed + (self.lagged - delayed) * keep;
        self.lagged
    }
}

/// State of the PI controller.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PiState {
    /// Integral part I, rad.
    pub integral: Vector2<f64>,
    /// Feedback f = I + K_p e contained in the command, rad.
    pub feedback: Vector2<f64>,
}

impl PiState {
    /// One tick with the error, rad. `integral_max` bounds |I|, rad; returns true if the bound is reached.
    pub fn step(&mut self, error: Vector2<f64>, gains: &PiGains, integral_max: f64, dt_s: f64) -> bool {
        self.integral += error * (gains.ki * dt_s);
        let size = self.integral.norm();
        let full = size > integral_max;
        if full {
            self.integral *= integral_max / size;
        }
        self.feedback = self.integral + error * gains.kp;
        full
    }

    /// Adds `shift`, rad, to compensate a change of the transmission gains, so that the command stays the same.
    pub fn hand_over(&mut self, shift: Vector2<f64>) {
        self.integral += shift;
        self.feedback += shift;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Closes the loop on gain·e^{−Ts}/(1+τs) + offset with the model `assumed`.
    fn closed_loop_error(truth: Dynamics, assumed: Dynamics, gain: f64, seconds: f64) -> f64 {
        let dt_s = 0.002;
        let gains = PiGains::skogestad(&assumed, 0.1, 3.0);
        let (mut model, mut pi) = (ReferenceModel::default(), PiState::default());
        let mut plant = ReferenceModel::default();
        let target = Vector2::new(0.6, -0.3);
        let mut estimate = Vector2::zeros();
        for _ in 0..(seconds / dt_s) as usize {
            let command = target + pi.feedback;
            let predicted = model.step(command - pi.feedback, &assumed, dt_s);
            pi.step(predicted - estimate, &gains, 2.0, dt_s);
            estimate = plant.step(command, &truth, dt_s) * gain + Vector2::new(0.05, 0.02);
        }
        (estimate - target).norm()
    }

    proptest! {
        #[test]
        fn removes_gain_and_offset_errors(lag_s in 0.01..0.3f64, delay_s in 0.0..0.2f64, gain in 0.7..1.25f64) {
            let d = Dynamics { lag_s, delay_s };
            prop_assert!(closed_loop_error(d, d, gain, 6.0) < 2e-3);
        }
    }

    #[test]
    fn the_loop_is_stable_with_an_unknown_dead_time_of_0_1_s() {
        let assumed = Dynamics { lag_s: 0.03, delay_s: 0.02 };
        let truth = Dynamics { lag_s: 0.04, delay_s: 0.12 };
        assert!(closed_loop_error(truth, assumed, 1.0, 8.0) < 5e-3);
    }

    #[test]
    fn a_gain_change_does_not_change_the_feedback() {
        let mut pi = PiState { integral: Vector2::new(0.1, 0.0), feedback: Vector2::new(0.1, 0.0) };
        pi.step(Vector2::zeros(), &PiGains { kp: 5.0, ki: 50.0 }, 1.0, 0.001);
        assert_eq!(pi.feedback, Vector2::new(0.1, 0.0));
    }

    #[test]
    fn the_integral_is_bounded_and_reports_the_bound() {
        let mut pi = PiState::default();
        let gains = PiGains { kp: 0.0, ki: 10.0 };
        assert!((0..1000).any(|_| pi.step(Vector2::new(0.1, 0.0), &gains, 0.2, 0.01)));
        assert!(pi.integral.norm() <= 0.2 + 1e-12);
    }
}
