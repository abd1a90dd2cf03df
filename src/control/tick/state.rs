//! What the loop remembers from tick to tick, and what of it outlives a restart.

use super::{LoopConfig, bellows_of};
use crate::control::backlash_adaptation::BacklashAdaptation;
use crate::control::follow::Follower;
use crate::control::learning::dynamics::DynamicsBank;
use crate::control::learning::online::RefineState;
use crate::control::obstruction::ObstructionDetector;
use crate::control::pi::{Dynamics, PiState, ReferenceModel};
use crate::control::saturation::SaturationMonitor;
use crate::control::standstill::StandstillLatch;
use crate::estimation::fusion::base_watch::Watch;
use crate::estimation::fusion::tip::Fusion;
use crate::model::arc::Shape;
use crate::model::bend::Bend;
use crate::model::transmission::{Line, SideState};
use crate::primitives::units::{Mm, Steps};
use nalgebra::{Vector1, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// What the loop remembers from tick to tick.
#[derive(Debug, Clone)]
pub struct LoopState {
    /// Orientation estimation.
    pub fusion: Fusion,
    pub(super) target: Shape,
    pub(super) bend: Follower<2>,
    pub(super) length: Follower<1>,
    pub(super) pistons: [Follower<1>; 3],
    pub(super) lines: [Line; 3],
    pub(super) dynamics: Dynamics,
    pub(super) sides: [SideState; 3],
    pub(super) play_output_mm: Vector3<f64>,
    pub(super) realised_mm: Vector3<f64>,
    pub(super) model: ReferenceModel,
    pub(super) pi: PiState,
    pub(super) rest: StandstillLatch,
    pub(super) rested_s: f64,
    pub(super) wall: ObstructionDetector,
    /// The integrator is at its bound.
    pub(super) full: bool,
    pub(super) spent: SaturationMonitor,
    pub(super) reach: BacklashAdaptation,
    pub(super) refine: RefineState,
    pub(super) bank: DynamicsBank,
    pub(super) last_steps: Steps,
    /// Time since each motor's last step, s.
    pub(super) idle_s: [f64; 3],
    pub(super) still_s: f64,
    pub(super) watch: Watch,
    /// What stood when all was quiet last: integral, felt bend, bend that the pistons gave by the play.
    pub(super) quiet: [Vector2<f64>; 3],
    pub(super) base_moved: bool,
    pub(super) held: Option<Held>,
    /// What a release from a hold still keeps the targets off by, mm.
    pub(super) ease_mm: Vector3<f64>,
    pub(super) easing: bool,
}

/// Pistons that are being stopped or stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Held {
    /// Where each comes to a stop, mm.
    pub(super) stop_mm: Vector3<f64>,
}

/// What outlives a restart of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RestartState {
    /// Microsteps counted since zero.
    pub steps: Steps,
    /// Felt bend vector, rad.
    pub bend_rad: [f64; 2],
    /// Far ends of the plays, mm of piston.
    pub play_output_mm: [f64; 3],
    /// Refined extension gains.
    pub k_epsilon: [f64; 3],
    /// Backlash half-widths, mm.
    pub k_lambda_mm: [f64; 3],
    /// Learnt lag, s.
    pub lag_s: f64,
    /// Learnt dead time, s.
    pub delay_s: f64,
    /// The rest, once it was found.
    pub rest: Option<RestartRest>,
}

/// The rest as alignment found it, in the base frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RestartRest {
    /// Mean specific force, m/s².
    pub acc_m_s2: [f64; 3],
    /// Mean field, µT, where there was a magnetometer.
    pub mag_ut: Option<[f64; 3]>,
    /// Gyroscope bias, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
}

impl LoopState {
    /// At rest, pistons at zero, straight, not aligned.
    #[must_use]
    pub fn new(config: &LoopConfig) -> Self {
        let rest = Shape { bend: Bend::STRAIGHT, length: Mm(config.geometry.rest_length_mm) };
        Self {
            fusion: Fusion::default(),
            target: rest,
            bend: Follower::resting(Vector2::zeros()),
            length: Follower::resting(Vector1::new(config.geometry.rest_length_mm)),
            pistons: [Follower::resting(Vector1::zeros()); 3],
            lines: config.lines,
            dynamics: config.dynamics,
            sides: [SideState::default(); 3],
            play_output_mm: Vector3::zeros(),
            realised_mm: Vector3::zeros(),
            model: ReferenceModel::default(),
            pi: PiState::default(),
            rest: StandstillLatch::default(),
            rested_s: 0.0,
            wall: ObstructionDetector::default(),
            full: false,
            spent: SaturationMonitor::default(),
            reach: BacklashAdaptation::default(),
            refine: RefineState::new(&config.lines),
            bank: DynamicsBank::default(),
            last_steps: Steps::default(),
            idle_s: [f64::INFINITY; 3],
            still_s: 0.0,
            watch: Watch::default(),
            quiet: [Vector2::zeros(); 3],
            base_moved: false,
            held: None,
            ease_mm: Vector3::zeros(),
            easing: false,
        }
    }

