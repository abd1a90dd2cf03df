//! The nominal model of a mapped rig with a set of operators.

use crate::diagnosis::rig::operators::TAKES_OVER;
use crate::diagnosis::rig::regress::{Columns, centred};
use crate::diagnosis::rig::{Drive, MapFile, Nominal, Operator, Signals, Task, oscillator};
use serde::{Deserialize, Serialize};

/// An operator at one value of η.
#[derive(Clone)]
pub struct Member {
    /// The operator.
    pub operator: Operator,
    /// Value of η.
    pub eta: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
    /// Columns on the log, [`centred`].
    pub columns: Vec<Vec<f64>>,
}

/// The recalibrated nominal model, and the scaling of raw signals to the [`Drive`] of the operators.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scale {
    /// What the output moves per unit of each input.
    pub weights: Vec<f64>,
    /// Middle of the prediction without its offset, in the unit of the output.
    pub middle: f64,
    /// Half of its range.
    pub half: f64,
    /// Least value of the moving signal.
    pub m_low: f64,
    /// Its range.
    pub m_range: f64,
    /// Frequency, rad/s, and damping of the oscillator, if there is one.
    pub swing: Option<[f64; 2]>,
}

/// The nominal model on logs of one rig: a line of one slope, with an offset of its own for each log.
pub struct MapBase {
    /// The nominal model.
    pub scale: Scale,
    /// Signals that the operators act on, of each log.
    pub drives: Vec<Drive>,
    /// Columns: the offset of each log, then the inputs, [`centred`].
    pub base: Vec<Vec<f64>>,
}

impl MapBase {
    /// Identifies the nominal model on the logs; `None` if their inputs do not determine it.
    pub fn new(map: &MapFile, logs: &[Signals]) -> Option<Self> {
        let swing = (map.nominal == Nominal::Resonance).then(|| resonance(logs));
        let of_each: Vec<Vec<Vec<f64>>> = logs.iter().map(|log| driven(log, swing)).collect();
        let inputs = stacked(of_each.clone());
        let mut base = offsets(logs);
        base.extend(stacked(of_each.iter().map(|columns| level(columns))));
        let columns = Columns::free(base.iter().map(Vec::as_slice).collect());
        let task = Task::new(logs.iter().map(|log| log.output.as_slice()));
        let weights = task.regress(&columns)?.coefficients[logs.len()..].to_vec();
        let (low, high) = range(&combined(&inputs, &weights, task.y.len()));
        let moving = logs.iter().flat_map(|log| log.motion.iter().flatten());
        let (m_low, m_high) = match logs[0].motion {
            Some(_) => range(moving),
            None => (0.0, 1.0),
        };
        let scale = Scale {
            weights,
            middle: (low + high) / 2.0,
            half: ((high - low) / 2.0).max(1e-12),
            m_low,
            m_range: (m_high - m_low).max(1e-12),
            swing,
        };
        let drives = logs.iter().zip(&of_each);
        let drives = drives.map(|(log, inputs)| scale.drive(log, inputs));
        Some(Self {
            drives: drives.collect(),
            scale,
            base,
        })
    }

    /// An operator at a value of η; its state starts anew with each log.
    pub fn member(&self, operator: &Operator, eta: f64) -> Member {
        let of_each = self.drives.iter();
        let of_each = of_each.map(|d| level(&(operator.columns)(d, eta)));
        Member {
            operator: *operator,
            eta,
            ci95: [eta; 2],
            columns: if operator.is_state {
                apart(of_each.collect())
            } else {
                stacked(of_each)
            },
        }
    }

    /// Values of η to be tried: those for the longest log.
    pub fn grid(&self, operator: &Operator) -> Vec<f64> {
        let longest = self.drives.iter().max_by_key(|d| d.t.len());
        longest.map_or(vec![], operator.grid)
    }

    /// Columns of a set, and the signs that their coefficients must have.
    pub fn columns<'a>(&'a self, members: &'a [Member]) -> Columns<'a> {
        let (mut of, mut signs): (Vec<&[f64]>, _) =
            (self.base.iter().map(Vec::as_slice).collect(), vec![]);
        let parts = self.drives[0].parts.len();
        for m in members {
            // of several inputs each has a weight of its own, and nothing tells its sign
            let weighted = parts > 0 && m.columns.len() > parts;
            signs.push((of.len(), if weighted { 0 } else { m.operator.sign }));
            of.extend(m.columns.iter().map(Vec::as_slice));
        }
        // what creeps has answered at once, the same way, and creeps on that way, unless another effect takes the answer over
        let has = |name: &str| members.iter().any(|m| m.operator.name == name);
        let (creeps, taken) = (has("creep"), TAKES_OVER.into_iter().any(has));
        if let ([weight], true, false) = (self.scale.weights.as_slice(), creeps, taken) {
            signs.push((self.drives.len(), if *weight < 0.0 { -1 } else { 1 }));
        }
        Columns { of, signs }
    }
}

/// Columns of several logs, one log below the other.
fn stacked(logs: impl IntoIterator<Item = Vec<Vec<f64>>>) -> Vec<Vec<f64>> {
    let below = |mut all: Vec<Vec<f64>>, log: Vec<Vec<f64>>| {
        all.iter_mut().zip(log).for_each(|(a, c)| a.extend(c));
        all
    };
    logs.into_iter().reduce(below).unwrap_or_default()
}

