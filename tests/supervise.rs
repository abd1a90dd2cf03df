//! The supervised loop on the paper twin: modes, gate, words, restarts.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{repo, twin, unit};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::config::supervisor::assemble;
use retroflex::control::saturation::Saturation;
use retroflex::control::tick::{Command, RestartState};
use retroflex::drill::bench::{Bench, Make};
use retroflex::model::bend::Bend;
use retroflex::primitives::units::{Mm, Seconds, Steps};
use retroflex::service::status;
use retroflex::simulation::lockstep::Lockstep;
use retroflex::simulation::plant::{Channel, InjectedFault};
use retroflex::simulation::sim::Sim;
use retroflex::simulation::world::World;
use retroflex::supervisor::cycle::order::{Order, Refusal};
use retroflex::supervisor::cycle::runner::Runner;
use retroflex::supervisor::cycle::{CycleOutput, Supervisor, SupervisorConfig};
use retroflex::supervisor::gate::{SafeState, TripCause};
use retroflex::supervisor::machine::Alarm;
use retroflex::supervisor::mode::Mode;

/// An order to bend, degrees.
fn bend_to(b: f64, d: f64) -> Order {
    Order::Bend(Command { bend: Bend::from_deg(b, d), length: Mm(20.0) }, None)
}

struct Fly {
    runner: Runner<Lockstep<Sim>>,
    k: u64,
}

impl Fly {
    fn new(kept: Option<RestartState>, machine: Option<Lockstep<Sim>>) -> Self {
        let machine = machine.unwrap_or_else(|| Lockstep::new(unit(0, 1)));
        let calib: Calibration = source::read(&repo("calib/paper.toml")).unwrap();
        let config = assemble(&twin(), &calib, &Gains::default(), machine.world.info());
        Self { runner: Runner::new(machine, Supervisor::new(config, kept)), k: 0 }
    }
    fn turn(&mut self, order: Option<Order>) -> CycleOutput {
        self.k += 1;
        let t = Seconds(self.k as f64 * 1e-3);
        self.runner.turn(t, order).unwrap()
    }
    fn run(&mut self, s: f64) -> CycleOutput {
        let mut last = self.turn(None);
        for _ in 1..(s * 1e3) as u64 {
            last = self.turn(None);
        }
        last
    }
    fn order(&mut self, o: Order) {
        self.turn(Some(o)).answer.unwrap().unwrap();
    }
    fn bend(&mut self, b: f64, d: f64) {
        self.order(bend_to(b, d));
    }
}

#[test]
fn healthy_tips_are_never_tripped_and_seldom_suspected() {
    let mut suspected = Vec::new();
    let mut poses = 0;
    for (seed, u) in (1..=6u64).flat_map(|seed| (0..8u64).map(move |u| (seed, u))) {
        let mut dice = StdRng::seed_from_u64(100 * seed + u);
        let mut f = Fly::new(None, Some(Lockstep::new(unit(u, 1))));
        f.run(2.5);
        f.order(Order::Arm);
        f.run(0.1);
        for n in 0..20 {
            f.bend(75.0 * dice.random::<f64>().sqrt(), 360.0 * dice.random::<f64>());
            let mut said = None;
            for _ in 0..2500 {
                let t = f.turn(None);
                assert!(t.tripped.is_none(), "seed {seed}, unit {u}, pose {n}: {:?}", t.tripped);
                said = said.or(t.suspicion.filter(|_| t.suspects));
            }
            // units are as different as their make; the first poses teach their gains
            poses += u32::from(n >= 2);
            suspected.extend(said.filter(|_| n >= 2).map(|s| format!("seed {seed}, unit {u}, pose {n}: {s}")));
        }
    }
    println!("{} of {poses} poses: {suspected:#?}", suspected.len());
    assert!(suspected.len() <= 12, "a word too many in more than 12 of {poses} poses: {suspected:#?}");
}

