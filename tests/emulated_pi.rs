//! The program on an emulated Raspberry Pi, layer 1: real `rppal`, real device files, a closed plant
//! behind them. Needs root and FUSE; skips with a printed reason where it cannot mount.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;
#[path = "emulated_pi/fuse.rs"]
mod fuse;
#[path = "emulated_pi/gpio.rs"]
mod gpio;
#[path = "emulated_pi/i2c.rs"]
mod i2c;
#[path = "emulated_pi/rig.rs"]
mod rig;
#[path = "emulated_pi/server.rs"]
mod server;

use common::repo;
use retroflex::config::board::Board;
use retroflex::config::source;
use rig::{Rig, on_a_pi};
use server::World;

fn board(name: &str) -> Board {
    source::read(&repo(&format!("boards/{name}.toml"))).unwrap()
}

/// The paper twin behind a board's pins.
fn world(name: &'static str) -> impl FnOnce() -> World + Send {
    move || World::new(&board(name), &common::plant(), 1)
}

/// Exit code, stdout, stderr.
fn run(rig: &Rig, args: &[&str]) -> (i32, String, String) {
    let out = rig.command(args).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (out.status.code().unwrap_or(-1), text(&out.stdout), text(&out.stderr))
}

#[test]
fn pulses_through_the_device_file_are_counted_one_by_one() {
    on_a_pi(world("linux-gpiochip"), |rig| {
        let path = repo("boards/linux-gpiochip.toml");
        let (code, out, err) = run(rig, &["bench", "rt", "--board", path.to_str().unwrap(), "--rate", "4000", "--seconds", "3"]);
        println!("{out}\n{err}");
        assert_eq!(code, 0);
        let world = rig.world();
        assert!(world.chip.pulses > 20_000, "{}", world.chip.pulses);
        let told = out.split("steps in").next().unwrap().split_whitespace().last().unwrap();
        assert_eq!(told.parse::<u64>().unwrap(), world.chip.pulses);
        // a bench leaves the drivers without current
        assert_eq!((world.chip.lost, world.chip.counted, world.chip.torn), (world.chip.pulses, [0; 3], 0));
    });
}
