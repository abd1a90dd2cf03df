//! The program on an emulated Raspberry Pi, layer 1: the real `rppal` on device files with a plant behind them. The tests
//! need root and FUSE; where they cannot mount, they print the reason and skip.
#![allow(dead_code, reason = "every test binary takes its own part of this")]

pub mod closed;
pub mod fuse;
pub mod gpio;
pub mod i2c;
pub mod registers;
pub mod rig;
pub mod server;

use self::rig::Rig;
use self::server::World;
use crate::common::repo;
use retroflex::config::board::Board;
use retroflex::config::source;

pub fn board(name: &str) -> Board {
    source::read(&repo(&format!("boards/{name}.toml"))).unwrap()
}

/// The paper twin behind a board's pins.
pub fn world(name: &'static str) -> impl FnOnce() -> World + Send {
    move || World::new(&board(name), &crate::common::plant(), 1)
}

/// Exit code, stdout, stderr.
pub fn run(rig: &Rig, args: &[&str]) -> (i32, String, String) {
    let out = rig.command(args).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        out.status.code().unwrap_or(-1),
        text(&out.stdout),
        text(&out.stderr),
    )
}

/// A board of the repository on a shared host. These tests verify counts and order, so the bound of lateness is the largest
/// that a board can have.
pub fn on_a_shared_host(
    rig: &Rig,
    name: &str,
    late: &str,
    lead: &str,
    more: &[(&str, &str)],
) -> String {
    variant(
        rig,
        name,
        &[
            &[(late, "late_max_us = 100000.0"), (lead, "lead_ms = 60.0")],
            more,
        ]
        .concat(),
    )
}

/// The board with a GPIO chip.
pub fn chip_board(rig: &Rig) -> String {
    on_a_shared_host(
        rig,
        "linux-gpiochip",
        "late_max_us = 5000.0",
        "lead_ms = 10.0",
        &[],
    )
}

/// A board file of the repository with lines replaced, in the rig's folder.
pub fn variant(rig: &Rig, name: &str, changes: &[(&str, &str)]) -> String {
    let board: Board = source::read(&repo(&format!("boards/{name}.toml"))).unwrap();
    let mut text = retroflex::config::show::whole(&board);
    for (old, new) in changes {
        assert!(text.contains(old), "`{old}` is not in {name}");
        text = text.replacen(old, new, 1);
    }
    let path = rig.folder().join(format!("{name}-variant.toml"));
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}
