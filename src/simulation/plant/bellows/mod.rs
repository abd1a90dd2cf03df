//! From delivered air to the lengths of the bellows.
//!
//! `air z → balance of air spring and rubber wall → memory of the rubber → first-order lag → length change q`.
//! Nominally `q = z / (1 + k_ε)` behind the lag.

pub(crate) mod balance;

use crate::simulation::plant::config::LineConfig;
use crate::simulation::plant::law::{BellowState, Laws, Step, each};
use crate::simulation::plant::memory::Decay;
use balance::Balance;
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
