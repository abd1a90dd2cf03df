//! From delivered air to the lengths of the bellows.
//!
//! `air z → balance of air spring and rubber wall → memory of the rubber → first-order lag → length change q`.
//! Nominally `q = z / (1 + k_ε)` behind the lag.
//!
//! The wall responds to a length change `q` with the pressure `p = c D W(q)`: `c` kPa per mm, `D` the share
//! of the stiffness that softening leaves, `W` the curve of the wall (nominally `W = q`). The air in the line
//! is compressed by `ε = (k_ε / c) G(p)`, `G` the curve of the gas (nominally `G = p`). The air delivered is
//! `z = q + ε`, which rises with q throughout, so that Newton's method finds the only root; started from the
//! last balance and slope, one round usually suffices. Where both curves are straight the root is
//! `q = z / (1 + k_ε D)`.

use crate::simulation::plant::config::LineConfig;
use crate::simulation::plant::law::{BellowState, Laws, Step, each};
use crate::simulation::plant::memory::Decay;
use nalgebra::Vector3;

/// The three bellows with their state.
#[derive(Debug)]
pub(crate) struct Bellows {
    balance: Balance,
    lag: Decay,
    lagged_mm: Vector3<f64>,
    /// State that reaches back into the lines.
    pub(crate) state: BellowState,
}

impl Bellows {
    pub(crate) fn new(config: &LineConfig, laws: &Laws) -> Self {
        Self {
            balance: Balance::new(config, laws),
            lag: Decay::new(config.lag_s),
            lagged_mm: Vector3::zeros(),
            state: BellowState::default(),
        }
    }

    /// Length changes of the bellows, mm, after one step with `air_mm` delivered.
    pub(crate) fn step(&mut self, air_mm: &Vector3<f64>, now: &mut Step<'_>) -> Vector3<f64> {
        let Step { at, laws, faults } = now;
        let (mut compliance, mut stiffness) = (faults.compliance, Vector3::repeat(1.0));
        for law in laws.iter_mut() {
            law.compliance(&mut compliance, at.t);
            law.softening(&mut stiffness, &self.state.bellow_mm);
        }
        self.state = self.balance.solve(air_mm, &compliance, &stiffness, laws);
        let mut q_mm = self.state.bellow_mm;
        each(laws, |law| law.bellows(&mut q_mm, at));
        q_mm.component_mul_assign(&faults.bellow_gain);
        self.lagged_mm += (q_mm - self.lagged_mm) * self.lag.share(at.dt_s);
        let mut out_mm = self.lagged_mm;
        each(laws, |law| law.lagged(&mut out_mm, at));
        out_mm
    }
}

/// Springs of the three channels and their last balance.
#[derive(Debug)]
struct Balance {
    k_epsilon: Vector3<f64>,
    kpa_per_mm: f64,
    straight: bool,
    last: [Point; 3],
}

/// A balance of one channel.
#[derive(Debug, Clone, Copy, Default)]
struct Point {
    air_mm: f64,
    bellow_mm: f64,
    /// dq/dz.
    slope: f64,
    pressure_kpa: f64,
}

/// Newton's method ends below this step, mm; its error is of the order of the square of the step.
const CLOSE_MM: f64 = 1e-5;
/// Largest number of rounds of Newton's method; two or three suffice for any step of the pistons.
const ROUNDS: usize = 30;

impl Balance {
    fn new(config: &LineConfig, laws: &Laws) -> Self {
        let mut laws = laws.iter();
        Self {
            k_epsilon: Vector3::from(config.k_epsilon),
            kpa_per_mm: config.kpa_per_mm,
            straight: laws.all(|law| law.gas(0.0).is_none() && law.wall(0.0).is_none()),
            last: [Point::default(); 3],
        }
    }

