//! Algorithm 1 on five units.

use crate::common::{identified, unit};
use nalgebra::Vector3;
use retroflex::control::learning::batch::{Measurement, solve};
use retroflex::control::tick::LoopConfig;
use retroflex::experiment::rig::Rig;
use retroflex::experiment::schedule::{HOLD_S, paper};
use retroflex::model::arc::Shape;
use retroflex::model::bend::Bend;
use retroflex::model::transmission::Line;
use retroflex::primitives::units::Mm;
use retroflex::simulation::sim::Sim;

/// Effective gains of Eq. 16 on this unit: the least-squares fit to the true orientation, after `warm` rounds of the same
/// poses in which air and rubber settle.
fn effective(config: &LoopConfig, mut world: Sim, warm: usize) -> [Line; 3] {
    let (mut last, mut side, mut travel) =
        (Vector3::<f64>::zeros(), Vector3::zeros(), Vector3::zeros());
    let open = LoopConfig {
        feedback: None,
        ..config.clone()
    };
    let mut rig = Rig::new(open, &mut world);
    rig.align().unwrap();
    let mut data = Vec::new();
    for (round, pose) in
        (0..=warm).flat_map(|round| paper().into_iter().map(move |pose| (round, pose)))
    {
        let mut command = Some(Shape {
            bend: pose.bend(),
            length: Mm(config.geometry.rest_length_mm),
        });
        let mut bend = Bend::STRAIGHT;
        for _ in 0..(HOLD_S / rig.period_s()).round() as usize {
            let sensed = rig.advance(command.take()).unwrap().1;
            bend = Bend::nearest(&sensed.truth.unwrap());
            let now = config.drive.piston_mm(&sensed.counted);
            for i in 0..3 {
                let step = now[i] - last[i];
                if step != 0.0 && step.signum() != side[i] {
                    (side[i], travel[i]) = (step.signum(), 0.0);
                }
                travel[i] += step.abs();
            }
            last = now;
        }
        let bellow_mm = config.geometry.lengths(&Shape {
            bend,
            length: Mm(config.geometry.rest_length_mm),
        });
        if round == warm {
            data.push(Measurement {
                piston_mm: last,
                bellow_mm,
                side,
                weight: travel.map(|t| f64::from(u8::from(t > 2.4))),
            });
        }
    }
    solve(&data, None).unwrap().map(|e| e.line)
}

#[test]
fn algorithm_1_converges_within_the_papers_count_to_the_effective_gains() {
    for seed in 0..=4 {
        let (config, found) = identified(seed);
        let truth = effective(&config, unit(seed, 50), found.history.len() - 2);
        println!(
            "unit {seed}: {} passes, found {:?}, effective {truth:?}",
            found.history.len() - 1,
            found.lines()
        );
        assert!(found.converged && found.history.len() - 1 <= 7);
        for (i, (ours, true_line)) in found.lines().iter().zip(&truth).enumerate() {
            assert!(
                (ours.k_epsilon / true_line.k_epsilon - 1.0).abs() < 0.05,
                "unit {seed}, channel {}: k_ε {ours:?}, effective {true_line:?}",
                i + 1
            );
            assert!(
                (ours.k_lambda_mm / true_line.k_lambda_mm - 1.0).abs() < 0.05,
                "unit {seed}, channel {}: k_λ {ours:?}, effective {true_line:?}",
                i + 1
            );
        }
    }
}
