//! Linear regression with held-out blocks: contiguous blocks alternate between two folds, and each fold is predicted by
//! a fit to the other. Blocks of two lengths are scored: long ones, which a drift cannot bridge, and short ones.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Long blocks of a log.
const LONG: usize = 12;
/// Most short blocks.
const SHORT: usize = 96;
/// Least rows of a block.
const ROWS: usize = 5;
/// Margin at either end of a block that is neither fitted nor scored, as a part of the block.
const MARGIN: f64 = 0.03;
/// Draws of the bootstrap.
const DRAWS: usize = 400;

/// A signal without its mean: each log has an offset of its own, so that the zero of a signal must not count.
pub fn centred(x: &[f64]) -> Vec<f64> {
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    x.iter().map(|x| x - mean).collect()
}

/// A signal to be explained, in blocks.
pub struct Task {
    /// The signal, [`centred`], one log after the other.
    pub y: Vec<f64>,
    /// Long and short block of each row; `None` in a margin. A block belongs to one log.
    blocks: [Vec<Option<usize>>; 2],
}

/// Block of each row of a log that is divided into `count` blocks, which are counted from `first`; `None` in a margin.
fn blocks(rows: usize, count: usize, first: usize) -> impl Iterator<Item = Option<usize>> {
    let length = rows as f64 / count as f64;
    let scored = |at: &f64| (MARGIN..1.0 - MARGIN).contains(&at.fract());
    (0..rows).map(move |k| {
        let at = Some((k as f64 + 0.5) / length).filter(scored)?;
        Some(first + (at as usize).min(count - 1))
    })
}

/// Columns of a regression, and the signs that some coefficients must have: index and ±1.
#[derive(Clone)]
pub struct Columns<'a> {
    /// The columns.
    pub of: Vec<&'a [f64]>,
    /// The signs.
    pub signs: Vec<(usize, i8)>,
}

impl<'a> Columns<'a> {
    /// Columns whose coefficients may have either sign.
    pub fn free(of: Vec<&'a [f64]>) -> Self {
        let signs = vec![];
        Self { of, signs }
    }
}

/// What the columns with these coefficients leave of a signal.
pub fn left(y: &[f64], columns: &[&[f64]], coefficients: &[f64]) -> Vec<f64> {
    let one = |k: usize| {
        let parts = columns.iter().zip(coefficients).map(|(x, c)| x[k] * c);
        y[k] - parts.sum::<f64>()
    };
    (0..y.len()).map(one).collect()
}

/// Sums of one fold.
struct Normal {
    gram: DMatrix<f64>,
    right: DVector<f64>,
    square: f64,
}

impl Normal {
    fn new(y: &[f64], columns: &[&[f64]], used: impl Fn(usize) -> bool) -> Self {
        let n = columns.len();
        let (mut gram, mut right, mut square) = (DMatrix::zeros(n, n), DVector::zeros(n), 0.0);
        for k in (0..y.len()).filter(|&k| used(k)) {
            for i in 0..n {
                let x = columns[i][k];
                right[i] += x * y[k];
                for j in 0..=i {
                    gram[(i, j)] += x * columns[j][k];
                }
            }
            square += y[k] * y[k];
        }
        gram.fill_upper_triangle_with_lower_triangle();
        Self {
            gram,
            right,
            square,
        }
    }

    /// Coefficients with the least squares, scaled to a unit diagonal, with a ridge that matters only for nearly equal columns; `None` if
    /// there are none, or if one does not have its sign.
    fn solve(&self, signs: &[(usize, i8)]) -> Option<DVector<f64>> {
        let (factor, size) = self.factor()?;
        let right = self.right.component_div(&size);
        let c = factor.solve(&right).component_div(&size);
        let right = |&(i, sign): &(usize, i8)| sign == 0 || c[i] * f64::from(sign) >= 0.0;
        (c.iter().all(|x| x.is_finite()) && signs.iter().all(right)).then_some(c)
    }

    /// Cholesky factor of the scaled sums, and the scales.
    fn factor(&self) -> Option<(Cholesky<f64, Dyn>, DVector<f64>)> {
        let size = self.gram.diagonal().map(|d| d.max(1e-300).sqrt());
        let n = self.gram.nrows();
        let scaled = DMatrix::from_fn(n, n, |i, j| {
            self.gram[(i, j)] / (size[i] * size[j]) + if i == j { 1e-9 } else { 0.0 }
        });
        Some((scaled.cholesky()?, size))
    }
}

