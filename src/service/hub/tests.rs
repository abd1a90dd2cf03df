//! Random requests of four clients that send ahead, against a hub and a loop whose rounds and cycles interleave at random. What
//! must hold is checked in every cycle.

mod house;

use crate::model::{Bend, Shape};
use crate::primitives::Mm;
use crate::service::protocol::{CalibrateAction, Frame};
use crate::service::rt_loop::Precondition;
use crate::service::{RecordAction, Request};
use crate::supervisor::{Mode, Order};
use house::House;
use rand::RngExt;
use rand::rngs::StdRng;
use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

/// Commands, unless `RETROFLEX_COMMANDS` asks for more.
const COMMANDS: usize = 5_000;
/// Some lines of one client: mostly at random, sometimes in an order that has a chance of being accepted.
fn requests(rng: &mut StdRng) -> Vec<Request> {
    let sequences: [&[usize]; 11] = [
        &[0, 2, 5],
        &[6, 0, 2, 5],
        &[0, 1, 6],
        &[0, 2, 5, 1, 6],
        &[0, 1, 0, 2, 5],
        &[3, 5],
        &[0, 7, 2],
        &[7, 1, 0],
        &[0, 4, 9],
        &[1, 10, 0],
        &[5, 6, 6],
    ];
    let all: Vec<usize> = if rng.random_range(0..2) == 0 {
        sequences[rng.random_range(0..sequences.len())].to_vec()
    } else {
        (0..rng.random_range(1..6))
            .map(|_| rng.random_range(0..20))
            .collect()
    };
    all.into_iter().map(|kind| request(rng, kind)).collect()
}

fn request(rng: &mut StdRng, kind: usize) -> Request {
    let angle = |rng: &mut StdRng| match rng.random_range(0..30) {
        0 => f64::NAN,
        1 => 1e300,
        2 => 134.0,
        _ => rng.random_range(0.0..70.0),
    };
    let (bend_deg, dir_deg) = (angle(rng), rng.random_range(-360.0..720.0));
    let (length_mm, frame) = (None, Frame::Base);
    match kind {
        0 => Request::Arm {},
        1 => Request::Disarm {},
        2 => Request::Bend {
            bend_deg,
            dir_deg,
            length_mm: (rng.random_range(0..5) == 0).then_some(20.5),
            speed_deg_s: (rng.random_range(0..3) == 0).then(|| rng.random_range(0.0..800.0)),
            frame,
        },
        3 => Request::Relax {},
        4 => Request::Path {
            rows: (0..rng.random_range(1..6))
                .map(|k| (f64::from(k) * 0.3, f64::from(k) * 5.0, dir_deg, None))
                .collect(),
            more: rng.random_range(0..4) == 0,
        },
        5 => Request::Record {
            action: RecordAction::Start,
            name: None,
            owned: rng.random_range(0..3) == 0,
        },
        6 => Request::Record {
            action: RecordAction::Stop,
            name: None,
            owned: false,
        },
        7 | 8 => Request::Calibrate {
            action: [
                CalibrateAction::Short,
                CalibrateAction::Full,
                CalibrateAction::Accept,
                CalibrateAction::Discard,
            ][rng.random_range(0..4)],
            poses: rng.random_range(5..25),
        },
        9 => Request::Hold {},
        10 => Request::Zero {
            straight: rng.random_range(0..4) == 0,
        },
        11 => Request::ResetFault {},
        12 => Request::Reload {},
        13 => Request::Status {},
        14 => Request::Reach {},
        15 => Request::Subscribe { rate_hz: 50.0 },
        16 => Request::Stop {},
        17 => Request::Bend {
            bend_deg,
            dir_deg,
            length_mm,
            speed_deg_s: None,
            frame: Frame::World,
        },
        _ => Request::Stream {
            bend_deg,
            dir_deg,
            length_mm,
            t_s: (kind == 18).then(|| rng.random_range(0.0..3.0)),
        },
    }
}

#[test]
fn random_requests_of_four_clients_break_nothing_in_any_cycle() {
    let asked = std::env::var("RETROFLEX_COMMANDS").ok();
    let commands = asked.map_or(COMMANDS, |n| n.parse().unwrap());
    let began = Instant::now();
    let (mut sent, mut cycles, mut seed) = (0, 0, 1);
    let (mut visited, mut accepted) = (BTreeMap::new(), BTreeMap::new());
    while sent < commands {
        let mut house = House::new(seed);
        while house.sent < 2_500 && sent + (house.sent as usize) < commands {
            house.send();
            // the hub is late at times
            let most = [5, 5, 5, 60, 60, 2500][house.rng.random_range(0..6)];
            for _ in 0..house.rng.random_range(0..=most) {
                house.cycle();
            }
            if house.rng.random_range(0..3) > 0 {
                house.round();
            }
            if house.rng.random_range(0..10) == 0 {
                house.look_at_the_disk();
            }
        }
        let until = Instant::now() + Duration::from_secs(10);
        while !(house.open.is_empty() && house.queues.iter().all(VecDeque::is_empty)) {
            assert!(
                Instant::now() < until,
                "seed {seed}: unanswered {:?}",
                house.open
            );
            house.cycle();
            house.round();
        }
        (sent, cycles, seed) = (sent + house.sent as usize, cycles + house.cycles, seed + 1);
        for (name, n) in house.visited {
            *visited.entry(name).or_insert(0) += n;
        }
        for (name, n) in house.accepted {
            *accepted.entry(name).or_insert(0) += n;
        }
    }
    println!("{sent} commands, {cycles} cycles, {:.1?}", began.elapsed());
    println!("cycles by mode {visited:?}; accepted {accepted:?}");
    for mode in [
        "aligning",
        "disarmed",
        "holding",
        "tracking",
        "calibrating",
        "relaxing",
    ] {
        assert!(
            visited.get(mode).is_some_and(|n| *n > 100),
            "{mode}: {visited:?}"
        );
    }
    assert!(accepted.len() > 12, "{accepted:?}");
}

