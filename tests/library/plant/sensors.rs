//! The IMU measures the true motion, and each sensor effect changes only its own readings.

use super::rig::{BEND, Rig, bend, config, perfect_imu, wander};
use nalgebra::{UnitQuaternion, Vector3};
use retroflex::primitives::sample::ImuSample;
use retroflex::primitives::units::Steps;
use retroflex::simulation::plant::{Output, Plant, imu::chip::ImuConfig};

const UP: f64 = 9.81;

fn samples(out: &[Output]) -> Vec<ImuSample> {
    out.iter().filter_map(|o| o.imu).collect()
}

/// World attitude of the plate as the configuration turns it.
fn plate(yaw: f64, pitch: f64, roll: f64) -> UnitQuaternion<f64> {
    let turn =
        |axis: Vector3<f64>, deg: f64| UnitQuaternion::from_scaled_axis(axis * deg.to_radians());
    turn(Vector3::z(), yaw) * turn(Vector3::y(), pitch) * turn(Vector3::x(), roll)
}

#[test]
fn a_still_sensor_reads_gravity_and_the_field() {
    let mut rig = Rig::clean("[base]\nyaw_deg = 40.0\npitch_deg = 65.0\nroll_deg = -20.0");
    let s = samples(&rig.hold(1.0));
    let r = plate(40.0, 65.0, -20.0);
    let field = Vector3::new(65f64.to_radians().cos(), 0.0, -65f64.to_radians().sin()) * 48.0;
    for x in &s {
        assert!((x.acc_m_s2 - r.inverse_transform_vector(&(Vector3::z() * UP))).norm() < 1e-9);
        assert!(x.gyro_rad_s.norm() < 1e-12);
        assert!(
            x.mag_ut
                .is_none_or(|m| (m - r.inverse_transform_vector(&field)).norm() < 1e-9)
        );
    }
    assert_eq!(s.len(), 500);
    assert_eq!(s.iter().filter(|x| x.mag_ut.is_some()).count(), 100);
    // lying on its side, the axis that points up reads +9.81
    let side = samples(&Rig::clean("[base]\npitch_deg = -90.0").hold(0.1))[0].acc_m_s2;
    assert!((side - Vector3::new(UP, 0.0, 0.0)).norm() < 1e-9, "{side}");
}

#[test]
fn the_integrated_gyroscope_is_the_orientation() {
    let mut c = config(
        "[base]\npitch_deg = 80.0\n[effects.gravity]\nsag_deg = 5.0\n[effects.torsion]\ntwist_deg = 12.0\n[effects.creep]\nshare = 0.2",
    );
    c.imu = perfect_imu();
    for dt in [0.0005, 0.001, 0.003, 0.01] {
        let mut rig = Rig::new(&c);
        rig.dt_s = dt;
        let (mut q, mut last_t, mut worst) = (UnitQuaternion::identity(), 0.0, 0.0f64);
        for o in wander(&mut rig) {
            let Some(s) = o.imu else { continue };
            q *= UnitQuaternion::from_scaled_axis(s.gyro_rad_s * (s.t.0 - last_t));
            last_t = s.t.0;
            worst = worst.max(q.angle_to(&o.truth.r_base_tip.quat()));
        }
        assert!(worst < 1e-6, "{dt}: {worst}");
    }
}

#[test]
fn gravity_and_field_agree_with_the_true_orientation_once_still() {
    let mut rig = Rig::clean("[base]\nyaw_deg = 100.0\npitch_deg = 50.0");
    let first = samples(&rig.hold(0.1))[0];
    rig.at(BEND);
    let out = rig.hold(1.0);
    let (o, s) = out
        .iter()
        .rev()
        .find_map(|o| o.imu.filter(|s| s.mag_ut.is_some()).map(|s| (o, s)))
        .unwrap();
    let r = o.truth.r_base_tip;
    assert!(bend(o).norm() > 30.0);
    assert!((r.apply(&Vector3::from(s.acc_m_s2)) - first.acc_m_s2).norm() < 1e-4);
    let rest_mag = Rig::clean("[base]\nyaw_deg = 100.0\npitch_deg = 50.0")
        .hold(0.1)
        .iter()
        .find_map(|o| o.imu?.mag_ut)
        .unwrap();
    assert!((r.apply(&s.mag_ut.unwrap()) - rest_mag).norm() < 1e-4);
}

