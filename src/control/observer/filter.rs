//! One Kalman filter: what the pistons should have caused, delayed and lagged, beside the estimated bend.
//!
//! `b̂(t) = H [nominal + columns · θ] + g + noise`. H is dead time and lag; θ are the parameters of [`super::laws`]; g is what no law
//! explains here, an Ornstein-Uhlenbeck process in the length of the path, that is a Gaussian process along it (Rasmussen & Williams
//! 2006, §B.2). At rest g alone follows the error, so it is the integral part of the loop. The last two states are the errors of lag
//! and dead time.

use super::config::{ObserverConfig, standard_deviations};
use super::knowledge::{Knowledge, RESIDUAL, row_of};
use super::laws::{self, Channels, Columns, LAWS, Theta};
use crate::control::dynamics::{Dynamics, DynamicsRange};
use crate::model::{Geometry, Line};
use crate::primitives::SURE_SIGMAS;
use nalgebra::{Vector2, Vector3};

/// Ticks of history: 1.2 s at a period of 1 ms.
const HISTORY: usize = 1200;
/// Speed above which a change of the prediction is no motion but a change of the dead time, rad/s.
const SPEED_MAX: f64 = 2.5;

/// How the tip answers the channels, delayed and lagged.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Answer {
    /// Bend of the model without learned columns, rad, and the columns.
    pub(super) lagged: Vector2<f64>,
    pub(super) columns: Columns,
    /// Rate of the predicted bend, rad/s, the largest within the response time, and the derivative with respect to the lag.
    pub(super) rate: Vector2<f64>,
    pub(super) recent_rate: f64,
    pub(super) lag_derivative: Vector2<f64>,
    /// What the tip did otherwise at the last measurement, rad, and its rate, rad/s.
    pub(super) residual: Vector2<f64>,
    pub(super) residual_rate: f64,
}

/// The observer.
#[derive(Debug, Clone)]
pub struct Observer {
    /// Geometry of the bending section.
    pub geometry: Geometry,
    /// Gains before the learned columns, with the half-widths in use.
    pub lines: [Line; 3],
    pub(super) sigma: Theta,
    /// Gains and half-widths are not learned.
    pub(super) fixed: bool,
    /// What the filter knows, apart from the state of the channels. The half-widths in use are in [`Self::lines`].
    pub known: Knowledge,
    /// The channels at the counted steps, and at those of the dead time ago.
    pub now: Channels,
    pub(super) then: Channels,
    /// Counted pistons and modelled bend of the last ticks; on the heap, so that a state is moved cheaply.
    pub(super) history: Box<[(Vector3<f64>, Vector2<f64>)]>,
    pub(super) head: usize,
    /// Bend of the model without learned columns at the counted steps, rad.
    pub modelled: Vector2<f64>,
    pub(super) answer: Answer,
    /// Lag and dead time by the bank.
    pub(super) bank: Dynamics,
    /// The same with their corrections.
    pub dynamics: Dynamics,
    pub(super) timing_error_s: f64,
    pub(super) noise_2: f64,
    /// Variance of the last measurement per axis, rad².
    pub variance: f64,
    pub(super) due_s: f64,
    pub(super) path: f64,
}

impl Observer {
    /// At rest with the pistons at zero. `sigmas` are the standard deviations of k_ε and of k_λ in mm that a calibration states, per channel;
    /// without them both are fixed.
    pub fn new(
        config: &ObserverConfig,
        geometry: &Geometry,
        lines: [Line; 3],
        sigmas: Option<[[f64; 2]; 3]>,
        dynamics: &DynamicsRange,
    ) -> Self {
        let sigma = standard_deviations(config, sigmas.is_none());
        let mut known = Knowledge::new(&sigma, config.residual_deg.to_radians());
        for (i, [k_epsilon, k_lambda_mm]) in sigmas.into_iter().flatten().enumerate() {
            let gain = config.calibration * k_epsilon / (1.0 + lines[i].k_epsilon);
            known.cap(laws::GAIN + i, gain * gain);
            known.cap(laws::PLAY + i, (config.calibration * k_lambda_mm).powi(2));
        }
        Self {
            geometry: *geometry,
            lines,
            sigma,
            fixed: sigmas.is_none(),
            known,
            now: Channels::default(),
            then: Channels::default(),
            history: vec![(Vector3::zeros(), Vector2::zeros()); HISTORY].into(),
            head: 0,
            modelled: Vector2::zeros(),
            answer: Answer::default(),
            bank: dynamics.best,
            dynamics: dynamics.best,
            timing_error_s: dynamics.error_max_s(),
            noise_2: 0.0,
            variance: 0.0,
            due_s: 0.0,
            path: 0.0,
        }
    }