/// Injects a fault into a held pose; what is said of it five seconds later.
fn named(fault: InjectedFault, at: (f64, f64)) -> (String, Option<u8>) {
    let mut f = Fly::new(None, None);
    f.run(2.5);
    f.order(Order::Arm);
    f.run(0.1);
    f.bend(at.0, at.1);
    f.run(2.5);
    f.runner.machine.world.plant_mut().inject(fault);
    let t = f.run(5.0);
    let s = t.suspicion.unwrap_or_else(|| panic!("{fault:?} was not noticed"));
    println!("{fault:?}: {s}");
    (format!("{:?}", s.kind), s.channel)
}

#[test]
fn a_fault_of_one_line_is_named_with_its_channel() {
    let cases = [
        (InjectedFault::Burst { channel: Channel::Two }, "Burst"),
        (InjectedFault::Gain { channel: Channel::Two, factor: 2.0 }, "Strong"),
        (InjectedFault::Leak { channel: Channel::Two, rate_per_s: 0.1 }, "Leak"),
    ];
    for (fault, kind) in cases {
        assert_eq!(named(fault, (65.0, 70.0)), (kind.to_owned(), Some(2)), "{fault:?}");
    }
}

#[test]
fn a_line_that_turns_weak_is_named_with_its_channel() {
    // in poses in which the line has something to give
    let cases =
        [(Channel::One, (65.0, 70.0)), (Channel::Two, (65.0, 70.0)), (Channel::Three, (60.0, 300.0)), (Channel::Two, (55.0, 200.0))];
    for (channel, at) in cases {
        let number = Some(channel.index() as u8 + 1);
        assert_eq!(named(InjectedFault::Gain { channel, factor: 0.4 }, at), ("Weak".to_owned(), number), "{channel:?} at {at:?}");
        assert_eq!(named(InjectedFault::Burst { channel }, at), ("Burst".to_owned(), number), "{channel:?} at {at:?}");
    }
}

#[test]
fn a_weak_line_is_made_good_and_not_taken_for_a_wall() {
    let mut f = Fly::new(None, None);
    f.run(2.5);
    f.order(Order::Arm);
    f.run(0.1);
    f.bend(50.0, 70.0);
    f.run(2.5);
    f.runner.machine.world.plant_mut().inject(InjectedFault::Gain { channel: Channel::Two, factor: 0.6 });
    let t = f.run(5.0);
    let off = (t.frame.estimate.unwrap().bend.0 - t.frame.target.bend.0).norm().to_degrees();
    assert!(!t.frame.blocked && t.frame.saturation == Saturation::No && off < 1.0, "{off}° off, {:?}", t.frame.saturation);
}

#[test]
fn a_controller_that_has_done_what_it_may_says_so() {
    let mut f = Fly::new(None, None);
    f.run(2.5);
    f.order(Order::Arm);
    f.run(0.1);
    let mut next = f.runner.supervisor.config().clone();
    next.tick.feedback.as_mut().unwrap().integral_max_rad = 0.05;
    f.runner.supervisor.reload(&mut next);
    f.bend(65.0, 70.0);
    f.run(2.5);
    f.runner.machine.world.plant_mut().inject(InjectedFault::Gain { channel: Channel::Two, factor: 0.7 });
    let t = f.run(5.0);
    assert_eq!((t.frame.saturation, t.mode), (Saturation::Feedback, Mode::Holding), "{:?}", t.tripped);
    let words = status::short(&t.frame).unwrap();
    assert!(status::blocked(&t.frame) && words.contains("integral_max_deg"), "{words}");
    // and takes it back where it can come
    f.bend(10.0, 70.0);
    let t = f.run(4.0);
    assert!(!status::blocked(&t.frame) && status::short(&t.frame).is_none(), "{:?}", t.frame.saturation);
}

