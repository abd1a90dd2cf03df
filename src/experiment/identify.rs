//! Algorithm 1 of the paper on a world: apply k, hold the poses, solve Eq. 25, repeat to 2 %.
//!
//! The bend is measured by the IMU. The side of each piston (Eq. 21) is read from the pulses: a
//! channel's row counts only once its piston has pushed further than the widest backlash since it last
//! turned. The last pass also tells lag and dead time, by the race of [`crate::refine::dynamics`].

use crate::control::pi::Dynamics;
use crate::experiment::rig::{Rig, RigError};
use crate::experiment::schedule::{HOLD_S, Pose, SCORED_S};
use crate::model::arc::Shape;
use crate::model::bend::Bend;
use crate::model::transmission::Line;
use crate::refine::batch::{Estimate, Measurement, Prior, Unidentifiable, relative_step, solve};
use crate::refine::dynamics::DynamicsBank;
use crate::tick::{Command, Config, Mode};
use crate::units::Mm;
use crate::world::World;
use nalgebra::{Vector2, Vector3};
use thiserror::Error;

/// The paper's criterion: relative step below 2 %.
pub const CONVERGED: f64 = 0.02;
/// Passes after which the iteration is given up.
pub const PASSES_MAX: usize = 12;
/// Rest of the set-point before a pose is measured, s: a long way takes longer than a hold.
const RESTED_S: f64 = 0.7;
/// Longest way that is waited for, s.
const WAY_MAX_S: f64 = 15.0;
/// Twice the widest backlash half-width that is believed, mm: travel after which a side is certain.
const SIDE_TRAVEL_MM: f64 = 2.4;

/// Why gains were not found.
#[derive(Debug, Error)]
pub enum IdentifyError {
    /// The rig stopped.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// The data do not fix the gains.
    #[error("identification: {0}")]
    Unidentifiable(#[from] Unidentifiable),
    /// A gain is outside anything physical.
    #[error(
        "identification: channel {channel} came to k_ε = {k_epsilon:.2}, k_λ = {k_lambda_mm:.2} mm; k_ε must lie in 0 to 10 and k_λ in 0 to 3 mm. Check that line {channel} reaches bellow {channel} and that the motor turns the right way"
    )]
    Unphysical {
        /// Channel, 1 to 3.
        channel: usize,
        /// Estimate.
        k_epsilon: f64,
        /// Estimate, mm.
        k_lambda_mm: f64,
    },
}

/// What the identification found.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// Gains with covariance, per channel.
    pub channels: [Estimate; 3],
    /// Lag and dead time.
    pub dynamics: Dynamics,
    /// Gains after every pass, from the start on.
    pub history: Vec<[Line; 3]>,
    /// The 2 % were reached.
    pub converged: bool,
}

impl Identified {
    /// The gains alone.
    #[must_use]
    pub fn lines(&self) -> [Line; 3] {
        self.channels.map(|e| e.line)
    }
}

/// Algorithm 1 from `config.lines` on, on one world.
///
/// # Errors
/// [`IdentifyError`] from the world or the data.
pub fn algorithm_1(
    config: &Config,
    world: &mut dyn World,
    poses: &[Pose],
    progress: &mut dyn FnMut(usize),
) -> Result<Identified, IdentifyError> {
    let open = Config { feedback: None, ..config.clone() };
    let mut rig = Rig::new(open, world);
    rig.align()?;
    let mut history = vec![config.lines];
    loop {
        let now = history.last().copied().unwrap_or(config.lines);
        rig.relearn(now);
        let (data, dynamics) = measure(&mut rig, poses, &mut || progress(history.len()))?;
        let channels = solve(&data, None)?;
        let next = plausible(&channels)?;
        history.push(next);
        let converged = relative_step(&next, &now) < CONVERGED;
        if converged || history.len() > PASSES_MAX {
            return Ok(Identified { channels, dynamics, history, converged });
        }
    }
}