    /// Parameters of the laws.
    pub fn theta(&self) -> Theta {
        self.known.x.fixed_rows::<LAWS>(0).into_owned()
    }

    /// The bend g that no law explains here, rad.
    pub fn residual(&self) -> Vector2<f64> {
        Vector2::new(self.known.x[RESIDUAL], self.known.x[RESIDUAL + 1])
    }

    /// Values and standard deviations of the parameters of the laws, to be remembered.
    pub fn learned(&self) -> [[f64; LAWS]; 2] {
        let sigmas = std::array::from_fn(|k| self.sigma_of(k));
        [self.theta().into(), sigmas]
    }

    /// Takes over what an earlier run has learned. A standard deviation that is larger than before any motion is not believed.
    pub fn assume(&mut self, [values, sigmas]: &[[f64; LAWS]; 2]) {
        for k in 0..LAWS {
            self.known.x[k] = values[k];
            self.known.reset(k, sigmas[k].min(self.sigma[k]).powi(2));
        }
    }

    /// Forgets what was learned.
    pub fn forget(&mut self) {
        self.known = Knowledge::new(&self.sigma, self.known.residual_size);
    }

    /// The tip, once settled, bends by `bend`, rad: g takes what the laws say otherwise, but no more than `sigmas` of its standard
    /// deviations.
    pub fn believe(&mut self, bend: &Vector2<f64>, sigmas: f64) {
        let most = sigmas * self.known.residual_size;
        let residual = (bend - self.settled_by_laws()).cap_magnitude(most);
        let size = self.known.residual_size;
        self.known.reset_residual(&residual, size);
    }

