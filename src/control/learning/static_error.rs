//! Learns the static error of the model as a function of the bend.
//!
//! The bend from the pistons `b_a` and the bend of the tip `b` differ by what the gains have wrong, by curves of the rubber and
//! of the air, by loads and by drift. With `p_i = b·u_i`, where `u_i` is the direction of bellow i, the difference is modelled as
//!
//! `b_a − b = Σ_i (⅔ ρ_i p_i + e_i p_i² + t_i p_i³) u_i + ω × b + c`:
//!
//! `ρ` is the error of 1 + k_ε as a fraction, `e` and `t` are curves (elongation unlike contraction, air and walls that
//! stiffen), `ω` is a rotation of the bend plane and `c` an offset. A Kalman filter with a random walk of the twelve
//! parameters (Jazwinski 1970, §8.3) learns them while the tip moves and where it stands. The feedback contains the result at
//! the set-point, so it starts at every target with what the poses before have taught, and a slow line is corrected for the
//! error at the end of its motion before it gets there.
//!
//! On a path, where pistons reverse without a stop, three more terms `−⅔ ν_i s_i u_i` follow the sides `s_i` of the backlash: where
//! k_λ is off by ν r (1 + k_ε), the bend jumps at every reversal. The caller gives ν to k_λ. At held poses the hysteresis of the
//! rubber looks the same, so nothing is learned there.
//!
//! Four safeguards: what the timing of the model may have wrong counts as noise, so a line that is not known yet teaches
//! little while it moves; an observation far from what the parameters can explain (an obstacle, a pinched line) is not learned
//! from; after an obstruction the caller returns to the state before it; and while the base sways, its mean square counts as noise,
//! and the rotation and offset that are found are those of the base.

use crate::model::{Geometry, Line};
use nalgebra::{SMatrix, SVector, Vector2, Vector3};

/// Number of parameters, and where each kind begins; ρ is first.
const N: usize = 15;
const EVEN: usize = 3;
const ODD: usize = 6;
const ROTATION: usize = 9;
const OFFSET: usize = 10;
const BACKLASH: usize = 12;
type Parameters = SVector<f64, N>;

/// Standard deviation of each parameter before any motion, for bends in rad, and the time in which the random walk restores
/// it, s.
const SIGMA: [f64; N] = [
    0.25, 0.25, 0.25, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.03, 0.03, 0.1, 0.1, 0.1,
];
const MEMORY_S: [f64; N] = [
    60.0, 60.0, 60.0, 60.0, 60.0, 60.0, 60.0, 60.0, 60.0, 60.0, 20.0, 20.0, 60.0, 60.0, 60.0,
];
/// Standard deviation of rotation and offset of a base that sways, rad.
const BASE_SIGMA: f64 = 0.15;
/// Difference that no smooth function explains, rad (0.4°), and the time for which it stays the same, s.
const REST_RAD: f64 = 0.007;
const SAME_S: f64 = 0.3;
/// Factor on the standard deviation of an error of timing, because it has the same sign over a whole move.
const TIMING: f64 = 3.0;
/// Factor on the mean square of a sway, because it stays the same for seconds. Of 300 and 2000, tried on ten units of the independent
/// plant, the larger left fewer of them worse than the open loop.
const SWAY: f64 = 2000.0;
/// Largest mean square of a sway relative to the estimate.
const SWAY_MAX: f64 = 4.0;
/// Difference in standard deviations from which an observation teaches nothing.
const OUTLIER: f64 = 4.0;
/// Interval between two updates, s.
const PERIOD_S: f64 = 0.02;
/// Rate that the tip counts as having while a piston crosses its backlash, rad/s.
const CROSSING_RAD_S: f64 = 1.0;
/// Largest error that is believed, rad (60°).
const LARGEST_RAD: f64 = 1.05;
/// Product of rate and error of timing below which the tip rests, rad (0.6°).
const QUIET_RAD: f64 = 0.01;

/// What a tick tells the learner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observed {
    /// Estimated bend, rad.
    pub bend: Vector2<f64>,
    /// Predicted minus estimated bend, rad.
    pub unexplained: Vector2<f64>,
    /// Rate of the predicted bend, rad/s.
    pub rate: f64,
    /// Side of the backlash of each piston, −1 to 1.
    pub sides: Vector3<f64>,
    /// The tip follows a path.
    pub follows: bool,
    /// Mean square of the bend that a swaying base feigns, rad².
    pub sway2: f64,
    /// How far the response time of the model may be off, s.
    pub timing_s: f64,
    /// Longest plausible response time, s.
    pub response_s: f64,
}

