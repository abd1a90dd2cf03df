//! Every effect has its characteristic signature.

use super::rig::{BEND, Rig, bend, config, perfect_imu};
use nalgebra::Vector2;
use retroflex::simulation::plant::Output;

/// Bend angles of the outputs, degrees.
fn bends(out: &[Output]) -> Vec<f64> {
    out.iter().map(|o| bend(o).norm()).collect()
}

fn scaled(by: f64) -> [f64; 3] {
    BEND.map(|x| x * by)
}

/// Pistons that bend by the same amount to direction `deg`.
fn towards(deg: f64) -> [f64; 3] {
    std::array::from_fn(|i| -10.0 * (deg + 120.0 * i as f64).to_radians().cos())
}

#[test]
fn the_nominal_plant_has_constant_curvature() {
    let mut rig = Rig::clean("");
    let b = rig.at(BEND);
    // unequal gains change the direction; with equal ones it is exact
    let equal = Rig::clean("[line]\nk_epsilon = [2.0, 2.0, 2.0]").at(BEND);
    assert!(b.norm() > 40.0 && equal.y.abs() < 0.1);
    assert!(
        (equal.x - (10.0 / 3.0 / (7.0 / 3f64.sqrt())).to_degrees()).abs() < 0.3,
        "{equal}"
    );
    assert!(rig.at([0.0; 3]).norm() < 1e-9, "no memory without play");
}

#[test]
fn play_loses_motion_at_reversals() {
    let mut rig = Rig::of("[line]\nk_lambda_mm = [1.0, 1.0, 1.0]");
    let there = rig.at(BEND);
    let lost = rig.at(BEND.map(|x| x - 1.9 * x.signum()));
    assert!((there - lost).norm() < 1e-9);
    assert!((there - rig.at(BEND.map(|x| x - 3.0 * x.signum()))).norm() > 2.0);
}

#[test]
fn missed_steps_leave_a_persistent_offset() {
    let mut rig = Rig::clean(
        "[effects.missed_steps]\nfull_steps = 4\nchannel = 2\nafter_s = 5.0\nstalls_max = 1",
    );
    rig.hold(3.0);
    rig.at(BEND);
    assert!(rig.at([0.0; 3]).norm() < 1e-9, "no stall before `after_s`");
    rig.at(BEND);
    let after = rig.at([0.0; 3]);
    assert!((3.0..12.0).contains(&after.norm()), "{after}");
    rig.at(BEND);
    assert!(
        (rig.at([0.0; 3]) - after).norm() < 1e-9,
        "the offset is constant"
    );
}

#[test]
fn gear_error_follows_position_not_time() {
    let ripple = |speed: f64| {
        let (mut with, mut without) = (
            Rig::clean("[effects.gear_periodic]\namplitude_mm = 0.2"),
            Rig::clean(""),
        );
        // read where the piston passes 2, 3, … 12 mm
        (2..=12)
            .map(|mm| {
                let to = [f64::from(mm), 0.0, 0.0];
                with.go(to, speed);
                without.go(to, speed);
                (bend(with.hold(0.5).last().unwrap()) - bend(without.hold(0.5).last().unwrap()))
                    .norm()
            })
            .collect::<Vec<f64>>()
    };
    let (slow, fast) = (ripple(2.0), ripple(20.0));
    assert!(slow.iter().zip(&fast).all(|(a, b)| (a - b).abs() < 1e-6));
    assert!(
        slow.iter().any(|r| *r > 0.4) && slow.iter().any(|r| *r < 0.3),
        "{slow:?}"
    );
}

#[test]
fn a_leak_decays_in_holds_and_leaves_the_opposite_offset() {
    let mut rig = Rig::clean("[effects.leak]\nrate_per_s = [0.02, 0.02, 0.02]");
    rig.go(BEND, 20.0);
    let b = bends(&rig.hold(30.0));
    assert!(b[29_999] < 0.75 * b[200] && b[200..].windows(500).step_by(500).all(|w| w[499] < w[0]));
    let back = rig.at([0.0; 3]);
    assert!(back.x < -5.0, "{back}");
}

