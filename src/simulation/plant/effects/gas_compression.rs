//! Boyle's law: trapped air is a spring that stiffens with pressure and softens under vacuum.
//!
//! With dead volume V_d (in mm of piston), polytropic exponent n and gauge pressure p over the
//! atmosphere P: `(P + p)(V_d − ε)ⁿ = P V_dⁿ`. V_d is not free: for small signals the spring is the
//! nominal one, `V_d = n P k_ε / c` with `c` the kPa per mm of bellow. Hence, with strength `s` (the pressure
//! in the air relative to the nominal line at the same k_ε),
//! `ε = (V_d / s) (1 − (1 + s p/P)^(−1/n))`, and `s → 0` is the linear spring.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.gas_compression]`
    GasCompression at "effects.gas_compression" sized by strength; background 0.012; drawn by rng, severity {
        /// Pressure that the air really sees, per pressure of the nominal line. Default 0 (linear
        /// spring); typical 0.3 to 2, which changes the gain by 5 to 30 % at full bend. A larger value bends the
        /// curve more.
        strength: f64 = 0.0, 0.0..=3.0, "beyond 3 a full bend needs absolute vacuum", draw rng.sized(0.5, 2.2, severity);
        /// Polytropic exponent n: 1 for slow, 1.4 for fast compression. Default 1.2. A larger value curves less.
        polytropic: f64 = 1.2, 1.0..=1.67, "1 is isothermal, 1.4 adiabatic air", draw rng.between(1.05, 1.35);
        /// Pressure of the atmosphere, kPa. Default 101.3. A larger value curves less.
        atmosphere_kpa: f64 = 101.3, 30.0..=200.0, "101.3 at sea level";
    }
}

/// Share of the atmosphere below which the curve continues along its tangent: no vacuum is perfect.
const VACUUM_FLOOR: f64 = 0.1;

impl Law for GasCompression {
    /// ε(p) and dε/dp of the true gas divided by those of the nominal spring at zero pressure.
    fn gas(&self, pressure_kpa: f64) -> Option<(f64, f64)> {
        let (n, s) = (self.polytropic, self.strength / self.atmosphere_kpa);
        let ratio = 1.0 + s * pressure_kpa;
        let bounded = ratio.max(VACUUM_FLOOR);
        let shrunk = (-bounded.ln() / n).exp();
        let slope = shrunk / bounded;
        let strain = n / s * (1.0 - shrunk) + slope * (ratio - bounded) / s;
        Some((strain, slope))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gas_obeys_boyle_and_is_linear_for_small_signals() {
        let g = GasCompression {
            strength: 1.0,
            ..GasCompression::default()
        };
        let linearised_kpa = |p: f64| g.gas(p).unwrap();
        let volume = g.polytropic * g.atmosphere_kpa; // dead volume in the unit of the result
        for p in [-80.0, -40.0, -10.0, 5.0, 40.0] {
            let (eps, slope) = linearised_kpa(p);
            let before = g.atmosphere_kpa * volume.powf(g.polytropic);
            let after = (g.atmosphere_kpa + p) * (volume - eps).powf(g.polytropic);
            assert!((after / before - 1.0).abs() < 1e-12);
            let h = 1e-4;
            let numeric = (linearised_kpa(p + h).0 - linearised_kpa(p - h).0) / (2.0 * h);
            assert!((numeric - slope).abs() < 1e-7);
        }
        assert!((linearised_kpa(1e-6).0 - 1e-6).abs() < 1e-12);
        // beyond the floor it goes on straight
        let (a, slope) = linearised_kpa(-95.0);
        assert!((linearised_kpa(-105.0).0 - (a - 10.0 * slope)).abs() < 1e-9);
        // pressure meets a stiffer spring than vacuum
        assert!(linearised_kpa(17.0).0 < 17.0 && linearised_kpa(-17.0).0 < -17.0);
    }
}
