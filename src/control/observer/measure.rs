//! What the observer takes from a measurement, and from the bank of candidates for lag and dead time.

use super::PERIOD_S;
use super::config::{ObserverConfig, standard_deviations};
use super::filter::Observer;
use super::knowledge::{DELAY, LAG, row_of};
use super::laws;
use crate::control::dynamics::{Dynamics, DynamicsRange};
use crate::primitives::SURE_SIGMAS;
use nalgebra::{Matrix2, Vector2};

crate::constants! {
    /// What a measurement is taken for.
    const MEASURE: MeasureConstants;
    /// Time constant with which the rate of the residual is smoothed, s.
    residual_rate_s = 0.03;
    /// Time constant with which its noise is smoothed, s.
    noise_s = 2.0;
    /// Standard deviation of an estimate that is not doubted, rad (0.6°).
    sigma_rad = 0.01;
    /// Rate of the residual that a settled pose may have, rad/s.
    settled_rad_s = 0.03;
    /// Largest correction of lag and dead time beyond [`CORRECTION_SHARE`], s.
    correction_s = 0.012;
    /// How sure the bank must be before they are corrected: a share of both …
    sure_share = 0.5;
    /// … and a constant, s.
    sure_s = 0.03;
    /// Least spread of a half-width, mm.
    spread_min_mm = 0.02;
    /// Largest spread as a share of the half-width.
    spread_max = 0.8;
    /// Weight of a pose in the size of g.
    size_gain = 0.15;
    /// Least size of g, rad.
    size_min = 0.003;
    /// Largest square of what a pose leaves that counts in it, rad².
    size_max_2 = 0.003;
}

/// How long an error of timing has the same sign, s: with and without states for lag and dead time.
const SAME_SIGN_S: [f64; 2] = [0.1, 3.0];
/// Largest corrections of lag and dead time as shares of both.
const CORRECTION_SHARE: [f64; 2] = [0.4, 0.15];
/// Standard deviation of lag and of dead time about those of the bank: a share and a constant, s.
const TIMES_SIGMA: [(f64, f64); 2] = [(0.15, 0.003), (0.06, 0.002)];
/// Half-widths that a line can have, mm.
const HALF_WIDTH_MM: [f64; 2] = [0.05, 1.6];
/// Bend that no tip has, rad: a filter that believes it has diverged and begins anew.
const BELIEVED_MAX: f64 = 2.0 * std::f64::consts::PI;

/// What the observer is told of the tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Estimated bend, less a periodic disturbance, rad.
    pub bend: Vector2<f64>,
    /// Covariance of the estimate, rad²; zero if it is not known.
    pub covariance: Matrix2<f64>,
    /// The laws learn too, not g alone.
    pub laws: bool,
}

