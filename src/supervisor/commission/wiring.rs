//! Identifies the wiring from the bends that the three channels cause.
//!
//! Channel i alone bends the tip by a vector aᵢ when it elongates; with the wiring of the board file the kinematics
//! predict eᵢ. A hypothesis consists of a permutation p (the bellow that line i reaches), signs s (the direction of each
//! motor) and an angle φ (the rotation of the sensor about the tip axis): aᵢ ∥ sᵢ Rot(φ) e_{p(i)}. All 48 hypotheses are
//! fitted with their best φ. Several may fit equally well, for example all lines moved by one place and a sensor turned
//! by 120°; then the one with the fewest changes wins, and the others are reported too.

use nalgebra::{Rotation2, Vector2};
use std::fmt::Write;

/// A wiring hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wiring {
    /// Bellow, from 0, that the line of each channel reaches.
    pub reaches: [usize; 3],
    /// Motors that turn in the wrong direction.
    pub inverted: [bool; 3],
    /// Rotation of the sensor about the tip axis relative to the board file, rad.
    pub turned_rad: f64,
    /// RMS angle between the hypothesis and the measured bends, rad.
    pub residual_rad: f64,
}

/// Rotation of the sensor below which calibration suffices, rad (20°).
pub const TURN_SMALL_RAD: f64 = 0.35;
/// Residuals that exceed the best by less fit equally well, rad (7°).
const ALIKE_RAD: f64 = 0.12;
/// Residual above which no hypothesis fits, rad (20°).
const RESIDUAL_MAX_RAD: f64 = 0.35;

const ORDERS: [[usize; 3]; 6] = [
    [0, 1, 2],
    [1, 0, 2],
    [0, 2, 1],
    [2, 1, 0],
    [1, 2, 0],
    [2, 0, 1],
];

impl Wiring {
    /// True if nothing needs to be changed.
    pub fn is_right(&self) -> bool {
        self.reaches == [0, 1, 2]
            && self.inverted == [false; 3]
            && self.turned_rad.abs() < TURN_SMALL_RAD
    }

    /// Number of changes, weighted.
    fn cost(&self) -> f64 {
        let moved = (0..3).filter(|&i| self.reaches[i] != i).count() as f64;
        let inverted = self.inverted.iter().filter(|x| **x).count() as f64;
        let small = self.turned_rad.abs() < TURN_SMALL_RAD;
        let turned = if small { 0.0 } else { 1.5 };
        moved + inverted + turned + 0.1 * self.turned_rad.abs()
    }

    /// Differences to the board file as text; empty if there are none.
    pub fn differences(&self) -> String {
        let mut text = String::new();
        for i in (0..3).filter(|&i| self.reaches[i] != i) {
            let bellow = self.reaches[i] + 1;
            let _ = write!(text, "line {} reaches bellow {bellow}; ", i + 1);
        }
        for i in (0..3).filter(|i| self.inverted[*i]) {
            let _ = write!(text, "motor {} turns in the wrong direction; ", i + 1);
        }
        if self.turned_rad.abs() >= TURN_SMALL_RAD {
            let deg = self.turned_rad.to_degrees();
            let _ = write!(text, "the sensor is turned by {deg:.0}° about the tip axis");
        }
        text.trim_end_matches("; ").to_owned()
    }
}

/// A bend of the tip for each channel, rad.
type Bends = [Vector2<f64>; 3];

/// The simplest wiring that explains the responses, then others that fit equally well; none if none fits.
pub fn identify(answers: &Bends, expected: &Bends) -> Vec<Wiring> {
    let mut all = Vec::new();
    for reaches in ORDERS {
        let inverted = (0..8).map(|bits| [0, 1, 2].map(|i| bits >> i & 1 == 1));
        all.extend(inverted.map(|inverted| fit(answers, expected, reaches, inverted)));
    }
    let best = all.iter().map(|w| w.residual_rad).fold(f64::MAX, f64::min);
    if best.is_nan() || best > RESIDUAL_MAX_RAD {
        return Vec::new();
    }
    all.retain(|w| w.residual_rad <= best + ALIKE_RAD);
    all.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    let most = all[0].cost() + 1.6;
    all.retain(|w| w.cost() <= most);
    all.truncate(4);
    all
}