/// The estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StaticError {
    parameters: Parameters,
    covariance: SMatrix<f64, N, N>,
    due_s: f64,
    last_bend: Vector2<f64>,
    last_sides: Vector3<f64>,
    /// Rotation and offset from before the base began to sway, which then explains what changes in both.
    doubted: Option<Vector3<f64>>,
    /// Largest recent rate of the tip or of its model, rad/s.
    rate: f64,
    /// Nothing moves, so that a pose can be learned from.
    pub quiet: bool,
}

impl Default for StaticError {
    fn default() -> Self {
        Self {
            parameters: Parameters::zeros(),
            covariance: SMatrix::from_diagonal(&Parameters::from(SIGMA.map(|s| s * s))),
            due_s: 0.0,
            last_bend: Vector2::zeros(),
            last_sides: Vector3::zeros(),
            doubted: None,
            rate: 0.0,
            quiet: false,
        }
    }
}

impl StaticError {
    /// The error at a bend, rad.
    pub fn at(&self, bend: &Vector2<f64>) -> Vector2<f64> {
        let mut own = self.parameters;
        if let Some(before) = &self.doubted {
            own.fixed_rows_mut::<3>(ROTATION).copy_from(before);
        }
        of(&own, bend)
    }

    /// The error at a bend together with what a turned base feigns, rad.
    pub fn expected(&self, bend: &Vector2<f64>) -> Vector2<f64> {
        of(&self.parameters, bend)
    }

    /// While the base sways, rotation and offset are those of the base: the error keeps what they were.
    pub fn doubt(&mut self, sways: bool) {
        if sways == self.doubted.is_some() {
            return;
        }
        let sigma = if sways {
            [BASE_SIGMA; 3]
        } else {
            [SIGMA[ROTATION], SIGMA[OFFSET], SIGMA[OFFSET + 1]]
        };
        self.covariance.fixed_rows_mut::<3>(ROTATION).fill(0.0);
        self.covariance.fixed_columns_mut::<3>(ROTATION).fill(0.0);
        (0..3).for_each(|i| self.covariance[(ROTATION + i, ROTATION + i)] = sigma[i] * sigma[i]);
        match self.doubted.take() {
            Some(before) => self
                .parameters
                .fixed_rows_mut::<3>(ROTATION)
                .copy_from(&before),
            None => self.doubted = Some(self.parameters.fixed_rows::<3>(ROTATION).into_owned()),
        }
    }

    /// One tick. Returns by how much the error at the present bend has changed, rad.
    pub fn learn(&mut self, seen: &Observed, dt_s: f64) -> Vector2<f64> {
        self.due_s += dt_s;
        let crossed = (seen.sides - self.last_sides).amax() > 1e-9;
        self.last_sides = seen.sides;
        self.rate = self
            .rate
            .max(if crossed { CROSSING_RAD_S } else { seen.rate });
        if self.due_s < PERIOD_S {
            return Vector2::zeros();
        }
        let dt_s = std::mem::take(&mut self.due_s);
        let moved = (seen.bend - self.last_bend).norm() / dt_s;
        self.last_bend = seen.bend;
        self.rate = moved.max(self.rate * (-dt_s / seen.response_s.max(dt_s)).exp());
        self.quiet = self.rate * seen.timing_s < QUIET_RAD;
        for i in 0..N {
            let sigma = if self.doubted.is_some() && (ROTATION..BACKLASH).contains(&i) {
                BASE_SIGMA
            } else {
                SIGMA[i]
            };
            let most = sigma * sigma;
            self.covariance[(i, i)] =
                (self.covariance[(i, i)] + most * dt_s / MEMORY_S[i]).min(most);
        }
        let before = self.at(&seen.bend);
        let mut rows = rows(&seen.bend);
        for i in 0..3 {
            let along = if seen.follows {
                -2.0 / 3.0 * seen.sides[i]
            } else {
                0.0
            } * Geometry::spoke(i);
            rows.iter_mut()
                .zip(along.iter())
                .for_each(|(row, &along)| row[BACKLASH + i] = along);
        }
        let misfit2 = (seen.unexplained - self.expected(&seen.bend)).norm_squared();
        // a sway may be larger than the estimate, which takes seconds
        let sway2 = misfit2.clamp(seen.sway2, SWAY_MAX * seen.sway2);
        let noise = REST_RAD.powi(2) + (TIMING * seen.timing_s * self.rate).powi(2) + SWAY * sway2;
        let spread = rows
            .iter()
            .map(|h| h.dot(&(self.covariance * h)))
            .sum::<f64>()
            / 2.0;
        let weight = 1.0 - misfit2 / (OUTLIER * OUTLIER * (spread + noise));
        if weight > 0.0 {
            let noise = noise * SAME_S / (dt_s * weight * weight);
            rows.iter()
                .zip(seen.unexplained.iter())
                .for_each(|(h, &y)| self.update(h, y, noise));
        }
        self.at(&seen.bend) - before
    }