impl Observer {
    /// Takes a measurement. At rest g follows it with the rate `ki_1_s`: the steady rate of a filter for a random walk of variance rate d²
    /// in noise of density r is √(d²/r).
    pub fn measure(&mut self, config: &ObserverConfig, ki_1_s: f64, measured: &Measured) {
        let (bend, laws) = (measured.bend, measured.laws);
        if self.due_s < PERIOD_S - 1e-9 {
            return;
        }
        let dt_s = std::mem::take(&mut self.due_s);
        let path = std::mem::take(&mut self.path);
        self.sigma = standard_deviations(config, self.fixed);
        let drift_2 = (ki_1_s * config.noise_deg.to_radians()).powi(2) * PERIOD_S;
        self.known.predict(config, &self.sigma, drift_2, path, dt_s);
        let residual = bend - self.predicted();
        let answer = &mut self.answer;
        let change = residual - std::mem::replace(&mut answer.residual, residual);
        let rate = change.norm() / dt_s;
        answer.residual_rate +=
            (rate - answer.residual_rate) * (dt_s / MEASURE.residual_rate_s).min(1.0);
        let least = config.noise_deg.to_radians().powi(2);
        // what changes by more is no noise
        let most_2 = SURE_SIGMAS * SURE_SIGMAS * least.max(self.noise_2);
        let noise_2 = (change.norm_squared() / 4.0).min(most_2);
        if answer.recent_rate < MEASURE.settled_rad_s {
            self.noise_2 += (noise_2 - self.noise_2) * (dt_s / MEASURE.noise_s).min(1.0);
        }
        let response_s = self.dynamics.response_s();
        let corrects =
            self.timing_error_s / SURE_SIGMAS < MEASURE.sure_share * response_s + MEASURE.sure_s;
        let mut timing_s = config.timing_s + config.timing_share * response_s;
        if !corrects {
            timing_s = timing_s.max(self.timing_error_s / SURE_SIGMAS);
        }
        let unsettled =
            config.unsettled_s * (answer.residual_rate - MEASURE.settled_rad_s).max(0.0);
        let timing_2 = (timing_s * answer.recent_rate).powi(2) + unsettled.powi(2);
        let same_sign = (SAME_SIGN_S[usize::from(!corrects)] / dt_s).max(1.0);
        self.variance = least.max(self.noise_2);
        if laws {
            self.variance += timing_2 * same_sign;
        }
        let (axes, doubt_2) = doubt(measured.covariance, &(residual - self.residual()), dt_s);
        let certain = self.variance;
        self.variance += doubt_2.mean();
        let rows = [0, 1].map(|axis| {
            // what the laws may have wrong is g's if they do not learn
            let columns = laws.then_some(&self.answer.columns);
            let mut row = row_of(columns, axis);
            if laws && corrects {
                row[LAG] = self.answer.lag_derivative[axis];
                row[DELAY] = -self.answer.rate[axis];
            }
            row
        });
        for axis in 0..2 {
            let along = axes.column(axis);
            let row = rows[0] * along[0] + rows[1] * along[1];
            let innovation = (bend - self.predicted() - self.residual()).dot(&along);
            self.known
                .correct(&row, innovation, certain + doubt_2[axis], laws);
        }
        self.take_times();
        self.take_plays();
        let believed = (self.settled_by_laws() + self.residual()).norm();
        if believed.is_nan() || believed > BELIEVED_MAX {
            self.forget();
            self.believe(&bend, f64::INFINITY);
        }
    }

    /// Takes the estimated errors of lag and dead time into both.
    fn take_times(&mut self) {
        let bank = [self.bank.lag_s, self.bank.delay_s];
        let mut now = [self.dynamics.lag_s, self.dynamics.delay_s];
        for k in 0..2 {
            let most = CORRECTION_SHARE[k] * bank[k] + MEASURE.correction_s;
            now[k] = (now[k] + std::mem::take(&mut self.known.x[LAG + k]))
                .clamp(bank[k] - most, bank[k] + most);
        }
        self.dynamics = Dynamics {
            lag_s: now[0].max(0.002),
            delay_s: now[1].max(0.0),
        };
    }

    /// Takes the estimated errors of the half-widths into the channels.
    fn take_plays(&mut self) {
        for i in 0..3 {
            let change = std::mem::take(&mut self.known.x[laws::PLAY + i]);
            let now_mm = self.lines[i].k_lambda_mm;
            let next_mm = if change == 0.0 {
                now_mm
            } else {
                (now_mm + change).clamp(HALF_WIDTH_MM[0], HALF_WIDTH_MM[1])
            };
            let spread_mm = self.half_width_sigma_mm(i).max(MEASURE.spread_min_mm);
            let spread_mm = spread_mm.min(MEASURE.spread_max * next_mm);
            let (change_mm, mm_per_rad) = (next_mm - now_mm, self.mm_per_rad(i));
            self.lines[i].k_lambda_mm = next_mm;
            self.now.widen(i, change_mm, spread_mm, mm_per_rad);
            self.then.widen(i, change_mm, spread_mm, mm_per_rad);
            self.answer.lagged += self.answer.columns.column(laws::PLAY + i) * change_mm;
        }
    }

    /// Takes over what the bank knows about lag and dead time.
    pub fn take_dynamics(&mut self, range: &DynamicsRange, moving: bool) {
        self.timing_error_s = range.error_max_s();
        if moving || range.best == self.bank {
            return;
        }
        (self.bank, self.dynamics) = (range.best, range.best);
        for (k, variance) in self.times_variance().into_iter().enumerate() {
            self.known.reset(LAG + k, variance);
        }
    }

