//! A pressurised lumen squeezes its neighbours; vacuum does not.
//!
//! Cause: the lumens of one extrusion share their walls. Pressure bulges a wall into the neighbours
//! and displaces their air (thick-walled tube: Timoshenko and Goodier, *Theory of Elasticity*, 3rd
//! ed. 1970, §28); under vacuum the profile of the lumen carries the load and its neighbours feel nothing.
//!
//! Law: `w_j += κ [(1 + a) w⁺_(j−1) + (1 − a) w⁺_(j+1)]` over the ring of three, `w⁺` the pressurised
//! part max(w, 0), rounded over 0.2 mm.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `strength` κ | – | 0 ± 0.1 | 0.01-0.3 |
//! | `lopsided` a | – | 0 ± 0.5 | −1-1 |
//!
//! Signature: other channels move when one is pressurised. With a = 0 both neighbours move alike,
//! which differs from a slope change of the one bellow (`asymmetry`) by common-mode length only: the
//! orientation cannot tell the two apart. Also confused with `clocking`, `cable_stiffness` (both
//! signs of pressure alike). Single-channel moves and the common-mode length separate it.

use crate::effects::smooth::positive;
use crate::effects::{Effect, Memory, Moment, Param, Stage, Starts};
use nalgebra::Vector3;

/// Slack over which the wall begins to bulge, mm.
const EDGE_MM: f64 = 0.2;

/// Coupling of pressurised lines into their neighbours.
#[derive(Debug, Clone, Copy, Default)]
pub struct Crosstalk;

impl Effect for Crosstalk {
    fn name(&self) -> &'static str {
        "crosstalk"
    }
    fn stage(&self) -> Stage {
        Stage::Transmission
    }
    fn signature(&self) -> &'static str {
        "other channels move when one is pressurised, not when it is evacuated"
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["asymmetry", "clocking", "cable_stiffness", "gas_compression"]
    }
    fn separated_by(&self) -> &'static str {
        "single-channel moves of both signs; common-mode length"
    }
    fn params(&self) -> Vec<Param> {
        vec![
            Param::new("strength", "", 0.0, 0.1, (-0.45, 0.45)),
            Param::new("lopsided", "", 0.0, 0.5, (-1.0, 1.0)),
        ]
    }
    /// Both signs: with neither strength nor side the slope along the side is nothing.
    fn starts(&self) -> Starts {
        vec![vec![0.06, 0.0], vec![-0.06, 0.0]]
    }
    fn slack(&self, p: &[f64], _m: &mut Memory, _at: &Moment, w_mm: &mut Vector3<f64>) {
        let pressed = w_mm.map(|w| positive(w, EDGE_MM));
        for j in 0..3 {
            w_mm[j] += p[0] * ((1.0 + p[1]) * pressed[(j + 2) % 3] + (1.0 - p[1]) * pressed[(j + 1) % 3]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::proof;

    #[test]
    fn keeps_the_rules() {
        proof::keeps_the_rules(&Crosstalk);
    }

    #[test]
    fn a_fit_finds_it_again() {
        proof::found_again(&Crosstalk, &[-0.15, 0.7]);
    }

    fn moved(p: [f64; 2], w: Vector3<f64>) -> Vector3<f64> {
        proof::drive(&Crosstalk, &p, 0.0, |_| w)[0].w_mm - w
    }

    #[test]
    fn only_pressure_reaches_the_neighbours() {
        let pressed = moved([0.2, 0.0], Vector3::x() * 10.0);
        assert!(pressed.x.abs() < 1e-12 && (pressed.y - 2.0).abs() < 0.05 && (pressed.z - 2.0).abs() < 0.05);
        assert!(moved([0.2, 0.0], -Vector3::x() * 10.0).norm() < 0.05);
    }

    #[test]
    fn a_lopsided_profile_squeezes_one_neighbour() {
        let pressed = moved([0.2, 1.0], Vector3::x() * 10.0);
        assert!((pressed.y - 4.0).abs() < 0.1 && pressed.z.abs() < 1e-12, "{pressed}");
    }
}
