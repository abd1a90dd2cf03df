//! The configuration of a running service, and the state that a supervisor starts from.

use crate::config::{Board, Calibration, Gains, ServiceSection};
use crate::control::{Dynamics, DynamicsPrior, LoopConfig, RestartState};
use crate::service::flight::start::Header;
use crate::service::{Belief, LearnedGains, Memory};
use crate::supervisor::{MachineInfo, Supervisor, SupervisorConfig};
use std::path::PathBuf;

/// The configuration of a running service.
pub struct RunConfig {
    /// Configuration of the supervisor.
    pub supervisor: SupervisorConfig,
    /// Table `[service]`.
    pub service: ServiceSection,
    /// The board, for a reload.
    pub board: Board,
    /// The gains file, for a reload; `None` runs on the defaults.
    pub gains: Option<PathBuf>,
    /// The calibration.
    pub calibration: Calibration,
    /// Its file; `None` runs on the one that comes with the program.
    pub calib: Option<PathBuf>,
    /// File of the model for the feedforward, if there is one.
    pub feedforward: Option<PathBuf>,
    /// Identity of the mounted tip; empty if none was given.
    pub tip: String,
    /// Hash of [`Self::texts`].
    pub config_hash: String,
    /// Texts of board, gains, calibration and, with a feedforward, its model, for the flight log.
    pub texts: Vec<String>,
}

/// What a supervisor starts from: the configuration with the accepted gains, and the remembered position.
#[derive(Debug, Clone)]
pub struct Start {
    /// Configuration.
    pub config: SupervisorConfig,
    /// Position at the last write of the memory.
    pub restart: Option<RestartState>,
    /// Trust in that position.
    pub belief: Belief,
    /// No measurement has confirmed the last zero.
    pub unverified: bool,
}

impl Start {
    /// The accepted calibration, if it is in use: it was made on the mounted tip, and no model describes the machine, whose gains were
    /// identified together with its effects.
    pub fn accepted<'a>(config: &RunConfig, memory: &'a Memory) -> Option<&'a LearnedGains> {
        let described = config.supervisor.tick.feedforward.is_some();
        let accepted = memory.accepted.as_ref();
        accepted.filter(|gains| gains.tip == config.tip && !described)
    }

    /// Applies what the memory holds about the mounted tip.
    pub fn new(config: &RunConfig, memory: &Memory, belief: Belief) -> Self {
        let mut supervisor = config.supervisor.clone();
        let described = supervisor.tick.feedforward.is_some();
        if let Some(gains) = Self::accepted(config, memory) {
            supervisor.tick.lines = gains.lines();
            supervisor.tick.dynamics = DynamicsPrior::calibrated(Dynamics {
                lag_s: gains.lag_s,
                delay_s: gains.delay_s,
            });
        }
        let mut restart = memory.restart;
        if let Some(restart) = &mut restart
            && (memory.tip != config.tip || described)
        {
            // the position belongs to the machine, the gains and the rest pose to the tip
            restart.k_epsilon = supervisor.tick.lines.map(|l| l.k_epsilon);
            restart.k_lambda_mm = supervisor.tick.lines.map(|l| l.k_lambda_mm);
            restart.rest = restart.rest.filter(|_| memory.tip == config.tip);
        }
        Self {
            config: supervisor,
            restart,
            belief,
            unverified: memory.unverified,
        }
    }

    /// A supervisor in this state.
    pub fn supervisor(self) -> Supervisor {
        let mut supervisor = Supervisor::new(self.config, self.restart);
        match (self.belief, self.restart) {
            (Belief::Certain, _) => {}
            (Belief::Checked, Some(restart)) => supervisor.check(restart),
            (Belief::Checked, None) | (Belief::Lost, _) => supervisor.doubt(),
        }
        if self.unverified {
            supervisor.set_unverified();
        }
        supervisor
    }

    /// The start as the flight log holds it.
    pub fn header(&self, run: &RunConfig, machine: &str) -> Header {
        let SupervisorConfig { tick, gate, .. } = &self.config;
        Header {
            log: 3,
            cycle: 0,
            program: env!("CARGO_PKG_VERSION").to_owned(),
            config_hash: run.config_hash.clone(),
            texts: run.texts.clone(),
            machine: MachineInfo {
                name: machine.to_owned(),
                period_s: gate.tick_s,
                step_mm: gate.step_mm,
                rest_length_mm: tick.geometry.rest_length_mm,
            },
            tip: run.tip.clone(),
            lines: tick.lines,
            dynamics: tick.dynamics,
            restart: self.restart,
            belief: self.belief,
            unverified: self.unverified,
        }
    }

    /// The start that a flight log holds.
    pub fn of(header: &Header, mut config: SupervisorConfig) -> Self {
        (config.tick.lines, config.tick.dynamics) = (header.lines, header.dynamics);
        Self {
            config,
            restart: header.restart,
            belief: header.belief,
            unverified: header.unverified,
        }
    }
}

/// A configuration after a reload: machine and calibration stay, the rest comes from the gains.
pub fn with_gains(
    now: &SupervisorConfig,
    board: &Board,
    calibration: &Calibration,
    gains: &Gains,
) -> SupervisorConfig {
    let mut next = now.clone();
    next.tick = LoopConfig {
        geometry: next.tick.geometry,
        drive: next.tick.drive,
        lines: next.tick.lines,
        line_sigmas: next.tick.line_sigmas,
        dynamics: next.tick.dynamics,
        feedforward: next.tick.feedforward,
        ..crate::config::assemble(board, calibration, gains)
    };
    next
}