    /// Variances of lag and of dead time about those of the bank, s².
    fn times_variance(&self) -> [f64; 2] {
        let times_s = [self.bank.lag_s, self.bank.delay_s];
        std::array::from_fn(|k| {
            let (share, least_s) = TIMES_SIGMA[k];
            let sigma_s = (share * times_s[k] + least_s).max(self.timing_error_s / SURE_SIGMAS);
            sigma_s * sigma_s
        })
    }

    /// A new pose begins: the next motion has its own speed, and what the last pose was off by tells how rough the map is.
    pub fn depart(&mut self) {
        for (k, most) in self.times_variance().into_iter().enumerate() {
            self.known.p[(LAG + k, LAG + k)] += 0.5 * most;
            self.known.cap(LAG + k, most);
        }
        let size_2 = (self.residual().norm_squared() / 2.0).min(MEASURE.size_max_2);
        let before_2 = self.known.residual_size.powi(2);
        let mean_2 = before_2 * (1.0 - MEASURE.size_gain) + MEASURE.size_gain * size_2;
        self.known.residual_size = mean_2.sqrt().max(MEASURE.size_min);
    }
}

/// Principal axes of the covariance of the estimate, rad², and the measurement noise along each, rad². An error of the estimate lasts for
/// seconds, and an innovation beyond [`SURE_SIGMAS`] is none of it: the tip has moved.
fn doubt(
    covariance: Matrix2<f64>,
    innovation: &Vector2<f64>,
    dt_s: f64,
) -> (Matrix2<f64>, Vector2<f64>) {
    let known = covariance.symmetric_eigen();
    let doubt_2 = Vector2::from_fn(|k, _| {
        let sigma = known.eigenvalues[k].max(0.0).sqrt();
        let most = SURE_SIGMAS * sigma.max(MEASURE.sigma_rad);
        let off = innovation.dot(&known.eigenvectors.column(k)) / most;
        let doubted = (sigma - MEASURE.sigma_rad).max(0.0).powi(2) * (1.0 - off * off).max(0.0);
        doubted * SAME_SIGN_S[1] / dt_s
    });
    (known.eigenvectors, doubt_2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::dynamics::DynamicsPrior;
    use crate::model::{Geometry, Line};
    use nalgebra::Vector3;

    const DT_S: f64 = 0.01;
    const LINES: [Line; 3] = [Line {
        k_epsilon: 2.2,
        k_lambda_mm: 0.9,
    }; 3];

    fn known(lag_s: f64) -> DynamicsRange {
        let expected = Dynamics {
            lag_s,
            delay_s: 0.01,
        };
        DynamicsPrior::calibrated(expected).range()
    }

    /// A tip whose lines have other gains and half-widths, with a lag of 30 ms.
    struct Tip {
        lines: [Line; 3],
        w_mm: Vector3<f64>,
        bend: Vector2<f64>,
    }

    impl Tip {
        fn step(&mut self, piston_mm: &Vector3<f64>) -> Vector2<f64> {
            self.w_mm = Vector3::from_fn(|i, _| self.lines[i].play(self.w_mm[i], piston_mm[i]));
            let v = std::array::from_fn(|i| {
                self.w_mm[i] / laws::mm_per_rad(&self.lines[i], &Geometry::default())
            });
            let to = laws::bend_of(&v);
            self.bend = to + (self.bend - to) * (-DT_S / 0.03f64).exp();
            self.bend
        }
    }

    /// Pistons for a bend by the nominal gains, pushing away from zero.
    fn pistons(bend: &Vector2<f64>) -> Vector3<f64> {
        Vector3::from_fn(|i, _| {
            let v = -Geometry::spoke(i).dot(bend);
            v * laws::mm_per_rad(&LINES[i], &Geometry::default()) + 0.9 * v.signum()
        })
    }

    /// An observer that has seen `poses` held poses of a tip, and its error at a last one that it has not seen, rad.
    fn learned(poses: usize, truth: [Line; 3]) -> (Observer, f64) {
        let (config, geometry) = (ObserverConfig::default(), Geometry::default());
        let mut observer = Observer::new(
            &config,
            &geometry,
            LINES,
            Some([[0.6, 0.25]; 3]),
            &known(0.03),
        );
        let mut tip = Tip {
            lines: truth,
            w_mm: Vector3::zeros(),
            bend: Vector2::zeros(),
        };
        let mut at = Vector3::zeros();
        let mut error = 0.0;
        for n in 0..=poses {
            let angle = 2.4 * n as f64;
            let target = Vector2::new(angle.cos(), angle.sin()) * (0.3 + 0.25 * (n % 4) as f64);
            observer.depart();
            for _ in 0..150 {
                let to = pistons(&target);
                at += (to - at).cap_magnitude(20.0 * DT_S);
                let bend = tip.step(&at);
                observer.follow(&at, None, DT_S);
                if n < poses {
                    observer.measure(&config, 23.0, &seen(bend, true));
                }
            }
            error = (observer.settled_by_laws() - tip.bend).norm();
        }
        (observer, error)
    }

    fn seen(bend: Vector2<f64>, laws: bool) -> Measured {
        Measured {
            bend,
            covariance: Matrix2::zeros(),
            laws,
        }
    }

    fn other(gains: [f64; 3], widths_mm: [f64; 3]) -> [Line; 3] {
        Line::each(gains, widths_mm)
    }

    #[test]
    fn poses_teach_gains_and_backlash_for_poses_that_were_not_seen() {
        let truth = other([1.8, 2.6, 2.3], [0.7, 1.1, 0.85]);
        let (before, after) = (learned(1, truth).1, learned(30, truth).1);
        assert!(before > 0.05 && after < 0.006, "{before} then {after} rad");
        let (observer, _) = learned(30, truth);
        for (i, line) in truth.iter().enumerate() {
            let found = observer.lines[i].k_lambda_mm;
            let sigma = observer.half_width_sigma_mm(i);
            assert!(
                (found - line.k_lambda_mm).abs() < (3.0 * sigma).max(0.05),
                "{found} ± {sigma} mm: {line:?}"
            );
        }
    }

    #[test]
    fn at_rest_the_residual_follows_and_the_laws_stay() {
        let (mut observer, _) = learned(30, LINES);
        let config = ObserverConfig::default();
        let at = observer.history[observer.head].0;
        let (laws, bend) = (observer.theta(), observer.settled_by_laws());
        let pushed = bend + Vector2::new(0.1, -0.05);
        for k in 0..100 {
            observer.follow(&at, None, DT_S);
            observer.measure(&config, 23.0, &seen(pushed, false));
            if k == 30 {
                let left = (observer.settled_by_laws() + observer.residual() - pushed).norm();
                assert!(left < 0.01, "{left} rad after 0.3 s");
            }
        }
        assert_eq!(observer.theta(), laws);
    }

    #[test]
    fn an_estimate_is_doubted_along_the_axis_that_it_does_not_know() {
        let covariance = Matrix2::new(0.05f64.powi(2), 0.0, 0.0, 0.001f64.powi(2));
        let along = |innovation: Vector2<f64>| {
            let (axes, doubt_2) = doubt(covariance, &innovation, DT_S);
            axes * Matrix2::from_diagonal(&doubt_2) * axes.transpose()
        };
        let small = along(Vector2::new(0.02, 0.02));
        assert!(small[(0, 0)] > 0.1 && small[(1, 1)].abs() < 1e-9, "{small}");
        let large = along(Vector2::new(0.2, 0.0));
        assert!(large.norm() < 1e-9, "four standard deviations: {large}");
    }

    #[test]
    fn fixed_gains_are_not_learned() {
        let config = ObserverConfig::default();
        let mut observer = Observer::new(&config, &Geometry::default(), LINES, None, &known(0.03));
        for k in 0..500 {
            let at = Vector3::new(0.02, -0.01, -0.01) * f64::from(k);
            observer.follow(&at, None, DT_S);
            observer.measure(
                &config,
                23.0,
                &seen(Vector2::new(0.002 * f64::from(k), 0.0), true),
            );
        }
        assert!(observer.theta().rows(laws::GAIN, 3).norm() < 1e-9);
        assert!(observer.lines == LINES && observer.gain_sigma(0) == 0.0);
    }

    #[test]
    fn the_covariance_stays_a_covariance() {
        let (observer, _) = learned(60, other([1.2, 3.4, 2.0], [0.4, 1.3, 0.9]));
        let least = observer.known.p.symmetric_eigenvalues().min();
        assert!(least > -1e-9, "{least}");
    }
}
