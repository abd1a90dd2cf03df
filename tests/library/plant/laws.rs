//! Properties of every plant: determinism, size 0, independence of the step, no NaN.

use super::rig::{Rig, bend, config, wander};
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use retroflex::primitives::frames::{Base, Rotation, Tip};
use retroflex::primitives::units::Steps;
use retroflex::simulation::plant::{EffectName, Plant, PlantConfig, effect_names};

fn rng(seed: u64) -> Xoshiro256PlusPlus {
    Xoshiro256PlusPlus::seed_from_u64(seed)
}

fn empty_table(e: &EffectName) -> PlantConfig {
    let table = if e.in_catalogue {
        "effects"
    } else {
        "effects.outside"
    };
    config(&format!("[{table}.{}]\n[base]\nimu = true", e.name))
}

#[test]
fn size_zero_is_bit_identical_to_none() {
    let none = wander(&mut Rig::of("[base]\nimu = true"));
    for e in effect_names() {
        let zero = empty_table(e);
        assert_ne!(
            zero.effects,
            PlantConfig::default().effects,
            "{} is not in the table",
            e.name
        );
        assert!(
            wander(&mut Rig::new(&zero)) == none,
            "{} of size 0 changes the output",
            e.name
        );
    }
}

/// Sensor effects never move the tip; mechanical effects always do.
#[test]
fn every_effect_acts_on_its_own_stage() {
    let none = wander(&mut Rig::of(""));
    for e in effect_names() {
        let one = PlantConfig::default()
            .with_effect(e.name, 0.7, &mut rng(3))
            .unwrap();
        let mut c = one.clone();
        // times and attitudes at which the effects act within a short log
        c.base.pitch_deg = 0.0;
        if let Some(m) = &mut c.effects.missed_steps {
            m.after_s = 3.0;
        }
        if let Some(m) = &mut c.effects.base_motion {
            m.at_s = 4.0;
        }
        if let Some(m) = &mut c.effects.outside.bubble_jump {
            m.at_s = 5.0;
        }
        if let Some(m) = &mut c.effects.outside.sensor_freeze {
            m.at_s = 3.0;
        }
        if let Some(m) = &mut c.effects.outside.snap_through {
            m.at_mm = 1.0;
        }
        if let Some(m) = &mut c.effects.contact {
            (m.direction_deg, m.at_deg) = (0.0, 15.0);
        }
        let out = wander(&mut Rig::new(&c));
        let moved = out
            .iter()
            .zip(&none)
            .any(|(a, b)| a.truth.r_base_tip.angle_to(&b.truth.r_base_tip) > 0.1f64.to_radians());
        let sensed = out.iter().zip(&none).any(|(a, b)| a.imu != b.imu);
        let unmoved = e.stage == "sensor"
            || e.stage == "base"
            || ["sensor_latency", "clock_drift", "sensor_freeze"].contains(&e.name);
        assert!(sensed, "{} changes no sample", e.name);
        assert_eq!(moved, !unmoved, "{}", e.name);
    }
}

#[test]
fn seed_and_configuration_fix_every_bit() {
    let busy = super::twin::paper_twin();
    let run = |seed| {
        let mut rig = Rig::new(&busy);
        rig.plant = Plant::new(&busy, seed).unwrap();
        wander(&mut rig)
    };
    let (a, b, c) = (run(1), run(1), run(2));
    assert!(a == b);
    assert!(a.iter().zip(&c).any(|(x, y)| x.imu != y.imu));
    assert!(
        a.iter().zip(&c).all(|(x, y)| x.truth == y.truth),
        "noise must not move the tip"
    );
}

/// Orientation every 10 ms under counts that change every 10 ms, the plant stepped by `dt_s`.
fn every_10_ms(c: &PlantConfig, dt_s: f64) -> Vec<Rotation<Base, Tip>> {
    let mut plant = Plant::new(c, 5).unwrap();
    let per = (0.01 / dt_s).round() as usize;
    (0..1500)
        .map(|k| {
            let t = f64::from(k) * 0.01;
            let s = |f: f64, a: f64| (a * (f * t).sin()).round() as i32;
            let steps = Steps([s(1.1, 300.0), s(0.7, -340.0), s(1.7, 200.0)]);
            (0..per)
                .map(|_| plant.step(&steps, dt_s).truth.r_base_tip)
                .last()
                .unwrap()
        })
        .collect()
}

fn furthest_deg(a: &[Rotation<Base, Tip>], b: &[Rotation<Base, Tip>]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(x, y)| x.angle_to(y).to_degrees())
        .fold(0.0, f64::max)
}