#[test]
fn gas_compression_is_even() {
    let mut rig = Rig::clean("[effects.gas_compression]\nstrength = 1.5");
    let q = |rig: &mut Rig, u: f64| {
        rig.at([u, u, u]);
        rig.hold(0.01).last().unwrap().truth.bellow_mm.x
    };
    let (up, down, small) = (
        q(&mut rig, 12.0) / 12.0,
        q(&mut rig, -12.0) / -12.0,
        q(&mut rig, 0.3) / 0.3,
    );
    assert!(
        up > 1.04 * small && down < 0.96 * small,
        "{up} {small} {down}"
    );
}

#[test]
fn line_lag_delays_the_motion_and_reaches_the_target() {
    let (mut with, mut without) = (
        Rig::clean("[effects.line_lag]\nlag_s = [0.3, 0.3, 0.3]"),
        Rig::clean(""),
    );
    with.go(BEND, 50.0);
    without.go(BEND, 50.0);
    let (a, b) = (bends(&with.hold(4.0)), bends(&without.hold(4.0)));
    assert!(a[100] < 0.6 * b[100] && (a[3999] - b[3999]).abs() < 0.1);
}

#[test]
fn thermal_drift_acts_without_a_command() {
    let mut rig = Rig::clean("[effects.thermal_drift]\noffset_mm = [1.0, 0.0, 0.0]");
    let b = bends(&rig.hold(300.0));
    assert!(
        b[2000] < 0.05
            && b[60_000] > 0.5
            && b[299_999] > b[60_000]
            && (2.0..5.0).contains(&b[299_999])
    );
}

#[test]
fn crosstalk_follows_pressure_and_not_vacuum() {
    let others = |u: f64| {
        let mut rig = Rig::clean("[effects.crosstalk]\nshare = 0.15");
        rig.at([u, 0.0, 0.0]);
        rig.hold(0.01).last().unwrap().truth.bellow_mm
    };
    assert!(others(12.0).y > 0.2 && others(12.0).z > 0.2);
    assert!(others(-12.0).y.abs() < 1e-9);
}

#[test]
fn stiffening_is_odd() {
    let q = |u: f64| {
        let mut rig = Rig::clean("[effects.stiffening]\nshare = 0.4");
        rig.at([u, 0.0, 0.0]);
        rig.hold(0.01).last().unwrap().truth.bellow_mm.x
    };
    assert!((q(15.0) + q(-15.0)).abs() < 1e-9);
    assert!(q(15.0) / 15.0 < 0.9 * q(2.0) / 2.0);
}

#[test]
fn asymmetry_changes_slope_at_zero() {
    let q = |u: f64| {
        let mut rig = Rig::clean("[effects.asymmetry]\nshare = 0.2");
        rig.at([u, 0.0, 0.0]);
        rig.hold(0.01).last().unwrap().truth.bellow_mm.x
    };
    let slope = |a: f64, b: f64| (q(b) - q(a)) / (b - a);
    assert!(slope(-15.0, -10.0) > 1.2 * slope(10.0, 15.0));
    assert!((slope(-15.0, -10.0) / slope(-10.0, -6.0) - 1.0).abs() < 0.03);
}

#[test]
fn hysteresis_does_not_depend_on_time() {
    let loop_at = |speed: f64| {
        let mut rig = Rig::clean("[effects.hysteresis]\nshare = 0.4");
        let mut at = |to: [f64; 3]| {
            rig.go(to, speed);
            bend(rig.hold(0.5).last().unwrap())
        };
        [scaled(1.0), scaled(0.0), scaled(-1.0), scaled(0.0)].map(&mut at)
    };
    let (slow, fast) = (loop_at(2.0), loop_at(40.0));
    assert!((slow[1] - slow[3]).norm() > 4.0, "{slow:?}");
    assert!(slow.iter().zip(&fast).all(|(a, b)| (a - b).norm() < 0.05));
}