    /// Takes out ν, by which each k_λ/(r (1 + k_ε)) is larger than the model's.
    pub fn take_backlash(&mut self) -> Vector3<f64> {
        let found = self.parameters.fixed_rows::<3>(BACKLASH).into_owned();
        self.parameters.fixed_rows_mut::<3>(BACKLASH).fill(0.0);
        found
    }

    fn update(&mut self, h: &Parameters, y: f64, noise: f64) {
        let about = self.covariance * h;
        let gain = about / (h.dot(&about) + noise);
        self.parameters += gain * (y - h.dot(&self.parameters));
        self.covariance -= gain * about.transpose();
    }

    /// The gains of the lines have changed: their part of the error is now another.
    pub fn change_lines(&mut self, before: &[Line; 3], after: &[Line; 3]) {
        for i in 0..3 {
            let ratio = (1.0 + before[i].k_epsilon) / (1.0 + after[i].k_epsilon);
            self.parameters[i] = ratio * (1.0 + self.parameters[i]) - 1.0;
        }
    }
}

/// The error at a bend with these parameters, rad.
fn of(parameters: &Parameters, bend: &Vector2<f64>) -> Vector2<f64> {
    let [x, y] = rows(bend);
    Vector2::new(x.dot(parameters), y.dot(parameters)).cap_magnitude(LARGEST_RAD)
}

