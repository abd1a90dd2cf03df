//! The nominal model of a mapped rig with a set of operators.

use crate::diagnosis::rig::regress::{Columns, left, variance};
use crate::diagnosis::rig::{
    DRIVEN, Drive, MapFile, Nominal, Operator, STILL, Signals, Task, none, oscillator,
};

/// An operator at one value of η.
#[derive(Clone)]
pub struct Member {
    /// The operator.
    pub operator: Operator,
    /// Value of η.
    pub eta: f64,
    /// Columns on the log.
    pub columns: Vec<Vec<f64>>,
}

/// Effects whose answer replaces the immediate one of the nominal model.
const TAKES_OVER: [&str; 7] = [
    "play",
    "hysteresis",
    "bouc_wen",
    "dead_band",
    "rate_limit",
    "lag",
    "delay",
];

/// Largest nominal prediction on a fresh log, in half ranges of the fitted one.
const OUTSIDE: f64 = 2.5;

/// Scaling of raw signals to the [`Drive`] of the operators, fixed by the diagnosed log.
#[derive(Debug, Clone)]
struct Scale {
    weights: Vec<f64>,
    middle: f64,
    half: f64,
    m_low: f64,
    m_range: f64,
    swing: Option<(f64, f64)>,
}

/// The nominal model on a log.
pub struct MapBase {
    scale: Scale,
    /// Signals that the operators act on.
    pub drive: Drive,
    base: Vec<Vec<f64>>,
}

/// Operators for an oscillator: the response to a nonlinear spring force, to first and second order of a perturbation
/// (Nayfeh 1973).
pub const RESONANT: [Operator; 2] = [
    // Spring with a third power (Duffing). Separated by several amplitudes.
    Operator::new("cubic", 0, "", none, |d, _| spring(d, 3)),
    // Spring with a square: stiffer to one side. Separated by amplitudes to both sides.
    Operator::new("asymmetry", 0, "", none, |d, _| spring(d, 2)),
];

/// Operators that apply to a rig; a period in time needs a clock.
pub fn catalogue(nominal: Nominal, clocked: bool) -> Vec<Operator> {
    let mut all = match nominal {
        Nominal::Still => STILL.to_vec(),
        Nominal::Line => DRIVEN.to_vec(),
        Nominal::Resonance => RESONANT.to_vec(),
    };
    all.retain(|o| clocked || o.name != "periodic_time");
    all
}

fn spring(d: &Drive, power: i32) -> Vec<Vec<f64>> {
    // `Scale::drive` stores frequency and damping of the oscillator in the first two samples of `m`
    let swung = |force: Vec<f64>| oscillator(&force, d.m[0], d.m[1]);
    let first = swung(d.v.iter().map(|v| v.powi(power)).collect());
    let slope = |(v, f): (&f64, &f64)| f64::from(power) * v.powi(power - 1) * f;
    let second = swung(d.v.iter().zip(&first).map(slope).collect());
    vec![first, second]
}

impl MapBase {
    /// Identifies the nominal model on the log.
    pub fn new(map: &MapFile, log: &Signals) -> Self {
        let swing = (map.nominal == Nominal::Resonance).then(|| resonance(log));
        let inputs = driven(log, swing);
        let ones = vec![1.0; log.output.len()];
        let base: Vec<Vec<f64>> = [ones].into_iter().chain(inputs.clone()).collect();
        let columns = Columns::free(base.iter().map(Vec::as_slice).collect());
        let regressed = Task::new(&log.output).regress(&columns);
        let weights = regressed.map_or(vec![1.0; inputs.len()], |r| r.coefficients[1..].to_vec());
        let (low, high) = range(&combined(&inputs, &weights, log.output.len()));
        let (m_low, m_high) = log.motion.as_deref().map_or((0.0, 1.0), range);
        let scale = Scale {
            weights,
            middle: (low + high) / 2.0,
            half: ((high - low) / 2.0).max(1e-12),
            m_low,
            m_range: (m_high - m_low).max(1e-12),
            swing,
        };
        let drive = scale.drive(log, &inputs);
        Self { scale, drive, base }
    }