/// A request of a kind that leads the set-point, for the cycle `k` of its stretch; `None` without one.
fn lead(house: &mut House, kind: &str, k: u32) -> Option<Request> {
    let every = match kind {
        "path" => u32::MAX,
        "bend" => 300,
        _ => 40,
    };
    if !k.is_multiple_of(every) {
        return None;
    }
    let rng = &mut house.rng;
    let (bend_deg, dir_deg) = (rng.random_range(0.0..60.0), rng.random_range(0.0..360.0));
    let (length_mm, frame) = (None, Frame::Base);
    Some(match kind {
        "bend" => Request::Bend {
            bend_deg,
            dir_deg,
            length_mm,
            speed_deg_s: (rng.random_range(0..3) > 0).then(|| rng.random_range(1.0..720.0)),
            frame,
        },
        "path" => {
            let row = |k: u32| (f64::from(k) * 0.02, 15.0 * f64::from(k % 4), dir_deg, None);
            Request::Path {
                rows: (0..20).map(row).collect(),
                more: false,
            }
        }
        _ => Request::Stream {
            bend_deg,
            dir_deg,
            length_mm,
            t_s: (kind == "timed").then(|| f64::from(k) * 1e-3),
        },
    })
}

/// Targets that jump, at any speed that may be asked for, set-points of streams, and a path: one lead at a time.
#[test]
fn no_client_leads_the_setpoint_faster_than_the_board_permits() {
    let mut worst = BTreeMap::<&str, f64>::new();
    for seed in 0..6 {
        let mut house = House::new(seed);
        let most_rad = house.hub.config.supervisor.tick.bend_pace.speed * house.rt.period_s;
        let mut turn = |house: &mut House, kind: &'static str| {
            let before = house.hub.output().copied();
            house.cycle();
            house.hub.take_loop_output();
            house.hub.persist();
            let (Some(before), Some(now)) = (before, house.hub.output().copied()) else {
                return;
            };
            if before.mode == Mode::Tracking && now.mode == Mode::Tracking {
                let moved = now.frame.setpoint.bend.0 - before.frame.setpoint.bend.0;
                let most = worst.entry(kind).or_default();
                *most = most.max(moved.norm() / most_rad);
            }
        };
        (0..2500).for_each(|_| turn(&mut house, "rest"));
        for kind in ["bend", "stream", "timed", "path"] {
            house.ask(Request::Arm {});
            std::thread::sleep(Duration::from_millis(50));
            (0..100).for_each(|_| turn(&mut house, "rest"));
            for k in 0..2000_u32 {
                if let Some(request) = lead(&mut house, kind, k) {
                    house.ask(request);
                }
                turn(&mut house, kind);
            }
            house.shared.stop.request();
            (0..600).for_each(|_| turn(&mut house, "rest"));
        }
    }
    println!("largest rate of the set-point as a share of the board's: {worst:?}");
    for (kind, share) in worst {
        assert!(share > 0.3 || kind == "rest", "{kind}: {share}");
        // a set-point that catches up with a moving reference adds the two speeds for a moment
        let most = if ["path", "timed"].contains(&kind) {
            1.5
        } else {
            1.001
        };
        assert!(share < most, "{kind}: {share}");
    }
}

/// The loop stops a tip by itself when the thread that takes commands hangs. What was received before does not release that stop.
#[test]
fn the_stop_of_the_loop_itself_refuses_what_was_received_before() {
    let mut house = House::new(17);
    let order = |house: &mut House, order, stops| {
        let (since, mode) = (Instant::now(), None);
        house
            .hub
            .push_order(house.cycles, order, Precondition { stops, since, mode });
        house.cycle();
        house.rt.runner.supervisor.is_stopped()
    };
    (0..2500).for_each(|_| house.cycle());
    assert!(!order(&mut house, Order::Arm, 0));
    assert!(house.rt.runner.supervisor.mode().moves());
    let hangs = |house: &House| (0..30).for_each(|_| house.shared.watch(0.05));
    hangs(&house);
    house.cycle();
    assert!(house.rt.runner.supervisor.is_stopped());
    assert_eq!(
        (house.shared.stop.requested(), house.shared.stop.completed()),
        (1, 1)
    );
    assert!(order(&mut house, Order::Arm, 0), "received before the stop");
    assert!(!order(&mut house, Order::Arm, 1), "received after it");
}

