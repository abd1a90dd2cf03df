//! What the pages show beside the figures: residuals bin by bin with pose and time, and traces.

use crate::diagnosis::chain::lines;
use crate::diagnosis::diagnose::Diagnosed;
use crate::diagnosis::observe::{G_M_S2, Observed, Quantity};
use crate::diagnosis::search::HeldOut;
use crate::model::arc::Geometry;
use crate::model::bend::Bend;
use crate::primitives::frames::Rotation;
use crate::report::polar::{Cell, RING_DEG, SECTORS};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// One bin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Time since the log began, s.
    pub t_s: f64,
    /// Bend the pistons ask for, degrees.
    pub bend_deg: f64,
    /// Its direction, degrees, 0..360.
    pub dir_deg: f64,
    /// Residual of the recalibrated model, degrees, over the sensors that give angles.
    pub before_deg: f64,
    /// Residual with the verdict's effects.
    pub after_deg: f64,
}

/// One signal: measured, and predicted by both models where they were scored (NaN elsewhere).
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// What is shown.
    pub label: String,
    /// Time since the log began, measured, recalibrated model, with effects.
    pub points: Vec<[f64; 4]>,
}

/// Everything the drawings need.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Scored bins.
    pub spots: Vec<Spot>,
    /// Signals worth a look, largest gap first.
    pub traces: Vec<Trace>,
}

impl Evidence {
    /// From a diagnosis and its log.
    #[must_use]
    pub fn new(log: &Observed, done: &Diagnosed) -> Self {
        let (before, after) = (&done.found.nominal.held_out, &done.chosen.held_out);
        let lines = lines(&done.found.nominal.fitted.theta);
        let start_s = log.start_s();
        let spots = (0..log.bins.len())
            .filter_map(|k| {
                let u = log.piston_mm[log.bins[k].at];
                let bend = Geometry::default().shape(&Vector3::from_fn(|i, _| lines[i].bellow_mm(u[i]))).bend;
                Some(Spot {
                    t_s: log.bins[k].t_s - start_s,
                    bend_deg: bend.beta().to_degrees(),
                    dir_deg: bend.delta().to_degrees().rem_euclid(360.0),
                    before_deg: angle_deg(log, before, k)?,
                    after_deg: angle_deg(log, after, k)?,
                })
            })
            .collect();
        let mut traces: Vec<(f64, Trace)> =
            (0..3).filter(|&kind| log.has[kind]).flat_map(|kind| traces(log, kind, before, after)).collect();
        traces.sort_by(|a, b| b.0.total_cmp(&a.0));
        Self { spots, traces: traces.into_iter().map(|t| t.1).collect() }
    }

    /// Cells of the polar map: RMS of what `pick` takes.
    #[must_use]
    pub fn cells(&self, pick: impl Fn(&Spot) -> f64) -> Vec<Cell> {
        let mut sums: std::collections::BTreeMap<(usize, usize), (f64, f64)> = std::collections::BTreeMap::new();
        for s in &self.spots {
            let sector = (s.dir_deg / 360.0 * SECTORS as f64) as usize % SECTORS;
            let sum = sums.entry(((s.bend_deg / RING_DEG) as usize, sector)).or_default();
            *sum = (sum.0 + pick(s).powi(2), sum.1 + 1.0);
        }
        sums.into_iter()
            .filter(|((ring, _), _)| *ring < 8)
            .map(|((ring, sector), (s, n))| Cell { ring, sector, value: (s / n).sqrt() })
            .collect()
    }

    /// RMS of what `pick` takes in `n` stretches of equal length: (middle of the stretch, RMS).
    #[must_use]
    pub fn over_time(&self, n: usize, pick: impl Fn(&Spot) -> f64) -> Vec<(f64, f64)> {
        let end = self.spots.last().map_or(0.0, |s| s.t_s) + 1e-9;
        let mut sums = vec![(0.0, 0.0); n];
        for s in &self.spots {
            let sum = &mut sums[((s.t_s / end * n as f64) as usize).min(n - 1)];
            *sum = (sum.0 + pick(s).powi(2), sum.1 + 1.0);
        }
        let middle = |k: usize| (k as f64 + 0.5) * end / n as f64;
        sums.iter().enumerate().filter(|(_, s)| s.1 > 0.0).map(|(k, s)| (middle(k), (s.0 / s.1).sqrt())).collect()
    }
}

