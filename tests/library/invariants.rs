//! Invariants to the last bit: equal seeds give equal frames, and the loop never reads the true orientation.

use crate::common::{uncalibrated, unit};
use nalgebra::{UnitQuaternion, Vector3};
use retroflex::control::tick::{Frame, LoopConfig};
use retroflex::experiment::evaluation::for_world;
use retroflex::experiment::rig::Rig;
use retroflex::experiment::schedule::paper;
use retroflex::model::Shape;
use retroflex::model::transmission::Line;
use retroflex::motion::machine::{MachineError, MachineInfo};
use retroflex::primitives::frames::Rotation;
use retroflex::primitives::units::{Mm, Steps};
use retroflex::simulation::world::{Reply, World};

/// Thirty seconds of closed loop on a world.
fn frames(world: &mut dyn World) -> Vec<Frame> {
    let config = for_world(&uncalibrated(), world);
    let lines = [2.3, 2.4, 2.2].map(|k_epsilon| Line {
        k_epsilon,
        k_lambda_mm: 0.8,
    });
    let length = Mm(config.geometry.rest_length_mm);
    let mut rig = Rig::new(LoopConfig { lines, ..config }, world);
    rig.align().unwrap();
    let mut all = Vec::new();
    for pose in paper().iter().step_by(6) {
        let mut command = Some(Shape {
            bend: pose.bend(),
            length,
        });
        for _ in 0..1500 {
            all.push(rig.advance(command.take()).unwrap().0);
        }
    }
    all
}

/// Bits of the results in a frame. The operator `==` would treat −0 as 0 and NaN as unequal.
fn bits(frame: &Frame) -> Vec<u64> {
    let numbers = [
        frame.t.0,
        frame.unexplained.x,
        frame.unexplained.y,
        frame.feedback.x,
        frame.feedback.y,
        frame.dynamics.lag_s,
        frame.dynamics.delay_s,
    ];
    let estimate = frame.estimate.map_or([0.0; 3], |f| {
        [f.bend.0.x, f.bend.0.y, f.sigma_rad.unwrap_or(-1.0)]
    });
    let steps = frame.steps.0.map(f64::from);
    let vectors = [frame.bellow_mm, frame.piston_target_mm]
        .into_iter()
        .flat_map(|v| [v.x, v.y, v.z]);
    numbers
        .into_iter()
        .chain(estimate)
        .chain(steps)
        .chain(frame.k_epsilon)
        .chain(vectors)
        .map(f64::to_bits)
        .collect()
}

#[test]
fn equal_seeds_give_equal_frames_to_the_last_bit() {
    let (a, b, other) = (
        frames(&mut unit(3, 1)),
        frames(&mut unit(3, 1)),
        frames(&mut unit(3, 2)),
    );
    assert!(a.len() > 20_000);
    for (x, y) in a.iter().zip(&b) {
        assert_eq!(bits(x), bits(y), "at {} s", x.t.0);
    }
    assert!(
        a.iter().zip(&other).any(|(x, y)| bits(x) != bits(y)),
        "another seed must give other noise"
    );
}

/// A world that reports a wrong true orientation.
struct WrongTruth<W>(W);

impl<W: World> World for WrongTruth<W> {
    fn info(&self) -> &MachineInfo {
        self.0.info()
    }
    fn step(&mut self, steps: &Steps) -> Result<Reply, MachineError> {
        let reply = self.0.step(steps)?;
        let t = reply.imu.map_or(0.0, |imu| imu.t.0);
        let wrong = UnitQuaternion::from_scaled_axis(Vector3::new(t.sin(), 0.7, -0.2 * t));
        Ok(Reply {
            truth: Some(Rotation::assert_frames(wrong)),
            ..reply
        })
    }
}

#[test]
fn the_loop_never_reads_the_true_orientation() {
    let (right, wrong) = (frames(&mut unit(5, 1)), frames(&mut WrongTruth(unit(5, 1))));
    for (x, y) in right.iter().zip(&wrong) {
        assert_eq!(bits(x), bits(y), "at {} s", x.t.0);
    }
}
