//! Predictive PI feedback on the bend vector.
//!
//! The tip follows the pistons after a dead time T and a lag τ. The controller compares the estimated bend `b̂` with the
//! bend that the counted steps should have caused by now,
//!
//! `d = D L b_a − b̂`,
//!
//! where `b_a` is the bend that the steps cause according to the transmission model, `L` the lag and `D` the dead time.
//! `d` is what the model does not explain: errors of the gains, drift, loads. The feedback is the low-passed `d`,
//!
//! `İ = (d − I)/λ`, `f = I + (τ₀/λ)(d − I)`,
//!
//! and the command is set-point plus `f`. Because `b_a` contains `f`, this is a PI controller with the integral time λ and,
//! for a dead time, the predictive PI controller of Hägglund (1992): internal-model control of `e^{−Ts}/(1+τs)` (Rivera,
//! Morari & Skogestad 1986). Because `b_a` follows the steps made and not the command, a piston at its speed or travel
//! limit does not wind up the integral (observer form of anti-windup, Åström & Hägglund 2006, §3.5).
//!
//! # Margins
//!
//! With the model exact except for a gain g the loop is stable for |g − 1| < 1, a gain margin of 2. Let the true lag differ
//! from the model's by at most a, the dead time by at most b, and let m be the longer lag. The two responses then differ at
//! the frequency ω by at most (a + b)ω/√(1 + m²ω²), and because (1 + λ²ω²)(1 + m²ω²) ≥ (λ + m)²ω², the loop is stable for
//! λ + m > a + b (small-gain theorem). On a slow line this allows any λ, so λ + m ≥ a + b + bm/λ is required: λ is never
//! below the error of the dead time. a and b are 1.5 times the largest plausible errors, which are large before the tip has
//! moved and shrink with the evidence ([`crate::control::learning::dynamics`]): the loop starts slowly and becomes quicker. λ
//! is also at least the dead time, so that errors of gain and of dead time together are tolerated (the SIMC rule,
//! Skogestad 2003).

use nalgebra::Vector2;

/// Lag and dead time from the pistons to the estimated bend.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Dynamics {
    /// First-order lag τ, s.
    pub lag_s: f64,
    /// Dead time T, s.
    pub delay_s: f64,
}

impl Dynamics {
    /// Lag plus dead time, s: the mean delay of the answer to a step.
    pub fn response_s(&self) -> f64 {
        self.lag_s + self.delay_s
    }
}

/// Lag and dead time before any motion, and how far they may be off.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DynamicsPrior {
    /// Expected values.
    pub expected: Dynamics,
    /// Standard deviation of lag and of dead time, s.
    pub uncertainty_s: f64,
}

/// Longest lag or dead time that any line or sensor has, s.
const TIME_MAX_S: f64 = 600.0;

impl DynamicsPrior {
    /// True for a lag or a dead time that something can have.
    pub fn is_possible_s(time_s: f64) -> bool {
        (0.0..=TIME_MAX_S).contains(&time_s)
    }
    /// What a calibration has measured.
    pub fn calibrated(expected: Dynamics) -> Self {
        Self {
            expected,
            uncertainty_s: UNCERTAINTY_MIN_S,
        }
    }

    /// Squared distance of a candidate from the expectation in standard deviations.
    pub fn distance_squared(&self, candidate: &Dynamics) -> f64 {
        let Dynamics { lag_s, delay_s } = self.expected;
        ((candidate.lag_s - lag_s).powi(2) + (candidate.delay_s - delay_s).powi(2))
            / self.uncertainty_s.powi(2)
    }

    /// The range of three standard deviations.
    pub fn range(&self) -> DynamicsRange {
        let margin_s = 3.0 * self.uncertainty_s;
        DynamicsRange {
            best: self.expected,
            integral_min_s: MARGIN * margin_s,
            lag_min_s: (self.expected.lag_s - margin_s).max(0.0),
            response_min_s: (self.expected.response_s() - margin_s).max(0.0),
            response_max_s: self.expected.response_s() + margin_s,
        }
    }
}

/// Lag and dead time in use, and the range that is plausible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DynamicsRange {
    /// The values that the reference model and the feedforward use.
    pub best: Dynamics,
    /// Smallest integral time that is stable for every plausible line, s.
    pub integral_min_s: f64,
    /// Smallest plausible lag, s.
    pub lag_min_s: f64,
    /// Smallest plausible sum of lag and dead time, s.
    pub response_min_s: f64,
    /// Largest plausible sum of lag and dead time, s.
    pub response_max_s: f64,
}

impl DynamicsRange {
    /// What a later start takes as its prior.
    pub fn prior(&self) -> DynamicsPrior {
        DynamicsPrior {
            expected: self.best,
            uncertainty_s: (self.error_max_s() / 3.0).max(UNCERTAINTY_MIN_S),
        }
    }