/// Scores on held-out blocks, and the fit to all rows.
#[derive(Debug, Clone)]
pub struct Regressed {
    /// Sum of squares and number of rows of each long and each short block, predicted by the fit to the other fold.
    pub blocks: [Vec<(f64, f64)>; 2],
    /// Coefficients of the fit to all rows.
    pub coefficients: Vec<f64>,
}

impl Regressed {
    /// Index of the blocks, long or short, in which more is left.
    pub fn worse(&self) -> usize {
        usize::from(mean_square(&self.blocks[1]) > mean_square(&self.blocks[0]))
    }

    /// Mean square over the held-out blocks, long or short, in which more is left.
    pub fn energy(&self) -> f64 {
        mean_square(&self.blocks[self.worse()])
    }

    /// Mean over the long and over the short blocks of the logarithm of the mean square: the negative predictive density of residuals
    /// whose variance is unknown.
    pub fn density(&self) -> [f64; 2] {
        let of = |blocks: &Vec<(f64, f64)>| {
            let log = |(s, n): &(f64, f64)| (s / n).max(f64::MIN_POSITIVE).ln();
            let logs: Vec<f64> = blocks.iter().filter(|b| b.1 > 0.0).map(log).collect();
            logs.iter().sum::<f64>() / logs.len().max(1) as f64
        };
        [0, 1].map(|k| of(&self.blocks[k]))
    }
}

/// Variance of a signal.
pub fn variance(x: &[f64]) -> f64 {
    centred(x).iter().map(|x| x.powi(2)).sum::<f64>() / x.len() as f64
}

fn mean_square(blocks: &[(f64, f64)]) -> f64 {
    let sum = |a: (f64, f64), b: &(f64, f64)| (a.0 + b.0, a.1 + b.1);
    let (s, n) = blocks.iter().fold((0.0, 0.0), sum);
    s / f64::max(n, 1.0)
}

/// 95 % interval of the closed part from blocks drawn with replacement; `floor` is the mean square of the noise.
pub fn closed_ci95(from: &Regressed, to: &Regressed, floor: f64, seed: u64) -> [f64; 2] {
    let mut rng = StdRng::seed_from_u64(seed);
    // the blocks in which the set leaves more
    let worse = to.worse();
    let (from, to) = (&from.blocks[worse], &to.blocks[worse]);
    let mut draw = |_| {
        let (mut before, mut after, mut rows) = (0.0, 0.0, 0.0);
        for _ in 0..from.len() {
            let i = rng.random_range(0..from.len());
            before += from[i].0;
            after += to[i].0;
            rows += from[i].1;
        }
        ((before - after) / (before - floor * rows).max(1e-300)).clamp(-1.0, 1.0)
    };
    let mut draws: Vec<f64> = (0..DRAWS).map(&mut draw).collect();
    draws.sort_by(f64::total_cmp);
    [draws[DRAWS / 40], draws[DRAWS - 1 - DRAWS / 40]]
}