#[test]
fn the_output_does_not_depend_on_the_step() {
    let nominal = every_10_ms(&PlantConfig::default(), 0.001);
    for dt in [0.0005, 0.005, 0.01] {
        let d = furthest_deg(&nominal, &every_10_ms(&PlantConfig::default(), dt));
        assert!(d < 1e-6, "{dt}: {d}");
    }
    // with effects, the remaining difference is the path of the lag through nonlinear stages
    let twin = super::twin::paper_twin();
    let fine = every_10_ms(&twin, 0.0005);
    for (dt, limit) in [(0.001, 0.02), (0.005, 0.1), (0.01, 0.2)] {
        let d = furthest_deg(&fine, &every_10_ms(&twin, dt));
        assert!(d < limit, "{dt}: {d}");
    }
}

#[test]
fn each_effect_alone_hardly_depends_on_the_step() {
    for e in effect_names() {
        let mut c = PlantConfig::default()
            .with_effect(e.name, 0.5, &mut rng(8))
            .unwrap();
        // random in time, or triggered by a threshold that a coarse step can miss
        if let Some(d) = &mut c.effects.transport_delay {
            d.jitter = 0.0;
        }
        if ["missed_steps", "stick_slip", "snap_through"].contains(&e.name) {
            continue;
        }
        let d = furthest_deg(&every_10_ms(&c, 0.001), &every_10_ms(&c, 0.005));
        assert!(d < 0.25, "{}: {d}", e.name);
    }
}

#[test]
fn no_effect_produces_a_nan() {
    for seed in 0..6 {
        let mut r = rng(seed);
        let mut c = PlantConfig::default();
        for e in effect_names() {
            c = c.with_effect(e.name, 1.0, &mut r).unwrap();
        }
        c.base.imu = true;
        let mut plant = Plant::new(&c, seed).unwrap();
        let mut counts = [0i32; 3];
        let dt = [0.0005, 0.001, 0.002, 0.005, 0.01][seed as usize % 5];
        for k in 0..8000 {
            if k % 150 == 0 {
                counts = std::array::from_fn(|_| r.random_range(-1000..1000));
            }
            let out = plant.step(&Steps(counts), dt);
            let t = &out.truth;
            assert!(
                (t.r_base_tip.quat().norm() - 1.0).abs() < 1e-9,
                "seed {seed} step {k}"
            );
            let all = [t.bellow_mm, t.play_output_mm, t.pressure_kpa];
            assert!(
                all.iter().flat_map(|v| v.iter()).all(|x| x.is_finite()),
                "seed {seed} step {k}: {out:?}"
            );
            assert!(
                out.imu.iter().chain(&out.base_imu).all(|s| s.is_finite()),
                "seed {seed} step {k}: {out:?}"
            );
        }
    }
}

#[test]
fn each_imperfection_is_small() {
    let lab = |c: &PlantConfig| {
        let mut rig = Rig::new(c);
        wander(&mut rig)
    };
    let quiet = config(
        "[imu]\ngyro_noise_deg_s_rthz = 0.0\nacc_noise_mg_rthz = 0.0\nmag_noise_ut = 0.0\nmag_digit_ut = 0.0\nacc_digit_mg = 0.0",
    );
    let none = lab(&quiet);
    let mut seen = std::collections::BTreeSet::new();
    for seed in 0..12 {
        let all = toml::Table::try_from(quiet.clone().background(&mut rng(seed))).unwrap();
        let effects = all["effects"].as_table().unwrap().clone();
        for (name, table) in effects.iter().filter(|(name, _)| *name != "outside") {
            let mut one = toml::Table::try_from(&quiet).unwrap();
            one.insert(
                "effects".to_owned(),
                toml::Table::from_iter([(name.clone(), table.clone())]).into(),
            );
            let out = lab(&one.try_into().unwrap());
            let n = out.len() as f64;
            let rms = |f: &dyn Fn(usize) -> f64| {
                ((0..out.len()).map(|k| f(k).powi(2)).sum::<f64>() / n)
                    .sqrt()
                    .to_degrees()
            };
            let moved = rms(&|k| out[k].truth.r_base_tip.angle_to(&none[k].truth.r_base_tip));
            let tilted = rms(&|k| {
                out[k]
                    .imu
                    .zip(none[k].imu)
                    .map_or(0.0, |(a, b)| a.acc_m_s2.angle(&b.acc_m_s2))
            });
            let turned = rms(&|k| {
                out[k]
                    .imu
                    .zip(none[k].imu)
                    .and_then(|(a, b)| Some(a.mag_ut?.angle(&b.mag_ut?)))
                    .unwrap_or(0.0)
            });
            assert!(
                moved < 0.15 && tilted < 0.15 && turned < 0.15,
                "{name}: {moved} {tilted} {turned}"
            );
            assert!(
                moved.max(tilted).max(turned) > 0.0005,
                "{name} does nothing"
            );
            seen.insert(name.clone());
        }
    }
    assert_eq!(seen.len(), 19, "{seen:?}");
    // together they are small as well
    assert!(bend(none.last().unwrap()).norm() < 10.0);
}
