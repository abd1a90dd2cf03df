//! Rate-independent memory of the rubber beyond plain backlash.
//!
//! Cause: internal friction of the wall and of the folds. Law: Prandtl-Ishlinskii, a weighted sum of
//! play operators (Krasnosel'skii and Pokrovskii, *Systems with Hysteresis*, 1989; Kuhnen, *Eur. J.
//! Control* 2003),
//! `q′ = (q + Σ_k ω_k F_rk[q]) / (1 + Σ_k ω_k)`, with F_r the play of half-width r and six radii
//! 0.15-4 mm of bellow length. The division preserves the gain of large moves, which leaves the loops:
//! `q′ = q − c_i (1 + s x + v (x² − ½)) Σ ω_k (q − F_rk[q]) / (1 + Σ ω_k)`, `x = q/√(q² + L²)`, L = 3 mm: loops
//! may be wider where the bellow is long (s > 0) or in the middle of its range (v < 0), as those of a
//! Preisach plane are, and the bellows differ (c₁ = 1).
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `small` ω of r = 0.15, 0.4 mm | – | 0 ± 0.15 | 0-0.5 |
//! | `middle` ω of r = 0.8, 1.4 mm | – | 0 ± 0.15 | 0-0.5 |
//! | `large` ω of r = 2.4, 4.0 mm | – | 0 ± 0.15 | 0-0.5 |
//! | `skew` s | – | 0 ± 0.2 | 0-0.3 |
//! | `waist` v | – | 0 ± 0.2 | 0-0.3 |
//! | `excess` c_i − 1 of channels 2, 3 | – | 0 ± 0.2 | 0-0.3 |
//!
//! Signature: loops that do not depend on speed, minor loops inside them, and wiping-out of return points.
//! Similar to a wrong k_λ (one radius only), `creep` and `line_lag` (both depend on
//! speed). Nested loops, slow and fast, separate it.

use crate::model::effects::prelude::*;

/// Half-widths of the plays, mm of bellow length; two share a weight.
const RADII_MM: [f64; 6] = [0.15, 0.4, 0.8, 1.4, 2.4, 4.0];

/// Length change over which the two sides of a loop differ, mm.
const SIDE_MM: f64 = 3.0;

/// Width of a channel's loops beyond that of the first.
const EXCESS: Param = Param::new("excess", "", 0.0, 0.2, (-0.9, 1.5));

/// Loops of the wall, similar for each bellow.
pub struct Hysteresis;

impl Effect for Hysteresis {
    info! {
        name: "hysteresis",
        stage: Stage::Bellows,
        signature: "loops that do not depend on speed, with minor loops and return points that are wiped out",
        confused_with: &["creep", "line_lag", "gear_periodic"],
        separated_by: "nested loops, slow and fast",
        params: &join::<7>(&[
            &Param::new("", "", 0.0, 0.15, (0.0, 1.5)).named(["small", "middle", "large"]),
            &[
                Param::new("skew", "", 0.0, 0.2, (-0.7, 0.7)),
                Param::new("waist", "", 0.0, 0.2, (-0.9, 0.9)),
            ],
            &[EXCESS.on(2), EXCESS.on(3)],
        ]),
        starts: &[&[0.05, 0.05, 0.05, 0.0, 0.0, 0.0, 0.0]],
    }
    /// Memory holds the six plays of each bellow.
    fn bellows(&self, p: &[f64], m: &mut Memory, _at: &Moment, q_mm: &mut Vector3<f64>) {
        let whole = 1.0 + 2.0 * (p[0] + p[1] + p[2]);
        for (i, plays) in m.0.chunks_exact_mut(RADII_MM.len()).take(3).enumerate() {
            let q = q_mm[i];
            let mut withheld = 0.0;
            for (k, (play, r)) in plays.iter_mut().zip(RADII_MM).enumerate() {
                *play = play.max(q - r).min(q + r);
                withheld += p[k / 2] * (q - *play);
            }
            let own = if i == 0 { 1.0 } else { 1.0 + p[4 + i] };
            let x = q / (q * q + SIDE_MM * SIDE_MM).sqrt();
            q_mm[i] = q - withheld / whole * own * (1.0 + p[3] * x + p[4] * (x * x - 0.5));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Hysteresis);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Hysteresis, &[0.1, 0.3, 0.2, 0.1, -0.1, -0.1, 0.15]);
    }

    /// Bellow length at the end of straight moves between piston positions, at a speed in mm/s.
    fn after(turns: &[f64], speed: f64) -> f64 {
        let mut m = Memory::default();
        let (mut at, mut q) = (0.0f64, Vector3::zeros());
        for &to in turns {
            let n = ((to - at).abs() / (speed * proof::DT_S)).ceil() as u32;
            for k in 1..=n {
                q = Vector3::repeat(at + (to - at) * f64::from(k) / f64::from(n));
                Hysteresis.bellows(
                    &[0.2, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0],
                    &mut m,
                    &proof::moment(0.0, q),
                    &mut q,
                );
            }
            at = to;
        }
        q.x
    }

    #[test]
    fn loops_do_not_depend_on_speed() {
        let path = [5.0, -5.0, 0.0, 3.0, 1.0];
        assert!((after(&path, 0.5) - after(&path, 20.0)).abs() < 1e-9);
    }

    #[test]
    fn branches_differ_and_minor_loops_are_wiped_out() {
        let (up, down) = (after(&[-5.0, 0.0], 5.0), after(&[5.0, 0.0], 5.0));
        assert!(down - up > 0.4, "{down} {up}");
        assert!((down + up).abs() < 1e-9, "the loop is odd");
        let through = after(&[-5.0, 2.0, 0.5, 2.0, 4.0], 5.0);
        assert!(
            (through - after(&[-5.0, 4.0], 5.0)).abs() < 1e-9,
            "an inner loop is wiped out"
        );
    }
}
