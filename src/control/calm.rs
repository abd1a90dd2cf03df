//! Calm corrections: once the set-point has rested for a while, the feedback moves the tip gently.
//!
//! What is left to correct then is small, and a quick correction costs more than it gains: a piston that reverses crosses a backlash
//! that is known to a few percent only, and the tip jumps by what is wrong. So the latch closes in a wider band, a reversal first
//! crosses a part of what was learned, and the feedback is bounded so that the tip, behind its lag, moves no faster than
//! 1 °/s. Larger errors, which an obstruction that gives way or a pinched line leaves, are corrected faster.
//!
//! A disturbance that bends the tip again and again, such as breath, is none of that: the feedback follows it without bounds. It shows
//! in what the model does not explain, which changes while the set-point rests.

use nalgebra::Vector2;

/// Time for which the set-point has rested, s.
const AFTER_S: f64 = 0.5;
/// Error below which the standstill latch closes, rad (0.3°).
const BAND_RAD: f64 = 0.0052;
/// Part of the learned share of the backlash that a reversal crosses at once.
const CROSSES: f64 = 0.5;
/// Speed of the tip, °/s, and the additional speed per degree of an error beyond [`LARGE_RAD`] (4°), 1/s.
const SPEED_DEG_S: f64 = 1.0;
const LARGE_RAD: f64 = 0.07;
const GAIN_1_S: f64 = 10.0;
/// Time after which a swing is forgotten, and memory of its mean square, s of rest.
const SWING_S: f64 = 2.0;
const MEMORY_S: f64 = 4.0;
/// Root mean square of a swing that is a disturbance, rad (1°).
const DISTURBED_RAD: f64 = 0.0175;

/// What a tick tells about a set-point that rests or moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// The set-point moves.
    pub moving: bool,
    /// Predicted minus estimated bend, rad.
    pub unexplained: Vector2<f64>,
    /// The loop hunts: a swing then is its own, and no disturbance of the tip.
    pub own: bool,
    /// Sum of lag and dead time, s.
    pub response_s: f64,
}

/// State of the bound.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CalmCorrection {
    /// Time since the set-point arrived, s.
    arrived_s: f64,
    last: Vector2<f64>,
    /// Change of what the model does not explain, rad, and its mean square.
    swing: Vector2<f64>,
    swing2: f64,
    disturbed: bool,
    /// Feedback that the tip has reached behind its lag, rad.
    reached: Vector2<f64>,
}

impl CalmCorrection {
    /// One tick.
    pub fn step(&mut self, rest: &Rest, dt_s: f64) {
        let change = rest.unexplained - std::mem::replace(&mut self.last, rest.unexplained);
        if rest.moving {
            self.arrived_s = 0.0;
            return;
        }
        self.arrived_s += dt_s;
        // a tip that still arrives is not disturbed
        if self.arrived_s >= AFTER_S + rest.response_s {
            self.swing = self.swing * (1.0 - dt_s / SWING_S) + change;
            self.swing2 += (self.swing.norm_squared() - self.swing2) * dt_s / MEMORY_S;
            self.disturbed = !rest.own && self.swing2 > DISTURBED_RAD * DISTURBED_RAD;
        }
    }

    /// The model now predicts a bend that differs by `shift`, rad, because its gains are others.
    pub fn shift(&mut self, shift: &Vector2<f64>) {
        self.last += shift;
    }

    /// Error at which the pistons may stand, rad.
    pub fn band_rad(&self) -> f64 {
        if self.is_calm() { BAND_RAD } else { 0.0 }
    }

    /// Part of the learned share of the backlash that a reversal crosses at once.
    pub fn crosses(&self) -> f64 {
        if self.is_calm() { CROSSES } else { 1.0 }
    }

    fn is_calm(&self) -> bool {
        self.arrived_s >= AFTER_S && !self.disturbed
    }

