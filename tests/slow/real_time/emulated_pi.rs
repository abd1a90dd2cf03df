//! The program on an emulated Raspberry Pi in real time, on a machine with nothing else to do.

use crate::common::repo;
use crate::pi::{
    chip_board,
    closed::{Service, Spoil},
    rig::on_a_pi,
    run, world,
};
use retroflex::model::bend::Bend;
use retroflex::service::protocol::Request;

#[test]
fn commissioning_finds_this_machine_wired_right() {
    on_a_pi(world("linux-gpiochip"), |rig| {
        let board = chip_board(rig);
        let (code, out, err) = run(rig, &["commission", "--board", &board, "--hold", "2"]);
        println!("{out}\n{err}");
        assert_eq!(code, 0);
        assert!(out.contains("wiring: agrees with the board file"), "{out}");
        let world = rig.world();
        assert_eq!(
            (world.chip.counted, world.chip.lost, world.chip.torn),
            ([0; 3], 0, 0)
        );
        assert_eq!(
            world.bus.limits,
            [Some(1), Some(2)],
            "transfers end after 20 ms and one repetition"
        );
    });
}

/// A complete session: boot, align, bend to within 1.0° of the truth, three faults of the sensor, 100,000 pulses counted
/// equally on both sides, and a tip that is straight and without current at the end.
#[test]
fn the_service_closes_its_loop_through_the_device_files() {
    on_a_pi(world("linux-gpiochip"), |rig| {
        let board = repo("boards/linux-gpiochip.toml")
            .to_str()
            .unwrap()
            .to_owned();
        let mut service = Service::start(rig, &board);
        // a machine without a memory does not know where its pistons are
        service.until("lost", 20.0, |s| s["mode"] == "lost");
        service.ask(&Request::Zero { straight: true });
        service.until("aligned", 20.0, |s| s["mode"] == "disarmed");
        service.ask(&Request::Arm {});
        service.arrived();
        for (bend, dir) in [(40.0, 60.0), (65.0, -120.0), (25.0, 170.0)] {
            service.bend(bend, dir);
            let error = service.settled_error_deg(bend, dir);
            assert!(error <= 1.0, "{error}");
        }

        // a burst of NACKs and a frozen sensor in motion, shorter than the gate's limit: no trip
        for (how, bend, dir) in [(Spoil::Nack, 50.0, 0.0), (Spoil::Frozen, 30.0, 90.0)] {
            service.bend(bend, dir);
            service.spoil(how, 0.3);
            let error = service.settled_error_deg(bend, dir);
            assert!(error <= 1.0, "{how:?}: {error}");
            assert!(service.status()["latched"].is_null());
        }

        // a bus that hangs for longer: the gate holds and latches, no pulse follows; motion continues after a reset
        service.bend(60.0, -60.0);
        service.spoil(Spoil::Hang, 1.2);
        let status = service.until("faulted", 2.0, |s| s["mode"] == "faulted");
        assert_eq!(status["latched"], "stale");
        let pulses = rig.world().chip.pulses;
        std::thread::sleep(std::time::Duration::from_millis(500));
        assert!(
            rig.world().chip.pulses == pulses && rig.world().chip.energised(),
            "the drivers do not hold"
        );
        service.until("samples again", 10.0, |s| s["sensor"]["held"] == false);
        service.ask(&Request::ResetFault {});
        service.ask(&Request::Arm {});
        service.bend(60.0, -60.0);
        let error = service.settled_error_deg(60.0, -60.0);
        assert!(error <= 1.0, "after the hang: {error}");

        // many moves
        let mut dir = 0.0;
        while rig.world().chip.pulses < 100_000 {
            dir += 150.0;
            service.bend(75.0, dir);
            service.arrived();
            service.compare();
        }
        service.bend(35.0, 30.0);
        let error = service.settled_error_deg(35.0, 30.0);
        assert!(error <= 1.0, "after many moves: {error}");
        println!(
            "{} pulses, counts compared {} times, {} stalls",
            rig.world().chip.pulses,
            service.compared,
            service.stalls
        );
        assert!(service.compared >= 30);

        let (status, stalled) = service.terminate();
        assert!(
            status.success(),
            "{status}: {}",
            crate::pi::closed::said(rig)
        );
        let mut world = rig.world();
        assert_eq!((world.chip.lost, world.chip.torn), (0, 0));
        if stalled {
            println!(
                "this host stalled the step thread during the last return, which a fault ends"
            );
            return;
        }
        assert_eq!(world.chip.counted, [0; 3]);
        assert!(!world.chip.energised());
        let left = Bend::from_rotation(&world.truth().r_base_tip)
            .beta()
            .to_degrees();
        assert!(left < 8.0, "relaxed, and still bent by {left}°");
    });
}
