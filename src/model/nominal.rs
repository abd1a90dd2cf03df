//! The parameters of the nominal model with a set of effects, and their places in one vector θ.

use crate::model::Line;
use crate::model::effects::{Effect, MODE_PARAMS};
use std::ops::Range;

/// Number of nominal parameters: ln(1 + k_ε) × 3, k_λ (mm) × 3, τ₀ (s).
pub const NOMINAL: usize = 7;

/// The lines of a parameter vector.
pub fn lines(theta: &[f64]) -> [Line; 3] {
    std::array::from_fn(|i| Line {
        k_epsilon: theta[i].exp() - 1.0,
        k_lambda_mm: theta[3 + i].max(0.0),
    })
}

/// The nominal parameter vector of lines and a lag, the inverse of [`lines`].
pub fn nominal_theta(lines: &[Line; 3], lag_s: f64) -> Vec<f64> {
    let mut theta: Vec<f64> = lines.iter().map(|l| (1.0 + l.k_epsilon).ln()).collect();
    theta.extend(lines.iter().map(|l| l.k_lambda_mm));
    theta.push(lag_s);
    theta
}

/// A set of effects in catalogue order, and the place of their parameters in the parameter vector θ.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// The effects.
    pub effects: Vec<&'static dyn Effect>,
    /// First parameter of each effect, and one past the last of all.
    pub at: Vec<usize>,
}

/// One event of an effect that happens once: indices in θ of its time, of its duration if it has one, and of its offsets.
#[derive(Debug, Clone, Copy)]
pub struct Event {
    /// Time, s after the start of the first log.
    pub time: usize,
    /// Duration, s.
    pub lasting: Option<usize>,
    /// Offsets of the three channels or axes.
    pub offsets: [usize; 3],
}

/// One periodic mode of an effect: indices in θ of its frequency, Hz, and of the offsets of its sine and its cosine.
#[derive(Debug, Clone, Copy)]
pub struct Mode {
    /// Frequency, Hz; 0 if the mode is absent.
    pub frequency: usize,
    /// Offsets of the three axes, of the sine and of the cosine.
    pub offsets: [[usize; 3]; 2],
}

impl Model {
    /// The nominal model with these effects.
    pub fn new(effects: &[&'static dyn Effect]) -> Self {
        let mut at = vec![NOMINAL];
        for e in effects {
            at.push(at[at.len() - 1] + e.params().len());
        }
        let effects = effects.to_vec();
        Self { effects, at }
    }

    /// The nominal model with the named effects of a catalogue.
    pub fn named(catalogue: &[&'static dyn Effect], names: &[&str]) -> Self {
        let mut effects = catalogue.to_vec();
        effects.retain(|e| names.contains(&e.name()));
        Self::new(&effects)
    }

    /// Names of the effects.
    pub fn names(&self) -> Vec<&'static str> {
        self.effects.iter().map(|e| e.name()).collect()
    }

    /// Place of the named effect among those of the model.
    pub fn position(&self, name: &str) -> Option<usize> {
        self.effects.iter().position(|e| e.name() == name)
    }

    /// Parameters of effect `i`.
    pub fn of<'p, T>(&self, theta: &'p [T], i: usize) -> &'p [T] {
        &theta[self.place(i)]
    }

    /// Place of the parameters of effect `i`.
    pub fn place(&self, i: usize) -> Range<usize> {
        self.at[i]..self.at[i + 1]
    }

    /// Effects with their parameters.
    pub fn each<'p>(
        &'p self,
        theta: &'p [f64],
    ) -> impl Iterator<Item = (&'static dyn Effect, &'p [f64])> {
        let effects = self.effects.iter().enumerate();
        effects.map(move |(i, e)| (*e, self.of(theta, i)))
    }

    /// Parameters of this model from those of another one: shared effects keep theirs, a new effect takes those of `fresh`.
    pub fn extended(
        &self,
        from: &Self,
        theta: &[f64],
        fresh: impl Fn(&dyn Effect) -> Vec<f64>,
    ) -> Vec<f64> {
        let mut out = theta[..NOMINAL].to_vec();
        for e in &self.effects {
            match from.position(e.name()) {
                Some(i) => out.extend_from_slice(from.of(theta, i)),
                None => out.extend(fresh(*e)),
            }
        }
        out
    }

    /// Events of all effects.
    pub fn all_events(&self) -> impl Iterator<Item = Event> {
        (0..self.effects.len()).flat_map(|i| self.events(i))
    }

    /// Events of effect `i`, which has one group of parameters per event.
    pub fn events(&self, i: usize) -> impl Iterator<Item = Event> + use<> {
        let (e, first) = (self.effects[i], self.at[i]);
        let (events, size) = (e.info().events, e.event_params());
        (0..events).map(move |k| {
            let from = first + k * size;
            Event {
                time: from,
                lasting: (size > 4).then_some(from + 1),
                offsets: std::array::from_fn(|i| from + size - 3 + i),
            }
        })
    }

    /// Periodic modes of effect `i`.
    pub fn modes(&self, i: usize) -> impl Iterator<Item = Mode> + use<> {
        let (modes, end) = (self.effects[i].modes(), self.at[i + 1]);
        (0..modes).map(move |k| {
            let frequency = end - (modes - k) * MODE_PARAMS;
            let offsets = |from: usize| std::array::from_fn(|axis| frequency + from + axis);
            Mode {
                frequency,
                offsets: [offsets(1), offsets(4)],
            }
        })
    }

    /// Which parameters belong to a mode that is absent at θ, and so change nothing.
    pub fn absent(&self, theta: &[f64]) -> Vec<bool> {
        let mut absent = vec![false; theta.len()];
        let modes = (0..self.effects.len()).flat_map(|i| self.modes(i));
        for mode in modes.filter(|m| theta[m.frequency] == 0.0) {
            absent[mode.frequency..mode.frequency + MODE_PARAMS].fill(true);
        }
        absent
    }

    /// Number of parameters at θ without those of absent modes.
    pub fn present(&self, theta: &[f64]) -> usize {
        self.absent(theta).iter().filter(|absent| !**absent).count()
    }

    /// Whether parameter `j` changes only the readings, not the motion.
    pub fn sensing_only(&self, j: usize) -> bool {
        let mut effects = self.effects.iter().enumerate();
        effects.any(|(i, e)| self.place(i).contains(&j) && e.sensing_only())
    }
}