/// Derivatives of the two components of the error with respect to the parameters.
fn rows(bend: &Vector2<f64>) -> [Parameters; 2] {
    let mut rows = [Parameters::zeros(); 2];
    for i in 0..3 {
        let spoke = Geometry::spoke(i);
        let p = spoke.dot(bend);
        for (row, along) in rows.iter_mut().zip(spoke.iter()) {
            (row[i], row[EVEN + i], row[ODD + i]) =
                (2.0 / 3.0 * p * along, p * p * along, p * p * p * along);
        }
    }
    (rows[0][ROTATION], rows[1][ROTATION]) = (-bend.y, bend.x);
    (rows[0][OFFSET], rows[1][OFFSET + 1]) = (1.0, 1.0);
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(bend: Vector2<f64>, unexplained: Vector2<f64>) -> Observed {
        Observed {
            bend,
            unexplained,
            rate: 0.0,
            sides: Vector3::zeros(),
            follows: false,
            sway2: 0.0,
            timing_s: 0.01,
            response_s: 0.05,
        }
    }

    /// A tip whose bellows have other gains, a curve and an offset.
    fn truth(b: &Vector2<f64>) -> Vector2<f64> {
        let of = |i: usize, gain: f64, even: f64| {
            let p = Geometry::spoke(i).dot(b);
            Geometry::spoke(i) * (2.0 / 3.0 * gain * p + even * p * p)
        };
        of(0, 0.2, 0.05) + of(1, -0.1, 0.0) + of(2, 0.1, -0.04) + Vector2::new(0.02, -0.01)
    }

    /// Holds poses out and back in `directions` directions for a second each.
    fn taught(directions: u32, error: impl Fn(&Vector2<f64>) -> Vector2<f64>) -> StaticError {
        let mut learner = StaticError::default();
        for d in 0..directions {
            let (sin, cos) = (f64::from(d) * 2.4).sin_cos();
            for beta in [0.26, 0.52, 0.79, 1.05, 0.79, 0.52, 0.26] {
                let bend = Vector2::new(cos, sin) * beta;
                for _ in 0..200 {
                    learner.learn(&seen(bend, error(&bend)), 0.005);
                }
            }
        }
        learner
    }

    #[test]
    fn three_directions_teach_all_others() {
        let learner = taught(3, truth);
        for k in 0..12 {
            let (sin, cos) = (f64::from(k) * 0.52).sin_cos();
            let bend = Vector2::new(cos, sin) * 0.9;
            let (left, whole) = (
                (learner.at(&bend) - truth(&bend)).norm(),
                truth(&bend).norm(),
            );
            assert!(
                left < 0.012 && left < 0.3 * whole.max(0.04),
                "{bend:?}: {left} of {whole}"
            );
        }
    }

    #[test]
    fn a_line_whose_timing_is_unknown_teaches_little_while_it_moves() {
        let learned = |timing_s: f64| {
            let mut learner = StaticError::default();
            for k in 0..200 {
                let bend = Vector2::new(0.005 * f64::from(k), 0.0);
                // behind by 0.2 s at 1 rad/s
                learner.learn(
                    &Observed {
                        rate: 1.0,
                        timing_s,
                        ..seen(bend, Vector2::new(0.2, 0.0))
                    },
                    0.005,
                );
            }
            learner.at(&Vector2::new(1.0, 0.0)).norm()
        };
        assert!(
            learned(0.3) < 0.1 * learned(0.001),
            "{} {}",
            learned(0.3),
            learned(0.001)
        );
    }

    #[test]
    fn an_obstacle_is_not_learned() {
        let mut learner = taught(3, truth);
        let bend = Vector2::new(0.7, 0.0);
        (0..100).for_each(|_| _ = learner.learn(&seen(bend, truth(&bend)), 0.005));
        let before = learner.at(&bend);
        for _ in 0..400 {
            learner.learn(&seen(bend, truth(&bend) + Vector2::new(0.4, 0.0)), 0.005);
        }
        assert!(
            (learner.at(&bend) - before).norm() < 1e-3,
            "{:?} {before:?}",
            learner.at(&bend)
        );
    }

    #[test]
    fn a_backlash_that_is_off_is_found_on_a_circle() {
        let (mut learner, nu) = (StaticError::default(), Vector3::new(0.04, -0.03, 0.0));
        let mut found = Vector3::zeros();
        for k in 0..6000 {
            let (sin, cos) = (0.005 * f64::from(k) * 0.63).sin_cos();
            let (bend, rate) = (Vector2::new(cos, sin) * 0.5, Vector2::new(-sin, cos) * 0.3);
            let sides = Vector3::from_fn(|i, _| -Geometry::spoke(i).dot(&rate).signum());
            let jumps = (0..3)
                .map(|i| Geometry::spoke(i) * (-2.0 / 3.0 * (nu[i] - found[i]) * sides[i]))
                .sum::<Vector2<f64>>();
            learner.learn(
                &Observed {
                    sides,
                    follows: true,
                    rate: 0.3,
                    ..seen(bend, truth(&bend) + jumps)
                },
                0.005,
            );
            found += learner.take_backlash();
        }
        assert!((found - nu).norm() < 0.01, "{found:?}");
    }

    #[test]
    fn what_changes_is_what_the_call_returns_and_other_gains_keep_the_rest() {
        let mut learner = taught(2, truth);
        let bend = Vector2::new(0.3, 0.4);
        let before = learner.at(&bend);
        let changed = (0..10)
            .map(|_| learner.learn(&seen(bend, Vector2::new(0.05, 0.05)), 0.005))
            .sum::<Vector2<f64>>();
        assert!((learner.at(&bend) - before - changed).norm() < 1e-12 && changed.norm() > 0.0);
        // a gain error of ρ = 0.25 that the lines take over leaves none
        let line = |k_epsilon| {
            [Line {
                k_epsilon,
                k_lambda_mm: 0.5,
            }; 3]
        };
        let mut learner = StaticError::default();
        learner.parameters.fixed_rows_mut::<3>(0).fill(0.25);
        learner.change_lines(&line(2.0), &line(2.75));
        assert!(learner.at(&bend).norm() < 1e-12);
    }
}
