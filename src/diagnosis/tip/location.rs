//! Where and when a log shows the gap, and which share of it each effect and each stage has.

use crate::diagnosis::tip::fit::{Candidate, HeldOut};
use crate::diagnosis::tip::observed::{Observed, Quantity};
use crate::diagnosis::{Candidates, Scored};
use crate::model::effects::{Stage, by_name};
use crate::model::{Bend, Line};
use crate::primitives::Rotation;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::Serialize;

/// A stage and its share of the gap.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageShare {
    /// Stage name.
    pub name: &'static str,
    /// Share, 0..=1; all shares add up to 1.
    pub share: f64,
}

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

/// Bend vector of bin `k` as commanded: the counted pistons through the gains of `lines`, without play.
pub fn commanded_bend(log: &Observed, lines: &[Line; 3], k: usize) -> Bend {
    let u = log.instants[log.bins[k].at].piston_mm;
    let q = Vector3::from_fn(|i, _| lines[i].bellow_mm(u[i]));
    log.rig.geometry.shape(&q).bend
}

/// Bend vector of a measured orientation turned back by a residual.
pub fn bend_without(reference: &Matrix3<f64>, residual: &Vector3<f64>) -> Bend {
    let measured = Rotation3::from_matrix_unchecked(*reference);
    let measured = UnitQuaternion::from_rotation_matrix(&measured);
    let predicted = measured * UnitQuaternion::from_scaled_axis(-residual);
    Bend::from_rotation(&Rotation::assert_frames(predicted))
}

/// Bend and direction, degrees; direction in 0..360.
pub fn polar_deg(bend: &Bend) -> (f64, f64) {
    let direction = bend.delta().to_degrees().rem_euclid(360.0);
    (bend.beta().to_degrees(), direction)
}

/// Errors by quantity of the recalibrated nominal model, and with the verdict's effects.
pub fn kinds(log: &Observed, scores: [&HeldOut; 2]) -> Vec<QuantityShare> {
    let share = |q: Quantity| QuantityShare {
        name: q.name(),
        rmse_deg: scores[0].rmse_deg[q],
        explained_deg: scores[1].rmse_deg[q],
    };
    log.quantities().map(share).collect()
}

/// RMSE of both scores over the angles of the bins that `pick` selects, degrees; `None` without samples.
fn pooled(log: &Observed, scores: [&HeldOut; 2], pick: impl Fn(usize) -> bool) -> Option<[f64; 2]> {
    let deg2 = 1f64.to_degrees().powi(2);
    let (mut sums, mut n) = ([0.0; 2], 0.0);
    for k in (0..log.bins.len()).filter(|&k| pick(k)) {
        let logged = |q: &Quantity| log.bins[k].weight[*q] > 0.0;
        let angles = || Quantity::ANGLES.into_iter().filter(logged);
        for (sum, h) in sums.iter_mut().zip(scores) {
            *sum += angles().fold(0.0, |s, q| s + h.residual[q][k].norm_squared() * deg2);
        }
        n += angles().count() as f64;
    }
    (n > 0.0).then(|| sums.map(|sum| (sum / n).sqrt()))
}

/// Errors by bend and direction.
pub fn regions(log: &Observed, scores: [&HeldOut; 2]) -> Vec<Region> {
    let lines = [log.rig.prior; 3];
    let pose = |k| polar_deg(&commanded_bend(log, &lines, k));
    let poses: Vec<(f64, f64)> = (0..log.bins.len()).map(pose).collect();
    let span = |k: u32, width: f64| [f64::from(k) * width, f64::from(k + 1) * width];
    let cells = (0..REGIONS.0).flat_map(|b| (0..REGIONS.1).map(move |d| (b, d)));
    let region = |(ring, sector)| {
        let (bend_deg, dir_deg) = (span(ring, RING_DEG), span(sector, SECTOR_DEG));
        let within = |[from, to]: [f64; 2], x: f64| (from..to).contains(&x);
        let inside = |k: usize| within(bend_deg, poses[k].0) && within(dir_deg, poses[k].1);
        let [rmse_deg, explained_deg] = pooled(log, scores, inside)?;
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
pub fn stretches(log: &Observed, scores: [&HeldOut; 2]) -> Vec<When> {
    let length_s = log.duration_s() / f64::from(STRETCHES);
    let stretch = |k: u32| {
        let [from_s, to_s] = [k, k + 1].map(|k| log.start_s() + length_s * f64::from(k));
        let within = |k: usize| (from_s..to_s).contains(&log.bins[k].t_s);
        let [rmse_deg, explained_deg] = pooled(log, scores, within)?;
        Some(When {
            from_s,
            to_s,
            rmse_deg,
            explained_deg,
        })
    };
    (0..STRETCHES).filter_map(stretch).collect()
}

/// Part of the gap that each effect of the set closes on held-out blocks. Each of several effects is credited with the mean of what it
/// closes when added first and when added last (of two effects that is Shapley's value, 1953), because effects together do not close the sum
/// of what each closes alone.
pub fn credits(
    found: &Candidates<Candidate>,
    chosen: &Candidate,
    gap: f64,
) -> Vec<(&'static str, f64)> {
    let (nominal, all) = (found.nominal.energy(), chosen.energy());
    let energy = |c: Option<&Candidate>| c.map_or(nominal, Candidate::energy);
    let share = |name: &&'static str| {
        let first = nominal - energy(found.set(&[name]));
        let last = energy(found.without(chosen, name)) - all;
        (*name, (0.5 * (first + last) / gap).clamp(0.0, 1.0))
    };
    chosen.names.iter().map(share).collect()
}

/// Shares of the seven stages, the largest first. What the verdict leaves is attributed to the stages in proportion to the probabilities of
/// their effects.
pub fn stages(
    credits: &[(&'static str, f64)],
    probabilities: &[(&'static str, f64)],
) -> Vec<StageShare> {
    let of = |list: &[(&'static str, f64)], stage: Stage| -> f64 {
        let here = |name: &str| by_name(name).is_some_and(|e| e.stage() == stage);
        let own = list.iter().filter(|(name, _)| here(name));
        own.map(|(_, share)| share).sum()
    };
    let [credited, probable] =
        [credits, probabilities].map(|list| list.iter().map(|c| c.1).sum::<f64>().max(1e-9));
    let known = credited.min(1.0);
    let share = |&s: &Stage| {
        let [closed, left] = [of(credits, s) * known, of(probabilities, s) * (1.0 - known)];
        let (name, share) = (s.name(), closed / credited + left / probable);
        StageShare { name, share }
    };
    let mut out: Vec<StageShare> = Stage::ALL.iter().map(share).collect();
    let total: f64 = out.iter().map(|s| s.share).sum::<f64>().max(1e-12);
    out.iter_mut().for_each(|s| s.share /= total);
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_seven_shares_add_up_to_one() {
        let shares = stages(
            &[("leak", 0.6), ("gravity", 0.3)],
            &[("leak", 0.9), ("torsion", 0.1)],
        );
        assert_eq!(shares.len(), 7);
        assert!((shares.iter().map(|s| s.share).sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!((shares[0].name, shares[1].name), ("transmission", "shape"));
        assert!(
            (shares[0].share - 0.69).abs() < 1e-9,
            "0.6 closed and nine tenths of the remainder"
        );
    }

    #[test]
    fn without_a_verdict_the_shares_follow_the_probabilities() {
        let shares = stages(&[], &[("hard_iron", 0.3), ("leak", 0.1)]);
        assert_eq!(shares[0].name, "sensor");
        assert!((shares[0].share - 0.75).abs() < 1e-6);
    }
}