#[test]
fn orders_are_taken_and_refused_by_mode() {
    let mut f = Fly::new(None, None);
    let refused = |f: &mut Fly, o| f.turn(Some(o)).answer.unwrap().unwrap_err().to_string();
    assert!(refused(&mut f, Order::Arm).contains("still for 2 s"));
    f.run(2.5);
    assert!(refused(&mut f, bend_to(30.0, 0.0)).contains("arm"));
    f.order(Order::Arm);
    f.run(0.1);
    f.order(bend_to(40.0, 0.0));
    f.run(0.1);
    assert!(refused(&mut f, Order::Disarm).contains("stop"));
    assert!(refused(&mut f, Order::Calibrate(true)).contains("stop"));
    f.order(Order::Stop);
    assert!(refused(&mut f, bend_to(30.0, 0.0)).contains("moment"));
    let t = f.run(0.5);
    let stood = t.steps;
    assert_eq!((t.mode, f.run(0.5).mode), (Mode::Holding, Mode::Holding));
    assert!((0..3).all(|i| (f.run(0.01).steps.0[i] - stood.0[i]).abs() < 40), "it stays about where it stopped");
    f.order(Order::Disarm);
    assert!(refused(&mut f, Order::Zero).contains("relax"));
    f.order(Order::Relax);
    let t = f.run(6.0);
    assert_eq!((t.mode, t.steps.0, t.energise), (Mode::Disarmed, [0; 3], false));
    f.order(Order::Zero);
    assert_eq!(f.run(2.5).mode, Mode::Disarmed);
}

#[test]
fn a_stream_that_falls_silent_stops_the_tip() {
    let mut f = Fly::new(None, None);
    f.run(2.5);
    f.order(Order::Arm);
    f.run(0.1);
    let Order::Bend(command, _) = bend_to(70.0, 10.0) else { unreachable!() };
    f.order(Order::Stream(command));
    let mut ended = None;
    for k in 0..400 {
        let t = f.turn(None);
        if t.stream_ended {
            ended.get_or_insert(k);
        }
    }
    assert!((248..=252).contains(&ended.unwrap()), "{ended:?} ms");
    let t = f.run(1.0);
    assert!(t.mode == Mode::Holding && t.frame.estimate.unwrap().bend.beta().to_degrees() < 60.0);
}

#[test]
fn a_reload_moves_nothing() {
    let mut f = Fly::new(None, None);
    f.run(2.5);
    f.order(Order::Arm);
    f.run(0.1);
    f.bend(50.0, 120.0);
    let before = f.run(2.5).steps;
    let mut next = f.runner.supervisor.config().clone();
    next.tick.feedback.as_mut().unwrap().tau_c_s = 0.25;
    f.runner.supervisor.reload(&mut next);
    assert!((f.runner.supervisor.config().tick.feedback.unwrap().tau_c_s - 0.25).abs() < 1e-12);
    for _ in 0..500 {
        let t = f.turn(None);
        assert!((0..3).all(|i| (t.steps.0[i] - before.0[i]).abs() <= 8), "{:?} {before:?}", t.steps);
    }
}

#[test]
fn what_is_kept_for_a_restart_is_what_was_pulsed() {
    let mut fly = Fly::new(None, None);
    fly.run(3.0);
    fly.order(Order::Arm);
    fly.bend(50.0, 30.0);
    let mut sensed = fly.run(0.2).sensed;
    // the step thread came late and stopped where it was, short of what it had been sent
    let stopped = sensed.counted;
    let mut sent = stopped;
    for _ in 0..500 {
        sensed.t.0 += 1e-3;
        (sensed.counted, sensed.alarm) = (stopped, Some(Alarm::Late { late_s: 0.1 }));
        sent = fly.runner.supervisor.turn(&sensed, None).steps;
    }
    let supervisor = &fly.runner.supervisor;
    assert_eq!((supervisor.mode(), supervisor.latched()), (Mode::Faulted, Some(TripCause::StepGenerator)));
    assert!(stopped != Steps::default() && sent != stopped, "{stopped:?} {sent:?}");
    assert_eq!(supervisor.keep().steps, stopped);
}