fn fit(answers: &Bends, expected: &Bends, reaches: [usize; 3], inverted: [bool; 3]) -> Wiring {
    let pairs = [0, 1, 2].map(|i| {
        let e = expected[reaches[i]].normalize();
        (answers[i].normalize(), if inverted[i] { -e } else { e })
    });
    // the angle that best rotates the expected directions onto the measured ones
    let (dot, cross) = pairs
        .iter()
        .fold((0.0, 0.0), |(d, c), (a, e)| (d + e.dot(a), c + e.perp(a)));
    let turned_rad = cross.atan2(dot);
    let turn = Rotation2::new(turned_rad);
    let squares = pairs.iter().map(|(a, e)| (turn * e).angle(a).powi(2));
    let residual_rad = (squares.sum::<f64>() / 3.0).sqrt();
    Wiring {
        reaches,
        inverted,
        turned_rad,
        residual_rad,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn expected() -> [Vector2<f64>; 3] {
        [0, 1, 2].map(|i| {
            Rotation2::new(-f64::from(i) * std::f64::consts::TAU / 3.0) * Vector2::new(-0.1, 0.0)
        })
    }

    fn answers(w: &Wiring) -> [Vector2<f64>; 3] {
        [0, 1, 2].map(|i| {
            Rotation2::new(w.turned_rad)
                * expected()[w.reaches[i]]
                * if w.inverted[i] { -1.0 } else { 1.0 }
        })
    }

    proptest! {
        /// The result explains the responses with no more changes than were made.
        #[test]
        fn the_simplest_wiring_is_found(order in 0..6usize, bits in 0..8u8, turned_rad in -3.1..3.1f64, noise in prop::array::uniform3(-0.15..0.15f64)) {
            let truth = Wiring { reaches: ORDERS[order], inverted: [0, 1, 2].map(|i| bits >> i & 1 == 1), turned_rad, residual_rad: 0.0 };
            let mut observed = answers(&truth);
            for (a, n) in observed.iter_mut().zip(noise) {
                *a = Rotation2::new(n) * *a;
            }
            let all = identify(&observed, &expected());
            let (found, others) = all.split_first().unwrap();
            // the noise rotates the result by up to its own size, possibly across the bound of a small rotation
            let near_bound = (turned_rad.abs() - TURN_SMALL_RAD).abs() < 0.15;
            let bound = truth.cost() + 0.05 + if near_bound { 1.5 } else { 0.0 };
            prop_assert!(found.cost() <= bound, "{found:?} for {truth:?}");
            let again = answers(found);
            for i in 0..3 {
                prop_assert!(again[i].angle(&observed[i]) < 0.5);
            }
            prop_assert!(others.iter().all(|o| o.cost() >= found.cost()));
        }
    }

    #[test]
    fn single_errors_are_identified_and_ambiguity_is_reported() {
        let right = Wiring {
            reaches: [0, 1, 2],
            inverted: [false; 3],
            turned_rad: 0.0,
            residual_rad: 0.0,
        };
        let all = identify(&answers(&right), &expected());
        assert!(
            all.len() == 1 && all[0].is_right() && all[0].differences().is_empty(),
            "{all:?}"
        );
        let swapped = Wiring {
            reaches: [1, 0, 2],
            ..right
        };
        let simplest = |of: &Wiring| identify(&answers(of), &expected())[0].differences();
        assert_eq!(
            simplest(&swapped),
            "line 1 reaches bellow 2; line 2 reaches bellow 1"
        );
        let inverted = Wiring {
            inverted: [false, true, false],
            ..right
        };
        assert_eq!(simplest(&inverted), "motor 2 turns in the wrong direction");
        let turned = Wiring {
            turned_rad: 0.9,
            ..right
        };
        let found = simplest(&turned);
        assert!(found.contains("turned by 52°"), "{found}");
        // lines moved by one place and a sensor turned by 120° are indistinguishable
        let cycled = Wiring {
            reaches: [1, 2, 0],
            ..right
        };
        let all = identify(&answers(&cycled), &expected());
        let all: Vec<String> = all.iter().map(Wiring::differences).collect();
        assert!(
            all.iter().any(|t| t.contains("line 1 reaches bellow 2"))
                && all.iter().any(|t| t.contains("turned by")),
            "{all:?}"
        );
    }

    #[test]
    fn responses_without_a_fitting_wiring_are_not_explained() {
        let same = [Vector2::new(0.1, 0.0); 3];
        let found = identify(&same, &expected());
        assert!((found.first()).is_none_or(|w| w.residual_rad < RESIDUAL_MAX_RAD));
    }
}
