//! The gap, closed: the machine that a diagnosis describes as a plant, and the open loop through its inverse.

use crate::common::{described, evaluate, uncalibrated};
use retroflex::diagnosis::tip::Rig;
use retroflex::experiment::evaluation::{self, Arm, Plan};
use retroflex::model::described::RestReadings;
use retroflex::model::effects::by_name;
use retroflex::model::{DescribedMachine, Geometry, Line, nominal_theta};
use retroflex::simulation::described::Described;
use retroflex::simulation::world::World;
use std::sync::Arc;

/// The bend error of these arms on the plant that `machine` describes, through its model, degrees.
fn through_its_model(machine: DescribedMachine, arms: &[Arm]) -> Vec<f64> {
    let machine = Arc::new(machine);
    let config = uncalibrated();
    let step_mm = config.drive.step_mm;
    let config = retroflex::control::tick::LoopConfig {
        lines: machine.chain().lines,
        ..config
    };
    let plan = Plan {
        config,
        identify: false,
        arms: arms.to_vec(),
        seed: 0,
        rig: Rig::default(),
        track: None,
        feedforward: Some(Arc::clone(&machine)),
    };
    let mut open =
        |_| Ok(Box::new(Described::new(machine.as_ref().clone(), step_mm, 1)) as Box<dyn World>);
    let e = evaluation::run(&plan, &mut open, &mut |_| ()).unwrap();
    arms.iter()
        .map(|arm| e.arm(*arm).unwrap().bend_rmse_deg)
        .collect()
}

#[test]
fn through_the_right_model_both_loops_leave_little_of_the_gap() {
    let arms = [Arm::Backlash, Arm::Diagnosed, Arm::Closed];
    let left = through_its_model(described(), &arms);
    println!("backlash, diagnosed, closed: {left:.2?}°");
    assert!(
        left[0] > 3.0 && left[1] < 0.3 && left[2] < 0.3,
        "{left:.2?}"
    );
}

/// Each kind of law alone, where it bends the tip far from what the nominal channels do.
#[test]
fn a_described_machine_does_not_mislead_the_closed_loop() {
    let laws: [(&str, &[f64]); 5] = [
        ("leak", &[0.009, 0.008, 0.009, 1.0]),
        ("curvature", &[0.3, 0.2]),
        ("gravity", &[0.15, 0.8]),
        ("line_lag", &[0.3, 0.25, 0.35, 0.1, 0.1]),
        ("gear_periodic", &[0.2, -0.1, 0.15, 0.1, 0.05, -0.1, 3.2]),
    ];
    for (name, parameters) in laws {
        let lines = Line::each([2.1, 2.5, 2.3], [0.9; 3]);
        let machine = DescribedMachine::new(
            Geometry::default(),
            RestReadings::default(),
            &nominal_theta(&lines, 0.02),
            vec![(by_name(name).unwrap(), parameters.to_vec())],
        );
        let left = through_its_model(machine, &[Arm::Backlash, Arm::Closed]);
        println!("{name}: backlash, closed: {left:.2?}°");
        assert!(left[1] < 0.3, "{name}: {left:.2?}");
    }
}

#[test]
fn the_diagnosed_arm_of_the_twin_stays_below_one_degree_and_does_not_hunt() {
    let e = evaluate(0, &[Arm::Extension, Arm::Backlash, Arm::Diagnosed]);
    let of = |arm| e.arm(arm).unwrap().bend_rmse_deg;
    println!(
        "backlash {:.2}°, diagnosed {:.2}°",
        of(Arm::Backlash),
        of(Arm::Diagnosed)
    );
    assert!(
        of(Arm::Diagnosed) <= 0.75 && of(Arm::Backlash) > 5.0,
        "{} {}",
        of(Arm::Backlash),
        of(Arm::Diagnosed)
    );
    // poses in which a piston is at its limit as well
    let diagnosed = e.arm(Arm::Diagnosed).unwrap();
    assert!(diagnosed.peak_to_peak_max_deg < 0.3);
    // the twin knows what the nominal model does not
    assert_eq!(e.foretold.len(), 2);
    for f in &e.foretold {
        let off = |deg: f64| (deg / f.machine_deg - 1.0).abs();
        assert!(off(f.twin_deg) < 0.1 && off(f.nominal_deg) > 0.3, "{f:?}");
    }
}
