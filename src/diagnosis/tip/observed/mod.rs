//! A log prepared for fits: bins with weights, and the instants at which the model runs.
//!
//! The mean of a reading over a bin equals the prediction at its middle up to the curvature of the motion, so model
//! and log are compared at the middles only. The model runs row by row while a piston moves and bin by bin while
//! none does. A fault of one sensor shows in one [`Quantity`], a mechanical one in all.

pub mod bins;
pub mod dependence;
pub mod quantity;
pub mod refuse;

pub use bins::{BIN_S, Bin, G_M_S2, Row, between, piston_after};
pub use dependence::{Depends, dependences};
pub use quantity::{PerQuantity, Quantity};
pub use refuse::ObserveError;

use crate::diagnosis::tip::Rig;
use crate::diagnosis::tip::observed::bins::{bins, compared, mean, noise, rows, thinned, turns};
use crate::diagnosis::tip::observed::refuse::refuse;
use crate::estimation::fusion::align::AlignConfig;
use crate::estimation::fusion::base::{BaseConfig, BaseTracker};
use crate::log::bend_log::BendLog;
use crate::model::RestReadings;
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Model error of a nominal unit per angle, rad (1 σ): a quarter of a degree is not attributed to an effect.
const ANGLE_FLOOR_RAD: f64 = 0.0044;
/// The same for rates, rad/s.
const RATE_FLOOR_RAD_S: f64 = 0.007;
/// Error of a predicted rate as a share of the rate.
const RATE_SHARE: f64 = 0.12;
/// Error of gravity as a direction while the tip turns, rad per rad/s.
const ACC_MOTION: f64 = 0.012;
/// Error of any angle while the tip turns (timing within a bin), rad per rad/s.
const ANGLE_MOTION: f64 = 0.006;
/// Turning rate per piston speed, rad/mm, where no gyroscope measures it.
const TURN_PER_MM: f64 = 0.1;

/// Time between two instants where nothing is compared, s.
const SPARSE_S: f64 = 0.2;
/// Time before a bin in which every row is an instant again, s: a slow line forgets the longer steps.
const AHEAD_S: f64 = 1.0;

/// Residuals are correlated over about this long, s: one independent observation per stretch.
pub const CORRELATED_S: f64 = 2.0;

/// Gap between two logs that are diagnosed together, a divisor of it and of every time between two of their starts, s: the longest
/// block of the scores, so that no block holds parts of two logs.
const APART_S: f64 = 12.0;

/// One of the logs that are diagnosed together. Each starts from rest, with a base frame, a field and a gyroscope bias of its own.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Name of the file.
    pub file: String,
    /// Time of the first row, s.
    pub start_s: f64,
    /// Its rows.
    pub rows: Range<usize>,
    /// Its instants.
    pub instants: Range<usize>,
    /// Its bins.
    pub bins: Range<usize>,
    /// Mean readings of the tip IMU at the initial rest.
    pub rest: RestReadings,
}

/// One or several logs of a machine, prepared for fits. Their times follow each other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Observed {
    /// The machine.
    pub rig: Rig,
    /// Instants at which the model runs: the middles of the bins among them.
    pub instants: Vec<Row>,
    /// The logs' own rows.
    pub rows: Vec<Row>,
    /// Bins.
    pub bins: Vec<Bin>,
    /// Which quantities are logged.
    pub has: PerQuantity<bool>,
    /// White noise of one bin, degrees (°/s for the gyroscope).
    pub noise_deg: PerQuantity<f64>,
    /// The logs.
    pub segments: Vec<Segment>,
}

/// Tells the bins how far the base has turned, if there is an IMU on it. `up` is the vertical in the axes of the tip's IMU at rest.
fn follow_base(bins: &mut [Bin], log: &BendLog, up: &Vector3<f64>) {
    let Some(imu) = &log.base else { return };
    let (config, align) = (BaseConfig::default(), AlignConfig::default());
    let mut base = BaseTracker::default();
    let turn = |sample| {
        base.update(&config, &align, &sample, Some(up));
        base.turn().r_rest_now.to_rotation_matrix().into_inner()
    };
    let turns: Vec<Matrix3<f64>> = imu.samples(&log.t_s).map(turn).collect();
    for bin in bins {
        let turns = &turns[bin.rows.0..bin.rows.1];
        bin.base = turns.iter().sum::<Matrix3<f64>>() / turns.len() as f64;
    }
}

