//! Data of the charts: residuals of the bins with pose and time, and measured and predicted signals.

use crate::diagnosis::tip::fit::HeldOut;
use crate::diagnosis::tip::observed::{G_M_S2, Observed, Quantity};
use crate::diagnosis::tip::{Diagnosed, bend_without, commanded_bend, polar_deg};
use crate::experiment::arm::root_mean;
use crate::report::gap::charts::{Trace, rms};
use crate::report::polar::{Cell, RING_DEG, SECTORS};
use nalgebra::{Matrix3, Vector3};

/// Residuals of one bin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Time since the log began, s.
    pub t_s: f64,
    /// Commanded bend, degrees.
    pub bend_deg: f64,
    /// Commanded direction, degrees, 0..360.
    pub dir_deg: f64,
    /// Residual of the recalibrated model, degrees RMS over the quantities that are angles.
    pub before_deg: f64,
    /// Residual with the verdict's effects, degrees.
    pub after_deg: f64,
}

/// Data of all charts.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Scored bins.
    pub spots: Vec<Spot>,
    /// Signals, largest closed gap first.
    pub traces: Vec<Trace>,
}

impl Evidence {
    /// The evidence of a diagnosis on its log.
    pub fn new(log: &Observed, done: &Diagnosed) -> Self {
        let (before, after) = (&done.found.nominal.held_out, &done.chosen.held_out);
        let lines = done.found.nominal.lines();
        let start_s = log.start_s();
        let spot = |k: usize| {
            let (bend_deg, dir_deg) = polar_deg(&commanded_bend(log, &lines, k));
            Some(Spot {
                t_s: log.bins[k].t_s - start_s,
                bend_deg,
                dir_deg,
                before_deg: angle_deg(log, before, k)?,
                after_deg: angle_deg(log, after, k)?,
            })
        };
        let logged = Quantity::ANGLES.into_iter().filter(|&q| log.has[q]);
        let traces = logged.flat_map(|q| traces(log, q, before, after));
        let mut traces: Vec<(f64, Trace)> = traces.collect();
        traces.sort_by(|a, b| b.0.total_cmp(&a.0));
        Self {
            spots: (0..log.bins.len()).filter_map(spot).collect(),
            traces: traces.into_iter().map(|t| t.1).collect(),
        }
    }

    /// Cells of the polar map: RMS of the values that `pick` returns.
    pub fn cells(&self, pick: impl Fn(&Spot) -> f64) -> Vec<Cell> {
        let sector = |s: &Spot| (s.dir_deg / 360.0 * SECTORS as f64) as usize % SECTORS;
        let place = |s: &Spot| ((s.bend_deg / RING_DEG) as usize, sector(s));
        let cell = |((ring, sector), value)| Cell {
            ring,
            sector,
            value,
        };
        let cells = rms(self.spots.iter().map(|s| (place(s), pick(s)))).map(cell);
        cells.filter(|cell| cell.ring < 8).collect()
    }
}

fn scored(held: &HeldOut, q: Quantity, k: usize) -> Option<Vector3<f64>> {
    let residual = held.residual[q].get(k).copied();
    residual.filter(|r| *r != Vector3::zeros())
}

/// RMS over the quantities that are angles, degrees; `None` where nothing was scored.
fn angle_deg(log: &Observed, held: &HeldOut, k: usize) -> Option<f64> {
    let weight = &log.bins[k].weight;
    let present = Quantity::ANGLES.into_iter().filter(|&q| weight[q] > 0.0);
    let scored = present.filter_map(|q| scored(held, q, k));
    let all: Vec<f64> = scored.map(|r| r.norm_squared()).collect();
    (!all.is_empty()).then(|| root_mean(all).to_degrees())
}

/// The signals of a quantity, each with the energy that its gap loses, degrees².
fn traces(log: &Observed, q: Quantity, before: &HeldOut, after: &HeldOut) -> Vec<(f64, Trace)> {
    let field = log.segments[0].rest.field_ut.norm().max(1.0);
    let bins = (0..log.bins.len()).filter(|&k| log.bins[k].weight[q] > 0.0);
    let or_nan = |r: Option<Vector3<f64>>| r.unwrap_or(Vector3::repeat(f64::NAN));
    let row = |k: usize| {
        let bin = &log.bins[k];
        let [b, a] = [before, after].map(|held| or_nan(scored(held, q, k)));
        let off = |v: Vector3<f64>| [v, v - b, v - a].map(angles);
        let shown = match q {
            Quantity::Reference => [Vector3::zeros(), b, a].map(|r| bend_of(&bin.reference, &r)),
            Quantity::Acc => off(bin.acc / G_M_S2),
            _ => off(bin.mag / field),
        };
        (bin.t_s - log.start_s(), shown)
    };
    let rows: Vec<(f64, [Vector3<f64>; 3])> = bins.map(row).collect();
    let one = |axis: usize| {
        let point = |(t_s, [m, b, a]): &(f64, [Vector3<f64>; 3])| [*t_s, m[axis], b[axis], a[axis]];
        let points: Vec<[f64; 4]> = rows.iter().map(point).collect();
        let is_predicted = |p: &&[f64; 4]| p[2].is_finite() && p[3].is_finite();
        let predicted = points.iter().filter(is_predicted);
        let closed = |p: &[f64; 4]| (p[1] - p[2]).powi(2) - (p[1] - p[3]).powi(2);
        let (closes, label) = (predicted.map(closed).sum(), label(q, axis));
        (closes, Trace { label, points })
    };
    let axes = if q == Quantity::Reference { 2 } else { 3 };
    (0..axes).map(one).collect()
}

fn label(q: Quantity, axis: usize) -> String {
    let axis = ["x", "y", "z"][axis];
    match q {
        Quantity::Reference => format!("bend b_{axis} by the tracker"),
        Quantity::Acc => format!("gravity along sensor {axis}"),
        Quantity::Mag | Quantity::Gyro => format!("field along sensor {axis}"),
    }
}

/// Components of a direction as angles above the plane normal to them, degrees.
fn angles(v: Vector3<f64>) -> Vector3<f64> {
    let angle = |x: f64| x.clamp(-1.0, 1.0).asin().to_degrees();
    v.map(|x| if x.is_finite() { angle(x) } else { f64::NAN })
}

/// Bend vector of a measured orientation turned back by a residual, degrees.
fn bend_of(reference: &Matrix3<f64>, residual: &Vector3<f64>) -> Vector3<f64> {
    if !residual.x.is_finite() {
        return Vector3::repeat(f64::NAN);
    }
    let b = bend_without(reference, residual).0;
    Vector3::new(b.x.to_degrees(), b.y.to_degrees(), 0.0)
}