/// Columns of a log, each without its mean.
fn level(columns: &[Vec<f64>]) -> Vec<Vec<f64>> {
    columns.iter().map(|column| centred(column)).collect()
}

/// The offset of each log.
fn offsets(logs: &[Signals]) -> Vec<Vec<f64>> {
    let ones = |log: &Signals| vec![vec![1.0; log.t.len()]];
    apart(logs.iter().map(ones).collect())
}

/// Columns of several logs, each zero in the other logs.
fn apart(logs: Vec<Vec<Vec<f64>>>) -> Vec<Vec<f64>> {
    let rows = |log: &Vec<Vec<f64>>| log.first().map_or(0, Vec::len);
    let (all, mut start): (usize, _) = (logs.iter().map(rows).sum(), 0);
    let mut out = vec![];
    for log in logs {
        let end = start + rows(&log);
        for column in log {
            let mut whole = vec![0.0; all];
            whole[start..end].copy_from_slice(&column);
            out.push(whole);
        }
        start = end;
    }
    out
}

impl Scale {
    /// The signals of a log as the operators see them; `inputs` are [`driven`].
    pub fn drive(&self, log: &Signals, inputs: &[Vec<f64>]) -> Drive {
        let rows = log.output.len();
        let v = combined(inputs, &self.weights, rows);
        let moved = |m: &Vec<f64>| m.iter().map(|x| (x - self.m_low) / self.m_range).collect();
        let mut m: Vec<f64> = log.motion.as_ref().map_or(vec![0.0; rows], moved);
        if let Some(swing) = self.swing {
            (m[0], m[1]) = sampled(swing, log);
        }
        let further = inputs.iter().zip(&self.weights).skip(1);
        let part = |(u, w): (&Vec<f64>, &f64)| u.iter().map(|u| u * w / self.half).collect();
        Drive {
            v: v.iter().map(|x| (x - self.middle) / self.half).collect(),
            m,
            m_range: self.m_range,
            t: log.t.clone(),
            zero: -self.middle / self.half,
            parts: further.map(part).collect(),
        }
    }
}

/// Frequency, `2 tan(ω h / 2)`, and damping of an oscillator at the time between the rows of a log.
fn sampled([rad_s, zeta]: [f64; 2], log: &Signals) -> (f64, f64) {
    (2.0 * (rad_s * step_s(log) / 2.0).min(1.5).tan(), zeta)
}

/// Time between two rows of a log, s.
fn step_s(log: &Signals) -> f64 {
    let last = log.t.len() - 1;
    (log.t[last] - log.t[0]) / last as f64
}

fn combined(inputs: &[Vec<f64>], weights: &[f64], rows: usize) -> Vec<f64> {
    let one = |k: usize| inputs.iter().zip(weights).map(|(u, w)| u[k] * w).sum();
    (0..rows).map(one).collect()
}

/// Least and largest value.
pub fn range<'x>(x: impl IntoIterator<Item = &'x f64>) -> (f64, f64) {
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    x.into_iter().fold(none, |(l, h), v| (l.min(*v), h.max(*v)))
}

/// The inputs of a log, filtered by the oscillator if there is one.
pub fn driven(log: &Signals, swing: Option<[f64; 2]>) -> Vec<Vec<f64>> {
    let Some((wh, zeta)) = swing.map(|swing| sampled(swing, log)) else {
        return log.inputs.clone();
    };
    let swung = log.inputs.iter().map(|u| oscillator(u, wh, zeta));
    swung.collect()
}

/// Frequency, rad/s, and damping with the least cost, from a grid and a pattern search.
fn resonance(logs: &[Signals]) -> [f64; 2] {
    let step_s = step_s(&logs[0]);
    let base = offsets(logs);
    let task = Task::new(logs.iter().map(|log| log.output.as_slice()));
    let swing = |wh: f64, zeta: f64| [2.0 * (wh / 2.0).atan() / step_s, zeta];
    let at = |(wh, zeta): (f64, f64)| {
        let column = logs
            .iter()
            .map(|log| level(&driven(log, Some(swing(wh, zeta)))));
        let column = stacked(column);
        let columns = base.iter().chain(&column).map(Vec::as_slice);
        let cost = task.cost(&Columns::free(columns.collect()));
        (cost.unwrap_or(f64::INFINITY), wh, zeta)
    };
    let least = |tried: Vec<(f64, f64)>| {
        let costs = tried.into_iter().map(at);
        costs.min_by(|a, b| a.0.total_cmp(&b.0))
    };
    let frequency = |k: u32| 0.02 * 100f64.powf(f64::from(k) / 39.0);
    let grid = (0..40).flat_map(|k| [0.02, 0.1, 0.5].map(|zeta| (frequency(k), zeta)));
    let mut best = least(grid.collect()).unwrap_or((f64::INFINITY, 0.5, 0.05));
    let mut step = 0.08;
    while step > 1e-4 {
        let (_, wh, zeta) = best;
        let (by, much) = (1.0 + step, 1.0 + 4.0 * step);
        let around = [
            (wh * by, zeta),
            (wh / by, zeta),
            (wh, zeta * much),
            (wh, zeta / much),
        ];
        match least(around.to_vec()).filter(|n| n.0 < best.0) {
            Some(better) => best = better,
            None => step /= 2.0,
        }
    }
    swing(best.1, best.2)
}