impl Observed {
    /// Appends another log of the same machine.
    pub fn append(&mut self, mut other: Self) {
        let quantity = |q| {
            let bins = |o: &Self| if o.has[q] { o.bins.len() as f64 } else { 0.0 };
            let [(a, n), (b, m)] = [&*self, &other].map(|o| (o.noise_deg[q], bins(o)));
            ((n * a * a + m * b * b) / (n + m).max(1.0)).sqrt()
        };
        self.noise_deg = PerQuantity::from_fn(quantity);
        self.has = PerQuantity::from_fn(|q| self.has[q] || other.has[q]);
        let start_s = self.start_s() + ((self.duration_s() / APART_S).ceil() + 1.0) * APART_S;
        let later_s = start_s - other.start_s();
        let (rows, instants, bins) = (self.rows.len(), self.instants.len(), self.bins.len());
        for row in other.rows.iter_mut().chain(&mut other.instants) {
            row.t_s += later_s;
        }
        for bin in &mut other.bins {
            bin.t_s += later_s;
            bin.at += instants;
            bin.rows = (bin.rows.0 + rows, bin.rows.1 + rows);
        }
        let after = |range: &mut Range<usize>, n| *range = range.start + n..range.end + n;
        for s in &mut other.segments {
            s.start_s += later_s;
            after(&mut s.rows, rows);
            after(&mut s.instants, instants);
            after(&mut s.bins, bins);
        }
        self.rows.append(&mut other.rows);
        self.instants.append(&mut other.instants);
        self.bins.append(&mut other.bins);
        self.segments.append(&mut other.segments);
    }

    /// Prepares a log of a machine.
    ///
    /// # Errors
    /// [`ObserveError`] if the log cannot be diagnosed.
    pub fn new(log: &BendLog, rig: &Rig) -> Result<Self, ObserveError> {
        refuse(log)?;
        let log = &*thinned(log);
        let rows = rows(log);
        let mut bins = bins(log, &rows);
        let moving = bins.iter().position(|b| b.speed_mm_s > 0.0);
        let rest = moving.unwrap_or(bins.len()).max(1);
        let up = mean(bins[..rest].iter().map(|b| b.acc));
        let up = up.map_or(Vector3::z(), |v| v.normalize());
        let field_ut = mean(bins[..rest].iter().map(|b| b.mag)).unwrap_or_default();
        follow_base(&mut bins, log, &up);
        let noise_deg = noise(&bins, field_ut.norm().max(1.0));
        let mut o = Self {
            rig: *rig,
            rows,
            bins: compared(bins),
            noise_deg,
            ..Self::default()
        };
        o.place_instants();
        let still = o.bins.iter().take_while(|b| b.speed_mm_s == 0.0);
        let rest = RestReadings {
            up,
            field_ut,
            gyro_bias_rad_s: mean(still.map(|b| b.gyr)).unwrap_or_default(),
        };
        let (rows, instants, bins) = (0..o.rows.len(), 0..o.instants.len(), 0..o.bins.len());
        o.segments.push(Segment {
            file: log.file.clone(),
            start_s: o.start_s(),
            rows,
            instants,
            bins,
            rest,
        });
        o.weigh();
        if o.quantities().next().is_none() {
            return Err(ObserveError::Blind);
        }
        Ok(o)
    }

    /// Places an instant at the middle of each bin and, while a piston moves, at every row between: the play output
    /// depends on where a path reverses. Where no bin is compared, rows at which a piston reverses, and a few others, suffice.
    fn place_instants(&mut self) {
        let mut before = 0;
        for k in 0..self.bins.len() {
            let bin = self.bins[k];
            let row = (bin.rows.0 + bin.rows.1 - 1) / 2;
            let skipped = k > 0 && bin.rows.0 > self.bins[k - 1].rows.1;
            if self.rows[row].idle_s < self.rows[row].t_s - self.rows[before].t_s {
                for (k, between) in self.rows.iter().enumerate().take(row).skip(before + 1) {
                    let last_s = self.instants.last().map_or(f64::NEG_INFINITY, |i| i.t_s);
                    let near = !skipped || bin.t_s - between.t_s < AHEAD_S;
                    if near || between.t_s - last_s >= SPARSE_S || turns(&self.rows, k) {
                        self.instants.push(*between);
                    }
                }
            }
            self.bins[k].at = self.instants.len();
            self.instants.push(Row {
                t_s: bin.t_s,
                piston_mm: piston_after(&self.rows, row, bin.t_s),
                idle_s: self.rows[row].idle_s,
            });
            before = row;
        }
    }

    /// Sets the weights of all bins and which quantities are logged.
    fn weigh(&mut self) {
        let noise_rad = PerQuantity::from_fn(|q| self.noise_deg[q].to_radians());
        for b in &mut self.bins {
            let turning = if b.gyr.x.is_nan() {
                TURN_PER_MM * b.speed_mm_s
            } else {
                b.gyr.norm()
            };
            let present =
                PerQuantity([b.reference[(0, 0)], b.acc.x, b.mag.x, b.gyr.x].map(|x| !x.is_nan()));
            let long = (b.lasting_s / BIN_S).sqrt();
            for q in Quantity::ALL {
                let (floor, motion) = match q {
                    Quantity::Gyro => (RATE_FLOOR_RAD_S, RATE_SHARE),
                    Quantity::Acc => (ANGLE_FLOOR_RAD, ACC_MOTION),
                    Quantity::Reference | Quantity::Mag => (ANGLE_FLOOR_RAD, ANGLE_MOTION),
                };
                let sigma =
                    (noise_rad[q].powi(2) + floor.powi(2) + (motion * turning).powi(2)).sqrt();
                b.weight[q] = if present[q] { 1.0 / sigma * long } else { 0.0 };
                self.has[q] |= present[q];
            }
        }
    }

