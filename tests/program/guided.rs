//! What leads the set-point of the supervised loop in place of a target: paths, set-points with times, orientations in the world.

use crate::common::{evaluate, plant, repo, twin};
use nalgebra::Vector3;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::config::supervisor::assemble;
use retroflex::control::dynamics::Dynamics;
use retroflex::control::path::Path;
use retroflex::drill::process::{Daemon, daemon::ask};
use retroflex::model::Shape;
use retroflex::model::bend::Bend;
use retroflex::model::transmission::Line;
use retroflex::motion::machine::Machine;
use retroflex::primitives::frames::{Rotation, Tip, World};
use retroflex::primitives::units::{Mm, Seconds};
use retroflex::service::protocol::Request;
use retroflex::simulation::lockstep::Lockstep;
use retroflex::simulation::plant::config::PlantConfig;
use retroflex::simulation::plant::{ImuFaults, Output};
use retroflex::simulation::sim::Sim;
use retroflex::supervisor::cycle::order::{Order, Refusal};
use retroflex::supervisor::cycle::runner::Runner;
use retroflex::supervisor::cycle::{CycleOutput, Source, Supervisor};
use retroflex::supervisor::mode::Mode;
use std::io::Write as _;
use std::path::Path as File;
use std::process::{self, Stdio};

struct Flight {
    runner: Runner<Lockstep<Sim>>,
    cycles: u64,
}

impl Flight {
    /// An armed tip on a unit of the twin, which `change` has changed.
    fn new(unit: u64, change: impl Fn(&mut PlantConfig)) -> Self {
        let (board, section) = (twin(), plant());
        let mut make = section.clone();
        change(&mut make);
        let machine = Lockstep::new(
            Sim::new(&make, unit, 7, section.period_s).unwrap(),
            &board.drive_limits(),
        );
        let paper: Calibration = source::read(&repo("calib/paper.toml")).unwrap();
        let mut config = assemble(&board, &paper, &Gains::default(), Machine::info(&machine));
        if unit > 0 {
            // as `evaluate` identifies them
            let found = evaluate(unit, &[]);
            for i in 0..3 {
                config.tick.lines[i] = Line {
                    k_epsilon: found.k_eps[i],
                    k_lambda_mm: found.k_lambda_mm[i],
                };
            }
            config.tick.dynamics.expected = Dynamics {
                lag_s: found.lag_s,
                delay_s: found.delay_s,
            };
        }
        let mut flight = Self {
            runner: Runner::new(machine, Supervisor::new(config, None)),
            cycles: 0,
        };
        while flight.turn(None).mode != Mode::Disarmed {
            assert!(flight.now_s() < 15.0, "not aligned");
        }
        flight.order(Order::Arm);
        flight.run(0.1);
        flight
    }

    fn period_s(&self) -> f64 {
        self.runner.supervisor.config().gate.tick_s
    }

    fn now_s(&self) -> f64 {
        self.cycles as f64 * self.period_s()
    }

    fn turn(&mut self, order: Option<Order>) -> CycleOutput {
        self.cycles += 1;
        self.runner.turn(Seconds(self.now_s()), order).unwrap()
    }

    fn run(&mut self, s: f64) -> CycleOutput {
        (0..(s / self.period_s()) as u64)
            .map(|_| self.turn(None))
            .last()
            .unwrap()
    }

    fn answer(&mut self, order: Order) -> Result<(), Refusal> {
        self.turn(Some(order)).answer.unwrap()
    }

    fn order(&mut self, order: Order) {
        self.answer(order).unwrap();
    }

    fn truth(&self) -> &Output {
        self.runner.machine.world.last.as_ref().unwrap()
    }

    fn true_bend(&self) -> Bend {
        Bend::nearest(&self.truth().truth.r_base_tip)
    }

    fn in_world(&self) -> Rotation<World, Tip> {
        self.truth().truth.r_world_base * self.truth().truth.r_base_tip
    }
}

fn at(bend_deg: f64, dir_deg: f64) -> Shape {
    Shape {
        bend: Bend::from_deg(bend_deg, dir_deg),
        length: Mm(20.0),
    }
}

/// A circle of 30° at 0.2 Hz.
fn circle(t_s: f64) -> Shape {
    at(30.0, 72.0 * t_s)
}

/// RMS of the differences, degrees.
fn rms(differences: &[f64]) -> f64 {
    (differences.iter().map(|d| d * d).sum::<f64>() / differences.len() as f64)
        .sqrt()
        .to_degrees()
}

