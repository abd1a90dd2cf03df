//! The supervised loop on the paper twin: modes, gate, words, restarts.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{twin, unit};
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::pilot::assemble;
use retroflex::machine::Lockstep;
use retroflex::model::bend::Bend;
use retroflex::pilot::flight::Flight;
use retroflex::pilot::order::Order;
use retroflex::pilot::{Pilot, Turned};
use retroflex::plant::{Channel, Fault};
use retroflex::sim::Sim;
use retroflex::supervise::mode::Mode;
use retroflex::tick::{Command, Kept};
use retroflex::units::{Mm, Seconds};
use retroflex::world::World;

struct Fly {
    flight: Flight<Lockstep<Sim>>,
    k: u64,
    verbose: bool,
}

impl Fly {
    fn new(kept: Option<Kept>, machine: Option<Lockstep<Sim>>) -> Self {
        let machine = machine.unwrap_or_else(|| Lockstep::new(unit(0, 1)));
        let mut calib = Calibration::default();
        calib.transmission.k_epsilon = [2.28, 2.64, 2.51];
        calib.transmission.k_lambda_mm = [0.98, 1.35, 1.04];
        let config = assemble(&twin(), &calib, &Gains::default(), machine.world.nature());
        Self { flight: Flight::new(machine, Pilot::new(config, kept)), k: 0, verbose: true }
    }
    fn turn(&mut self, order: Option<Order>) -> Turned {
        self.k += 1;
        let t = Seconds(self.k as f64 * 1e-3);
        let before = self.flight.pilot.mode();
        let turned = self.flight.turn(t, order).unwrap();
        if self.verbose {
            if turned.mode != before {
                eprintln!("{:.3} {before} -> {}", t.0, turned.mode);
            }
            if let Some(c) = turned.tripped {
                eprintln!("{:.3} TRIP {c:?} steps {:?}", t.0, turned.steps);
            }
            if turned.suspects {
                eprintln!("{:.3} SUSPECT {} {:?}", t.0, turned.suspicion.unwrap(), turned.suspicion);
            }
            if !turned.raised.is_empty() {
                eprintln!("{:.3} raised {}", t.0, turned.raised);
            }
        }
        turned
    }
    fn run(&mut self, s: f64) -> Turned {
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
        self.turn(Some(Order::Bend(Command { bend: Bend::from_deg(b, d), length: Mm(20.0) }, None)));
    }
}

#[test]
fn explore() {
    for fault in [
        None,
        Some(Fault::Leak { channel: Channel::Two, rate_per_s: 0.1 }),
        Some(Fault::Burst { channel: Channel::Two }),
        Some(Fault::AirBubble { channel: Channel::Two, factor: 1.8 }),
        Some(Fault::Blocked { channel: Channel::Two }),
        Some(Fault::Gain { channel: Channel::Two, factor: 0.5 }),
        Some(Fault::Gain { channel: Channel::Two, factor: 2.0 }),
        Some(Fault::StepLoss { channel: Channel::Two, microsteps: 100 }),
        Some(Fault::Inverted { channel: Channel::Two }),
        Some(Fault::Disabled { channel: Channel::Two }),
        Some(Fault::EndStop { channel: Channel::Two, at_mm: 14.0 }),
        Some(Fault::Wall { at_deg: 50.0, dir_deg: 100.0 }),
        Some(Fault::Push { bend_deg: 12.0, dir_deg: 0.0 }),
        Some(Fault::BaseTurn { axis: [1.0, 0.0, 0.0], angle_deg: 10.0, over_s: 0.5 }),
    ] {
        for mid in [true, false] {
            eprintln!("===== {fault:?} mid {mid}");
            let mut f = Fly::new(None, None);
            f.run(2.5);
            f.order(Order::Arm);
            f.run(0.1);
            f.bend(40.0, 30.0);
            f.run(2.0);
            f.bend(70.0, 60.0);
            f.run(if mid { 0.25 } else { 2.0 });
            if let Some(fault) = fault {
                f.flight.machine.world.plant_mut().inject(fault);
            }
            f.run(4.0);
            f.bend(20.0, 200.0);
            let t = f.run(3.0);
            let truth = f.flight.machine.world.last().unwrap().truth.r_base_tip;
            let b = Bend::from_rotation(&truth);
            eprintln!(
                "end {} felt {:?} true {:.2} {:.2}",
                t.mode,
                t.frame.felt.map(|f| f.bend.beta().to_degrees()),
                b.beta().to_degrees(),
                b.delta().to_degrees()
            );
            if f.flight.pilot.mode().moves() {
                f.order(Order::Relax);
                f.run(6.0);
                assert_eq!(f.flight.pilot.mode(), Mode::Disarmed);
            }
        }
    }
}
