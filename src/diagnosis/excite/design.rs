//! Seeded search for the schedule that separates effects best.
//!
//! Every effect of the catalogue is run through the model on the schedule; the distance of two effects is what remains
//! of one after a recalibration and after imitation by the other ([`crate::diagnosis::excite::distance`]). A local search
//! over manoeuvres increases the small distances within the limits of bellows, travel, speed and duration. Optimal design
//! for model discrimination: Atkinson and Fedorov, *Biometrika* 1975 (T-optimality); local search after Kirkpatrick,
//! Gelatt and Vecchi, *Science* 1983. Equal requests give equal schedules.

use crate::diagnosis::excite::{
    Machine, Manoeuvre, Rival, ScheduleRow, first_guess, information, schedule, standard,
};
use crate::diagnosis::tip::{SavedModel, separable};
use crate::model::effects::catalogue;
use nalgebra::DMatrix;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Longest schedule, s.
pub const LONGEST_S: f64 = 285.0;
/// Size given to every effect on the standard schedule, standard deviations.
const SIZE: f64 = 30.0;
/// Largest factor by which an effect is enlarged to that size.
const ENLARGED_MAX: f64 = 5.0;
/// Distance beyond which a pair gains nothing: in a search over all pairs, and over the pairs in question.
const ENOUGH: [f64; 2] = [15.0, 150.0];
/// Distance below which a schedule does not separate a pair.
pub const APART: f64 = 3.0;
/// Weight of a pair with no effect in question, and of one with one effect in question.
const OUTSIDE: [f64; 2] = [0.02, 0.1];
/// Neighbours drawn until one is short enough.
const ATTEMPTS: usize = 50;

/// A request for a schedule.
#[derive(Debug, Clone)]
pub struct Request {
    /// The machine.
    pub machine: Machine,
    /// A saved diagnosis whose effects are separated first.
    pub like: Option<SavedModel>,
    /// Whether a tracker will record the schedule.
    pub tracker: bool,
    /// Seed of the search.
    pub seed: u64,
    /// Schedules to evaluate, at least 1.
    pub rounds: usize,
}

/// A designed schedule.
#[derive(Debug, Clone)]
pub struct Design {
    /// Rows.
    pub rows: Vec<ScheduleRow>,
    /// Names of the effects, in the order of the distances.
    pub names: Vec<&'static str>,
    /// Names in question: the effects of the saved diagnosis and those confusable with them, or all.
    pub focus: Vec<&'static str>,
    /// Length of the schedule, s.
    pub duration_s: f64,
    /// Distances between effects on the designed schedule, standard deviations.
    pub distances: DMatrix<f64>,
    /// The same on the standard schedule.
    pub standard: DMatrix<f64>,
}