    /// Largest plausible error of the response time, s.
    pub fn error_max_s(&self) -> f64 {
        let response_s = self.best.response_s();
        (self.response_max_s - response_s)
            .max(response_s - self.response_min_s)
            .max(0.0)
    }
}

/// Smallest uncertainty of a remembered lag or dead time, s: a line may be exchanged or pinched in the meantime.
const UNCERTAINTY_MIN_S: f64 = 0.02;

/// Time constants of the loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PiGains {
    /// Integral time λ, s.
    pub integral_s: f64,
    /// Lag τ₀ that the proportional part compensates, s.
    pub lag_s: f64,
}

/// Factor on the errors of lag and dead time.
const MARGIN: f64 = 1.5;

impl Dynamics {
    /// Smallest integral time with which a loop whose model these dynamics are is stable on the line `truth`, s.
    pub fn integral_min_s(&self, truth: &Self) -> f64 {
        let longest_s = self.lag_s.max(truth.lag_s);
        let [lag_off_s, delay_off_s] =
            [self.lag_s - truth.lag_s, self.delay_s - truth.delay_s].map(f64::abs);
        let half = (MARGIN * (lag_off_s + delay_off_s) - longest_s) / 2.0;
        half + (half * half + MARGIN * delay_off_s * longest_s).sqrt()
    }
}

/// Share of the closed-loop time constant that the integral time has while the reference moves.
const FOLLOWING_SHARE: f64 = 0.35;
/// Proportional gain while the reference moves.
const FOLLOWING_KP: f64 = 0.45;

impl PiGains {
    /// Gains for the closed-loop time constant `tau_c_s`, stable for every plausible line. The proportional gain is
    /// bounded by `kp_max`, because it amplifies the noise of the estimate. `caution` ≥ 1 slows the loop down.
    pub fn new(range: &DynamicsRange, tau_c_s: f64, kp_max: f64, caution: f64) -> Self {
        let integral_s = tau_c_s
            .max(range.best.delay_s)
            .max(range.integral_min_s)
            .max(range.lag_min_s / kp_max)
            * caution;
        Self {
            integral_s,
            lag_s: range.lag_min_s.min(kp_max * integral_s),
        }
    }

    /// Quicker gains for a reference that moves. What the model does not explain then changes with the bend, and every
    /// delay of the feedback is an error; the noise that it passes on does not matter, because the pistons move anyway. With
    /// a proportional gain below 0.5 the loop is stable for every plausible line, as with [`PiGains::new`].
    pub fn following(range: &DynamicsRange, tau_c_s: f64, kp_max: f64, caution: f64) -> Self {
        let integral_s = (FOLLOWING_SHARE * tau_c_s).max(range.integral_min_s) * caution;
        Self {
            integral_s,
            lag_s: FOLLOWING_KP.min(kp_max) * integral_s,
        }
    }
}

/// Length of the delay line: 1 s at a period of 1 ms, 10 s at 10 ms.
const LINE: usize = 1024;

/// Reference model: dead time, then first-order lag.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceModel {
    line: [Vector2<f64>; LINE],
    head: usize,
    lagged: Vector2<f64>,
}

impl Default for ReferenceModel {
    fn default() -> Self {
        Self {
            line: [Vector2::zeros(); LINE],
            head: 0,
            lagged: Vector2::zeros(),
        }
    }
}

impl ReferenceModel {
    /// A model that has rested at `at`, rad.
    pub fn resting(at: Vector2<f64>) -> Self {
        Self {
            line: [at; LINE],
            head: 0,
            lagged: at,
        }
    }

    /// The last prediction, rad.
    pub fn predicted(&self) -> Vector2<f64> {
        self.lagged
    }

    /// Adds `shift`, rad, to all bends, because the transmission gains have changed.
    pub fn shift(&mut self, shift: Vector2<f64>) {
        self.line.iter_mut().for_each(|bend| *bend += shift);
        self.lagged += shift;
    }

