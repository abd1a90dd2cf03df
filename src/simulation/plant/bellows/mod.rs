//! From delivered air to how long the bellows are.
//!
//! `air z → balance of air spring and rubber wall → hysteresis → creep → snap → first-order lag →
//! ringing → length change q`. Nominally `q = z / (1 + k_ε)` behind the lag.

pub mod asymmetry;
pub mod balance;
pub mod bubble_jump;
pub mod creep;
pub mod hysteresis;
pub mod ringing;
pub mod snap_through;
pub mod softening;
pub mod stiffening;

use crate::simulation::plant::config::PlantConfig;
use crate::simulation::plant::line::Felt;
use crate::simulation::plant::memory::Decay;
use crate::simulation::plant::plant_effect::active;
use balance::Balance;
use bubble_jump::BubbleJump;
use creep::Creeping;
use hysteresis::Plies;
use nalgebra::Vector3;
use ringing::Rings;
use snap_through::Snapping;
use softening::Damage;

/// The three bellows with what they remember.
#[derive(Debug, Clone)]
pub(crate) struct Bellows {
    balance: Balance,
    bubble: Option<BubbleJump>,
    damage: Option<Damage>,
    plies: Option<Plies>,
    creeping: Option<Creeping>,
    snapping: Option<Snapping>,
    lag: Decay,
    rings: Option<Rings>,
    lagged_mm: Vector3<f64>,
    /// What the lines feel of the bellows.
    pub(crate) estimate: Felt,
    /// What was broken at run time.
    pub(crate) broken: Broken,
}

/// Breakages of the bellows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Broken {
    /// Factor on the compliance of the air in each line.
    pub(crate) compliance: Vector3<f64>,
    /// Factor on the elongation of each bellow.
    pub(crate) gain: Vector3<f64>,
}

impl Default for Broken {
    fn default() -> Self {
        Self { compliance: Vector3::repeat(1.0), gain: Vector3::repeat(1.0) }
    }
}

impl Bellows {
    pub(crate) fn new(config: &PlantConfig) -> Self {
        let effects = &config.effects;
        let zero = Vector3::zeros();
        Self {
            balance: Balance::new(config),
            bubble: active(effects.outside.bubble_jump.as_ref()),
            damage: active(effects.softening.as_ref()).map(Damage::new),
            plies: active(effects.hysteresis.as_ref()).map(Plies::new),
            creeping: active(effects.creep.as_ref()).map(Creeping::new),
            snapping: active(effects.outside.snap_through.as_ref()).map(Snapping::new),
            lag: Decay::new(config.line.lag_s),
            rings: active(effects.outside.ringing.as_ref()).map(Rings::new),
            lagged_mm: zero,
            estimate: Felt { bellow_mm: zero, pressure_kpa: zero },
            broken: Broken::default(),
        }
    }

    /// Length changes of the bellows, mm, after `dt_s` with `air_mm` delivered.
    pub(crate) fn step(&mut self, air_mm: &Vector3<f64>, t: f64, dt_s: f64) -> Vector3<f64> {
        let mut compliance = self.broken.compliance;
        if let Some(bubble) = &self.bubble {
            compliance[bubble.channel - 1] *= bubble.factor(t);
        }
        let softness = self.damage.as_ref().map_or_else(|| Vector3::repeat(1.0), Damage::left);
        let (mut q, pressure) = self.balance.solve(air_mm, &compliance, &softness);
        self.estimate = Felt { bellow_mm: q, pressure_kpa: pressure };
        if let Some(damage) = &mut self.damage {
            damage.stretch(&q);
        }
        if let Some(plies) = &mut self.plies {
            q = plies.step(&q);
        }
        if let Some(creeping) = &mut self.creeping {
            q += creeping.step(&q, dt_s);
        }
        if let Some(snapping) = &mut self.snapping {
            q += snapping.step(&q, dt_s);
        }
        q.component_mul_assign(&self.broken.gain);
        self.lagged_mm += (q - self.lagged_mm) * self.lag.share(dt_s);
        match &mut self.rings {
            Some(rings) => rings.step(&self.lagged_mm, dt_s),
            None => self.lagged_mm,
        }
    }
}