/// One pass with a prior: the short calibration of a new tip.
///
/// # Errors
/// [`IdentifyError`] from the world or the data.
pub fn with_prior(config: &Config, world: &mut dyn World, poses: &[Pose], prior: &[Prior; 3]) -> Result<Identified, IdentifyError> {
    let lines = prior.map(|p| p.line);
    let mut rig = Rig::new(Config { feedback: None, lines, ..config.clone() }, world);
    rig.align()?;
    let (data, dynamics) = measure(&mut rig, poses, &mut || ())?;
    let channels = solve(&data, Some(prior))?;
    let next = plausible(&channels)?;
    Ok(Identified { channels, dynamics, history: vec![lines, next], converged: true })
}

fn plausible(channels: &[Estimate; 3]) -> Result<[Line; 3], IdentifyError> {
    for (i, e) in channels.iter().enumerate() {
        let Line { k_epsilon, k_lambda_mm } = e.line;
        if !(0.0..=10.0).contains(&k_epsilon) || !(-0.3..=3.0).contains(&k_lambda_mm) {
            return Err(IdentifyError::Unphysical { channel: i + 1, k_epsilon, k_lambda_mm });
        }
    }
    // a backlash found slightly negative is none
    Ok([0, 1, 2].map(|i: usize| Line { k_lambda_mm: channels[i].line.k_lambda_mm.max(0.0), ..channels[i].line }))
}

/// Which way each piston pushes and how far it has since it turned.
#[derive(Default)]
struct Pushes {
    last_mm: Vector3<f64>,
    side: Vector3<f64>,
    travel_mm: Vector3<f64>,
}

impl Pushes {
    fn follow(&mut self, piston_mm: &Vector3<f64>) {
        for i in 0..3 {
            let step = piston_mm[i] - self.last_mm[i];
            if step * self.side[i] < 0.0 || (self.side[i] == 0.0 && step != 0.0) {
                (self.side[i], self.travel_mm[i]) = (step.signum(), 0.0);
            }
            self.travel_mm[i] += step.abs();
        }
        self.last_mm = *piston_mm;
    }
    fn weight(&self) -> Vector3<f64> {
        self.travel_mm.map(|t| if t >= SIDE_TRAVEL_MM { 1.0 } else { 0.0 })
    }
}

/// Holds every pose and measures it: rows for Eq. 22, and the dynamics of the motion between.
fn measure(rig: &mut Rig<'_>, poses: &[Pose], progress: &mut dyn FnMut()) -> Result<(Vec<Measurement>, Dynamics), RigError> {
    let dt_s = rig.period_s();
    let ticks_of = |seconds: f64| (seconds / dt_s).round() as usize;
    let (scored, rest, longest) = (ticks_of(SCORED_S), ticks_of(RESTED_S), ticks_of(WAY_MAX_S));
    let length = Mm(rig.config.geometry.rest_length_mm);
    let (mut pushes, mut bank, mut data) = (Pushes::default(), DynamicsBank::default(), Vec::with_capacity(poses.len()));
    for pose in poses {
        let mut command = Some(Command { bend: pose.bend(), length });
        let (mut sum, mut rested, mut seen) = (Vector2::zeros(), 0, 0);
        let least = ticks_of(HOLD_S) - scored;
        for k in 1..=longest {
            let (frame, _) = rig.advance(command.take())?;
            pushes.follow(&rig.config.drive.piston_mm(&frame.steps));
            rested = if frame.mode == Mode::Holding { rested + 1 } else { 0 };
            let Some(felt) = frame.felt else { continue };
            bank.step(frame.pistons_give.0, felt.bend.0, dt_s);
            if k > least && rested > rest {
                sum += felt.bend.0;
                seen += 1;
            }
            if seen == scored {
                break;
            }
        }
        // a pose that was not reached in that time is no measurement
        if seen == scored {
            let bellow_mm = rig.config.geometry.lengths(&Shape { bend: Bend(sum / scored as f64), length });
            data.push(Measurement { piston_mm: pushes.last_mm, bellow_mm, side: pushes.side, weight: pushes.weight() });
        }
        progress();
    }
    Ok((data, bank.best(&rig.config.dynamics).unwrap_or(rig.config.dynamics)))
}