    /// Transmission gains in use.
    #[must_use]
    pub fn lines(&self) -> &[Line; 3] {
        &self.lines
    }

    /// Replaces the transmission gains, as a new calibration does.
    pub fn set_lines(&mut self, lines: [Line; 3]) {
        self.lines = lines;
    }

    /// The pistons rest at these counts, wherever they were led from, and the tip is to stay at `at`:
    /// what feedback is in the pistons becomes the integral part, so that nothing moves by itself.
    pub fn stand(&mut self, config: &LoopConfig, steps: &Steps, at: Bend) {
        let piston_mm = config.drive.piston_mm(steps);
        for i in 0..3 {
            let line = &self.lines[i];
            let w_mm = line.play(self.play_output_mm[i], piston_mm[i]);
            let side = if line.k_lambda_mm > 0.0 { ((piston_mm[i] - w_mm) / line.k_lambda_mm).clamp(-1.0, 1.0) } else { 0.0 };
            self.play_output_mm[i] = w_mm;
            self.realised_mm[i] = w_mm;
            self.sides[i] = SideState { w_mm, side, way: if side == 0.0 { 0.0 } else { side.signum() } };
            self.pistons[i] = Follower::resting(Vector1::new(piston_mm[i]));
        }
        let given = config.geometry.shape(&bellows_of(&self.lines, &self.realised_mm));
        let length = given.length.0.clamp(0.5 * config.geometry.rest_length_mm, 2.0 * config.geometry.rest_length_mm);
        self.target = Shape { bend: at, length: Mm(length) };
        self.bend = Follower::resting(at.0);
        self.length = Follower::resting(Vector1::new(length));
        let feedback = given.bend.0 - at.0;
        self.pi = PiState { integral: feedback, feedback };
        self.model = ReferenceModel::resting(at.0);
        (self.rest, self.rested_s, self.wall) = (StandstillLatch::default(), 0.0, ObstructionDetector::default());
        (self.full, self.spent) = (false, SaturationMonitor::default());
        (self.held, self.ease_mm, self.easing) = (None, Vector3::zeros(), false);
        self.last_steps = *steps;
        self.reach.forget();
    }

    /// Takes the feedback out of the command, as an open loop needs it.
    pub fn forget_feedback(&mut self) {
        self.pi = PiState::default();
        (self.full, self.spent) = (false, SaturationMonitor::default());
    }

    /// What is worth keeping over a restart, with the pistons at these counts.
    #[must_use]
    pub fn keep(&self, steps: &Steps) -> RestartState {
        let rest = self.fusion.rest().map(|r| RestartRest {
            acc_m_s2: r.acc_rest_m_s2.into(),
            mag_ut: r.mag_rest_ut.map(Into::into),
            gyro_bias_rad_s: r.gyro_bias_rad_s.into(),
        });
        RestartState {
            steps: *steps,
            bend_rad: self.fusion.estimate().map_or([0.0; 2], |f| f.bend.0.into()),
            play_output_mm: self.play_output_mm.into(),
            k_epsilon: self.lines.map(|l| l.k_epsilon),
            k_lambda_mm: self.lines.map(|l| l.k_lambda_mm),
            lag_s: self.dynamics.lag_s,
            delay_s: self.dynamics.delay_s,
            rest,
        }
    }

    /// Takes up what was kept before alignment: where the pistons stand and what was learnt.
    pub fn take_up(&mut self, config: &LoopConfig, kept: &RestartState) {
        self.lines = [0, 1, 2].map(|i: usize| Line { k_epsilon: kept.k_epsilon[i], k_lambda_mm: kept.k_lambda_mm[i] });
        self.dynamics = Dynamics { lag_s: kept.lag_s, delay_s: kept.delay_s };
        self.play_output_mm = kept.play_output_mm.into();
        self.stand(config, &kept.steps, Bend(kept.bend_rad.into()));
    }
}
