//! Linear regression with held-out blocks: contiguous blocks alternate between two folds, and each fold is predicted by
//! a fit to the other.

use nalgebra::{DMatrix, DVector};

/// Blocks of a log.
const BLOCKS: usize = 12;
/// Margin at either end of a block that is neither fitted nor scored, as a part of the block.
const MARGIN: f64 = 0.03;

/// A signal to be explained, in blocks.
pub struct Task<'a> {
    /// The signal.
    pub y: &'a [f64],
    /// Block of each row; `None` in a margin.
    pub block: Vec<Option<usize>>,
}

/// Sums of one fold.
struct Normal {
    gram: DMatrix<f64>,
    right: DVector<f64>,
    square: f64,
}

/// Scores on held-out blocks, and the fit to all rows.
#[derive(Debug, Clone)]
pub struct Regressed {
    /// Sum of squares that the two fits leave in sample.
    pub cost: f64,
    /// Sum of squares and number of rows of each block, predicted by the fit to the other fold.
    pub blocks: Vec<(f64, f64)>,
    /// Coefficients of the fit to all rows.
    pub coefficients: Vec<f64>,
}

impl Regressed {
    /// Mean square over the held-out blocks.
    pub fn energy(&self) -> f64 {
        let (s, n) = self.blocks.iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        s / n.max(1.0)
    }
}

impl<'a> Task<'a> {
    /// Divides the rows of a signal into blocks.
    pub fn new(y: &'a [f64]) -> Self {
        let length = y.len() as f64 / BLOCKS as f64;
        let of = |k: usize| {
            let at = (k as f64 + 0.5) / length;
            (MARGIN..1.0 - MARGIN).contains(&at.fract()).then_some((at as usize).min(BLOCKS - 1))
        };
        Self { block: (0..y.len()).map(of).collect(), y }
    }

    /// Regresses on `columns`; `None` if the columns do not determine the coefficients, or if coefficient `first` does not
    /// have `sign` (0: either).
    pub fn regress(&self, columns: &[&[f64]], first: usize, sign: i8) -> Option<Regressed> {
        let normals = [self.normal(columns, 0), self.normal(columns, 1)];
        let right_sign = |c: &DVector<f64>| sign == 0 || c[first] * f64::from(sign) >= 0.0;
        let mut blocks = vec![(0.0, 0.0); BLOCKS];
        let mut cost = 0.0;
        for fold in 0..2 {
            let fitted = &normals[1 - fold];
            let c = solve(&fitted.gram, &fitted.right).filter(right_sign)?;
            cost += fitted.square - 2.0 * c.dot(&fitted.right) + c.dot(&(&fitted.gram * &c));
            for (k, block) in self.block.iter().enumerate() {
                if let Some(b) = block.filter(|b| b % 2 == fold) {
                    let left = self.y[k] - columns.iter().zip(c.iter()).map(|(x, c)| x[k] * c).sum::<f64>();
                    blocks[b] = (blocks[b].0 + left * left, blocks[b].1 + 1.0);
                }
            }
        }
        let all = solve(&(&normals[0].gram + &normals[1].gram), &(&normals[0].right + &normals[1].right)).filter(right_sign)?;
        Some(Regressed { cost, blocks, coefficients: all.iter().copied().collect() })
    }

    fn normal(&self, columns: &[&[f64]], fold: usize) -> Normal {
        let n = columns.len();
        let (mut gram, mut right, mut square) = (DMatrix::zeros(n, n), DVector::zeros(n), 0.0);
        for (k, block) in self.block.iter().enumerate() {
            if block.is_some_and(|b| b % 2 == fold) {
                for i in 0..n {
                    let x = columns[i][k];
                    right[i] += x * self.y[k];
                    for j in 0..=i {
                        gram[(i, j)] += x * columns[j][k];
                    }
                }
                square += self.y[k] * self.y[k];
            }
        }
        gram.fill_upper_triangle_with_lower_triangle();
        Normal { gram, right, square }
    }
}

/// Solves the normal equations scaled to a unit diagonal, with a ridge that matters only for nearly equal columns.
fn solve(gram: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    let size = gram.diagonal().map(|d| d.max(1e-300).sqrt());
    let n = gram.nrows();
    let scaled = DMatrix::from_fn(n, n, |i, j| gram[(i, j)] / (size[i] * size[j]) + if i == j { 1e-9 } else { 0.0 });
    let c = scaled.cholesky()?.solve(&right.component_div(&size));
    Some(c.component_div(&size)).filter(|c| c.iter().all(|x| x.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_block_is_predicted_by_a_fit_to_the_other_fold() {
        // the slope differs between the folds, so the held-out error is large and the in-sample error is zero
        let x: Vec<f64> = (0..1200).map(|k| (f64::from(k) * 0.1).sin()).collect();
        let y: Vec<f64> = x.iter().enumerate().map(|(k, x)| x * if (k / 100) % 2 == 0 { 1.0 } else { 3.0 }).collect();
        let r = Task::new(&y).regress(&[&x], 0, 0).unwrap();
        assert!((r.coefficients[0] - 2.0).abs() < 0.05, "{:?}", r.coefficients);
        assert!(r.cost < 1e-9 && (r.energy() - 2.0).abs() < 0.1, "{} {}", r.cost, r.energy());
        assert!(Task::new(&y).regress(&[&x], 0, -1).is_none());
    }
}
