//! Where and when a log shows the gap.

use crate::diagnosis::tip::StageShare;
use crate::diagnosis::tip::fit::HeldOut;
use crate::diagnosis::tip::observed::{Observed, Quantity};
use crate::model::{Bend, Line};
use nalgebra::Vector3;
use serde::Serialize;

/// Error in a region of bend and direction.
#[derive(Debug, Clone, Serialize)]
pub struct Region {
    /// Bend, degrees, from and to.
    pub bend_deg: [f64; 2],
    /// Direction, degrees, from and to.
    pub dir_deg: [f64; 2],
    /// RMSE of the recalibrated model, degrees.
    pub rmse_deg: f64,
    /// RMSE with the verdict's effects, degrees.
    pub explained_deg: f64,
}

/// Error in a stretch of time.
#[derive(Debug, Clone, Serialize)]
pub struct When {
    /// Start, s.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
    /// RMSE of the recalibrated model, degrees.
    pub rmse_deg: f64,
    /// RMSE with the verdict's effects, degrees.
    pub explained_deg: f64,
}

/// Error of one quantity.
#[derive(Debug, Clone, Serialize)]
pub struct QuantityShare {
    /// Name of the quantity.
    pub name: &'static str,
    /// RMSE of the recalibrated model, degrees (°/s for the gyroscope).
    pub rmse_deg: f64,
    /// RMSE with the verdict's effects.
    pub explained_deg: f64,
}

/// Location of the gap.
#[derive(Debug, Clone, Serialize)]
pub struct Location {
    /// Stages, largest share first.
    pub stages: Vec<StageShare>,
    /// Groups of stages that this log cannot separate.
    pub merged: Vec<Vec<&'static str>>,
    /// By bend and direction.
    pub regions: Vec<Region>,
    /// By time.
    pub when: Vec<When>,
    /// By quantity.
    pub kinds: Vec<QuantityShare>,
}

/// Regions: rings of bend × sectors of direction.
const REGIONS: (u32, u32) = (3, 6);
/// Widths of a ring and a sector, degrees.
const RING_DEG: f64 = 30.0;
const SECTOR_DEG: f64 = 60.0;
/// Stretches of time.
const STRETCHES: u32 = 20;

/// Held-out scores of the nominal model and of the verdict's set.
#[derive(Clone, Copy)]
pub struct BeforeAfter<'a> {
    /// The log.
    pub log: &'a Observed,
    /// Recalibrated nominal model.
    pub before: &'a HeldOut,
    /// With the verdict's effects.
    pub after: &'a HeldOut,
}

/// Bend vector of bin `k` as commanded: the counted pistons through the gains of `lines`, without play.
pub fn commanded_bend(log: &Observed, lines: &[Line; 3], k: usize) -> Bend {
    let u = log.piston_mm[log.bins[k].at];
    log.rig
        .geometry
        .shape(&Vector3::from_fn(|i, _| lines[i].bellow_mm(u[i])))
        .bend
}

/// Bend and direction, degrees; direction in 0..360.
pub fn polar_deg(bend: &Bend) -> (f64, f64) {
    let direction = bend.delta().to_degrees().rem_euclid(360.0);
    (bend.beta().to_degrees(), direction)
}

impl BeforeAfter<'_> {
    /// RMSE before and after over the angles of the bins that `pick` selects, degrees; `None` without samples.
    fn pooled(&self, pick: impl Fn(usize) -> bool) -> Option<(f64, f64)> {
        let deg2 = 1f64.to_degrees().powi(2);
        let (mut before, mut after, mut n) = (0.0, 0.0, 0.0);
        for k in (0..self.log.bins.len()).filter(|&k| pick(k)) {
            let logged = |q: &Quantity| self.log.bins[k].weight[*q] > 0.0;
            let angles = || Quantity::ANGLES.into_iter().filter(logged);
            let squares =
                |h: &HeldOut| angles().fold(0.0, |s, q| s + h.residual[q][k].norm_squared() * deg2);
            before += squares(self.before);
            after += squares(self.after);
            n += angles().count() as f64;
        }
        (n > 0.0).then(|| ((before / n).sqrt(), (after / n).sqrt()))
    }

    /// Errors by bend and direction.
    pub fn regions(&self) -> Vec<Region> {
        let lines = [self.log.rig.prior; 3];
        let pose = |k| polar_deg(&commanded_bend(self.log, &lines, k));
        let poses: Vec<(f64, f64)> = (0..self.log.bins.len()).map(pose).collect();
        let span = |k: u32, width: f64| [f64::from(k) * width, f64::from(k + 1) * width];
        let cells = (0..REGIONS.0)
            .flat_map(|b| (0..REGIONS.1).map(move |d| (span(b, RING_DEG), span(d, SECTOR_DEG))));
        let region = |(bend_deg, dir_deg): ([f64; 2], [f64; 2])| {
            let within = |[from, to]: [f64; 2], x: f64| (from..to).contains(&x);
            let inside = |k: usize| within(bend_deg, poses[k].0) && within(dir_deg, poses[k].1);
            let (rmse_deg, explained_deg) = self.pooled(inside)?;
            Some(Region {
                bend_deg,
                dir_deg,
                rmse_deg,
                explained_deg,
            })
        };
        cells.filter_map(region).collect()
    }

    /// Errors by time.
    pub fn when(&self) -> Vec<When> {
        let start_s = self.log.start_s();
        let length_s = self.log.duration_s() / f64::from(STRETCHES);
        let stretch = |k: u32| {
            let [from_s, to_s] = [k, k + 1].map(|k| start_s + length_s * f64::from(k));
            let rmse = self.pooled(|k| (from_s..to_s).contains(&self.log.bins[k].t_s));
            rmse.map(|(rmse_deg, explained_deg)| When {
                from_s,
                to_s,
                rmse_deg,
                explained_deg,
            })
        };
        (0..STRETCHES).filter_map(stretch).collect()
    }

    /// Errors by quantity.
    pub fn quantities(&self) -> Vec<QuantityShare> {
        let share = |q: Quantity| QuantityShare {
            name: q.name(),
            rmse_deg: self.before.rmse_deg[q],
            explained_deg: self.after.rmse_deg[q],
        };
        self.log.quantities().map(share).collect()
    }
}
