//! Injected faults act, end when cleared, and leave their consequences.

use super::rig::{BEND, Rig, bend};
use retroflex::model::Bend;
use retroflex::primitives::sample::ImuSample;
use retroflex::simulation::plant::{BURST_PER_S, Output};

fn last(out: &[Output]) -> Output {
    *out.last().unwrap()
}

fn samples(rig: &mut Rig, seconds: f64) -> Vec<ImuSample> {
    rig.hold(seconds).iter().filter_map(|o| o.imu).collect()
}

#[test]
fn samples_freeze_become_nan_saturate_and_spike() {
    let mut rig = Rig::of("");
    samples(&mut rig, 0.5);
    rig.plant.faults.imu.frozen = true;
    let s = samples(&mut rig, 0.2);
    assert!(
        s.windows(2)
            .all(|w| w[0].gyro_rad_s == w[1].gyro_rad_s && w[1].t.0 > w[0].t.0)
    );
    rig.plant.clear();
    rig.plant.faults.imu.nan = true;
    assert!(samples(&mut rig, 0.1).iter().all(|s| !s.is_finite()));
    rig.plant.clear();
    rig.plant.faults.imu.saturated = true;
    assert!(
        samples(&mut rig, 0.1)
            .iter()
            .all(|s| (s.gyro_rad_s.amin().to_degrees() - 500.0).abs() < 0.1)
    );
    rig.plant.clear();
    rig.plant.faults.imu.spike = Some((300.0, 1.0));
    let s = samples(&mut rig, 0.1);
    assert!(s[0].gyro_rad_s.amin().to_degrees() > 290.0 && s[0].acc_m_s2.x > 9.0);
    assert!(
        s[1..]
            .iter()
            .all(|s| s.gyro_rad_s.norm().to_degrees() < 3.0)
    );
}

#[test]
fn a_bias_fault_shifts_the_readings() {
    let mut rig = Rig::clean("");
    rig.plant.faults.imu.rate_deg_s = [3.0, 0.0, 0.0];
    let s = samples(&mut rig, 0.1)[0];
    assert!((s.gyro_rad_s.x.to_degrees() - 3.0).abs() < 1e-9);
    rig.plant.clear();
    assert!(samples(&mut rig, 0.1)[0].gyro_rad_s.norm() < 1e-9);
}

#[test]
fn drives_lose_steps_invert_stop_and_switch_off() {
    let mut rig = Rig::clean("");
    rig.plant.slip(1, 100);
    let lost = rig.at([0.0; 3]);
    assert!(lost.norm() > 3.0);
    rig.plant.clear();
    assert!(
        (rig.at([0.0; 3]) - lost).norm() < 1e-9,
        "lost steps stay lost"
    );

    let play_output = |rig: &mut Rig, to: f64| {
        rig.at([to, 0.0, 0.0]);
        last(&rig.hold(0.01)).truth.play_output_mm.x
    };
    let mut rig = Rig::clean("");
    rig.plant.faults.drive_gain[0] = -1.0;
    assert!((play_output(&mut rig, 5.0) + 5.0).abs() < 0.02);
    let mut rig = Rig::clean("");
    rig.plant.faults.drive_gain[0] = 0.0;
    assert_eq!(play_output(&mut rig, 5.0), 0.0);
    rig.plant.clear();
    assert!(
        (play_output(&mut rig, 6.0) - 1.0).abs() < 0.03,
        "steps sent meanwhile are lost"
    );
    let mut rig = Rig::clean("");
    rig.plant.faults.stop_mm[0] = Some(-4.0);
    assert!(
        (play_output(&mut rig, 7.0) - 7.0).abs() < 0.02
            && (play_output(&mut rig, -9.0) + 4.0).abs() < 0.02
    );
    assert!(
        (play_output(&mut rig, -8.0) + 3.0).abs() < 0.03,
        "the rack leaves the stop at once, 5 mm short"
    );
}

#[test]
fn lines_leak_burst_block_and_admit_air() {
    let pressure = |rig: &mut Rig, seconds: f64| last(&rig.hold(seconds)).truth.pressure_kpa.x;
    let mut rig = Rig::clean("");
    rig.at(BEND);
    let held = pressure(&mut rig, 1.0);
    rig.plant.faults.leak_per_s[0] = 0.05;
    let leaked = pressure(&mut rig, 10.0);
    assert!(
        (leaked / held - (-0.5f64).exp()).abs() < 0.01,
        "{leaked} {held}"
    );
    rig.plant.faults.leak_per_s[0] = BURST_PER_S;
    assert!(pressure(&mut rig, 1.0).abs() < 1e-3);
    rig.plant.clear();
    assert!(pressure(&mut rig, 1.0).abs() < 1e-3, "escaped air is gone");
    assert!(rig.at([0.0; 3]).norm() > 10.0);

    let mut rig = Rig::clean("");
    rig.at(BEND);
    rig.plant.faults.blocked[0] = true;
    let before = last(&rig.hold(0.01)).truth.bellow_mm.x;
    rig.at([0.0; 3]);
    assert!((last(&rig.hold(0.01)).truth.bellow_mm.x - before).abs() < 1e-9);
    rig.plant.clear();
    assert!(bend(&last(&rig.hold(1.0))).norm() < 1e-6);

    let mut rig = Rig::clean("");
    let before = rig.at(BEND).norm();
    rig.plant.faults.compliance[0] = 1.5;
    assert!(bend(&last(&rig.hold(1.0))).norm() < before - 3.0);
    rig.plant.clear();
    rig.plant.faults.bellow_gain[0] = 1.5;
    assert!(bend(&last(&rig.hold(1.0))).norm() > before + 3.0);
}

#[test]
fn the_base_turns_and_magnets_pushes_and_walls_act() {
    let mut rig = Rig::clean("");
    let rest = samples(&mut rig, 1.0)[0];
    rig.plant.turn_base([0.0, 2.0, 0.0], 10.0, 2.0);
    let s = samples(&mut rig, 3.0);
    let end = *s.last().unwrap();
    assert!((end.acc_m_s2.angle(&rest.acc_m_s2).to_degrees() - 10.0).abs() < 1e-3);
    let turned: f64 = s.iter().map(|s| s.gyro_rad_s.y * 0.002).sum();
    assert!((turned.to_degrees() - 10.0).abs() < 0.01);
    rig.plant.clear();
    assert!(
        (samples(&mut rig, 0.1)[0].acc_m_s2 - end.acc_m_s2).norm() < 1e-6,
        "the base stays turned"
    );

    let mag = |rig: &mut Rig| {
        samples(rig, 0.1)
            .iter()
            .rev()
            .find_map(|s| s.mag_ut)
            .unwrap()
    };
    let mut rig = Rig::clean("");
    let before = mag(&mut rig);
    rig.plant.faults.magnet_ut = [30.0, 0.0, 0.0].into();
    assert!(((mag(&mut rig) - before).norm() - 30.0).abs() < 1e-6);

    rig.plant.faults.push = Bend::from_deg(12.0, 90.0);
    let pushed = bend(&last(&rig.hold(0.1)));
    assert!(pushed.x.abs() < 1e-6 && (pushed.y - 12.0).abs() < 1e-6);
    rig.plant.clear();
    assert!(bend(&last(&rig.hold(0.1))).norm() < 1e-6);

    let free = rig.at(BEND).x;
    rig.plant.put_wall(20.0, 0.0);
    let out = last(&rig.hold(0.1));
    assert!(out.truth.wall_touched && bend(&out).x < free - 8.0);
    rig.plant.clear();
    assert!(!last(&rig.hold(0.1)).truth.wall_touched);
}
