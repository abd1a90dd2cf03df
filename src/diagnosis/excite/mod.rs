//! Designs a schedule on which the effects lie as far apart as they can.
//!
//! Every effect of the catalogue is run through the model on the schedule; the distance of two is
//! what of the one remains after a recalibration and after the other has imitated what it can
//! ([`distance`]). A seeded local search over manoeuvres ([`manoeuvre`]) raises the small distances,
//! within bellow, travel, speed and five minutes. Optimal design for model discrimination: Atkinson
//! and Fedorov, *Biometrika* 1975 (T-optimality); local search after Kirkpatrick, Gelatt and Vecchi,
//! *Science* 1983.

pub mod distance;
pub mod manoeuvre;
pub mod points;
pub mod rows;
pub mod standard;
pub mod synthetic;

use crate::diagnosis::excite::distance::{Distances, information};
use crate::diagnosis::excite::manoeuvre::{Manoeuvre, first_guess, schedule};
use crate::diagnosis::excite::points::Rival;
use crate::diagnosis::excite::rows::{Rig, Row};
use crate::diagnosis::saved::SavedModel;
use crate::model::effects::catalogue;
use crate::model::transmission::Line;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Longest schedule, s.
pub const LONGEST_S: f64 = 285.0;
/// Size that every effect is given on the standard schedule, standard deviations.
const SIZE: f64 = 30.0;
/// A distance from here on is as good as any: of all pairs, and of a few that are in question.
const ENOUGH: [f64; 2] = [15.0, 150.0];
/// A pair nearer than this, on the schedule designed, is not separated by it.
pub const APART: f64 = 3.0;

/// Pairs that no motion separates. A tip IMU alone sees the sum of both delays; bellows off their
/// places bend the tip by a constant matrix, and so does anisotropic stiffness. Turned about the axis,
/// a sensor looks like bellows all turned alike, but that is one point of two effects, not the pair.
const TWINS: [[&str; 2]; 2] = [["transport_delay", "sensor_latency"], ["clocking", "cable_stiffness"]];

/// Whether motion can separate two effects at all.
#[must_use]
pub fn separable(a: &str, b: &str, tracker: bool) -> bool {
    !TWINS.iter().enumerate().any(|(n, t)| t.contains(&a) && t.contains(&b) && a != b && !(n == 0 && tracker))
}

/// What is to be designed.
#[derive(Debug, Clone)]
pub struct Wanted {
    /// Gains of the machine.
    pub lines: [Line; 3],
    /// A diagnosis whose effects are to be told apart first.
    pub like: Option<SavedModel>,
    /// The schedule will be recorded with a tracker.
    pub tracker: bool,
    /// Seed of the search.
    pub seed: u64,
    /// Schedules tried at most.
    pub rounds: usize,
}

/// A schedule and what it is worth.
#[derive(Debug, Clone)]
pub struct Designed {
    /// The rows.
    pub rows: Vec<Row>,
    /// Names of the effects, in the order of the distances.
    pub names: Vec<&'static str>,
    /// Names that matter most: the effects of `like` and what they are taken for; all if there is none.
    pub focus: Vec<&'static str>,
    /// Distances on the schedule designed.
    pub distances: Distances,
    /// Distances on the standard schedule.
    pub standard: Distances,
    /// Schedules tried.
    pub tried: usize,
}

impl Designed {
    /// Pairs in question, nearest first: names, distance here, distance on the standard schedule.
    #[must_use]
    pub fn pairs(&self) -> Vec<(&'static str, &'static str, f64, f64)> {
        let at = |name: &str| self.names.iter().position(|n| *n == name);
        let focus: Vec<usize> = self.focus.iter().filter_map(|n| at(n)).collect();
        let mut out = Vec::new();
        for (a, &i) in focus.iter().enumerate() {
            for &j in &focus[a + 1..] {
                out.push((self.names[i], self.names[j], self.distances.of[(i, j)], self.standard.of[(i, j)]));
            }
        }
        out.sort_by(|a, b| a.2.total_cmp(&b.2));
        out
    }
}

/// Weight of a pair outside the focus, and of one with one foot in it.
const OUTSIDE: [f64; 2] = [0.02, 0.1];

/// Designs; `go_on` is told how many schedules were tried, and may end the search by `false`.
#[must_use]
pub fn design(wanted: &Wanted, go_on: &mut dyn FnMut(usize) -> bool) -> Designed {
    let mut rng = StdRng::seed_from_u64(wanted.seed);
    let rig = Rig::new(wanted.lines);
    let rivals = rivals(wanted.like.as_ref(), &mut rng);
    let names: Vec<&'static str> = rivals.iter().map(|r| r.effect.name()).collect();
    let focus = focus(wanted.like.as_ref(), &names);
    let look = |rows: &[Row]| information(&rig, rows, &rivals, wanted.tracker, wanted.seed);
    let standard_rows = standard::rows(&rig);
    let plain = look(&standard_rows);
    let sizes = plain.as_ref().map(|i| i.sizes()).unwrap_or_default();
    let scale: Vec<Vec<f64>> = sizes.iter().map(|s| s.iter().map(|x| (SIZE / x.max(1e-9)).min(5.0)).collect()).collect();
    let judge = |rows: &[Row]| look(rows).map(|i| i.distances(&scale));
    let mut search = Climb {
        rig,
        judge: &judge,
        best: first_guess(),
        cost: f64::INFINITY,
        distances: None,
        enough: ENOUGH[usize::from(focus.len() < names.len())],
        weight: weights(&names, &focus, wanted.tracker),
    };
    (search.cost, search.distances) = search.judge_cost(&first_guess());
    let mut tried = 1;
    while tried < wanted.rounds && go_on(tried) {
        search.step(&mut rng);
        tried += 1;
    }
    let rows = schedule(&rig, &search.best);
    let empty = || Distances { of: nalgebra::DMatrix::zeros(names.len(), names.len()), duration_s: rig.duration_s(&rows) };
    let distances = search.distances.clone().unwrap_or_else(empty);
    let standard = plain.map_or_else(empty, |i| i.distances(&scale));
    Designed { names: names.clone(), focus, distances, standard, rows, tried }
}