    /// Quantities that the log observes.
    pub fn quantities(&self) -> impl Iterator<Item = Quantity> + use<> {
        let has = self.has;
        Quantity::ALL.into_iter().filter(move |&q| has[q])
    }

    /// Mean of a value over the logged quantities.
    pub fn mean(&self, of: &PerQuantity<f64>) -> f64 {
        self.quantities().map(|q| of[q]).sum::<f64>() / self.quantities().count() as f64
    }

    /// RMS over the logged quantities of an energy (deg²) summed over them, degrees.
    pub fn rms_deg(&self, energy: f64) -> f64 {
        (energy / self.quantities().count() as f64).sqrt()
    }

    /// Energy of white noise alone, deg², summed over the quantities and their three components.
    pub fn noise_energy(&self) -> f64 {
        let of = |q| 3.0 * self.noise_deg[q].powi(2);
        self.quantities().map(of).sum()
    }

    /// Time from the first row of the first log to the last row of the last, s.
    pub fn duration_s(&self) -> f64 {
        self.rows.last().map_or(0.0, |row| row.t_s) - self.start_s()
    }

    /// Time of the first row, s.
    pub fn start_s(&self) -> f64 {
        self.rows.first().map_or(0.0, |row| row.t_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::tip::model::run;
    use crate::model::Model;
    use crate::model::effects::{Effect, catalogue};
    use crate::model::{Line, nominal_theta};
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    /// Half an hour of random moves and holds at 50 Hz with the bins that `keep` leaves.
    fn long_log(keep: impl Fn(Vec<Bin>) -> Vec<Bin>) -> Observed {
        let mut rng = StdRng::seed_from_u64(3);
        let (mut log, mut at, mut target) =
            (BendLog::default(), Vector3::zeros(), Vector3::zeros());
        let mut hold = 200;
        for k in 0..90_000 {
            let to_go: Vector3<f64> = target - at;
            if to_go.amax() > 1e-9 {
                at += to_go.map(|d| d.clamp(-0.2, 0.2));
            } else if hold > 0 {
                hold -= 1;
            } else {
                (target, hold) = (
                    Vector3::from_fn(|_, _| rng.random_range(-12.0..12.0)),
                    rng.random_range(10..100),
                );
            }
            log.t_s.push(f64::from(k) * 0.02);
            log.piston_mm.push(at);
        }
        let rows = rows(&log);
        let mut o = Observed {
            bins: keep(bins(&log, &rows)),
            rows,
            ..Observed::default()
        };
        o.place_instants();
        let (rows, instants, bins) = (0..o.rows.len(), 0..o.instants.len(), 0..o.bins.len());
        let rest = RestReadings::default();
        o.segments.push(Segment {
            file: String::new(),
            start_s: 0.0,
            rows,
            instants,
            bins,
            rest,
        });
        o
    }

    /// Where nothing is compared, the model may take longer steps: it arrives at the compared bins in the same state, also with a memory.
    #[test]
    fn the_model_runs_through_what_is_not_compared() {
        let (part, whole, all) = (long_log(compared), long_log(|bins| bins), catalogue());
        assert!(
            part.instants.len() < whole.instants.len() / 2,
            "{} of {}",
            part.instants.len(),
            whole.instants.len()
        );
        let nominal = nominal_theta(
            &[Line {
                k_epsilon: 2.2,
                k_lambda_mm: 0.8,
            }; 3],
            0.02,
        );
        // a law with a rate of its own integrates it from instant to instant, so its state depends a little on how far apart they are
        for (names, bound_deg) in [
            (&[][..], 1e-6),
            (&["hysteresis"], 1e-6),
            (&["leak"], 0.05),
            (&["creep"], 0.05),
            (&["line_lag"], 0.15),
        ] {
            let model = Model::named(all, names);
            let fresh = |e: &dyn Effect| {
                e.params()
                    .iter()
                    .map(|p| (p.start + 0.5 * p.scale).clamp(p.low, p.high))
                    .collect::<Vec<f64>>()
            };
            let theta = model.extended(&Model::new(&[]), &nominal, fresh);
            let (of_part, of_whole) = (run(&part, &model, &theta), run(&whole, &model, &theta));
            let same = |a: &&Bin| {
                part.bins
                    .binary_search_by(|b| b.t_s.total_cmp(&a.t_s))
                    .ok()
                    .map(|k| part.bins[k].at)
            };
            let apart =
                |a: &Bin| same(&a).map(|at| (of_part[at] - of_whole[a.at]).amax().to_degrees());
            let apart: Vec<f64> = whole.bins.iter().filter_map(apart).collect();
            let furthest = apart.iter().copied().fold(0.0, f64::max);
            assert!(
                apart.len() == part.bins.len() && furthest < bound_deg,
                "{names:?}: {furthest}°"
            );
        }
    }
}
