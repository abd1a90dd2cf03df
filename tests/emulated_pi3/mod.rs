//! The program on an emulated Raspberry Pi, layer 2: a whole Pi 3 in QEMU with Debian's kernel and systemd.
//! Real registers, a real I²C controller, the unit file as shipped, and the built-in plant closed around it:
//! pulses are read from QEMU's trace of stores to the chip, motion goes back to a sensor in the guest.
//!
//! `.ci/emulated-pi3` makes the machine and runs this. Counts, orders and states are judged and nothing that
//! has to do with time: an emulated processor has none.

mod chips;
mod guest;
mod runner;
mod service;
mod stages;
mod tip;
mod trace;
mod verdicts;
mod wire;

use self::service::Scene;
use retroflex::config::board::Board;
use retroflex::config::source;
use std::path::PathBuf;

/// The board whose lines, geometry and drive the guest has.
fn board() -> Board {
    source::read(&crate::common::repo("boards/pi3.toml")).unwrap()
}

#[test]
fn a_whole_pi_3_runs_the_service() {
    let Some(folder) = std::env::var_os("EMULATED_PI3").map(PathBuf::from) else {
        println!(
            "skipped: .ci/emulated-pi3 makes the machine, and names its folder in EMULATED_PI3"
        );
        return;
    };
    let words = chips::on_the_controller(&folder).unwrap();
    let guest = guest::Guest::start(&folder, &words);
    let tip = tip::TheTip::start(&guest, &board(), &crate::common::plant());
    let verdicts = verdicts::Verdicts::new(&folder.join("verdicts.txt"));
    let mut scene = Scene {
        guest,
        tip,
        verdicts,
        zero: [0; 3],
        stalls: 0,
    };
    stages::machine(&mut scene);
    stages::controller(&mut scene);
    stages::pins(&mut scene);
    runner::service(&mut scene);
    runner::watchdog(&mut scene);
    runner::caught(&mut scene);
    runner::stop(&mut scene);
    let Scene {
        guest,
        mut verdicts,
        ..
    } = scene;
    verdicts.hold("the guest shuts down", guest.end(), "QEMU has ended");
    assert!(verdicts.end());
}
