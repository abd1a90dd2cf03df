//! Where air spring and rubber wall balance.
//!
//! The wall answers an elongation `q` with the pressure `p = c D W(q)`: `c` kPa per mm, `D` what
//! damage has left of it, `W` its curve (nominally `W = q`). The air in the line gives way by
//! `ε = (k_ε / c) G(p)`, `G` the gas curve (nominally `G = p`). The air delivered is `z = q + ε`. The
//! left side rises with q throughout, so Newton's method from the last balance finds the only root;
//! where both curves are straight it is `q = z / (1 + k_ε D)`.

use crate::plant::bellows::asymmetry::Asymmetry;
use crate::plant::bellows::stiffening::Stiffening;
use crate::plant::cause::active;
use crate::plant::config::PlantConfig;
use crate::plant::line::gas_compression::GasCompression;
use nalgebra::Vector3;

/// Springs of the three channels and their last balance.
#[derive(Debug, Clone)]
pub(crate) struct Balance {
    k_epsilon: Vector3<f64>,
    kpa_per_mm: f64,
    gas: Option<GasCompression>,
    stiffening: Option<Stiffening>,
    asymmetry: Option<Asymmetry>,
    straight: bool,
    last_mm: Vector3<f64>,
}

/// Newton ends below this step, mm.
const CLOSE_MM: f64 = 1e-10;
/// Newton's steps at most; from the last balance it takes two or three.
const STEPS_MAX: usize = 30;

impl Balance {
    pub(crate) fn new(config: &PlantConfig) -> Self {
        let effects = &config.effects;
        let gas = active(effects.gas_compression.as_ref());
        let stiffening = active(effects.stiffening.as_ref());
        let asymmetry = active(effects.asymmetry.as_ref());
        let straight = gas.is_none() && stiffening.is_none() && asymmetry.is_none();
        let k_epsilon = Vector3::from(config.line.k_epsilon);
        Self { k_epsilon, kpa_per_mm: config.line.kpa_per_mm, gas, stiffening, asymmetry, straight, last_mm: Vector3::zeros() }
    }

    /// Elongations, mm, and gauge pressures, kPa, for the air delivered (mm of piston).
    pub(crate) fn solve(&mut self, air_mm: &Vector3<f64>, compliance: &Vector3<f64>, softness: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let mut pressure = Vector3::zeros();
        for i in 0..3 {
            let k = self.k_epsilon[i] * compliance[i];
            if self.straight {
                self.last_mm[i] = air_mm[i] / (1.0 + k * softness[i]);
                pressure[i] = self.kpa_per_mm * softness[i] * self.last_mm[i];
            } else {
                (self.last_mm[i], pressure[i]) = self.newton(air_mm[i], k, softness[i], self.last_mm[i]);
            }
        }
        (self.last_mm, pressure)
    }

    fn newton(&self, air_mm: f64, k: f64, softness: f64, start_mm: f64) -> (f64, f64) {
        let stiffness = self.kpa_per_mm * softness;
        let (mut q, mut pressure) = (start_mm, 0.0);
        for _ in 0..STEPS_MAX {
            let (wall, wall_slope) = self.wall(q);
            pressure = stiffness * wall;
            let (squeeze, gas_slope) = self.gas.as_ref().map_or((pressure, 1.0), |g| g.linearised_kpa(pressure));
            let miss = q + k / self.kpa_per_mm * squeeze - air_mm;
            let step = miss / (1.0 + k * softness * gas_slope * wall_slope);
            q -= step;
            if step.abs() < CLOSE_MM {
                break;
            }
        }
        (q, pressure)
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
    use crate::plant::effects::Effects;
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