    /// Length changes and pressures for the air delivered (mm of piston), the factors on the compliance of the air
    /// and those on the stiffness of the walls.
    fn solve(
        &mut self,
        air_mm: &Vector3<f64>,
        compliance: &Vector3<f64>,
        stiffness: &Vector3<f64>,
        laws: &Laws,
    ) -> BellowState {
        for i in 0..3 {
            let k = self.k_epsilon[i] * compliance[i];
            self.last[i] = if self.straight {
                self.linear(air_mm[i], k, stiffness[i])
            } else {
                self.newton(air_mm[i], k, stiffness[i], &self.last[i], laws)
            };
        }
        BellowState {
            bellow_mm: Vector3::from(self.last.map(|p| p.bellow_mm)),
            pressure_kpa: Vector3::from(self.last.map(|p| p.pressure_kpa)),
        }
    }

    fn linear(&self, air_mm: f64, k: f64, softness: f64) -> Point {
        let slope = 1.0 / (1.0 + k * softness);
        let bellow_mm = air_mm * slope;
        Point {
            air_mm,
            bellow_mm,
            slope,
            pressure_kpa: self.kpa_per_mm * softness * bellow_mm,
        }
    }

    fn newton(&self, air_mm: f64, k: f64, softness: f64, last: &Point, laws: &Laws) -> Point {
        let stiffness = self.kpa_per_mm * softness;
        let mut p = Point {
            air_mm,
            bellow_mm: last.bellow_mm + last.slope * (air_mm - last.air_mm),
            ..*last
        };
        for _ in 0..ROUNDS {
            let (wall, wall_slope) = wall(p.bellow_mm, laws);
            p.pressure_kpa = stiffness * wall;
            let gas = laws.iter().find_map(|law| law.gas(p.pressure_kpa));
            let (squeeze, gas_slope) = gas.unwrap_or((p.pressure_kpa, 1.0));
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
}

/// W and dW/dq.
fn wall(q_mm: f64, laws: &Laws) -> (f64, f64) {
    let extra = laws.iter().filter_map(|law| law.wall(q_mm));
    extra.fold((q_mm, 1.0), |(w, slope), (dw, ds)| (w + dw, slope + ds))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::plant::config::PlantConfig;
    use proptest::prelude::*;

    const CURVED: &str = "[effects.gas_compression]\nstrength = 1.5\n[effects.stiffening]\nshare = 0.3\n[effects.asymmetry]\nshare = -0.2";

    fn curved() -> (Balance, Laws) {
        let config: PlantConfig = toml::from_str(CURVED).unwrap();
        let laws = config.effects.laws(&config.unit_data(1));
        (Balance::new(&config.line, &laws), laws)
    }

    proptest! {
        #[test]
        fn air_is_shared_between_bellow_and_spring_from_any_start(from in -25.0..25.0f64, to in -25.0..25.0f64, softness in 0.4..1.0f64) {
            let (mut b, laws) = curved();
            let one = Vector3::repeat(1.0);
            b.solve(&Vector3::repeat(from), &one, &one, &laws);
            let s = b.solve(&Vector3::repeat(to), &one, &(one * softness), &laws);
            for i in 0..3 {
                let gas = laws.iter().find_map(|law| law.gas(s.pressure_kpa[i])).unwrap();
                let eps = b.k_epsilon[i] / b.kpa_per_mm * gas.0;
                prop_assert!((s.bellow_mm[i] + eps - to).abs() < 1e-6, "{} {} {}", s.bellow_mm[i], eps, to);
            }
        }
    }

    #[test]
    fn small_signals_are_nominal() {
        let (mut b, laws) = curved();
        let s = b.solve(
            &Vector3::repeat(1e-4),
            &Vector3::repeat(1.0),
            &Vector3::repeat(1.0),
            &laws,
        );
        for i in 0..3 {
            assert!((s.bellow_mm[i] * (1.0 + b.k_epsilon[i]) / 1e-4 - 1.0).abs() < 1e-3);
        }
        assert!((s.pressure_kpa.x / s.bellow_mm.x / 3.2 - 1.0).abs() < 1e-3);
    }
}