fn path(seconds: f64, at: impl Fn(f64) -> Shape) -> Box<Path> {
    let t_s: Vec<f64> = (0..=(seconds * 50.0) as u32)
        .map(|k| f64::from(k) / 50.0)
        .collect();
    let rows = t_s
        .iter()
        .map(|t| at(*t))
        .map(|c| Vector3::new(c.bend.0.x, c.bend.0.y, c.length.0))
        .collect();
    Box::new(Path::new(t_s, rows).unwrap())
}

/// Follows a path that was ordered, and gives the RMS of desired minus true bend in its first `seconds`, degrees.
fn follow(flight: &mut Flight, seconds: f64, at: impl Fn(f64) -> Shape) -> f64 {
    let mut off = Vec::new();
    loop {
        let output = flight.turn(None);
        let Source::Path { began_s } = output.source else {
            panic!("after {} rows: {:?}", off.len(), output.source);
        };
        assert_eq!(output.mode, Mode::Tracking);
        let after_s = flight.now_s() - began_s;
        if after_s >= seconds {
            return rms(&off);
        }
        if after_s >= 0.0 {
            off.push((flight.true_bend().0 - at(after_s).bend.0).norm());
        }
    }
}

#[test]
fn a_path_that_rests_is_followed_to_its_end() {
    for (first_s, between_s) in [(2.0, 0.0), (0.0, 1.5), (1.0, 3.0)] {
        let at = |t: f64| {
            let moved_s = (t - first_s).clamp(0.0, 1.0) + (t - first_s - 1.0 - between_s).max(0.0);
            circle(moved_s)
        };
        let mut flight = Flight::new(0, |_| ());
        flight.order(Order::Bend(at(0.0), None));
        flight.run(4.0);
        flight.runner.supervisor.load(&mut Some(path(8.0, at)));
        flight.order(Order::Play);
        let off = follow(&mut flight, 7.9, at);
        println!("rests {first_s} s and {between_s} s: {off:.2}°");
        assert!(off < 0.9, "{off:.2}");
    }
}

#[test]
fn a_loaded_path_is_followed_as_evaluate_follows_it_and_ends_in_a_hold() {
    let mut flight = Flight::new(0, |_| ());
    assert_eq!(flight.answer(Order::Play), Err(Refusal::NoPath));
    flight.order(Order::Bend(circle(0.0), None));
    flight.run(4.0);
    let mut loaded = Some(path(10.0, circle));
    flight.runner.supervisor.load(&mut loaded);
    assert!(loaded.is_none());
    flight.order(Order::Play);
    let off = follow(&mut flight, 9.9, circle);
    println!("path: {off:.2}°");
    // `evaluate --track` measures 0.42° on this circle
    assert!(off < 0.6, "{off:.2}");
    let last = flight.run(2.0);
    assert!(
        last.mode == Mode::Holding && last.source == Source::Target,
        "{:?}",
        last.mode
    );
    assert!((last.frame.target.bend.0 - circle(10.0).bend.0).norm() < 1e-6);

    // a hold and a stop end a path, and a new one does not begin by itself
    flight.order(Order::Play);
    flight.run(1.0);
    flight.order(Order::Hold);
    assert_eq!(flight.run(2.0).mode, Mode::Holding);
    flight.order(Order::Play);
    flight.run(1.0);
    flight.runner.supervisor.load(&mut Some(path(2.0, circle)));
    assert_eq!(flight.run(2.0).mode, Mode::Holding);
    flight.order(Order::Play);
    flight.run(0.5);
    flight.order(Order::Stop);
    let stopped = flight.run(0.5);
    assert!(stopped.mode == Mode::Holding && stopped.source == Source::Target);
    assert_eq!(flight.answer(Order::Play), Err(Refusal::Stopped));
}