    /// Outputs of the plays once the pistons are at `piston_mm`, mm.
    pub fn play_outputs(&self, piston_mm: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.lines[i].play(self.now.play[i].w_mm, piston_mm[i]))
    }

    /// Displacement of piston `i` per v, mm/rad.
    pub fn mm_per_rad(&self, i: usize) -> f64 {
        laws::mm_per_rad(&self.lines[i], &self.geometry)
    }

    /// One tick with the counted pistons. `modelled` is the bend of a described machine, in place of the nominal one, rad.
    pub fn follow(&mut self, piston_mm: &Vector3<f64>, modelled: Option<Vector2<f64>>, dt_s: f64) {
        self.now
            .advance(&self.lines, &self.geometry, piston_mm, dt_s);
        self.modelled = modelled.unwrap_or_else(|| self.now.nominal());
        self.head = (self.head + 1) % HISTORY;
        self.history[self.head] = (*piston_mm, self.modelled);
        let ticks = self.dynamics.delay_s / dt_s.max(f64::MIN_POSITIVE);
        let whole = (ticks.floor() as usize).min(HISTORY - 2);
        let part = (ticks - whole as f64).clamp(0.0, 1.0);
        let ago = |n: usize| self.history[(self.head + HISTORY - n) % HISTORY];
        let ((later_mm, later), (earlier_mm, earlier)) = (ago(whole), ago(whole + 1));
        let then_mm = later_mm.lerp(&earlier_mm, part);
        self.then
            .advance(&self.lines, &self.geometry, &then_mm, dt_s);
        let from = modelled.map_or_else(|| self.then.nominal(), |_| later.lerp(&earlier, part));
        let before = self.predicted();
        let Dynamics { lag_s, .. } = self.dynamics;
        let keep = (-dt_s / lag_s.max(1e-3)).exp();
        let columns = self.then.columns(&self.lines, &self.geometry);
        self.answer.lagged = from + (self.answer.lagged - from) * keep;
        self.answer.columns = columns + (self.answer.columns - columns) * keep;
        let moved = (self.predicted() - before).cap_magnitude(SPEED_MAX * dt_s);
        self.path += moved.norm();
        let answer = &mut self.answer;
        answer.rate = moved / dt_s.max(f64::MIN_POSITIVE);
        let keep = (-dt_s / lag_s.max(5e-3)).exp();
        answer.lag_derivative = -answer.rate + (answer.lag_derivative + answer.rate) * keep;
        // half of the largest plausible error counts for how long a motion is in flight
        let answered_s = self.dynamics.response_s() + self.timing_error_s / (SURE_SIGMAS / 2.0);
        let slowest = (-dt_s / answered_s.max(0.02)).exp();
        answer.recent_rate = answer.rate.norm().max(answer.recent_rate * slowest);
        self.due_s += dt_s;
    }

    /// The pistons rest and the tip stays at `at`, rad, whatever the laws say: g takes the difference.
    pub fn stand(
        &mut self,
        config: &ObserverConfig,
        piston_mm: &Vector3<f64>,
        modelled: Option<Vector2<f64>>,
        at: &Vector2<f64>,
    ) {
        self.now
            .advance(&self.lines, &self.geometry, piston_mm, 0.0);
        self.then = self.now;
        self.modelled = modelled.unwrap_or_else(|| self.now.nominal());
        self.history.fill((*piston_mm, self.modelled));
        self.answer = Answer {
            lagged: self.modelled,
            columns: self.now.columns(&self.lines, &self.geometry),
            ..Answer::default()
        };
        let residual = at - self.settled_by_laws();
        self.known
            .reset_residual(&residual, config.residual_deg.to_radians());
    }

    /// The channels have the play outputs `w_mm` with the pistons at `piston_mm`, and have rested there.
    pub fn rest(&mut self, w_mm: &Vector3<f64>, piston_mm: &Vector3<f64>) {
        for i in 0..3 {
            let w_mm = self.lines[i].play(w_mm[i], piston_mm[i]);
            let (off_mm, half_width_mm) = (piston_mm[i] - w_mm, self.lines[i].k_lambda_mm);
            let mm_per_rad = self.mm_per_rad(i);
            self.now.rest(i, w_mm, off_mm, half_width_mm, mm_per_rad);
        }
    }

    /// Rate of the predicted bend, rad/s.
    pub fn rate(&self) -> Vector2<f64> {
        self.answer.rate
    }

    /// Bend by the laws as the tip shows it now, without g, rad.
    pub fn predicted(&self) -> Vector2<f64> {
        self.answer.lagged + self.answer.columns * self.theta()
    }

    /// Bend of the plays through straight `lines` at the counted steps, and dead time ago, rad.
    pub fn played_by(&self, lines: &[Line; 3]) -> [Vector2<f64>; 2] {
        [&self.now, &self.then].map(|channels| {
            laws::bend_of(&std::array::from_fn(|i| {
                channels.play[i].w_mm / laws::mm_per_rad(&lines[i], &self.geometry)
            }))
        })
    }

    /// Bend by the laws once the tip has settled at the counted steps, without g, rad.
    pub fn settled_by_laws(&self) -> Vector2<f64> {
        self.modelled + self.now.columns(&self.lines, &self.geometry) * self.theta()
    }

    /// Bend once the pistons have reached `piston_mm`, with g, rad; and the channels there.
    pub fn at(&self, piston_mm: &Vector3<f64>) -> (Vector2<f64>, Channels) {
        let mut there = self.now;
        there.advance(&self.lines, &self.geometry, piston_mm, 0.0);
        let modelled = self.modelled + there.nominal() - self.now.nominal();
        let columns = there.columns(&self.lines, &self.geometry);
        (modelled + columns * self.theta() + self.residual(), there)
    }

    /// Standard deviation of the settled bend at the counted steps by what is or was `known`, rad, over both axes.
    pub fn settled_sigma(&self, known: &Knowledge) -> f64 {
        let columns = self.now.columns(&self.lines, &self.geometry);
        let rows = (0..2).map(|axis| row_of(Some(&columns), axis));
        let variance: f64 = rows.map(|row| row.dot(&(known.p * row))).sum();
        variance.max(0.0).sqrt()
    }

    /// Standard deviation of the half-width of channel `i`, mm.
    pub fn half_width_sigma_mm(&self, i: usize) -> f64 {
        self.sigma_of(laws::PLAY + i)
    }

    /// Standard deviation of the gain of channel `i`.
    pub fn gain_sigma(&self, i: usize) -> f64 {
        self.sigma_of(laws::GAIN + i)
    }

    fn sigma_of(&self, k: usize) -> f64 {
        self.known.p[(k, k)].max(0.0).sqrt()
    }
}
