//! Long logs: an hour is compared in as many rows as a few minutes.

use crate::diagnosis::rig::regress::variance;
use std::ops::Range;

/// Most rows of a log that are compared.
pub const ROWS_MAX: usize = 20_000;
/// Largest part of the variance of an input that the means of rows may hide: there are fifty means or more in a period of the motion.
const HIDDEN: f64 = 1e-3;

/// What is compared of a log: at most [`ROWS_MAX`] means of successive rows, as many at a time as hide nothing of the motion of the inputs. Of a
/// log that is longer even so, it is the stretch in which the inputs move most.
pub struct Compared {
    stretch: Range<usize>,
    /// Rows of a mean.
    each: usize,
}

impl Compared {
    /// What is compared of a log with these inputs and so many rows.
    pub fn new(inputs: &[Vec<f64>], rows: usize) -> Self {
        let mut each = rows.div_ceil(ROWS_MAX).max(1);
        while each > 1 && inputs.iter().any(|u| hidden(u, each) > HIDDEN) {
            each /= 2;
        }
        let length = (ROWS_MAX * each).min(rows);
        let moves = |stretch: &Range<usize>| -> f64 {
            let of = |u: &Vec<f64>| variance(&u[stretch.clone()]) / variance(u).max(1e-300);
            inputs.iter().map(of).sum()
        };
        let stretches = (0..=rows - length).step_by(length.max(1));
        let stretches = stretches.map(|first| first..first + length);
        let stretch = stretches.max_by(|a, b| moves(a).total_cmp(&moves(b)));
        Self {
            stretch: stretch.unwrap_or(0..rows),
            each,
        }
    }

    /// What is compared of a signal of the log.
    pub fn of(&self, x: &[f64]) -> Vec<f64> {
        means(&x[self.stretch.clone()], self.each)
    }
}

/// Part of the variance of a signal that the means of so many rows at a time do not have.
fn hidden(x: &[f64], each: usize) -> f64 {
    1.0 - variance(&means(x, each)) / variance(x)
}

/// The means of so many values at a time; fewer values at the end are left out.
fn means(x: &[f64], each: usize) -> Vec<f64> {
    let mean = |few: &[f64]| few.iter().sum::<f64>() / each as f64;
    x.chunks_exact(each).map(mean).collect()
}