#[test]
fn set_points_with_times_are_followed_without_the_jitter_of_their_arrival() {
    let mut flight = Flight::new(0, |_| ());
    flight.order(Order::Bend(circle(0.0), None));
    flight.run(4.0);
    let (mut dice, from_s) = (StdRng::seed_from_u64(5), flight.now_s() + flight.period_s());
    // rows every 20 ms that arrive up to 15 ms late
    let mut arrivals: Vec<(f64, f64)> = (0..400)
        .map(|k| {
            (
                f64::from(k) * 0.02,
                f64::from(k) * 0.02 + 0.015 * dice.random::<f64>(),
            )
        })
        .collect();
    arrivals[0].1 = 0.0;
    let (mut next, mut off) = (0, Vec::new());
    while next < arrivals.len() {
        let (t_s, arrives_s) = arrivals[next];
        let due = flight.now_s() + flight.period_s() - from_s >= arrives_s;
        let output = flight.turn(due.then_some(Order::Timed(circle(t_s), 100.0 + t_s)));
        assert!(
            output.answer.is_none_or(|a| a.is_ok()),
            "{:?}",
            output.answer
        );
        next += usize::from(due);
        let t = flight.now_s() - from_s;
        if t > 1.0 {
            off.push((flight.true_bend().0 - circle(t).bend.0).norm());
        }
    }
    println!("stream with times: {:.2}°", rms(&off));
    // `evaluate --track --live` measures 0.66°
    assert!(rms(&off) < 1.1, "{:.2}", rms(&off));
    for t_s in [107.9, 100.0, 0.0, -5.0, -1e9] {
        let answer = flight.answer(Order::Timed(circle(0.0), t_s));
        assert_eq!(answer, Err(Refusal::Backwards), "{t_s}");
    }
    assert_eq!(
        flight.answer(Order::Timed(circle(0.0), 109.5)),
        Err(Refusal::Ahead)
    );
    assert_eq!(
        flight.answer(Order::Timed(circle(0.0), f64::NAN)),
        Err(Refusal::NotANumber)
    );
    let silent = (0..500)
        .map(|_| flight.turn(None))
        .find(|output| output.stream_ended)
        .expect("the dead man's time");
    assert_eq!(silent.mode, Mode::Holding);
}

/// A base with an IMU, or without, that sways by 10° from the third second on.
fn swaying(imu: bool) -> impl Fn(&mut PlantConfig) {
    move |make| {
        make.base.imu = imu;
        let motion = make.effects.base_motion.get_or_insert_default();
        (motion.sway_deg, motion.axis) = (10.0, [0.6, 0.5, 0.6]);
    }
}

#[test]
fn a_tip_keeps_its_orientation_in_the_world_while_the_base_sways() {
    let pointing = |unit: u64, order: fn(Shape) -> Order| {
        let mut flight = Flight::new(unit, swaying(true));
        flight.order(order(at(40.0, 60.0)));
        // the attitude of the base at the command, and the tip's in it
        let wanted = flight.truth().truth.r_world_base * at(40.0, 60.0).bend.rotation();
        flight.run(4.0);
        let mut off = Vec::new();
        for _ in 0..(25.0 / flight.period_s()) as u32 {
            flight.turn(None);
            off.push(
                flight
                    .in_world()
                    .apply(&Vector3::z())
                    .angle(&wanted.apply(&Vector3::z())),
            );
        }
        rms(&off)
    };
    for unit in 1..=5 {
        let with = pointing(unit, |command| Order::World(command, None));
        println!("unit {unit}: pointing {with:.2}° RMS");
        assert!(with <= 1.5, "unit {unit}: {with}");
    }
    let without = pointing(0, |command| Order::Bend(command, None));
    println!("without --world: {without:.2}° RMS");
    assert!(without > 3.0);
}

#[test]
fn an_orientation_in_the_world_needs_a_healthy_imu_on_the_base() {
    let mut flight = Flight::new(0, swaying(false));
    assert_eq!(
        flight.answer(Order::World(at(40.0, 60.0), None)),
        Err(Refusal::NoBase)
    );

    let mut flight = Flight::new(0, swaying(true));
    flight.order(Order::World(at(40.0, 60.0), None));
    assert!(matches!(
        flight.run(5.0).source,
        Source::World { reached: true, .. }
    ));
    flight.runner.machine.world.plant.faults.base_imu.slow = ImuFaults::SILENT;
    let lost = flight.run(0.3);
    assert_eq!(lost.source, Source::WorldLost);
    let kept = lost.frame.target.bend.0;
    let last = flight.run(3.0);
    assert!(
        (last.frame.target.bend.0 - kept).norm() < 1e-9
            && last.mode == Mode::Holding
            && last.source == Source::WorldLost
    );
    flight.order(Order::Bend(at(20.0, 0.0), None));
    assert_eq!(flight.run(0.1).source, Source::Target);
}

