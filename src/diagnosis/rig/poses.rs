//! What the log of a rig cannot show, whatever the scores.

use crate::diagnosis::rig::Signals;

/// Rows below which the probabilities are not to be trusted; the weights are fitted to logs of 500 rows and more.
const FEW: usize = 200;
/// Distinct values of the inputs below which a log has few poses.
const FEW_POSES: usize = 30;
/// Mean square of what the output moves from the third to the fourth quarter of a pose, in units of what it moves from pose to pose, below
/// which it stands. A response that goes on through the poses has a sixteenth.
const STANDS: f64 = 0.01;
/// Ratio of the 90th to the 10th percentile of the speed below which a log has one speed only.
const ONE_SPEED: f64 = 1.3;
/// Samples from which the speeds are estimated.
const SPEEDS: usize = 400;

/// Whether each of the logs shows nothing but a few poses: the output stands still while the inputs do, so that it has no more independent rows than
/// poses.
pub fn poor(logs: &[Signals]) -> bool {
    logs.iter().all(stands)
}

fn stands(log: &Signals) -> bool {
    let rows = log.output.len();
    let changes = |k: &usize| *k == 0 || log.inputs.iter().any(|u| u[*k] != u[k - 1]);
    let mut starts: Vec<usize> = (0..rows).filter(changes).collect();
    if log.inputs.is_empty() || starts.len() >= FEW_POSES || starts.len() < 2 {
        return false;
    }
    starts.push(rows);
    // the means of the last two quarters of each pose
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
    let last = |w: &[usize]| {
        let quarter = ((w[1] - w[0]) / 4).max(1);
        let (third, fourth) = (w[1].saturating_sub(2 * quarter), w[1] - quarter);
        [third..fourth, fourth..w[1]].map(|rows| mean(&log.output[rows]))
    };
    let quarters: Vec<[f64; 2]> = starts.windows(2).map(last).collect();
    let within: f64 = quarters.iter().map(|[a, b]| (b - a).powi(2)).sum();
    let ends = quarters.windows(2).map(|w| w[1][1] - w[0][1]);
    let between: f64 = ends.map(|moved| moved.powi(2)).sum();
    within < STANDS * between
}

/// Number of distinct values of the inputs, up to [`FEW_POSES`].
fn poses(logs: &[Signals]) -> usize {
    let mut known: Vec<Vec<f64>> = Vec::new();
    for log in logs {
        for k in 0..log.output.len() {
            let pose: Vec<f64> = log.inputs.iter().map(|u| u[k]).collect();
            if known.len() < FEW_POSES && !known.contains(&pose) {
                known.push(pose);
            }
        }
    }
    known.len()
}

/// Speeds of the moving signal, sampled all over a log.
fn speeds(log: &Signals) -> Vec<f64> {
    let Some(m) = log.motion.as_ref() else {
        return vec![];
    };
    let (step, last) = ((m.len() / SPEEDS).max(1), m.len() - 1);
    let starts = (0..).map(|k| k * step).take_while(|k| k + step <= last);
    let speed = |k: usize| ((m[k + step] - m[k]) / (log.t[k + step] - log.t[k])).abs();
    starts.map(speed).collect()
}

/// What these logs cannot show, regardless of the scores.
pub fn notes(logs: &[Signals]) -> Vec<String> {
    let mut out = Vec::new();
    let rows: usize = logs.iter().map(|log| log.output.len()).sum();
    if rows < FEW {
        out.push(format!("the log has {rows} rows; of fewer than {FEW}, noise is taken for an effect too often. Record a longer log"));
    }
    let logged: usize = logs.iter().map(|log| log.logged).sum();
    if logged > rows {
        out.push(format!("of {logged} rows, {rows} means or rows of the stretch with most motion are compared; what is faster than the means or slower than the stretch does not show. Cut the log, or set `every` in the map"));
    }
    let (poses, first) = (poses(logs), &logs[0]);
    if !first.inputs.is_empty() && poses < FEW_POSES {
        out.push(format!("the inputs have {poses} distinct values; a law of the path fits so few poses by chance. Record a log that passes {FEW_POSES} poses or more, each from both sides"));
    }
    if !first.clocked {
        out.push("the log has no clock: effects of time and effects of the path cannot be separated; times are in rows. Record a clock, and a second speed".to_owned());
        return out;
    }
    let mut speeds: Vec<f64> = logs.iter().flat_map(speeds).collect();
    speeds.sort_by(f64::total_cmp);
    let part = |tenths: usize| speeds.get(speeds.len() * tenths / 10).copied();
    let (low, high) = (part(1).unwrap_or(0.0), part(9).unwrap_or(0.0));
    if low > 0.0 && high / low < ONE_SPEED {
        out.push(format!("the log has one speed ({high:.3} per second): an effect that is periodic in position is periodic in time as well. Record a second speed"));
    }
    out
}