/// The program was killed with the tip bent and its drivers on; another takes over.
fn taken_over(change: impl Fn(&mut RestartState, &mut SupervisorConfig)) -> (Fly, Vec<bool>) {
    let mut before = Fly::new(None, None);
    before.run(3.0);
    before.order(Order::Arm);
    before.run(0.1);
    before.bend(50.0, 30.0);
    before.run(3.0);
    let mut kept = before.runner.supervisor.keep();
    let (mut config, t0) = (before.runner.supervisor.config().clone(), before.k);
    change(&mut kept, &mut config);
    let runner = Runner::new(before.runner.machine, Supervisor::new(config, Some(kept)));
    let mut after = Fly { runner, k: t0 };
    let energise = (0..4000).map(|_| after.turn(None).energise).collect();
    (after, energise)
}

#[test]
fn a_tip_found_held_is_held_until_it_is_known() {
    let (fly, energise) = taken_over(|_, _| {});
    assert_eq!(fly.runner.supervisor.mode(), Mode::Disarmed);
    assert!(energise.iter().all(|e| *e), "let go after {:?} turns", energise.iter().position(|e| !e));
    // what is remembered is not what is felt: held until that is known, then let go
    let turned_away = |kept: &mut RestartState, _: &mut SupervisorConfig| kept.bend_rad = [-0.9, 0.3];
    let (fly, energise) = taken_over(turned_away);
    assert_eq!(fly.runner.supervisor.mode(), Mode::Lost);
    assert!(energise[..1000].iter().all(|e| *e) && !energise[3999]);
    // a board that lets go when its loop hangs lets go here too
    let (_, energise) = taken_over(|_, config| config.gate.on.late = SafeState::Release);
    assert!(!energise[0]);
    // nothing is remembered: nothing is held
    let (_, energise) = taken_over(|kept, _| kept.steps = Steps::default());
    assert!(!energise[0]);
}

/// A bent tip whose step thread has stopped with this alarm.
fn stopped_by(alarm: Alarm) -> Bench {
    let calibration = source::read(&repo("calib/paper.toml")).unwrap();
    let make = Make { board: twin(), calibration, gains: Gains::default() };
    let mut bench = make.bench(0, 1).unwrap();
    assert!(bench.until(10.0, |t| t.mode == Mode::Disarmed).unwrap());
    bench.turn(Some(Order::Arm)).unwrap();
    bench.run(0.1).unwrap();
    bench.turn(Some(bend_to(50.0, 30.0))).unwrap();
    bench.run(0.3).unwrap();
    bench.runner.machine.alarm = Some(alarm);
    let turned = bench.run(0.5).unwrap();
    assert_eq!((turned.mode, turned.latched), (Mode::Faulted, Some(TripCause::StepGenerator)));
    assert!(turned.counted != Steps::default());
    bench
}

#[test]
fn a_tip_whose_step_thread_stopped_is_led_back_to_rest() {
    let mut bench = stopped_by(Alarm::Late { late_s: 0.1 });
    assert_eq!(bench.turn(Some(Order::Relax)).unwrap().answer, Some(Ok(())));
    assert!(bench.until(20.0, |t| t.mode != Mode::Relaxing).unwrap());
    let turned = bench.turn(None).unwrap();
    assert_eq!((turned.mode, turned.counted, turned.energise), (Mode::Disarmed, Steps::default(), false));
    assert_eq!(turned.latched, Some(TripCause::StepGenerator), "until it is reset");
    assert!(bench.true_bend().beta().to_degrees() < 5.0);
}

#[test]
fn an_alarm_that_comes_again_ends_the_way_back() {
    let mut bench = stopped_by(Alarm::Pins);
    bench.turn(Some(Order::Relax)).unwrap();
    bench.runner.machine.alarm = Some(Alarm::Pins);
    let turned = bench.run(0.3).unwrap();
    assert_eq!((turned.mode, turned.latched), (Mode::Faulted, Some(TripCause::StepGenerator)));
}

#[test]
fn nothing_is_led_back_while_the_emergency_stop_is_pressed() {
    let mut bench = stopped_by(Alarm::Underrun);
    bench.runner.machine.pressed = true;
    bench.run(0.1).unwrap();
    assert_eq!(bench.turn(Some(Order::Relax)).unwrap().answer, Some(Err(Refusal::StillThere)));
}