fn rivals(like: Option<&SavedModel>, rng: &mut StdRng) -> Vec<Rival> {
    catalogue()
        .into_iter()
        .map(|e| {
            let name = e.name();
            let drawn = Rival::drawn(e, rng);
            let saved = like.and_then(|m| crate::model::effects::by_name(name).and_then(|e| Rival::saved(e, m)));
            saved.unwrap_or(drawn)
        })
        .collect()
}

fn focus(like: Option<&SavedModel>, names: &[&'static str]) -> Vec<&'static str> {
    let Some(model) = like.filter(|m| !m.in_question().is_empty()) else { return names.to_vec() };
    let asked = model.in_question();
    names.iter().copied().filter(|n| asked.iter().any(|a| a == n)).collect()
}

fn weights(names: &[&str], focus: &[&str], tracker: bool) -> nalgebra::DMatrix<f64> {
    let inside = |i: usize| focus.contains(&names[i]);
    nalgebra::DMatrix::from_fn(names.len(), names.len(), |i, j| match (inside(i), inside(j)) {
        _ if !separable(names[i], names[j], tracker) => 0.0,
        (true, true) => 1.0,
        (false, false) => OUTSIDE[0],
        _ => OUTSIDE[1],
    })
}

/// The search: a list of manoeuvres and what it costs.
struct Climb<'a> {
    rig: Rig,
    judge: &'a dyn Fn(&[Row]) -> Option<Distances>,
    best: Vec<Manoeuvre>,
    cost: f64,
    distances: Option<Distances>,
    weight: nalgebra::DMatrix<f64>,
    enough: f64,
}

impl Climb<'_> {
    /// `Σ w / (1 + min(D, enough)²)`: dominated by the nearest pairs, indifferent to the far ones.
    fn judge_cost(&self, list: &[Manoeuvre]) -> (f64, Option<Distances>) {
        let rows = schedule(&self.rig, list);
        if self.rig.duration_s(&rows) > LONGEST_S {
            return (f64::INFINITY, None);
        }
        let Some(d) = (self.judge)(&rows) else { return (f64::INFINITY, None) };
        let n = d.of.nrows();
        let mut cost = 0.0;
        for i in 0..n {
            for j in 0..=i {
                cost += self.weight[(i, j)] / (1.0 + d.of[(i, j)].min(self.enough).powi(2));
            }
        }
        (cost, Some(d))
    }

    /// Tries a neighbour that is not too long, and keeps it if it is better.
    fn step(&mut self, rng: &mut StdRng) {
        let near = (0..50).map(|_| neighbour(&self.best, rng)).find(|l| self.rig.duration_s(&schedule(&self.rig, l)) <= LONGEST_S);
        let Some(list) = near else { return };
        let (cost, distances) = self.judge_cost(&list);
        if cost < self.cost {
            (self.best, self.cost, self.distances) = (list, cost, distances);
        }
    }
}

/// A list with one manoeuvre changed, exchanged, added, taken out, or moved.
fn neighbour(list: &[Manoeuvre], rng: &mut StdRng) -> Vec<Manoeuvre> {
    let mut out = list.to_vec();
    let at = rng.random_range(0..out.len());
    match rng.random_range(0..10) {
        0..=4 => out[at] = out[at].varied(rng),
        5 | 6 => out[at] = Manoeuvre::any(rng),
        7 => out.insert(at, Manoeuvre::any(rng)),
        8 if out.len() > 4 => {
            out.remove(at);
            out[at % (list.len() - 1)] = Manoeuvre::any(rng);
        }
        _ => {
            let m = out.remove(at);
            out.insert(rng.random_range(0..=out.len()), m);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: [Line; 3] = [
        Line { k_epsilon: 2.22, k_lambda_mm: 0.87 },
        Line { k_epsilon: 2.53, k_lambda_mm: 0.92 },
        Line { k_epsilon: 2.21, k_lambda_mm: 0.81 },
    ];

    fn wanted(rounds: usize) -> Wanted {
        Wanted { lines: PAPER, like: None, tracker: false, seed: 1, rounds }
    }

    #[test]
    fn effects_lie_further_apart_per_second_than_on_the_standard_schedule() {
        let d = design(&wanted(6), &mut |_| true);
        let nearest = |of: &Distances| {
            let pairs = (0..d.names.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
            let separable = pairs.filter(|&(i, j)| separable(d.names[i], d.names[j], false));
            separable.map(|p| of.of[p]).fold(f64::INFINITY, f64::min) / of.duration_s.sqrt()
        };
        let (here, there) = (nearest(&d.distances), nearest(&d.standard));
        println!("nearest pair per root second: {here:.3} designed, {there:.3} standard");
        assert!(here > there && d.distances.duration_s <= LONGEST_S);
    }

    #[test]
    fn the_same_seed_gives_the_same_schedule() {
        assert_eq!(design(&wanted(3), &mut |_| true).rows, design(&wanted(3), &mut |_| true).rows);
        assert_eq!(design(&wanted(50), &mut |n| n < 2).tried, 2);
    }
}
