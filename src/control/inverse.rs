//! The inverse of the belief: from a wanted bend to the pistons.
//!
//! Three lines make two bends, so one common length is free. Of the eight patterns of directions in which the pistons can move, the
//! inverse takes the one that is least uncertain: a line that reverses crosses a gap whose width is known to a standard deviation, and
//! the common length is chosen, within a small range, such that no line has to.

use crate::control::ActuatorLimits;
use crate::control::observer::Observer;
use crate::control::observer::laws::{Channels, Theta};
use crate::model::Geometry;
use nalgebra::{Vector2, Vector3};

/// Output below which a channel does not move, rad.
const STILL_RAD: f64 = 2e-4;
/// Least standard deviation of a gap, mm, so that a reversal is never free.
const GAP_SIGMA_MIN_MM: f64 = 0.03;
/// Cost of the common length, rad² of bend per rad² of it.
const LENGTH_COST: f64 = 0.04;

/// Directions of the three pistons.
fn patterns() -> impl Iterator<Item = [f64; 3]> {
    (0..8u32).map(|k| std::array::from_fn(|i| if k >> i & 1 == 1 { 1.0 } else { -1.0 }))
}

/// Outputs of the three channels that make a bend without common length, rad.
pub fn outputs(bend: &Vector2<f64>) -> [f64; 3] {
    std::array::from_fn(|i| -Geometry::spoke(i).dot(bend))
}

/// Bend variance that the reversal of channel `i` adds, rad².
fn reversal(observer: &Observer, i: usize, least_mm: f64) -> f64 {
    let gap_mm = 2.0 * observer.half_width_sigma_mm(i).max(least_mm);
    (2.0 / 3.0 * gap_mm / observer.mm_per_rad(i)).powi(2)
}

/// True if a motion of channel `i` towards `sign` first crosses the gap.
fn reverses(channels: &Channels, i: usize, sign: f64) -> bool {
    sign * -channels.play[i].slope < 0.0
}

/// Least bend variance that a move by `bend` adds, rad².
pub fn risk(observer: &Observer, bend: &Vector2<f64>, free_mm: f64) -> f64 {
    let outputs = outputs(bend);
    let free = free_mm / observer.geometry.r_mm;
    let of = |signs: [f64; 3]| {
        let length = common_length(signs, outputs.map(|q| -q), [-free, free], 1e-12, 0.0)?;
        let reversals = (0..3)
            .filter(|&i| (outputs[i] + length) * signs[i] > 1e-4)
            .filter(|&i| reverses(&observer.now, i, signs[i]))
            .map(|i| reversal(observer, i, 0.0));
        Some(reversals.sum())
    };
    let least = patterns().filter_map(of).min_by(f64::total_cmp);
    least.unwrap_or(0.0)
}

/// The common length within `range` nearest to `wanted` with which every channel moves towards its sign from `least`.
fn common_length(
    signs: [f64; 3],
    least: [f64; 3],
    range: [f64; 2],
    slack: f64,
    wanted: f64,
) -> Option<f64> {
    let [mut low, mut high] = range;
    for i in 0..3 {
        if signs[i] > 0.0 {
            low = low.max(least[i] - slack);
        } else {
            high = high.min(least[i] + slack);
        }
    }
    (low <= high).then(|| wanted.clamp(low, high))
}

/// Outputs of the channels, and the side on which each piston then pushes; 0 for a channel that stays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Outputs, rad.
    pub outputs: [f64; 3],
    /// Sides.
    pub sides: [f64; 3],
    /// Common length, rad of output.
    pub length: f64,
}

/// What the choice starts from.
#[derive(Debug, Clone, Copy)]
pub struct From<'a> {
    /// The belief.
    pub observer: &'a Observer,
    /// Limits of the actuators.
    pub limits: &'a ActuatorLimits,
    /// Channels where the pistons are going.
    pub there: &'a Channels,
    /// Parameters of the laws.
    pub theta: &'a Theta,
    /// Estimated bend, rad.
    pub estimate: &'a Vector2<f64>,
    /// Common length commanded last and, in a motion that chooses anew, none; rad.
    pub keep: Option<f64>,
    /// Common length of the command, rad.
    pub length: f64,
    /// Common length that may be spent beside it, mm either way.
    pub free_mm: f64,
}

/// Chooses common length and sides for the bend `bend`.
pub fn choose(from: &From<'_>, bend: &Vector2<f64>) -> Choice {
    let (observer, theta) = (from.observer, from.theta);
    let wanted = outputs(bend);
    let now = std::array::from_fn::<_, 3, _>(|i| from.there.output(i, from.there.v[i], theta));
    let [low, high] = room(from, &wanted);
    let centre = if low > high {
        (low + high) / 2.0
    } else {
        from.length.clamp(low, high)
    };
    let spare = from.free_mm / observer.geometry.r_mm;
    let range = [
        (centre - spare).max(low.min(centre)),
        (centre + spare).min(high.max(centre)),
    ];
    let needed = std::array::from_fn(|i| now[i] - wanted[i]);
    let settled = |length: f64, signs: [f64; 3]| {
        let outputs = wanted.map(|q| q + length);
        let moves = |i: usize| (outputs[i] - now[i]).abs() > STILL_RAD;
        Choice {
            outputs,
            sides: std::array::from_fn(|i| if moves(i) { signs[i] } else { 0.0 }),
            length,
        }
    };
    let preferred = from.keep.unwrap_or(centre);
    let mut best: Option<(f64, Choice)> = None;
    for signs in patterns() {
        let Some(length) = common_length(signs, needed, range, STILL_RAD, preferred) else {
            continue;
        };
        let choice = settled(length, signs);
        let reversals: f64 = (0..3)
            .filter(|&i| choice.sides[i] != 0.0 && reverses(from.there, i, signs[i]))
            .map(|i| reversal(observer, i, GAP_SIGMA_MIN_MM))
            .sum();
        let cost = reversals + LENGTH_COST * (length - centre).powi(2);
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, choice));
        }
    }
    let straight = || std::array::from_fn(|i| (wanted[i] + centre - now[i]).signum());
    best.map_or_else(|| settled(centre, straight()), |(_, choice)| choice)
}

