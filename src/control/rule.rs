//! The feedback, an orientation PI loop written once, and the rule for when to move.
//!
//! The observer believes that the tip, once it has settled at the counted pistons, bends by `b = laws + g`. The proportional part
//! moves the laws by `kp (target − b)`; the integral part is g itself, which follows what the laws leave at rest with the rate `ki`
//! ([`super::observer`]). A tip at rest is moved when what the move takes off the squared error exceeds what it risks,
//!
//! `|e|² − |e'|² > caution² (reversal min(1, t_answer / t_rest) + step² + slip²)`,
//!
//! because a move crosses gaps whose width is known to a standard deviation, and friction. What a reversal does wrong is seen after
//! `t_answer`, while an error that has lasted for `t_rest` goes on. `|e'|` is what the limits of the actuators leave; 0 without a limit and with `kp` 1. The variance of
//! the belief is on neither side: it is the same before and after a move.

use crate::control::CalmConfig;
use crate::control::dynamics::Dynamics;
use crate::control::observer::Observer;
use crate::control::observer::laws::{OFFSET, ROTATION};
use crate::primitives::lasting;
use nalgebra::{Vector2, Vector3};

crate::constants! {
    /// What a move is believed to do, and how fast a late one is.
    const RULE: RuleConstants;
    /// Weight of one answer in the mean square of the slip.
    slip_gain = 0.05;
    /// Share of that mean square that a new target keeps.
    slip_keep = 0.75;
    /// Largest slip, rad.
    slip_max = 0.05;
    /// Time beyond dead time and three lags after which a move is answered, s.
    answered_s = 0.2;
    /// Least time for which a new pose is corrected at full speed, s.
    quick_min_s = 0.35;
    /// Speed per error above the large one, 1/s.
    large_gain_1_s = 10.0;
    /// Factor on the piston speed of a late correction, and standard deviations of a gap that are surely empty.
    late_factor = 1.5;
}

/// State of the rule.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rule {
    /// Pistons that were decided, mm.
    pub aim_mm: Vector3<f64>,
    /// The same within their limits, mm.
    pub goal_mm: Vector3<f64>,
    /// Common length spent beside the commanded one, rad of output.
    pub free: f64,
    /// Time for which the set-point has rested, s.
    pub held_s: f64,
    /// Target of the last move, and the time since.
    acted: Option<(Vector2<f64>, f64)>,
    /// Mean square of what the tip missed after earlier moves, rad².
    slip_2: f64,
    /// Time since the last move, s.
    pub rests_s: f64,
}

impl Rule {
    /// Pistons that rest at `piston_mm`.
    pub fn resting(piston_mm: Vector3<f64>) -> Self {
        Self {
            aim_mm: piston_mm,
            goal_mm: piston_mm,
            ..Self::default()
        }
    }

    /// A new target.
    pub fn depart(&mut self) {
        self.acted = None;
        self.slip_2 *= RULE.slip_keep;
    }

    /// One tick with a set-point that moves or rests.
    pub fn step(&mut self, moving: bool, dt_s: f64) {
        self.held_s = lasting(!moving, self.held_s, dt_s);
        self.rests_s = lasting(!moving, self.rests_s, dt_s);
    }

    /// Takes the answer to the last move. A disturbed tip is no measurement.
    pub fn answer(
        &mut self,
        dynamics: &Dynamics,
        estimate: &Vector2<f64>,
        disturbed: bool,
        dt_s: f64,
    ) {
        let Some((aim, since_s)) = &mut self.acted else {
            return;
        };
        *since_s += dt_s;
        if *since_s > answered_s(dynamics) && !disturbed {
            let miss_2 = (estimate - *aim).norm().min(RULE.slip_max).powi(2);
            self.slip_2 += RULE.slip_gain * (miss_2 - self.slip_2);
            self.acted = None;
        }
    }

    /// Whether to make a move that removes `gain_2` of the squared error, with this risk; both rad². What a reversal does wrong lasts
    /// until it is answered, and what is not moved lasts on: for as long again, at a guess, as it has.
    pub fn moves(
        &self,
        dynamics: &Dynamics,
        gain_2: f64,
        risk: f64,
        step: f64,
        caution: f64,
    ) -> bool {
        let lasts = (answered_s(dynamics) / self.rests_s.max(f64::MIN_POSITIVE)).min(1.0);
        gain_2 > caution * caution * (risk * lasts + step * step + self.slip_2)
    }

