//! The parameters of a set at the least cost, all together, with their intervals.
//!
//! Gauss-Newton: beside the columns of a set, the log is regressed on what these change with each η. The coefficient of a change is the step
//! of its η, and the variance of the coefficient that of η.

use crate::diagnosis::rig::model::range;
use crate::diagnosis::rig::{Member, RigProblem};

/// Most steps, and halvings of each.
const STEPS: usize = 12;
const HALVINGS: i32 = 6;
/// Part of the half-width of its interval below which a step is the last.
const ARRIVED: f64 = 0.01;
/// Relative change of a parameter from which the change of its columns is taken.
const NEAR: f64 = 1e-6;
/// Chi-square of one degree of freedom at 95 %.
const CHI_SQUARE: f64 = 3.84;

impl RigProblem<'_> {
    /// Part by which the cost rises at the ends of a 95 % interval, as if the short blocks were independent.
    pub(super) fn rise(&self) -> f64 {
        CHI_SQUARE / self.nominal.scores.blocks[1].len() as f64
    }

    /// The least cost near the parameters of these members, and the members there. A step is halved until the cost falls.
    pub(super) fn refined(&self, mut members: Vec<Member>) -> Option<(f64, Vec<Member>)> {
        let grids = members.iter().map(|m| range(&self.base.grid(&m.operator)));
        let grids: Vec<(f64, f64)> = grids.collect();
        let cost_of = |members: &[Member]| self.task.cost(&self.base.columns(members));
        let mut cost = cost_of(&members)?;
        for _ in 0..STEPS {
            let Some(steps) = self.steps(&members) else {
                break;
            };
            let half = |spread: f64| (self.rise() * cost.max(0.0) * spread).sqrt();
            for ((m, (low, high)), (_, spread)) in members.iter_mut().zip(&grids).zip(&steps) {
                let half = half(*spread);
                m.ci95 = [(m.eta - half).max(*low), (m.eta + half).min(*high)];
            }
            if steps
                .iter()
                .all(|(step, spread)| step.abs() <= ARRIVED * half(*spread))
            {
                break;
            }
            let moved = |k: i32| {
                let one = |i: usize| {
                    let (m, (low, high), step) = (&members[i], grids[i], steps[i].0);
                    let eta = (m.eta + step * 0.5f64.powi(k)).clamp(low, high);
                    Member {
                        ci95: m.ci95,
                        ..self.base.member(&m.operator, eta)
                    }
                };
                let moved: Vec<Member> = (0..members.len()).map(one).collect();
                Some((cost_of(&moved)?, moved))
            };
            match (0..HALVINGS)
                .filter_map(moved)
                .find(|(less, _)| *less < cost)
            {
                Some(better) => (cost, members) = better,
                None => break,
            }
        }
        Some((cost, members))
    }

    /// The step of the parameter of each member, and its variance for noise of variance one; zero for one without a parameter.
    fn steps(&self, members: &[Member]) -> Option<Vec<(f64, f64)>> {
        let mut columns = self.base.columns(members);
        let fitted = self.task.fit(&columns)?;
        let (known, mut own) = (columns.of.len(), &fitted[self.base.base.len()..]);
        let change = |m: &Member| {
            let sizes;
            (sizes, own) = own.split_at(m.columns.len());
            (!m.operator.eta.is_empty()).then(|| self.change(m, sizes))
        };
        let changes: Vec<Option<Vec<f64>>> = members.iter().map(change).collect();
        columns
            .of
            .extend(changes.iter().flatten().map(Vec::as_slice));
        columns.signs.clear();
        let mut found = self.task.fit(&columns)?.into_iter().skip(known);
        let mut step = |change: &Option<_>| change.as_ref().and_then(|_| found.next());
        Some(
            changes
                .iter()
                .map(|c| step(c).unwrap_or_default())
                .collect(),
        )
    }

    /// What the columns of a member with these sizes change with its parameter.
    fn change(&self, m: &Member, sizes: &[(f64, f64)]) -> Vec<f64> {
        let near = self.base.member(&m.operator, m.eta * (1.0 + NEAR));
        let mut out = vec![0.0; self.task.y.len()];
        for ((near, own), (size, _)) in near.columns.iter().zip(&m.columns).zip(sizes) {
            for ((out, near), own) in out.iter_mut().zip(near).zip(own) {
                *out += size * (near - own) / (NEAR * m.eta);
            }
        }
        out
    }
}