    /// The feedback after this tick, between that `before` it and the `wanted` one, rad, at an error of `error_rad`.
    pub fn limit(&mut self, before: &Vector2<f64>, wanted: &Vector2<f64>, error_rad: f64, lag_s: f64, dt_s: f64) -> Vector2<f64> {
        let lag_s = lag_s.max(dt_s);
        let mut feedback = *wanted;
        if self.is_calm() {
            let speed = SPEED_DEG_S.to_radians() + GAIN_1_S * (error_rad - LARGE_RAD).max(0.0);
            // what is under way already is not taken back
            let lead = (speed * lag_s).max((before - self.reached).norm());
            feedback = self.reached + (feedback - self.reached).cap_magnitude(lead);
        }
        self.reached += (feedback - self.reached) * (dt_s / lag_s).min(1.0);
        feedback
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.005;

    /// A hold of 2 s after a motion, with the given unexplained bend, degrees.
    fn hold(calm: &mut CalmCorrection, own: bool, unexplained_deg: impl Fn(f64) -> f64) {
        for k in -20..400 {
            let t = f64::from(k) * DT_S;
            let unexplained = Vector2::new(unexplained_deg(t).to_radians(), 0.0);
            calm.step(&Rest { moving: k < 0, unexplained, own, response_s: 0.05 }, DT_S);
        }
    }

    /// Speed of the tip behind a lag during a calm hold that wants 20° more, °/s.
    fn speed_deg_s(lag_s: f64, error_deg: f64) -> f64 {
        let mut calm = CalmCorrection::default();
        hold(&mut calm, false, |_| 0.0);
        let (mut feedback, mut tip, mut moved) = (Vector2::zeros(), Vector2::<f64>::zeros(), 0.0);
        for k in 0..400 {
            feedback = calm.limit(&feedback, &Vector2::new(0.35, 0.0), error_deg.to_radians(), lag_s, DT_S);
            let before = tip;
            tip += (feedback - tip) * (DT_S / lag_s).min(1.0);
            moved = if k >= 200 { moved + (tip - before).norm() } else { 0.0 };
        }
        moved.to_degrees()
    }

    #[test]
    fn the_tip_moves_gently_behind_any_lag_and_faster_at_a_large_error() {
        for lag_s in [0.01, 0.1, 0.5] {
            assert!((speed_deg_s(lag_s, 1.0) - SPEED_DEG_S).abs() < 0.05, "{lag_s}: {}", speed_deg_s(lag_s, 1.0));
        }
        assert!(speed_deg_s(0.05, 4.5) > 4.0 * SPEED_DEG_S);
    }

    #[test]
    fn an_arriving_tip_is_not_bounded() {
        let mut calm = CalmCorrection::default();
        let wanted = Vector2::new(0.3, 0.1);
        assert_eq!(calm.limit(&Vector2::zeros(), &wanted, 0.3, 0.05, DT_S), wanted);
        assert_eq!((calm.band_rad(), calm.crosses()), (0.0, 1.0));
    }

    #[test]
    fn breath_is_followed_and_a_swing_of_the_loop_is_not() {
        let breath = |t: f64| 3.0 * (std::f64::consts::TAU * 0.25 * t).sin();
        for (own, follows) in [(false, true), (true, false)] {
            let mut calm = CalmCorrection::default();
            (0..6).for_each(|_| hold(&mut calm, own, breath));
            assert_eq!(calm.crosses() == 1.0, follows, "{calm:?}");
        }
    }

    #[test]
    fn a_new_gain_and_a_tip_that_arrives_late_are_no_disturbance() {
        let mut calm = CalmCorrection::default();
        (0..6).for_each(|_| hold(&mut calm, false, |t| 8.0 * (-t / 0.2).exp()));
        assert!(calm.band_rad() > 0.0, "{calm:?}");
        let before = calm.swing2;
        calm.shift(&Vector2::new(0.2, 0.0));
        calm.step(&Rest { moving: false, unexplained: calm.last, own: false, response_s: 0.05 }, DT_S);
        assert!(calm.band_rad() > 0.0 && calm.swing2 <= before, "{calm:?}");
    }
}