#[test]
fn creep_grows_in_holds_and_recovers() {
    let mut rig = Rig::clean("[effects.creep]\nshare = 0.2");
    rig.go(BEND, 20.0);
    let b = bends(&rig.hold(60.0));
    assert!(
        b[59_999] > 1.08 * b[300] && b[300..].windows(1000).step_by(1000).all(|w| w[999] > w[0])
    );
    let soon = rig.at([0.0; 3]);
    assert!(soon.x > 1.0, "{soon}");
    assert!(bend(rig.hold(200.0).last().unwrap()).norm() < 0.5 * soon.norm());
}

#[test]
fn softening_shows_from_the_second_stretch_on() {
    let mut rig = Rig::clean("[effects.softening]\nshare = 0.3");
    let first = rig.at(scaled(0.5));
    rig.at(scaled(1.4));
    let second = rig.at(scaled(0.5));
    rig.at(scaled(1.4));
    assert!(second.norm() > 1.05 * first.norm());
    assert!((rig.at(scaled(0.5)) - second).norm() < 1e-9);
}

#[test]
fn gravity_follows_the_vertical() {
    let at = |pitch: f64, pistons: [f64; 3]| {
        Rig::clean(&format!("[line]\nk_epsilon = [2.0, 2.0, 2.0]\n[base]\npitch_deg = {pitch}\n[effects.gravity]\nsag_deg = 6.0"))
            .at(pistons)
    };
    let free = Rig::clean("[line]\nk_epsilon = [2.0, 2.0, 2.0]")
        .at(BEND)
        .norm();
    assert!(at(0.0, BEND).norm() > free + 1.0 && at(180.0, BEND).norm() < free - 1.0);
    assert!(
        (at(0.0, towards(90.0)).norm() - at(0.0, BEND).norm()).abs() < 0.1,
        "upright it is alike all round"
    );
    assert!(
        (at(90.0, BEND).norm() - at(90.0, towards(180.0)).norm()).abs() > 0.3,
        "level it is not"
    );
    assert!(
        at(90.0, [0.0; 3]).norm() < 1e-9,
        "rest is the zero, sagged or not"
    );
}

#[test]
fn curvature_is_isotropic_and_grows_with_bend() {
    let gain = |deg: f64, by: f64| {
        let text = "[line]\nk_epsilon = [2.0, 2.0, 2.0]\n";
        let to = towards(deg).map(|x| x * by);
        Rig::clean(&format!("{text}[effects.curvature]\nexcess_deg = 6.0"))
            .at(to)
            .norm()
            / Rig::clean(text).at(to).norm()
    };
    assert!((gain(0.0, 1.0) - gain(77.0, 1.0)).abs() < 2e-3);
    assert!(gain(0.0, 0.2) < 1.01 && gain(0.0, 1.0) > 1.05);
}

#[test]
fn clocking_turns_the_plane() {
    let text = "[line]\nk_epsilon = [2.0, 2.0, 2.0]\n[effects.clocking]\noffset_deg = ";
    let dir = |offset: &str, deg: f64| {
        let b = Rig::clean(&format!("{text}{offset}\nwander = 0.0")).at(towards(deg));
        let turn = b.y.atan2(b.x).to_degrees() - deg;
        (turn + 540.0).rem_euclid(360.0) - 180.0
    };
    for deg in [0.0, 60.0, 200.0] {
        assert!(
            (dir("[8.0, 8.0, 8.0]", deg).abs() - 8.0).abs() < 0.2,
            "all alike turn everything alike"
        );
    }
    let one: Vec<f64> = (0..12)
        .map(|k| dir("[12.0, 0.0, 0.0]", 30.0 * f64::from(k)))
        .collect();
    let (low, high) = one
        .iter()
        .fold((f64::MAX, f64::MIN), |(l, h), &x| (l.min(x), h.max(x)));
    assert!(
        high - low > 5.0,
        "one alone turns directions unequally: {one:?}"
    );
}