#[test]
fn an_orientation_out_of_reach_is_approached_as_far_as_the_tip_bends() {
    let mut flight = Flight::new(0, |make| make.base.imu = true);
    flight.order(Order::World(at(75.0, 0.0), None));
    flight.run(4.0);
    // the base turns away from the tip
    let world_base = flight.truth().truth.r_world_base;
    let axis = world_base.apply(&at(1.0, 0.0).bend.rotation_vector().normalize());
    flight
        .runner
        .machine
        .world
        .plant
        .turn_base((-axis).into(), 30.0, 2.0);
    let last = flight.run(5.0);
    let bend_deg = last.frame.target.bend.beta().to_degrees();
    println!("out of reach: {bend_deg:.1}° of 105° asked for");
    assert!(
        matches!(last.source, Source::World { reached: false, .. })
            && (78.0..92.0).contains(&bend_deg),
        "{:?} {bend_deg}",
        last.source
    );
    flight
        .runner
        .machine
        .world
        .plant
        .turn_base(axis.into(), 30.0, 2.0);
    let last = flight.run(5.0);
    assert!(
        matches!(last.source, Source::World { reached: true, .. })
            && (last.frame.target.bend.0 - at(75.0, 0.0).bend.0)
                .norm()
                .to_degrees()
                < 1.0
    );
}

/// Runs a command of the program with this standard input; returns its exit code and output.
fn cli(socket: &File, args: &[&str], input: &str) -> (i32, String) {
    let mut command = process::Command::new(env!("CARGO_BIN_EXE_retroflex"));
    command
        .args(args)
        .env("RETROFLEX_SOCKET", socket)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    // a command that refuses its first line does not read the rest
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    let out = child.wait_with_output().unwrap();
    (
        out.status.code().unwrap(),
        String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr),
    )
}

#[test]
fn the_service_plays_a_path_and_streams_set_points_with_times() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(File::new(env!("CARGO_BIN_EXE_retroflex")), folder.path()).unwrap();
    let socket = daemon.sockets()[0].clone();
    let expect = |args: &[&str], input: &str, code: i32, part: &str| {
        let (got, text) = cli(&socket, args, input);
        assert!(
            got == code && text.contains(part),
            "{args:?}: expected {code} and `{part}`, got {got}:\n{text}"
        );
    };
    let file = |name: &str, rows: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, format!("t_s,bend_deg,dir_deg\n{rows}")).unwrap();
        path.to_str().unwrap().to_owned()
    };
    daemon
        .until(10.0, "alignment", |s| s["mode"] == "disarmed")
        .unwrap();
    // more rows than one request holds, and too fast
    let rows = (0..=300).map(|k| {
        format!(
            "{:.3},30,{:.1}\n",
            f64::from(k) * 0.005,
            f64::from(k * 18 % 3600) / 10.0
        )
    });
    let circle = file("circle.csv", &rows.collect::<String>());
    expect(&["play", &circle], "", 1, "retroflex arm");
    expect(&["arm"], "", 0, "");
    expect(
        &["play", &circle, "--record", "round"],
        "",
        0,
        "times the speed that the pistons can follow",
    );
    daemon
        .until(2.0, "the end of the path", |s| {
            s["mode"] == "holding" && s["path"].is_null()
        })
        .unwrap();
    expect(&["record", "start", "moved"], "", 0, "recording");
    expect(&["record", "stop"], "", 0, "cannot be replayed, because");
    let far = file("far.csv", "0,20,0\n5,120,0\n");
    expect(
        &["play", &far],
        "",
        2,
        "far.csv, line 3, column bend_deg: `120` is not within",
    );
    let target = daemon.until(1.0, "a status", |_| true).unwrap()["target"].clone();
    expect(
        &["play", &file("beyond.csv", "0,20,0\n5,89,0\n")],
        "",
        2,
        "beyond.csv, line 3, column bend_deg: `89` is not within",
    );
    // whichever pose of a schedule it is
    for (seed, count) in [(1, 3_usize), (2, 40), (3, 400)] {
        let mut rng = StdRng::seed_from_u64(seed);
        let wrong = rng.random_range(1..count);
        let mut rows = "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n".to_owned();
        for k in 0..count {
            let bend_deg = if k == wrong {
                150.0
            } else {
                rng.random_range(0.0..40.0)
            };
            let dir_deg: f64 = rng.random_range(0.0..360.0);
            rows += &format!("{bend_deg:.1},{dir_deg:.1},20,1,10\n");
        }
        let path = folder.path().join("poses.csv");
        std::fs::write(&path, rows).unwrap();
        let named = format!(
            "poses.csv, row {}, bend_deg 150: expected within reach",
            wrong + 1
        );
        expect(&["play", path.to_str().unwrap()], "", 2, &named);
    }
    assert_eq!(
        daemon.until(1.0, "a status", |_| true).unwrap()["target"],
        target,
        "a refused path moves nothing"
    );
    expect(
        &["play", &file("late.csv", "0,20,0\n0,25,0\n")],
        "",
        2,
        "late.csv, line 3, column t_s",
    );

    expect(&["bend", "30", "--wait"], "", 0, "settled");
    let rows: String = (0..=50)
        .map(|k| {
            format!(
                "{} 0 {}\n",
                30.0 - 0.2 * f64::from(k),
                7.0 + f64::from(k) * 0.02
            )
        })
        .collect();
    expect(&["stream"], &rows, 0, "of 20.0° at 0°: settled");
    daemon
        .until(3.0, "the hold", |s| {
            s["mode"] == "holding"
                && (s["target"]["bend_deg"].as_f64().unwrap_or(0.0) - 20.0).abs() < 0.5
        })
        .unwrap();
    // the end of the input is a target, also where the times were too short for the tip
    expect(
        &["stream"],
        "30 0 0.00\n30 4 0.02\n30 8 0.04\n",
        0,
        "of 30.0° at 8°: settled",
    );
    expect(&["stream"], "20 0\n", 0, "of 20.0° at 0°: settled");
    expect(
        &["stream"],
        "20 0 1\n20 x 2\n",
        2,
        "line 2: DIR `x`: expected a number",
    );
    expect(
        &["stream"],
        "20 0\n120 0\n",
        2,
        "line 2: the tip bends by at most",
    );
    expect(&["bend", "20", "--world"], "", 1, "IMU on the base");

    // paths and set-points with times make the same decisions again
    assert!(daemon.end().unwrap().0);
    let flights = std::fs::read_dir(folder.path().join("state/flights"))
        .unwrap()
        .map(|e| e.unwrap().path());
    let flight = flights.max().unwrap();
    expect(&["replay", flight.to_str().unwrap()], "", 0, " 0 differ");
}