#[test]
fn the_accelerometer_measures_the_motion_of_the_tip() {
    let mut rig = Rig::clean("");
    let out = [rig.hold(0.5), rig.go(BEND, 20.0), rig.hold(1.0)].concat();
    // specific force minus gravity, integrated twice, is the displacement of the tip
    let (mut v, mut x, mut last_t) = (Vector3::zeros(), Vector3::zeros(), 0.0);
    for o in &out {
        let Some(s) = o.imu else { continue };
        let dt = s.t.0 - last_t;
        last_t = s.t.0;
        v += (o.truth.r_base_tip.apply(&s.acc_m_s2) - Vector3::z() * UP) * dt;
        x += v * dt;
    }
    let end = out.last().unwrap();
    let length = 20.0 + end.truth.bellow_mm.mean();
    let b = bend(end).map(f64::to_radians);
    let beta = b.norm();
    let want = Vector3::new(
        b.x * (1.0 - beta.cos()) / beta / beta,
        -b.y * (1.0 - beta.cos()) / beta / beta,
        beta.sin() / beta,
    ) * length
        - Vector3::z() * 20.0;
    assert!((x * 1e3 - want).norm() < 0.02, "{} {want}", x * 1e3);
}

/// Whether an effect changes the readings of (gyroscope, accelerometer, magnetometer).
fn differs(effect: &str) -> (bool, bool, bool) {
    let run = |text: &str| {
        let mut rig = Rig::of(text);
        samples(&wander(&mut rig))
    };
    let (with, without) = (run(effect), run(""));
    assert_eq!(with.len(), without.len());
    let any =
        |f: fn(&ImuSample, &ImuSample) -> bool| with.iter().zip(&without).any(|(a, b)| f(a, b));
    (
        any(|a, b| a.gyro_rad_s != b.gyro_rad_s),
        any(|a, b| a.acc_m_s2 != b.acc_m_s2),
        any(|a, b| a.mag_ut != b.mag_ut),
    )
}

#[test]
fn each_sensor_effect_changes_its_own_sensor_only() {
    assert_eq!(
        differs("[effects.gyro_bias]\nwarm_up_deg_s = [1.0, 0.5, -0.5]"),
        (true, false, false)
    );
    assert_eq!(
        differs("[effects.accel_bias]\nbias_mg = [50.0, -30.0, 20.0]"),
        (false, true, false)
    );
    assert_eq!(
        differs("[effects.hard_iron]\noffset_ut = [10.0, 0.0, 5.0]"),
        (false, false, true)
    );
    assert_eq!(
        differs("[effects.motor_field]\namplitude_ut = [5.0, 5.0, 5.0]"),
        (false, false, true)
    );
    assert_eq!(
        differs("[effects.mount_misalignment]\ntilt_deg = [5.0, 3.0, 8.0]"),
        (true, true, true)
    );
    assert_eq!(
        differs("[effects.outside.gyro_scale]\nshare = [0.1, 0.1, 0.1]"),
        (true, false, false)
    );
    assert_eq!(
        differs("[effects.outside.g_sensitivity]\ndeg_s_per_g = [1.0, 1.0, 1.0]"),
        (true, false, false)
    );
    assert_eq!(
        differs("[effects.outside.acc_scale]\nshare = [0.1, 0.1, 0.1]"),
        (false, true, false)
    );
    assert_eq!(
        differs("[effects.outside.soft_iron]\nstretch = 0.2"),
        (false, false, true)
    );
}

#[test]
fn gyro_bias_drifts_from_zero() {
    let mut rig = Rig::clean("[effects.gyro_bias]\nwarm_up_deg_s = [2.0, 0.0, 0.0]\nover_s = 20.0");
    let s = samples(&rig.hold(100.0));
    let deg = |k: usize| s[k].gyro_rad_s.x.to_degrees();
    assert!(deg(0) < 0.01 && deg(5_000) > 0.5 && deg(49_000) > 1.8 && deg(49_000) < 2.0);
}

#[test]
fn accel_bias_changes_the_norm_with_attitude() {
    let norm = |pitch: f64| {
        samples(
            &Rig::clean(&format!(
                "[base]\npitch_deg = {pitch}\n[effects.accel_bias]\nbias_mg = [0.0, 0.0, 60.0]"
            ))
            .hold(0.1),
        )[0]
        .acc_m_s2
        .norm()
    };
    assert!(norm(0.0) > UP + 0.55 && norm(180.0) < UP - 0.55 && (norm(90.0) - UP).abs() < 0.05);
}