impl Task {
    /// Divides the rows of each log into blocks.
    pub fn new<'l>(logs: impl IntoIterator<Item = &'l [f64]>) -> Self {
        let (mut y, mut blocks, mut known) = (vec![], [vec![], vec![]], [0, 0]);
        for log in logs {
            let counts = [LONG, (log.len() / ROWS).clamp(LONG, SHORT)];
            for (k, count) in counts.into_iter().enumerate() {
                blocks[k].extend(self::blocks(log.len(), count, known[k]));
                known[k] += count;
            }
            y.extend(centred(log));
        }
        Self { y, blocks }
    }

    /// Sum of squares that a fit to all rows leaves; `None` if the columns do not determine the coefficients, or one does not have its
    /// sign.
    pub fn cost(&self, columns: &Columns<'_>) -> Option<f64> {
        let all = Normal::new(&self.y, &columns.of, |_| true);
        let c = all.solve(&columns.signs)?;
        Some(all.square - 2.0 * c.dot(&all.right) + c.dot(&(&all.gram * &c)))
    }

    /// Coefficients of a fit to all rows, and the variance of each for noise of variance one. `None` as for [`Task::cost`].
    pub fn fit(&self, columns: &Columns<'_>) -> Option<Vec<(f64, f64)>> {
        let all = Normal::new(&self.y, &columns.of, |_| true);
        let (c, (factor, size)) = (all.solve(&columns.signs)?, all.factor()?);
        let spread = factor.inverse().diagonal();
        let one = |k: usize| (c[k], spread[k] / size[k].powi(2));
        Some((0..c.len()).map(one).collect())
    }

    /// Regresses on the columns; `None` as for [`Task::cost`].
    pub fn regress(&self, columns: &Columns<'_>) -> Option<Regressed> {
        let all = Normal::new(&self.y, &columns.of, |_| true).solve(&columns.signs)?;
        Some(Regressed {
            blocks: [self.scored(columns, 0)?, self.scored(columns, 1)?],
            coefficients: all.as_slice().to_vec(),
        })
    }

    /// What a fit to the other fold leaves of each row, on long (0) or short (1) blocks; NaN in a margin. `None` as for [`Task::cost`].
    pub fn left_out(&self, columns: &Columns<'_>, length: usize) -> Option<Vec<f64>> {
        let blocks = &self.blocks[length];
        let mut out = vec![f64::NAN; self.y.len()];
        for fold in 0..2 {
            let other = |k: usize| blocks[k].is_some_and(|b| b % 2 != fold);
            let c = Normal::new(&self.y, &columns.of, other).solve(&columns.signs)?;
            let left = left(&self.y, &columns.of, c.as_slice());
            for k in (0..out.len()).filter(|&k| blocks[k].is_some_and(|b| b % 2 == fold)) {
                out[k] = left[k];
            }
        }
        Some(out)
    }

    /// Sum of squares and number of rows of each block.
    fn scored(&self, columns: &Columns<'_>, length: usize) -> Option<Vec<(f64, f64)>> {
        let blocks = &self.blocks[length];
        let count = blocks.iter().flatten().max().map_or(0, |last| last + 1);
        let mut out = vec![(0.0, 0.0); count];
        for (left, block) in self.left_out(columns, length)?.iter().zip(blocks) {
            if let Some(b) = *block {
                out[b] = (out[b].0 + left * left, out[b].1 + 1.0);
            }
        }
        Some(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_block_is_predicted_by_a_fit_to_the_other_fold() {
        // the slope differs between the long folds, so their held-out error is large
        let x: Vec<f64> = (0..1200).map(|k| (f64::from(k) * 0.1).sin()).collect();
        let y: Vec<f64> = x
            .iter()
            .enumerate()
            .map(|(k, x)| x * if (k / 100) % 2 == 0 { 1.0 } else { 3.0 })
            .collect();
        let task = Task::new([y.as_slice()]);
        let columns = |sign| Columns {
            of: vec![x.as_slice()],
            signs: vec![(0, sign)],
        };
        let r = task.regress(&columns(0)).unwrap();
        assert!(
            (r.coefficients[0] - 2.0).abs() < 0.05,
            "{:?}",
            r.coefficients
        );
        assert!(
            (r.energy() - 2.0).abs() < 0.1 && r.worse() == 0,
            "{}",
            r.energy()
        );
        assert!(
            (task.cost(&columns(0)).unwrap() / 1200.0 - 0.5).abs() < 0.05,
            "a fit to all rows leaves a quarter of that"
        );
        assert!(task.regress(&columns(-1)).is_none());
    }

    #[test]
    fn no_block_holds_rows_of_two_logs_and_each_log_has_both_folds() {
        let logs = [vec![0.0; 130], vec![1.0; 67]];
        let task = Task::new(logs.iter().map(Vec::as_slice));
        for blocks in &task.blocks {
            let of = |rows: std::ops::Range<usize>| -> Vec<usize> {
                blocks[rows].iter().flatten().copied().collect()
            };
            let (first, second) = (of(0..130), of(130..197));
            assert!(first.iter().max() < second.iter().min());
            for log in [first, second] {
                assert!([0, 1].iter().all(|fold| log.iter().any(|b| b % 2 == *fold)));
            }
        }
    }
}