/// Steers at 10 °/s, with pauses of the sender of drawn lengths: the set-point moves no faster after them.
fn a_pause_of_the_sender_is_not_made_up_for(daemon: &Daemon, table: &str) {
    let sender = process::Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(["steer", "--speed", "10", "--expo", "0", "--replay", table])
        .arg("--socket")
        .arg(&daemon.sockets()[0])
        .spawn()
        .unwrap();
    let signal = |signal: &str| {
        let mut kill = process::Command::new("kill");
        let sent = kill.args([signal, &sender.id().to_string()]).status();
        assert!(sent.unwrap().success());
    };
    let mut client = daemon.client().unwrap();
    let mut setpoint = || {
        let status = ask(&mut client, &Request::Status {}).unwrap();
        let of = |key: &str| status["setpoint"][key].as_f64().unwrap();
        at(of("bend_deg"), of("dir_deg")).bend.0
    };
    std::thread::sleep(std::time::Duration::from_millis(500));
    let start = setpoint();
    for pause_ms in [250, 350, 450] {
        signal("-STOP");
        std::thread::sleep(std::time::Duration::from_millis(pause_ms));
        let before = setpoint();
        let resumed = std::time::Instant::now();
        signal("-CONT");
        std::thread::sleep(std::time::Duration::from_millis(500));
        let moved = (setpoint() - before).norm().to_degrees();
        // at 10 °/s since it resumed, with 0.1 s to spare; a pause that was made up for would add its 0.25 s or more
        let allowed = 10.0 * (resumed.elapsed().as_secs_f64() + 0.1);
        println!("moved by {moved:.1}° of at most {allowed:.1}° after {pause_ms} ms");
        assert!(
            moved < allowed,
            "{moved:.1}° for {allowed:.1}° after {pause_ms} ms"
        );
    }
    assert_ne!(setpoint(), start, "the sender does not go on");
    assert!(sender.wait_with_output().unwrap().status.success());
}