    /// Notes a move towards `target`.
    pub fn act(&mut self, target: &Vector2<f64>) {
        self.rests_s = 0.0;
        self.acted.get_or_insert((*target, 0.0));
    }

    /// The pistons `goal_mm`, approached from `from_mm` no faster than late corrections permit: after a while at rest a piston that
    /// pushes the tip moves slowly, one in the part of its gap that is surely empty does not.
    pub fn slowly(
        &self,
        config: &CalmConfig,
        observer: &Observer,
        from_mm: &Vector3<f64>,
        error_rad: f64,
        dt_s: f64,
    ) -> Vector3<f64> {
        let Dynamics { lag_s, delay_s } = observer.dynamics;
        if self.held_s <= (config.after_s - (delay_s + 2.0 * lag_s)).max(RULE.quick_min_s) {
            return self.goal_mm;
        }
        let beyond = (error_rad - config.large_deg.to_radians()).max(0.0);
        let speed = config.speed_deg_s.to_radians() + RULE.large_gain_1_s * beyond;
        Vector3::from_fn(|i, _| {
            let (from, goal) = (from_mm[i], self.goal_mm[i]);
            let to_go = goal - from;
            if to_go.abs() < 1e-9 {
                return goal;
            }
            let play = &observer.now.play[i];
            let engaged = -play.slope * to_go > 0.0 && !observer.now.is_uncertain(i);
            let sigma_mm = observer.half_width_sigma_mm(i);
            let engages = play.w_mm
                + to_go.signum() * (observer.lines[i].k_lambda_mm - RULE.late_factor * sigma_mm);
            if !engaged && (engages - from) * to_go > 0.0 {
                let crosses = (goal - engages) * to_go > 0.0;
                return if crosses { engages } else { goal };
            }
            let most = speed * RULE.late_factor * observer.mm_per_rad(i) * dt_s;
            from + to_go.clamp(-most, most)
        })
    }
}

/// Time after which a move is answered, s.
fn answered_s(dynamics: &Dynamics) -> f64 {
    dynamics.delay_s + 3.0 * dynamics.lag_s + RULE.answered_s
}

/// Bend of the channels with which the tip is at `at`, rad, while g has the share `share` and a disturbance bends by `disturbed`.
pub fn needed(
    observer: &Observer,
    at: &Vector2<f64>,
    share: f64,
    disturbed: &Vector2<f64>,
) -> Vector2<f64> {
    let theta = observer.theta();
    let offset = Vector2::new(theta[OFFSET], theta[OFFSET + 1]);
    unrotated(
        at - observer.residual() * share - disturbed - offset,
        theta[ROTATION],
    )
}

/// The bend whose rotation by the small angle `angle` is `bend`.
pub fn unrotated(bend: Vector2<f64>, angle: f64) -> Vector2<f64> {
    (bend - Vector2::new(-bend.y, bend.x) * angle) / (1.0 + angle * angle)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DYNAMICS: Dynamics = Dynamics {
        lag_s: 0.03,
        delay_s: 0.01,
    };

    #[test]
    fn a_tip_that_slips_is_moved_less_and_a_new_target_forgives() {
        let (mut rule, target) = (Rule::default(), Vector2::new(0.5, 0.0));
        let small = Vector2::new(0.004, 0.0);
        let moves = |rule: &Rule| rule.moves(&DYNAMICS, small.norm_squared(), 0.0, 0.0015, 1.0);
        assert!(moves(&rule));
        for _ in 0..40 {
            rule.act(&target);
            (0..100).for_each(|_| rule.answer(&DYNAMICS, &Vector2::new(0.52, 0.0), false, 0.01));
        }
        assert!(!moves(&rule), "{rule:?}");
        (0..40).for_each(|_| rule.depart());
        assert!(moves(&rule), "{rule:?}");
    }

    #[test]
    fn a_reversal_must_be_worth_its_risk() {
        let rule = Rule::default();
        let gain_2 = 1e-4;
        assert!(
            rule.moves(&DYNAMICS, gain_2, 1e-6, 0.0015, 1.0)
                && !rule.moves(&DYNAMICS, gain_2, 2e-4, 0.0015, 1.0)
        );
        assert!(
            rule.moves(&DYNAMICS, gain_2, 2e-4, 0.0015, 0.5),
            "less cautious"
        );
    }
}
