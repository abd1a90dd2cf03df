//! Algorithm 1 of the paper on one world.

use crate::control::LoopConfig;
use crate::control::learning::batch::Prior;
use crate::control::learning::identify::{Algorithm1, Identified, Next};
use crate::control::learning::schedule::Pose;
use crate::experiment::error::ExperimentError;
use crate::experiment::rig::Rig;
use crate::simulation::world::World;

/// Runs Algorithm 1 on one world, starting at `config.lines` or at the gains of the prior.
///
/// # Errors
/// [`ExperimentError`] from the world or the data.
pub fn algorithm_1(
    config: &LoopConfig,
    world: &mut dyn World,
    poses: &[Pose],
    prior: Option<&[Prior; 3]>,
    progress: &mut dyn FnMut(usize),
) -> Result<Identified, ExperimentError> {
    let (poses, prior) = (poses.to_vec(), prior.copied());
    let mut algorithm =
        Algorithm1::new(config.geometry, poses, config.lines, prior, config.dynamics);
    let open = LoopConfig {
        feedback: None,
        ..config.clone()
    };
    let mut rig = Rig::new(open, world);
    rig.align()?;
    rig.relearn(algorithm.lines());
    let mut command = Some(algorithm.command());
    loop {
        let (frame, sensed) = rig.advance(command.take())?;
        let piston_mm = rig.config.drive.piston_mm(&sensed.counted);
        let pass = algorithm.pass();
        let next = algorithm.step(&frame, &piston_mm, rig.period_s())?;
        if next != Next::Wait {
            progress(pass);
        }
        match next {
            Next::Wait => {}
            Next::Drive(pose) => command = Some(pose),
            Next::Lines(lines) => {
                rig.relearn(lines);
                command = Some(algorithm.command());
            }
            Next::Done(found) => return Ok(found),
        }
    }
}
