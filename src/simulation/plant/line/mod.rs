//! From plungers to the air that reaches the bellows.
//!
//! `plunger → play → + warmth, squeezing, dragging → − leaked → lumen flow → air delivered z`.
//! Everything is counted in mm of piston. Nominally `z` is the far end of the play.

pub mod crosstalk;
pub mod gas_compression;
pub mod leak;
pub mod line_lag;
pub mod play;
pub mod rate_coupling;
pub mod thermal_drift;

use crate::simulation::plant::config::PlantConfig;
use crate::simulation::plant::plant_effect::active;
use crosstalk::Crosstalk;
use leak::{Leak, Leaking};
use line_lag::Lumen;
use nalgebra::Vector3;
use play::Play;
use rate_coupling::Dragging;
use thermal_drift::Warming;

/// The three lines with what they remember.
#[derive(Debug, Clone)]
pub(crate) struct Line {
    k_epsilon: Vector3<f64>,
    play: Play,
    dragging: Option<Dragging>,
    warmth: Option<Warming>,
    crosstalk: Option<Crosstalk>,
    leaking: Option<Leaking>,
    lumen: Option<Lumen>,
    delivered_mm: Vector3<f64>,
    /// What was broken at run time.
    pub(crate) broken: Broken,
}

/// Breakages of the lines.
#[derive(Debug, Clone, Default)]
pub(crate) struct Broken {
    leaking: Option<Leaking>,
    blocked: [bool; 3],
}

impl Broken {
    /// Opens a leak of `rate_per_s` on a channel (from 0), on top of others.
    pub(crate) fn leak(&mut self, channel: usize, rate_per_s: f64) {
        let mut rates = self.leaking.as_ref().map_or([0.0; 3], Leaking::rate_per_s);
        rates[channel] = rate_per_s;
        let lost_mm = self.leaking.as_ref().map_or_else(Vector3::zeros, Leaking::lost_mm);
        self.leaking = Some(Leaking::with_lost(Leak::plain(rates), lost_mm));
    }
    /// Blocks a lumen: what is in stays in.
    pub(crate) fn block(&mut self, channel: usize) {
        self.blocked[channel] = true;
    }
    /// Mends everything; air that is lost stays lost.
    pub(crate) fn mend(&mut self) {
        self.blocked = [false; 3];
        if let Some(l) = &self.leaking {
            self.leaking = Some(Leaking::with_lost(Leak::plain([0.0; 3]), l.lost_mm()));
        }
    }
}

/// State of the bellows that reaches back into the lines.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Felt {
    /// Bellow length changes, mm.
    pub(crate) bellow_mm: Vector3<f64>,
    /// Gauge pressures, kPa.
    pub(crate) pressure_kpa: Vector3<f64>,
}

impl Line {
    pub(crate) fn new(config: &PlantConfig) -> Self {
        let effects = &config.effects;
        Self {
            k_epsilon: Vector3::from(config.line.k_epsilon),
            play: Play::new(&config.line.k_lambda_mm, active(effects.outside.play_wear.as_ref())),
            dragging: active(effects.outside.rate_coupling.as_ref()).map(Dragging::new),
            warmth: active(effects.thermal_drift.as_ref()).map(Warming::new),
            crosstalk: active(effects.crosstalk.as_ref()),
            leaking: active(effects.leak.as_ref()).map(Leaking::new),
            lumen: active(effects.line_lag.as_ref()).map(Lumen::new),
            delivered_mm: Vector3::zeros(),
            broken: Broken::default(),
        }
    }

    /// Far end of the play, mm of piston.
    pub(crate) fn play_output_mm(&self) -> Vector3<f64> {
        self.play.play_output_mm()
    }

    /// All lines are opened for a moment, pistons at rest.
    pub(crate) fn vent(&mut self) {
        for leaking in [&mut self.leaking, &mut self.broken.leaking].into_iter().flatten() {
            leaking.vent();
        }
    }

    /// Air delivered to the bellows, mm of piston, after `dt_s`.
    pub(crate) fn step(&mut self, plunger_mm: &Vector3<f64>, estimate: &Felt, dt_s: f64) -> Vector3<f64> {
        let play_output = self.play.step(plunger_mm);
        let mut pushed = play_output;
        if let Some(dragging) = &mut self.dragging {
            pushed += dragging.step(&play_output, dt_s);
        }
        if let Some(warmth) = &mut self.warmth {
            pushed += warmth.step(dt_s);
        }
        if let Some(crosstalk) = &self.crosstalk {
            pushed += crosstalk.squeezed_mm(&estimate.bellow_mm, &self.k_epsilon);
        }
        for leaking in [&mut self.leaking, &mut self.broken.leaking].into_iter().flatten() {
            pushed -= leaking.step(&pushed, &estimate.pressure_kpa, dt_s);
        }
        let arrived = match &mut self.lumen {
            Some(lumen) => lumen.step(&pushed, dt_s),
            None => pushed,
        };
        for i in 0..3 {
            if !self.broken.blocked[i] {
                self.delivered_mm[i] = arrived[i];
            }
        }
        self.delivered_mm
    }
}