#[test]
fn a_cable_is_two_fold_and_one_sided() {
    let text = "[line]\nk_epsilon = [2.0, 2.0, 2.0]\n[effects.cable_stiffness]\nshare = 0.2\ndirection_deg = 30.0";
    let size = |deg: f64| Rig::clean(text).at(towards(deg)).norm();
    assert!(size(30.0) < 0.9 * size(120.0) && size(210.0) < 0.95 * size(120.0));
    assert!((size(120.0) - size(300.0)).abs() < 0.1 && size(30.0) < size(210.0) - 1.0);
}

#[test]
fn torsion_does_not_move_the_axis() {
    let twisted = {
        let mut r = Rig::clean("[effects.torsion]\ntwist_deg = 10.0");
        r.at(BEND);
        *r.hold(0.1).last().unwrap()
    };
    let straight = {
        let mut r = Rig::clean("");
        r.at(BEND);
        *r.hold(0.1).last().unwrap()
    };
    assert!((bend(&twisted) - bend(&straight)).norm() < 1e-6);
    assert!(
        twisted
            .truth
            .r_base_tip
            .angle_to(&straight.truth.r_base_tip)
            .to_degrees()
            > 5.0
    );
}

#[test]
fn a_wall_stops_one_way() {
    let text = "[line]\nk_epsilon = [2.0, 2.0, 2.0]\n";
    let wall = format!("{text}[effects.contact]\nblock = 1.0\nat_deg = 25.0\ndirection_deg = 0.0");
    let (mut with, mut without) = (Rig::clean(&wall), Rig::clean(text));
    let touched = |rig: &mut Rig| rig.hold(0.1).last().unwrap().truth.wall_touched;
    assert!((with.at(scaled(0.5)) - without.at(scaled(0.5))).norm() < 1e-9 && !touched(&mut with));
    assert!(with.at(scaled(1.2)).x < without.at(scaled(1.2)).x - 10.0 && touched(&mut with));
    assert!(
        (with.at(scaled(-1.2)) - without.at(scaled(-1.2))).norm() < 1e-9 && !touched(&mut with)
    );
}