/// The state at the start, the stick away from the operator, which a joystick counts as negative, and the button; then nothing until the
/// device is gone.
fn joystick_goes_away(device: &File, away_s: f64) {
    let event = |value: i16, kind: u8, number: u8| {
        let [low, high] = value.to_ne_bytes();
        [0, 0, 0, 0, low, high, kind, number]
    };
    let mut joystick = std::fs::OpenOptions::new()
        .write(true)
        .open(device)
        .unwrap();
    let state = [event(0, 0x81, 0), event(0, 0x82, 0), event(0, 0x82, 1)];
    let moved = [event(i16::MAX, 2, 1), event(1, 1, 0)];
    let events = [state.concat(), moved.concat()].concat();
    joystick.write_all(&events).unwrap();
    std::thread::sleep(std::time::Duration::from_secs_f64(away_s));
}

#[test]
fn a_stick_steers_the_tip_while_its_button_is_held() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(File::new(env!("CARGO_BIN_EXE_retroflex")), folder.path()).unwrap();
    let socket = daemon.sockets()[0].clone();
    let expect = |args: &[&str], code: i32, part: &str| {
        let (got, text) = cli(&socket, args, "");
        assert!(
            got == code && text.contains(part),
            "{args:?}: expected {code} and `{part}`, got {got}:\n{text}"
        );
    };
    let table = |name: &str, rows: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, format!("t_s,x,y,held\n{rows}")).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let target = |what: &str, bend_deg: f64, dir_deg: f64| {
        let near = |s: &serde_json::Value| {
            let given = |key: &str| s["target"][key].as_f64().unwrap_or(f64::NAN);
            (at(given("bend_deg"), given("dir_deg")).bend.0 - at(bend_deg, dir_deg).bend.0)
                .norm()
                .to_degrees()
                < 1.0
        };
        daemon
            .until(3.0, what, |s| s["mode"] == "holding" && near(s))
            .unwrap();
    };
    daemon
        .until(10.0, "alignment", |s| s["mode"] == "disarmed")
        .unwrap();
    let up = table("up.csv", "0,0,1,1\n1.5,0,1,0\n1.9,0,1,0\n");
    expect(&["steer", "--replay", &up], 1, "must be armed");
    expect(&["arm"], 0, "");
    // the stick stays where it is when the button is released, and the tip holds
    expect(
        &[
            "steer",
            "--mode",
            "position",
            "--bend-max",
            "30",
            "--replay",
            &up,
        ],
        0,
        "",
    );
    target("the stick's bend", 30.0, 90.0);
    expect(
        &["steer", "--replay", &table("far.csv", "0,0,0,1\n1,2,0,1\n")],
        2,
        "far.csv, line 3, column x: `2` is not within -1 to 1",
    );
    expect(
        &[
            "steer",
            "--replay",
            folder.path().join("none.csv").to_str().unwrap(),
        ],
        2,
        "none.csv",
    );
    expect(&["steer", "--device", "/dev/none"], 2, "/dev/none");

    a_pause_of_the_sender_is_not_made_up_for(&daemon, &table("long.csv", "0,0,-1,1\n4,0,-1,0\n"));

    // a joystick that goes away while its button is held
    let device = folder.path().join("js0");
    assert!(
        process::Command::new("mkfifo")
            .arg(&device)
            .status()
            .unwrap()
            .success()
    );
    let plug = |away_s: f64| {
        let device = device.clone();
        std::thread::spawn(move || joystick_goes_away(&device, away_s))
    };
    let steer = |more: &[&str], part: &str| {
        let given = ["steer", "--device", device.to_str().unwrap(), "--expo", "0"];
        expect(&[&given, more].concat(), 3, part);
    };
    let hold = || {
        let status = daemon.until(3.0, "the hold", |s| s["mode"] == "holding");
        let status = status.unwrap();
        let degrees = |key: &str| status["target"][key].as_f64().unwrap();
        at(degrees("bend_deg"), degrees("dir_deg")).bend.0
    };
    // out of range with its button held, and switched off later
    let (gone, before) = (plug(2.5), hold());
    steer(
        &["--speed", "10", "--silence", "0.5"],
        "said nothing for 0.5 s",
    );
    gone.join().unwrap();
    let moved_deg = (hold() - before).norm().to_degrees();
    assert!(
        (3.0..9.0).contains(&moved_deg),
        "10 °/s for half a second: {moved_deg}"
    );
    // unplugged
    let (gone, before) = (plug(1.0), hold());
    steer(&["--speed", "20"], "holding");
    gone.join().unwrap();
    let moved_deg = (hold() - before).norm().to_degrees();
    assert!(
        (14.0..24.0).contains(&moved_deg),
        "20 °/s for a second: {moved_deg}"
    );
}