    /// One tick with the present bend from the pistons, rad; returns the predicted bend, rad.
    pub fn step(
        &mut self,
        commanded: Vector2<f64>,
        dynamics: &Dynamics,
        dt_s: f64,
    ) -> Vector2<f64> {
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
    /// Feedback f contained in the command, rad.
    pub feedback: Vector2<f64>,
}

impl PiState {
    /// One tick with the unexplained bend d, rad. While the prediction moves, an error of its timing makes part of d: what
    /// `timing`, rad, explains of a change is left out. `integral_max` bounds |I|, rad; returns true if the bound is reached.
    pub fn step(
        &mut self,
        unexplained: Vector2<f64>,
        timing: f64,
        gains: &PiGains,
        integral_max: f64,
        dt_s: f64,
    ) -> bool {
        let change = unexplained - self.integral;
        let change = change * (1.0 - timing / change.norm().max(timing).max(f64::MIN_POSITIVE));
        self.integral += change * (1.0 - (-dt_s / gains.integral_s).exp());
        let size = self.integral.norm();
        let full = size > integral_max;
        if full {
            self.integral *= integral_max / size;
        }
        self.feedback = self.integral + change * (gains.lag_s / gains.integral_s);
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

    fn within(best: Dynamics, error_s: f64) -> DynamicsRange {
        let r = best.response_s();
        DynamicsRange {
            best,
            integral_min_s: MARGIN * error_s,
            lag_min_s: (best.lag_s - error_s).max(0.0),
            response_min_s: r - error_s,
            response_max_s: r + error_s,
        }
    }

    /// Largest error over the last second after `seconds` on gain·e^{−Ts}/(1+τs) + offset.
    fn closed_loop_error(truth: Dynamics, range: DynamicsRange, gain: f64, seconds: f64) -> f64 {
        closed_loop_error_with(
            PiGains::new(&range, 0.1, 3.0, 1.0),
            truth,
            range,
            gain,
            seconds,
        )
    }

    fn closed_loop_error_with(
        gains: PiGains,
        truth: Dynamics,
        range: DynamicsRange,
        gain: f64,
        seconds: f64,
    ) -> f64 {
        let dt_s = 0.002;
        let (mut model, mut pi) = (ReferenceModel::default(), PiState::default());
        let mut plant = ReferenceModel::default();
        let target = Vector2::new(0.6, -0.3);
        let mut estimate = Vector2::zeros();
        let ticks = (seconds / dt_s) as usize;
        let mut largest: f64 = 0.0;
        for k in 0..ticks {
            let command = target + pi.feedback;
            pi.step(
                model.step(command, &range.best, dt_s) - estimate,
                0.0,
                &gains,
                2.0,
                dt_s,
            );
            estimate = plant.step(command, &truth, dt_s) * gain + Vector2::new(0.05, 0.02);
            if k + (1.0 / dt_s) as usize > ticks {
                largest = largest.max((estimate - target).norm());
            }
        }
        largest
    }

    proptest! {
        #[test]
        fn removes_gain_and_offset_errors(lag_s in 0.01..0.3f64, delay_s in 0.0..0.3f64, gain in 0.6..1.5f64) {
            let d = Dynamics { lag_s, delay_s };
            prop_assert!(closed_loop_error(d, within(d, 0.0), gain, 12.0) < 2e-3);
        }

        #[test]
        fn is_stable_for_every_plausible_line(
            lag_s in 0.02..0.6f64, delay_s in 0.05..0.3f64, lag_off_s in -0.3..0.3f64, delay_off_s in -0.2..0.2f64,
        ) {
            let best = Dynamics { lag_s, delay_s };
            let truth = Dynamics { lag_s: (lag_s + lag_off_s).max(0.0), delay_s: (delay_s + delay_off_s).max(0.0) };
            let (integral_min_s, lag_min_s) = (best.integral_min_s(&truth), lag_s.min(truth.lag_s));
            let range = DynamicsRange { integral_min_s, lag_min_s, ..within(best, 0.0) };
            prop_assert!(closed_loop_error(truth, range, 1.0, 20.0) < 5e-3);
            let following = PiGains::following(&range, 0.1, 3.0, 1.0);
            prop_assert!(closed_loop_error_with(following, truth, range, 1.0, 20.0) < 5e-3);
        }
    }

    #[test]
    fn the_gain_margin_is_two() {
        let d = Dynamics {
            lag_s: 0.03,
            delay_s: 0.1,
        };
        assert!(closed_loop_error(d, within(d, 0.02), 1.9, 30.0) < 0.01);
    }

    #[test]
    fn a_gain_change_does_not_change_the_feedback() {
        let mut pi = PiState {
            integral: Vector2::new(0.1, 0.0),
            feedback: Vector2::new(0.1, 0.0),
        };
        pi.step(
            Vector2::new(0.1, 0.0),
            0.0,
            &PiGains {
                integral_s: 0.02,
                lag_s: 0.1,
            },
            1.0,
            0.001,
        );
        assert_eq!(pi.feedback, Vector2::new(0.1, 0.0));
    }

    #[test]
    fn the_integral_is_bounded_and_reports_the_bound() {
        let mut pi = PiState::default();
        let gains = PiGains {
            integral_s: 0.1,
            lag_s: 0.0,
        };
        assert!((0..1000).any(|_| pi.step(Vector2::new(0.3, 0.0), 0.0, &gains, 0.2, 0.01)));
        assert!(pi.integral.norm() <= 0.2 + 1e-12);
    }
}