    /// Columns of a set, and the signs that their coefficients must have.
    pub fn columns<'a>(&'a self, members: &'a [Member]) -> Columns<'a> {
        let (mut of, mut signs): (Vec<&[f64]>, _) =
            (self.base.iter().map(Vec::as_slice).collect(), vec![]);
        for m in members {
            // of several inputs each has a weight of its own, and nothing tells its sign
            let weighted = !self.drive.parts.is_empty() && m.columns.len() > self.drive.parts.len();
            signs.push((of.len(), if weighted { 0 } else { m.operator.sign }));
            of.extend(m.columns.iter().map(Vec::as_slice));
        }
        // what creeps has answered at once, the same way, and creeps on that way, unless another effect takes the answer over
        let has = |name: &str| members.iter().any(|m| m.operator.name == name);
        let (creeps, taken) = (has("creep"), TAKES_OVER.into_iter().any(has));
        if let ([weight], true, false) = (self.scale.weights.as_slice(), creeps, taken) {
            signs.push((1, if *weight < 0.0 { -1 } else { 1 }));
        }
        Columns { of, signs }
    }

    /// RMSE on another log of the rig of a set with these fitted coefficients; only the offset is set again. `None` if that log is too far
    /// outside the fitted range for an extrapolation.
    pub fn rmse_on(&self, other: &Signals, members: &[Member], fitted: &[f64]) -> Option<f64> {
        let inputs = driven(other, self.scale.swing);
        let drive = self.scale.drive(other, &inputs);
        let (low, high) = range(&drive.v);
        if low.abs().max(high.abs()) > OUTSIDE {
            return None;
        }
        let own = |m: &Member| (m.operator.columns)(&drive, m.eta);
        let own = members.iter().flat_map(own);
        let columns: Vec<Vec<f64>> = inputs.into_iter().chain(own).collect();
        let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        Some(variance(&left(&other.output, &columns, &fitted[1..])).sqrt())
    }
}

impl Scale {
    fn drive(&self, log: &Signals, inputs: &[Vec<f64>]) -> Drive {
        let rows = log.output.len();
        let v = combined(inputs, &self.weights, rows);
        let moved = |m: &Vec<f64>| m.iter().map(|x| (x - self.m_low) / self.m_range).collect();
        let mut m: Vec<f64> = log.motion.as_ref().map_or(vec![0.0; rows], moved);
        if let Some((wh, zeta)) = self.swing {
            (m[0], m[1]) = (wh, zeta);
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

fn combined(inputs: &[Vec<f64>], weights: &[f64], rows: usize) -> Vec<f64> {
    let one = |k: usize| inputs.iter().zip(weights).map(|(u, w)| u[k] * w).sum();
    (0..rows).map(one).collect()
}

fn range(x: &[f64]) -> (f64, f64) {
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    x.iter().fold(none, |(l, h), v| (l.min(*v), h.max(*v)))
}

/// The inputs, filtered by the oscillator if there is one.
fn driven(log: &Signals, swing: Option<(f64, f64)>) -> Vec<Vec<f64>> {
    match swing {
        Some((wh, zeta)) => log.inputs.iter().map(|u| oscillator(u, wh, zeta)).collect(),
        None => log.inputs.clone(),
    }
}

/// Frequency (2 tan(ω h / 2)) and damping with the least cost, from a grid and a pattern search.
fn resonance(log: &Signals) -> (f64, f64) {
    let ones = vec![1.0; log.output.len()];
    let task = Task::new(&log.output);
    let at = |(wh, zeta): (f64, f64)| {
        let column = oscillator(&log.inputs[0], wh, zeta);
        let cost = task.cost(&Columns::free(vec![&ones, &column]));
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
    (best.1, best.2)
}