#[test]
fn hard_iron_is_fixed_to_the_body_and_the_motors_to_the_world() {
    let mag = |text: &str, pitch: f64| {
        let all = Rig::clean(&format!("[base]\npitch_deg = {pitch}\n{text}")).hold(0.5);
        all.iter().rev().find_map(|o| o.imu?.mag_ut).unwrap()
    };
    let off = |text: &str, pitch: f64| mag(text, pitch) - mag("", pitch);
    let iron = "[effects.hard_iron]\noffset_ut = [10.0, 0.0, 0.0]\nviscous = 0.0";
    assert!((off(iron, 0.0) - off(iron, 120.0)).norm() < 1e-9);
    let motors = "[effects.motor_field]\namplitude_ut = [5.0, 0.0, 0.0]";
    let (a, b) = (off(motors, 0.0), off(motors, 120.0));
    assert!((a - b).norm() > 1.0 && (plate(0.0, 120.0, 0.0) * b - a).norm() < 1e-9);
}

#[test]
fn the_motor_field_follows_the_coils_and_falls_at_idle() {
    let field = |steps: i32| {
        let mut c = config(
            "[effects.motor_field]\namplitude_ut = [5.0, 0.0, 0.0]\n[shape]\nr_mm = [20.0, 20.0, 20.0]\n[line]\nk_epsilon = [20.0, 20.0, 20.0]",
        );
        c.imu = ImuConfig {
            mag_period_s: 0.002,
            ..perfect_imu()
        };
        let mut plant = Plant::new(&c, 1).unwrap();
        let mut last = Vector3::zeros();
        let mut first = Vector3::zeros();
        for k in 0..1500 {
            // equal counts: the tip lengthens and stays straight
            if let Some(m) = plant
                .step(&Steps([steps; 3]), 0.001)
                .imu
                .and_then(|s| s.mag_ut)
            {
                last = m;
                if k < 3 {
                    first = m;
                }
            }
        }
        (first, last)
    };
    let earth = Vector3::new(65f64.to_radians().cos(), 0.0, -65f64.to_radians().sin()) * 48.0;
    let (moving, idle) = field(16);
    assert!(((moving - earth).norm() / (idle - earth).norm() - 2.0).abs() < 0.05);
    assert!(
        (field(16).1 - field(80).1).norm() < 0.02,
        "64 microsteps are one turn of the coils"
    );
    assert!((field(16).1 - field(48).1).norm() > 2.0);
}

#[test]
fn a_tilted_chip_is_a_constant_rotation() {
    let text = "[effects.mount_misalignment]\ntilt_deg = [4.0, -3.0, 7.0]\ngive = 0.0";
    let (a, b) = (
        samples(&wander(&mut Rig::clean(text))),
        samples(&wander(&mut Rig::clean(""))),
    );
    let r = UnitQuaternion::from_scaled_axis(Vector3::new(4.0, -3.0, 7.0).map(f64::to_radians));
    for (x, y) in a.iter().zip(&b) {
        assert!(
            (r * x.acc_m_s2 - y.acc_m_s2).norm() < 1e-9
                && (r * x.gyro_rad_s - y.gyro_rad_s).norm() < 1e-9
        );
    }
}

#[test]
fn latency_delays_the_samples_only() {
    let path = |text: &str| {
        let mut rig = Rig::clean(text);
        [rig.hold(1.0), rig.go(BEND, 20.0), rig.hold(1.0)].concat()
    };
    let (a, b) = (
        path("[effects.sensor_latency]\nlatency_s = 0.1\njitter = 0.0"),
        path(""),
    );
    assert!(a.iter().zip(&b).all(|(x, y)| x.truth == y.truth));
    let (s, r) = (samples(&a), samples(&b));
    let worst = (50..s.len())
        .map(|k| (s[k].gyro_rad_s - r[k - 50].gyro_rad_s).norm())
        .fold(0.0, f64::max);
    assert!(worst < 1e-9, "{worst}");
    assert!(s.iter().zip(&r).all(|(x, y)| x.t == y.t));
}

#[test]
fn clocks_drift_and_sensors_freeze() {
    let s = samples(&Rig::of("[effects.outside.clock_drift]\nper_mille = 10.0").hold(10.0));
    assert!((s.last().unwrap().t.0 - 10.1).abs() < 1e-6);
    let s = samples(&Rig::of("[effects.outside.sensor_freeze]\nfor_s = 1.0\nat_s = 2.0").hold(4.0));
    let frozen = s
        .windows(2)
        .filter(|w| {
            w[0].gyro_rad_s == w[1].gyro_rad_s && w[0].acc_m_s2 == w[1].acc_m_s2 && w[0].t != w[1].t
        })
        .count();
    assert!((498..=502).contains(&frozen), "{frozen}");
}
