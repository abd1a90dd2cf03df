//! Where air spring and rubber wall balance.
//!
//! The wall answers an elongation `q` with the pressure `p = c D W(q)`: `c` kPa per mm, `D` what
//! damage has left of it, `W` its curve (nominally `W = q`). The air in the line gives way by
//! `ε = (k_ε / c) G(p)`, `G` the gas curve (nominally `G = p`). The air delivered is `z = q + ε`. The
//! left side rises with q throughout, so Newton's method finds the only root; it starts from the last
//! balance and slope, which is near enough that one round does. Where both curves are straight the
//! root is `q = z / (1 + k_ε D)`.

use crate::simulation::plant::bellows::asymmetry::Asymmetry;
use crate::simulation::plant::bellows::stiffening::Hardening;
use crate::simulation::plant::config::PlantConfig;
use crate::simulation::plant::line::gas_compression::GasCompression;
use crate::simulation::plant::plant_effect::active;
use nalgebra::Vector3;

/// Springs of the three channels and their last balance.
#[derive(Debug, Clone)]
pub(crate) struct Balance {
    k_epsilon: Vector3<f64>,
    kpa_per_mm: f64,
    gas: Option<GasCompression>,
    stiffening: Option<Hardening>,
    asymmetry: Option<Asymmetry>,
    straight: bool,
    last: [Point; 3],
}

/// A balance that was found.
#[derive(Debug, Clone, Copy, Default)]
struct Point {
    air_mm: f64,
    bellow_mm: f64,
    /// dq/dz there.
    slope: f64,
    pressure_kpa: f64,
}

/// Newton ends below this step, mm: its error is of the order of the square of that.
const CLOSE_MM: f64 = 1e-5;
/// Newton's rounds at most.
const ROUNDS: usize = 30;

impl Balance {
    pub(crate) fn new(config: &PlantConfig) -> Self {
        let effects = &config.effects;
        let gas = active(effects.gas_compression.as_ref());
        let stiffening = active(effects.stiffening.as_ref()).map(|c| Hardening::new(&c));
        let asymmetry = active(effects.asymmetry.as_ref());
        let straight = gas.is_none() && stiffening.is_none() && asymmetry.is_none();
        let k_epsilon = Vector3::from(config.line.k_epsilon);
        Self { k_epsilon, kpa_per_mm: config.line.kpa_per_mm, gas, stiffening, asymmetry, straight, last: [Point::default(); 3] }
    }

    /// Elongations, mm, and gauge pressures, kPa, for the air delivered (mm of piston).
    pub(crate) fn solve(
        &mut self,
        air_mm: &Vector3<f64>,
        compliance: &Vector3<f64>,
        softness: &Vector3<f64>,
    ) -> (Vector3<f64>, Vector3<f64>) {
        for i in 0..3 {
            let k = self.k_epsilon[i] * compliance[i];
            self.last[i] =
                if self.straight { self.line(air_mm[i], k, softness[i]) } else { self.newton(air_mm[i], k, softness[i], &self.last[i]) };
        }
        let [a, b, c] = &self.last;
        (Vector3::new(a.bellow_mm, b.bellow_mm, c.bellow_mm), Vector3::new(a.pressure_kpa, b.pressure_kpa, c.pressure_kpa))
    }

    fn line(&self, air_mm: f64, k: f64, softness: f64) -> Point {
        let slope = 1.0 / (1.0 + k * softness);
        let bellow_mm = air_mm * slope;
        Point { air_mm, bellow_mm, slope, pressure_kpa: self.kpa_per_mm * softness * bellow_mm }
    }

    fn newton(&self, air_mm: f64, k: f64, softness: f64, last: &Point) -> Point {
        let stiffness = self.kpa_per_mm * softness;
        let mut p = Point { air_mm, bellow_mm: last.bellow_mm + last.slope * (air_mm - last.air_mm), ..*last };
        for _ in 0..ROUNDS {
            let (wall, wall_slope) = self.wall(p.bellow_mm);
            p.pressure_kpa = stiffness * wall;
            let (squeeze, gas_slope) = self.gas.as_ref().map_or((p.pressure_kpa, 1.0), |g| g.linearised_kpa(p.pressure_kpa));
            p.slope = 1.0 / (1.0 + k * softness * gas_slope * wall_slope);
            let step = (p.bellow_mm + k / self.kpa_per_mm * squeeze - air_mm) * p.slope;
            p.bellow_mm -= step;
            p.pressure_kpa -= stiffness * wall_slope * step;
            if step.abs() < CLOSE_MM {
                break;
            }
        }
        p
    }

    /// W and dW/dq.
    fn wall(&self, q_mm: f64) -> (f64, f64) {
        let (mut w, mut slope) = (q_mm, 1.0);
        if let Some(s) = &self.stiffening {
            let (dw, ds) = s.extra(q_mm);
            (w, slope) = (w + dw, slope + ds);
        }
        if let Some(a) = &self.asymmetry {
            let (dw, ds) = a.extra(q_mm);
            (w, slope) = (w + dw, slope + ds);
        }
        (w, slope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::plant::bellows::stiffening::Stiffening;
    use crate::simulation::plant::effects::Effects;
    use proptest::prelude::*;

    fn curved() -> Balance {
        let effects = Effects {
            gas_compression: Some(GasCompression { strength: 1.5, ..GasCompression::default() }),
            stiffening: Some(Stiffening { share: 0.3, ..Stiffening::default() }),
            asymmetry: Some(Asymmetry { share: -0.2, ..Asymmetry::default() }),
            ..Effects::default()
        };
        Balance::new(&PlantConfig { effects, ..PlantConfig::default() })
    }

    proptest! {
        #[test]
        fn balances_from_anywhere(from in -25.0..25.0f64, to in -25.0..25.0f64, softness in 0.4..1.0f64) {
            let mut b = curved();
            let one = Vector3::repeat(1.0);
            b.solve(&Vector3::repeat(from), &one, &one);
            let (q, p) = b.solve(&Vector3::repeat(to), &one, &(one * softness));
            for i in 0..3 {
                let eps = b.k_epsilon[i] / b.kpa_per_mm * b.gas.as_ref().unwrap().linearised_kpa(p[i]).0;
                prop_assert!((q[i] + eps - to).abs() < 1e-6, "{} {} {}", q[i], eps, to);
            }
        }
    }

    #[test]
    fn small_signals_are_nominal() {
        let (q, p) = curved().solve(&Vector3::repeat(1e-4), &Vector3::repeat(1.0), &Vector3::repeat(1.0));
        for i in 0..3 {
            let k = PlantConfig::default().line.k_epsilon[i];
            assert!((q[i] * (1.0 + k) / 1e-4 - 1.0).abs() < 1e-3);
        }
        assert!((p.x / q.x / 3.2 - 1.0).abs() < 1e-3);
    }
}
