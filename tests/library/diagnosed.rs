//! The gap, closed: the machine that a diagnosis describes as a plant, and the open loop through its inverse.

use crate::common::{described, evaluate, uncalibrated};
use retroflex::diagnosis::rig::Rig;
use retroflex::experiment::evaluation::{self, Arm, Plan};
use retroflex::simulation::described::Described;
use retroflex::simulation::world::World;
use std::sync::Arc;

#[test]
fn the_open_loop_through_the_right_model_leaves_little_of_the_gap() {
    let machine = Arc::new(described());
    let config = uncalibrated();
    let step_mm = config.drive.step_mm;
    let config = retroflex::control::tick::LoopConfig {
        lines: machine.chain().lines,
        ..config
    };
    let arms = vec![Arm::Backlash, Arm::Diagnosed];
    let plan = Plan {
        config,
        identify: false,
        arms,
        seed: 0,
        rig: Rig::default(),
        track: None,
        feedforward: Some(Arc::clone(&machine)),
    };
    let mut open =
        |_| Ok(Box::new(Described::new(machine.as_ref().clone(), step_mm, 1)) as Box<dyn World>);
    let e = evaluation::run(&plan, &mut open, &mut |_| ()).unwrap();
    let of = |arm| e.arm(arm).unwrap().bend_rmse_deg;
    println!(
        "backlash {:.2}°, diagnosed {:.2}°",
        of(Arm::Backlash),
        of(Arm::Diagnosed)
    );
    assert!(
        of(Arm::Backlash) > 3.0 && of(Arm::Diagnosed) < 0.3,
        "{} {}",
        of(Arm::Backlash),
        of(Arm::Diagnosed)
    );
}

#[test]
fn the_diagnosed_arm_of_the_twin_stays_below_one_and_a_half_degrees() {
    let e = evaluate(0, &[Arm::Extension, Arm::Backlash, Arm::Diagnosed]);
    let of = |arm| e.arm(arm).unwrap().bend_rmse_deg;
    println!(
        "backlash {:.2}°, diagnosed {:.2}°",
        of(Arm::Backlash),
        of(Arm::Diagnosed)
    );
    assert!(
        of(Arm::Diagnosed) <= 1.5 && of(Arm::Backlash) > 5.0,
        "{} {}",
        of(Arm::Backlash),
        of(Arm::Diagnosed)
    );
    // the twin knows what the nominal model does not
    assert_eq!(e.foretold.len(), 2);
    for f in &e.foretold {
        let off = |deg: f64| (deg / f.machine_deg - 1.0).abs();
        assert!(off(f.twin_deg) < 0.1 && off(f.nominal_deg) > 0.3, "{f:?}");
    }
}