fn scored(held: &HeldOut, kind: usize, k: usize) -> Option<Vector3<f64>> {
    held.residual[kind].get(k).copied().filter(|r| *r != Vector3::zeros())
}

/// RMS over the kinds that are angles; `None` where nothing was scored.
fn angle_deg(log: &Observed, held: &HeldOut, k: usize) -> Option<f64> {
    let all: Vec<f64> =
        (0..3).filter(|&kind| log.bins[k].weight[kind] > 0.0).filter_map(|kind| scored(held, kind, k)).map(|r| r.norm_squared()).collect();
    (!all.is_empty()).then(|| (all.iter().sum::<f64>() / all.len() as f64).sqrt().to_degrees())
}

/// The three signals of a kind with how much of their gap closes, degrees².
fn traces(log: &Observed, kind: usize, before: &HeldOut, after: &HeldOut) -> Vec<(f64, Trace)> {
    let field = log.field_base_ut.norm().max(1.0);
    let bins: Vec<usize> = (0..log.bins.len()).filter(|&k| log.bins[k].weight[kind] > 0.0).collect();
    let nothing = Vector3::repeat(f64::NAN);
    let axes: &[usize] = if kind == 0 { &[0, 1] } else { &[0, 1, 2] };
    let rows: Vec<[Vector3<f64>; 3]> = bins
        .iter()
        .map(|&k| {
            let (b, a) = (scored(before, kind, k).unwrap_or(nothing), scored(after, kind, k).unwrap_or(nothing));
            let bin = &log.bins[k];
            match kind {
                0 => [Vector3::zeros(), b, a].map(|r| bend_of(&bin.reference, &r)),
                1 => [bin.acc / G_M_S2, bin.acc / G_M_S2 - b, bin.acc / G_M_S2 - a].map(angles),
                _ => [bin.mag / field, bin.mag / field - b, bin.mag / field - a].map(angles),
            }
        })
        .collect();
    axes.iter()
        .map(|&axis| {
            let points: Vec<[f64; 4]> =
                bins.iter().zip(&rows).map(|(&k, r)| [log.bins[k].t_s - log.start_s(), r[0][axis], r[1][axis], r[2][axis]]).collect();
            let closes =
                points.iter().filter(|p| p[2].is_finite() && p[3].is_finite()).map(|p| (p[1] - p[2]).powi(2) - (p[1] - p[3]).powi(2)).sum();
            (closes, Trace { label: label(kind, axis), points })
        })
        .collect()
}

fn label(kind: usize, axis: usize) -> String {
    let axis_name = ["x", "y", "z"][axis];
    match kind {
        0 => format!("bend b_{axis_name} by the tracker"),
        1 => format!("gravity along sensor {axis_name}"),
        _ => format!("{} along sensor {axis_name}", if Quantity::ALL[kind] == Quantity::Mag { "field" } else { "signal" }),
    }
}

/// Components of a direction as angles above the plane across them, degrees.
fn angles(v: Vector3<f64>) -> Vector3<f64> {
    v.map(|x| if x.is_finite() { x.clamp(-1.0, 1.0).asin().to_degrees() } else { f64::NAN })
}

/// Bend vector of a measured orientation, turned back by a residual, degrees.
fn bend_of(reference: &Matrix3<f64>, residual: &Vector3<f64>) -> Vector3<f64> {
    if !residual.x.is_finite() {
        return Vector3::repeat(f64::NAN);
    }
    let measured = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*reference));
    let b = Bend::from_rotation(&Rotation::assert_frames(measured * UnitQuaternion::from_scaled_axis(-residual))).0;
    Vector3::new(b.x.to_degrees(), b.y.to_degrees(), 0.0)
}