/// Two effects with their distances, standard deviations.
#[derive(Debug, Clone, Copy)]
pub struct Pair {
    /// Names.
    pub names: [&'static str; 2],
    /// On the designed schedule.
    pub designed: f64,
    /// On the standard schedule.
    pub standard: f64,
}

impl Design {
    /// Pairs in question, nearest first.
    pub fn pairs(&self) -> Vec<Pair> {
        let place = |n: &&str| self.names.iter().position(|name| name == n);
        let focus: Vec<usize> = self.focus.iter().filter_map(place).collect();
        let pair = |(i, j): (usize, usize)| Pair {
            names: [self.names[i], self.names[j]],
            designed: self.distances[(i, j)],
            standard: self.standard[(i, j)],
        };
        let pairs = (0..focus.len()).flat_map(|a| focus[a + 1..].iter().map(move |&j| (a, j)));
        let mut out: Vec<Pair> = pairs.map(|(a, j)| pair((focus[a], j))).collect();
        out.sort_by(|a, b| a.designed.total_cmp(&b.designed));
        out
    }
}

/// Designs a schedule; `progress` receives the number of schedules evaluated.
pub fn design(request: &Request, progress: &mut dyn FnMut(usize)) -> Design {
    let mut rng = StdRng::seed_from_u64(request.seed);
    let (machine, like) = (&request.machine, request.like.as_ref());
    let effects = catalogue().iter();
    let rivals: Vec<Rival> = effects.map(|e| Rival::new(*e, like, &mut rng)).collect();
    let names: Vec<&'static str> = rivals.iter().map(|r| r.effect.name()).collect();
    let focus = focus(like, &names);
    let (tracker, seed) = (request.tracker, request.seed);
    let evaluate = |rows: &[ScheduleRow]| information(machine, rows, &rivals, tracker, seed);
    let standard = evaluate(&standard::rows(machine));
    let sizes = standard.as_ref().map(|i| i.sizes()).unwrap_or_default();
    let enlarged = |x: &f64| (SIZE / x.max(1e-9)).min(ENLARGED_MAX);
    let scale = sizes.iter().map(|s| s.iter().map(enlarged).collect());
    let scale: Vec<Vec<f64>> = scale.collect();
    let distances = |rows: &[ScheduleRow]| evaluate(rows).map(|i| i.distances(&scale));
    let weight = weights(&names, &focus, tracker);
    let enough = ENOUGH[usize::from(focus.len() < names.len())];
    let evaluated = |list: Vec<Manoeuvre>| {
        let short = is_short(machine, &list).then(|| schedule(machine, &list));
        let distances = short.and_then(|rows| distances(&rows));
        let cost = distances.as_ref().map(|d| cost(d, &weight, enough));
        Evaluated {
            list,
            cost: cost.unwrap_or(f64::INFINITY),
            distances,
        }
    };
    let mut best = evaluated(first_guess(machine.rig.geometry.rest_length_mm));
    progress(1);
    for tried in 2..=request.rounds {
        let mut near = (0..ATTEMPTS).map(|_| neighbour(&best.list, machine, &mut rng));
        let next = near.find(|list| is_short(machine, list)).map(evaluated);
        if let Some(better) = next.filter(|next| next.cost < best.cost) {
            best = better;
        }
        progress(tried);
    }
    let rows = schedule(machine, &best.list);
    let empty = || DMatrix::zeros(names.len(), names.len());
    let distances = best.distances.unwrap_or_else(empty);
    let standard = standard.map_or_else(empty, |i| i.distances(&scale));
    Design {
        names,
        focus,
        distances,
        standard,
        duration_s: machine.duration_s(&rows),
        rows,
    }
}

fn focus(like: Option<&SavedModel>, names: &[&'static str]) -> Vec<&'static str> {
    let asked = like.map(SavedModel::in_question).unwrap_or_default();
    let mut names = names.to_vec();
    names.retain(|n| asked.is_empty() || asked.iter().any(|a| a == n));
    names
}

fn weights(names: &[&str], focus: &[&str], tracker: bool) -> DMatrix<f64> {
    let inside = |i: usize| focus.contains(&names[i]);
    DMatrix::from_fn(names.len(), names.len(), |i, j| {
        match (inside(i), inside(j)) {
            _ if !separable(names[i], names[j], tracker) => 0.0,
            (true, true) => 1.0,
            (false, false) => OUTSIDE[0],
            _ => OUTSIDE[1],
        }
    })
}

/// A list of manoeuvres with its [`cost`], infinite if the schedule is too long or cannot be diagnosed.
struct Evaluated {
    list: Vec<Manoeuvre>,
    cost: f64,
    distances: Option<DMatrix<f64>>,
}

/// `Σ w / (1 + min(D, enough)²)`, dominated by the nearest pairs.
fn cost(distances: &DMatrix<f64>, weight: &DMatrix<f64>, enough: f64) -> f64 {
    let mut cost = 0.0;
    for i in 0..distances.nrows() {
        for j in 0..=i {
            cost += weight[(i, j)] / (1.0 + distances[(i, j)].min(enough).powi(2));
        }
    }
    cost
}

fn is_short(machine: &Machine, list: &[Manoeuvre]) -> bool {
    machine.duration_s(&schedule(machine, list)) <= LONGEST_S
}

/// A list with one manoeuvre changed, replaced, added, removed or moved.
fn neighbour(list: &[Manoeuvre], machine: &Machine, rng: &mut StdRng) -> Vec<Manoeuvre> {
    let mut out = list.to_vec();
    let at = rng.random_range(0..out.len());
    match rng.random_range(0..10) {
        0..=4 => out[at] = out[at].varied(machine, rng),
        5 | 6 => out[at] = Manoeuvre::any(machine, rng),
        7 => out.insert(at, Manoeuvre::any(machine, rng)),
        8 if out.len() > 4 => {
            out.remove(at);
            out[at % (list.len() - 1)] = Manoeuvre::any(machine, rng);
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
    use crate::diagnosis::tip::Rig;
    use crate::model::transmission::Line;

    const PAPER: [Line; 3] = [
        Line {
            k_epsilon: 2.22,
            k_lambda_mm: 0.87,
        },
        Line {
            k_epsilon: 2.53,
            k_lambda_mm: 0.92,
        },
        Line {
            k_epsilon: 2.21,
            k_lambda_mm: 0.81,
        },
    ];

    fn request(rounds: usize) -> Request {
        Request {
            machine: Machine::new(Rig::default(), PAPER),
            like: None,
            tracker: false,
            seed: 1,
            rounds,
        }
    }

    #[test]
    fn effects_lie_further_apart_per_second_than_on_the_standard_schedule() {
        let d = design(&request(6), &mut |_| ());
        let machine = request(6).machine;
        let standard_s = machine.duration_s(&standard::rows(&machine));
        let nearest = |of: &DMatrix<f64>, duration_s: f64| {
            let pairs = (0..d.names.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
            let separable = pairs.filter(|&(i, j)| separable(d.names[i], d.names[j], false));
            separable.map(|p| of[p]).fold(f64::INFINITY, f64::min) / duration_s.sqrt()
        };
        let (here, there) = (
            nearest(&d.distances, d.duration_s),
            nearest(&d.standard, standard_s),
        );
        println!("nearest pair per root second: {here:.3} designed, {there:.3} standard");
        assert!(here > there && d.duration_s <= LONGEST_S);
    }

    #[test]
    fn equal_requests_give_equal_schedules() {
        let mut evaluated = Vec::new();
        let first = design(&request(3), &mut |n| evaluated.push(n));
        assert_eq!(first.rows, design(&request(3), &mut |_| ()).rows);
        assert_eq!(evaluated, [1, 2, 3], "the budget is a number of schedules");
    }

    #[test]
    fn a_smaller_machine_gets_a_schedule_within_its_limits() {
        let mut small = request(2);
        let rig = Rig {
            travel_mm: 20.0,
            speed_max_mm_s: 15.0,
            bellow_mm: [16.0, 26.0],
            ..Rig::default()
        };
        small.machine = Machine::new(rig, PAPER);
        let d = design(&small, &mut |_| ());
        assert!(d.rows.iter().all(|r| small.machine.reaches(r)));
    }
}