/// Orders that were decided in a mode, before a stop or long ago: each is carried out only where that still holds.
#[test]
fn what_was_decided_on_an_old_picture_is_not_carried_out() {
    let mut house = House::new(7);
    let modes = [
        Mode::Disarmed,
        Mode::Holding,
        Mode::Tracking,
        Mode::Calibrating,
        Mode::Relaxing,
    ];
    (0..2500).for_each(|_| house.cycle());
    let (mut carried_out, mut refused) = (0, 0);
    for id in 0..3000 {
        let order = match house.rng.random_range(0..7) {
            0 => Order::Arm,
            1 => Order::Disarm,
            2 => Order::Relax,
            3 => Order::Calibrate(house.rng.random_range(0..2) == 0),
            4 => Order::Hold,
            5 => Order::Lines(house.hub.config.supervisor.tick.lines),
            _ => Order::Bend(
                Shape {
                    bend: Bend::from_deg(5.0, 90.0),
                    length: Mm(20.0),
                },
                None,
            ),
        };
        let decided = modes[house.rng.random_range(0..modes.len())];
        let old = house.rng.random_range(0..10) == 0;
        let age = Duration::from_secs(if old { 3 } else { 0 });
        let precondition = Precondition {
            stops: house.shared.stop.requested(),
            since: Instant::now().checked_sub(age).unwrap(),
            mode: (house.rng.random_range(0..3) > 0).then_some(decided),
        };
        house.hub.push_order(id, order, precondition);
        let before = house.rt.runner.supervisor.mode();
        house.cycle();
        house.hub.take_loop_output();
        let taken = house.hub.output().unwrap().order.is_some();
        let theirs = before == Mode::Calibrating && order.calibrates();
        let holds = !old && precondition.mode.map_or(!theirs, |mode| mode == before);
        assert_eq!(
            taken, holds,
            "{order:?} in {before}, decided in {:?}, old {old}",
            precondition.mode
        );
        *(if taken {
            &mut carried_out
        } else {
            &mut refused
        }) += 1;
        (0..house.rng.random_range(0..200)).for_each(|_| house.cycle());
    }
    assert!(
        carried_out > 500 && refused > 500,
        "{carried_out} {refused}"
    );
}

/// Every command that moves the tip or its gains, drawn, from another client. What is refused takes over neither the tip nor the
/// attendance, so that the tip holds when the client that calibrates disconnects.
#[test]
fn a_calibration_is_led_by_its_client_alone() {
    let mut house = House::new(11);
    (0..2500).for_each(|_| house.cycle());
    house.ask(Request::Arm {});
    let mut begun = false;
    for _ in 0..500 {
        std::thread::sleep(Duration::from_millis(1));
        house.cycle();
        house.hub.take_loop_output();
        house.hub.persist();
        if house.hub.mode() == Mode::Holding && !std::mem::replace(&mut begun, true) {
            let action = CalibrateAction::Short;
            house.ask(Request::Calibrate { action, poses: 24 });
        }
    }
    assert_eq!(house.hub.mode(), Mode::Calibrating);
    let owner = house.hub.motion_owner;
    assert_eq!(owner.map(|(client, _)| client), Some(1));
    house.accepted_until_now();
    let kinds = [0, 2, 4, 7, 9, 10, 17, 18, 19];
    for n in 0..3000 {
        let kind = kinds[house.rng.random_range(0..kinds.len())];
        let request = request(&mut house.rng, kind);
        // rows of which more will come move nothing yet
        if !matches!(request, Request::Path { more: true, .. }) {
            house.queue(1, request);
        }
        house.cycle();
        house.round();
        assert_eq!(house.hub.mode(), Mode::Calibrating, "request {n}");
        assert_eq!(house.hub.motion_owner, owner, "request {n}");
    }
    assert_eq!(house.accepted_until_now(), BTreeMap::new());
    house.hub.forget(1, "disconnected");
    (0..50).for_each(|_| house.cycle());
    assert_eq!(house.rt.runner.supervisor.mode(), Mode::Holding);
}

#[test]
fn a_direction_out_of_range_is_refused_before_it_reaches_the_loop() {
    let mut house = House::new(3);
    for dir_deg in [36_000.5, -1e5, 1e19, -1e308, 1e308] {
        house.ask(Request::bend(10.0, dir_deg, None, None));
        house.ask(Request::stream(10.0, dir_deg, None));
        house.ask(Request::stream(10.0, dir_deg, Some(0.0)));
        assert!(house.hub.pending.is_empty(), "{dir_deg}");
    }
    for turns in [-100.0, 1.25, 37.0] {
        house.ask(Request::bend(10.0, 360.0 * turns, None, None));
        assert_eq!(std::mem::take(&mut house.hub.pending).len(), 1, "{turns}");
    }
}
