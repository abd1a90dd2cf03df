//! Mean and covariance of the observer: how both change with time, path and measurements.

use super::config::ObserverConfig;
use super::laws::{self, Columns, LAWS, Theta};
use nalgebra::{SMatrix, SVector, Vector2};

/// First state of g, and of the errors of lag and dead time.
pub(super) const RESIDUAL: usize = LAWS;
pub(super) const LAG: usize = LAWS + 2;
pub(super) const DELAY: usize = LAWS + 3;
const STATES: usize = LAWS + 4;
pub(super) type State = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;

/// What the filter knows, apart from the state of the channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knowledge {
    pub(super) x: State,
    pub(super) p: Covariance,
    /// Standard deviation of g, rad.
    pub(super) residual_size: f64,
}

impl Knowledge {
    pub(super) fn new(sigma: &Theta, residual: f64) -> Self {
        let mut p = Covariance::zeros();
        for k in 0..LAWS {
            p[(k, k)] = sigma[k] * sigma[k];
        }
        for k in RESIDUAL..LAG {
            p[(k, k)] = residual * residual;
        }
        (p[(LAG, LAG)], p[(DELAY, DELAY)]) = (1e-4, 2.5e-5);
        Self {
            x: State::zeros(),
            p,
            residual_size: residual,
        }
    }

    pub(super) fn predict(
        &mut self,
        config: &ObserverConfig,
        sigma: &Theta,
        drift_2: f64,
        path: f64,
        dt_s: f64,
    ) {
        for k in 0..LAWS {
            let memory_s = if k >= laws::OFFSET {
                config.offset_memory_s
            } else if (laws::PLAY..laws::ROTATION).contains(&k) {
                config.constants_memory_s
            } else {
                config.memory_s
            };
            let most = sigma[k] * sigma[k];
            // what does not move says nothing about the map and changes it by nothing
            if path > 0.0 || k >= laws::OFFSET {
                self.p[(k, k)] += most * dt_s / memory_s;
            }
            self.cap(k, most);
        }
        let keep = (-path / config.residual_path_deg.to_radians()).exp();
        for k in RESIDUAL..LAG {
            self.x[k] *= keep;
            self.p.row_mut(k).scale_mut(keep);
            self.p.column_mut(k).scale_mut(keep);
            self.p[(k, k)] += (1.0 - keep * keep) * self.residual_size.powi(2) + drift_2 * dt_s;
        }
    }

    /// Takes an innovation. Without `laws` g alone learns.
    pub(super) fn correct(&mut self, row: &State, innovation: f64, variance: f64, laws: bool) {
        let about = self.p * row;
        let expected = row.dot(&about) + variance;
        let mut gain = about / expected;
        if !laws {
            gain.rows_mut(0, LAWS).fill(0.0);
            gain.rows_mut(LAG, STATES - LAG).fill(0.0);
        }
        self.x += gain * innovation;
        // for any gain (Schmidt 1966)
        let cross = gain * about.transpose();
        self.p += gain * gain.transpose() * expected - cross - cross.transpose();
        self.p = (self.p + self.p.transpose()) * 0.5;
    }

    /// A variance of at most `most`, with the correlations that go with it.
    pub(super) fn cap(&mut self, k: usize, most: f64) {
        let variance = self.p[(k, k)];
        if variance > most {
            let share = (most / variance).sqrt();
            self.p.row_mut(k).scale_mut(share);
            self.p.column_mut(k).scale_mut(share);
        }
    }

    pub(super) fn reset(&mut self, k: usize, variance: f64) {
        self.p.row_mut(k).fill(0.0);
        self.p.column_mut(k).fill(0.0);
        self.p[(k, k)] = variance;
    }

    pub(super) fn reset_residual(&mut self, residual: &Vector2<f64>, sigma: f64) {
        for axis in 0..2 {
            self.reset(RESIDUAL + axis, sigma * sigma);
            self.x[RESIDUAL + axis] = residual[axis];
        }
    }
}

/// Derivatives of the bend along an axis with respect to the states: of the laws, if they count, and of g.
pub(super) fn row_of(columns: Option<&Columns>, axis: usize) -> State {
    let mut row = State::zeros();
    if let Some(columns) = columns {
        let of_laws = columns.row(axis).transpose();
        row.fixed_rows_mut::<LAWS>(0).copy_from(&of_laws);
    }
    row[RESIDUAL + axis] = 1.0;
    row
}
