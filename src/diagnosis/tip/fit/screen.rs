//! Which of all pairs of effects are worth a fit.
//!
//! The fit of each single effect changes the residuals of the recalibrated model. What two effects do together is about the sum of what
//! each does alone, from where one step along the tangents of both fits, with the nominal gains, predicts what a fit of the pair would
//! leave. All pairs share one normal matrix, of the tangents at all singles and of their changes.

use crate::diagnosis::tip::fit::{
    BaseFit, Candidate, LeastSquares, Start, Sums, Tangent, schwarz, stepped, within,
};
use crate::model::effects::Effect;
use crate::model::{Model, NOMINAL};
use nalgebra::{DMatrix, DVector};

/// The fit of one effect, and what the pairs with it need: the tangent at the fit, without that of the nominal gains, and the change of the
/// residuals.
pub type Alone = (Candidate, Tangent);

/// The fit of one effect beside that of the nominal model.
pub fn alone(nominal: &BaseFit<'_>, fit: BaseFit<'_>) -> Alone {
    let candidate = Candidate::new(&fit);
    let residuals = fit.point.residual.iter().zip(&nominal.point.residual);
    let change = residuals.map(|(r, r0)| (r - r0) as f32).collect();
    let mut columns = fit.tangent.columns;
    columns.drain(..NOMINAL);
    columns.push(change);
    (candidate, Tangent { columns })
}

/// All pairs, the most promising first, with parameters from where a fit starts.
pub fn screen(
    nominal: &BaseFit<'_>,
    catalogue: &[&'static dyn Effect],
    alone: &[Alone],
) -> Vec<(Model, Vec<f64>)> {
    let (mut all, mut at) = (nominal.tangent.clone(), vec![NOMINAL]);
    for (_, own) in alone {
        all.columns.extend_from_slice(&own.columns);
        at.push(all.columns.len());
    }
    let sums = all.whole(&nominal.point, nominal.problem.log.bins.len());
    let gram = Gram { sums, at };
    let mut out: Vec<(Model, f64, Start)> = Vec::new();
    for a in 0..alone.len() {
        out.extend((0..a).filter_map(|b| gram.pair(nominal, catalogue, alone, [a, b])));
    }
    out.sort_by(|a, b| a.1.total_cmp(&b.1));
    let out = out.into_iter();
    out.map(|(model, _, start)| (model, start.theta)).collect()
}

/// Products of all columns with each other and with the residuals of the nominal model.
struct Gram {
    sums: Sums,
    /// First column of each single, and one past the last of all; the last column of each is its change.
    at: Vec<usize>,
}

impl Gram {
    /// The model, [`schwarz`], and the start of a fit of two singles.
    fn pair(
        &self,
        nominal: &BaseFit<'_>,
        catalogue: &[&'static dyn Effect],
        alone: &[Alone],
        of: [usize; 2],
    ) -> Option<(Model, f64, Start)> {
        let log = nominal.problem.log;
        let model = Model::named(catalogue, &of.map(|k| alone[k].0.names[0]));
        let problem = LeastSquares::new(log, model);
        let of = if alone[of[0]].0.names == [problem.model.effects[0].name()] {
            of
        } else {
            [of[1], of[0]]
        };
        let changes = of.map(|k| self.at[k + 1] - 1);
        let own = of.into_iter().flat_map(|k| self.at[k]..self.at[k + 1] - 1);
        let used: Vec<usize> = (0..NOMINAL).chain(own).collect();
        let Sums { normal, gradient } = &self.sums;
        // the residuals are those of the nominal model and both changes
        let along = |i: usize| gradient[i] + changes.iter().map(|&c| normal[(i, c)]).sum::<f64>();
        let squares =
            nominal.point.data() + changes.iter().map(|&c| gradient[c] + along(c)).sum::<f64>();
        let thetas = of.map(|k| &alone[k].0.theta);
        let gains = (0..NOMINAL).map(|i| thetas[0][i] + thetas[1][i] - nominal.point.theta[i]);
        let own = thetas.iter().flat_map(|t| &t[NOMINAL..]).copied();
        let theta = within(gains.chain(own), &problem.bounds);
        let n = used.len();
        let mut sums = Sums {
            normal: DMatrix::from_fn(n, n, |a, b| normal[(used[a], used[b])]),
            gradient: DVector::from_fn(n, |a, _| along(used[a])),
        };
        sums.add_prior(&problem, &theta);
        let squares = squares + problem.prior(&theta);
        let start = stepped(&problem, &theta, squares, &sums, nominal)?;
        let present = problem.model.present(&theta);
        Some((problem.model, schwarz(log, start.predicted, present), start))
    }
}
