//! A pressurised lumen squeezes its neighbours; vacuum does not.
//!
//! Cause: the lumens of one extrusion share their walls. Pressure bulges a wall into the neighbours
//! and displaces their air (thick-walled tube: Timoshenko and Goodier, *Theory of Elasticity*, 3rd
//! ed. 1970, §28); under vacuum the profile of the lumen carries the load and its neighbours are not displaced.
//!
//! Law: `w_j += Σ_i c_ij w⁺_i`, i ≠ j: six couplings, since no extrusion is symmetric, with `w⁺` the
//! pressurised part max(w, 0), rounded over 0.2 mm.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `c12`…`c32` c_ij, from line i into line j | – | 0 ± 0.1 | 0.01-0.3 |
//!
//! Signature: other channels move when one is pressurised. Where both neighbours move alike, it differs from a slope change of the one bellow (`asymmetry`) by common-mode length only: the
//! orientation cannot tell the two apart. Also similar to `clocking`, `cable_stiffness` (both
//! signs of pressure alike). Single-channel moves and the common-mode length separate it.

use crate::model::effects::prelude::*;

/// Play output over which the wall begins to bulge, mm.
const EDGE_MM: f64 = 0.2;

/// Couplings in the order of the parameters: from which line into which, counted from 0.
const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)];

/// Coupling of pressurised lines into their neighbours.
pub struct Crosstalk;

impl Effect for Crosstalk {
    info! {
        name: "crosstalk",
        stage: Stage::Transmission,
        signature: "other channels move when one is pressurised, not when it is evacuated",
        confused_with: &[
            "asymmetry",
            "clocking",
            "cable_stiffness",
            "gas_compression",
        ],
        separated_by: "single-channel moves of both signs; common-mode length",
        params: &Param::new("", "", 0.0, 0.1, (-0.2, 0.6))
            .named(["c12", "c13", "c21", "c23", "c31", "c32"]),
        starts: &[&[0.05; PAIRS.len()]],
    }
    fn play_output(&self, p: &[f64], _m: &mut Memory, _at: &Moment, w_mm: &mut Vector3<f64>) {
        let pressed = w_mm.map(|w| positive(w, EDGE_MM));
        for ((from, to), c) in PAIRS.iter().zip(p) {
            w_mm[*to] += c * pressed[*from];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Crosstalk);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::fitted(&Crosstalk, &[0.1, 0.15, 0.05, 0.2, 0.08, 0.12]);
    }

    fn moved(set: &[(&str, f64)], w: Vector3<f64>) -> Vector3<f64> {
        let p = proof::with(&Crosstalk, set);
        proof::drive(&Crosstalk, &p, 0.0, |_| w)[0].w_mm - w
    }

    #[test]
    fn only_pressure_reaches_the_neighbours() {
        let both = [("c12", 0.2), ("c13", 0.1)];
        let pressed = moved(&both, Vector3::x() * 10.0);
        assert!(
            pressed.x.abs() < 1e-12
                && (pressed.y - 2.0).abs() < 0.05
                && (pressed.z - 1.0).abs() < 0.05
        );
        assert!(moved(&both, -Vector3::x() * 10.0).norm() < 0.05);
        assert!(
            moved(&both, Vector3::y() * 10.0).norm() < 0.05,
            "the second line has no coupling"
        );
    }
}