/// Common lengths with which every piston keeps its travel and every line its pressure, rad; crossed if there is none.
fn room(from: &From<'_>, wanted: &[f64; 3]) -> [f64; 2] {
    let (observer, limits) = (from.observer, from.limits);
    let squeeze_mm = limits.pressure_max_kpa / limits.pressure_kpa_per_mm;
    let shown = outputs(from.estimate);
    let mut room = [f64::NEG_INFINITY, f64::INFINITY];
    for i in 0..3 {
        let (half_width_mm, mm_per_rad) = (observer.lines[i].k_lambda_mm, observer.mm_per_rad(i));
        let bellow_mm = shown[i] * observer.geometry.r_mm;
        let least_mm = (-limits.travel_mm).max(bellow_mm - squeeze_mm) + half_width_mm;
        let most_mm = limits.travel_mm.min(bellow_mm + squeeze_mm) - half_width_mm;
        let output = |piston_mm: f64| from.there.output(i, piston_mm / mm_per_rad, from.theta);
        room[0] = room[0].max(output(least_mm) - wanted[i]);
        room[1] = room[1].min(output(most_mm) - wanted[i]);
    }
    room
}

/// Pistons of a choice, mm; a channel that stays keeps its `aim_mm`.
pub fn pistons(from: &From<'_>, choice: &Choice, aim_mm: &Vector3<f64>) -> Vector3<f64> {
    Vector3::from_fn(|i, _| {
        if choice.sides[i] == 0.0 {
            return aim_mm[i];
        }
        let v = from.observer.now.solve(i, choice.outputs[i], from.theta);
        v * from.observer.mm_per_rad(i) + choice.sides[i] * from.observer.lines[i].k_lambda_mm
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::dynamics::{Dynamics, DynamicsPrior};
    use crate::control::observer::{ObserverConfig, laws::bend_of};
    use crate::model::Line;

    const LIMITS: ActuatorLimits = ActuatorLimits {
        travel_mm: 30.0,
        pressure_kpa_per_mm: 2.0,
        pressure_max_kpa: 41.0,
        bellow_min_mm: 14.0,
        bellow_max_mm: 29.0,
    };

    /// An observer whose pistons have been led to a bend, pushing outward.
    fn bent(bend: &Vector2<f64>) -> (Observer, Vector3<f64>) {
        let lines = [Line {
            k_epsilon: 2.2,
            k_lambda_mm: 0.9,
        }; 3];
        let dynamics = DynamicsPrior::calibrated(Dynamics {
            lag_s: 0.03,
            delay_s: 0.01,
        });
        let config = ObserverConfig::default();
        let mut observer = Observer::new(
            &config,
            &Geometry::default(),
            lines,
            Some([[0.6, 0.25]; 3]),
            &dynamics.range(),
        );
        let q = outputs(bend);
        let at = Vector3::from_fn(|i, _| q[i] * observer.mm_per_rad(i) + 0.9 * q[i].signum());
        (0..100).for_each(|k| observer.follow(&(at * (f64::from(k + 1) / 100.0)), None, 0.01));
        (observer, at)
    }

    fn chosen(observer: &Observer, to: &Vector2<f64>, free_mm: f64) -> Choice {
        let from = From {
            observer,
            limits: &LIMITS,
            there: &observer.now,
            theta: &observer.theta(),
            estimate: &observer.modelled,
            keep: None,
            length: 0.0,
            free_mm,
        };
        choose(&from, to)
    }

    #[test]
    fn a_choice_makes_the_bend_and_its_pistons_are_solved() {
        let (observer, at) = bent(&Vector2::new(0.6, 0.3));
        for to in [
            Vector2::new(0.7, 0.35),
            Vector2::new(0.2, -0.4),
            Vector2::new(-0.8, 0.1),
        ] {
            let choice = chosen(&observer, &to, 0.25);
            assert!((bend_of(&choice.outputs) - to).norm() < 1e-9);
            let from = From {
                observer: &observer,
                limits: &LIMITS,
                there: &observer.now,
                theta: &observer.theta(),
                estimate: &observer.modelled,
                keep: None,
                length: 0.0,
                free_mm: 0.25,
            };
            let (bend, _) = observer.at(&pistons(&from, &choice, &at));
            assert!((bend - to).norm() < 1e-3, "{bend} for {to}");
        }
    }

    /// A small step back needs no reversal of the line that pulls if the others give way.
    #[test]
    fn the_common_length_avoids_reversals() {
        let (observer, _) = bent(&Vector2::new(0.6, 0.3));
        let count = |free_mm: f64| -> usize {
            (0..24)
                .map(|k| {
                    let (sin, cos) = (0.2618 * f64::from(k)).sin_cos();
                    let to = observer.modelled + Vector2::new(cos, sin) * 0.012;
                    let choice = chosen(&observer, &to, free_mm);
                    let turned = |i: &usize| {
                        choice.sides[*i] != 0.0 && reverses(&observer.now, *i, choice.sides[*i])
                    };
                    (0..3).filter(turned).count()
                })
                .sum()
        };
        let (fixed, free) = (count(0.0), count(0.25));
        assert!(free * 2 <= fixed, "{free} of {fixed} reversals");
    }
}