#[test]
fn transport_delay_shifts_the_motion() {
    let (mut with, mut without) = (
        Rig::clean("[effects.transport_delay]\ndelay_s = 0.12\njitter = 0.0"),
        Rig::clean(""),
    );
    let path = |rig: &mut Rig| [rig.hold(1.0), rig.go(BEND, 20.0), rig.hold(1.0)].concat();
    let (a, b) = (path(&mut with), path(&mut without));
    let worst = (120..a.len())
        .map(|k| (bend(&a[k]) - bend(&b[k - 120])).norm())
        .fold(0.0, f64::max);
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn effects_outside_the_catalogue_have_their_signatures() {
    // a bubble changes the bend in a hold
    let mut rig =
        Rig::clean("[effects.outside.bubble_jump]\nchange = 0.5\nchannel = 1\nat_s = 4.0");
    rig.at(BEND);
    let b = bends(&rig.hold(4.0));
    let jumps = b
        .windows(100)
        .map(|w| (w[99] - w[0]).abs())
        .fold(0.0, f64::max);
    assert!(jumps > 3.0 && (b[3999] - b[3900]).abs() < 1e-6);

    // ringing overshoots
    let mut rig = Rig::clean("[effects.outside.ringing]\nshare = 0.8");
    rig.go(BEND, 60.0);
    let b = bends(&rig.hold(5.0));
    assert!(b.iter().fold(0.0f64, |m, x| m.max(*x)) > 1.1 * b[4999]);

    // rate coupling vanishes at standstill
    let (mut with, mut without) = (
        Rig::clean("[effects.outside.rate_coupling]\nshift_s = 0.1"),
        Rig::clean(""),
    );
    let (m, n) = (with.go(BEND, 20.0), without.go(BEND, 20.0));
    assert!((bend(m.last().unwrap()) - bend(n.last().unwrap())).norm() > 1.0);
    assert!(
        (bend(with.hold(3.0).last().unwrap()) - bend(without.hold(3.0).last().unwrap())).norm()
            < 1e-3
    );

    // a longer tip bends more; at the rest length nothing changes
    let text = "[line]\nk_epsilon = [2.0, 2.0, 2.0]\n[effects.outside.length_gain]\nshare = 0.4";
    let long = Rig::clean(text).at(BEND.map(|x| x + 9.0)).norm();
    assert!(long > 1.15 * Rig::clean(text).at(BEND).norm());

    // stick-slip moves in jumps
    let mut rig = Rig::clean("[effects.outside.stick_slip]\nbreakaway_mm = 0.6");
    let b = rig.go([-10.0, 0.0, 0.0], 5.0);
    let speed: Vec<f64> = b
        .windows(10)
        .map(|w| (bend(&w[9]) - bend(&w[0])).norm())
        .collect();
    let fastest = speed.iter().fold(0.0f64, |m, x| m.max(*x));
    let starts = speed
        .windows(2)
        .filter(|w| w[0] < 0.3 * fastest && w[1] >= 0.3 * fastest)
        .count();
    assert!(
        (10..25).contains(&starts),
        "{starts} jumps over 10 mm of rod"
    );

    // play grows with use
    let mut rig = Rig::of("[effects.outside.play_wear]\ngrowth = 1.5\nover_mm = 100.0");
    let mut gap = || {
        rig.at([0.0; 3]);
        let a = rig.at(BEND);
        rig.at(scaled(1.5));
        (a - rig.at(BEND)).norm()
    };
    let first = gap();
    (0..6).for_each(|_| {
        gap();
    });
    assert!(gap() > first + 2.0);

    // a held bend twists the tip, a fold pops
    let mut rig = Rig::clean("[effects.outside.twist_creep]\ntwist_deg = 12.0");
    rig.at(BEND);
    let (a, b) = (
        *rig.hold(0.1).last().unwrap(),
        *rig.hold(20.0).last().unwrap(),
    );
    assert!(
        (bend(&a) - bend(&b)).norm() < 1e-6
            && a.truth
                .r_base_tip
                .angle_to(&b.truth.r_base_tip)
                .to_degrees()
                > 5.0
    );
    let mut rig =
        Rig::clean("[effects.outside.snap_through]\njump_mm = 0.6\nat_mm = 1.5\nchannel = 1");
    let slope = |rig: &mut Rig, to: f64| rig.at([to, 0.0, 0.0]).norm();
    let steps: Vec<f64> = (2..8).map(|u| slope(&mut rig, f64::from(u))).collect();
    let rises: Vec<f64> = steps.windows(2).map(|w| w[1] - w[0]).collect();
    assert!(
        rises.iter().filter(|r| **r > 2.0 * rises[0]).count() == 1,
        "{rises:?}"
    );
}

#[test]
fn base_motion_moves_no_piston_and_no_joint() {
    let mut c = config(
        "[effects.base_motion]\nangle_deg = 8.0\nat_s = 2.0\nover_s = 2.0\n[base]\nimu = true",
    );
    c.imu = perfect_imu();
    let mut rig = Rig::new(&c);
    let out = rig.hold(6.0);
    assert!(bends(&out).iter().all(|b| *b < 1e-9));
    let ends = |pick: fn(&Output) -> Option<retroflex::primitives::sample::ImuSample>| {
        let all: Vec<_> = out.iter().filter_map(pick).collect();
        all[0]
            .acc_m_s2
            .angle(&all.last().unwrap().acc_m_s2)
            .to_degrees()
    };
    assert!((ends(|o| o.imu) - 8.0).abs() < 0.01 && (ends(|o| o.base_imu) - 8.0).abs() < 0.01);
    assert_eq!(rig.sent_mm().norm(), 0.0);
}

#[test]
fn bend_directions_follow_the_convention() {
    // bellow 2 stands at 120°: shortening it alone bends to direction −120°
    let b: Vector2<f64> = Rig::clean("").at([0.0, -8.0, 0.0]);
    assert!((b.y.atan2(b.x).to_degrees() + 120.0).abs() < 1e-6);
}
