//! The sensor bus of the guest: `/dev/i2c-1` through CUSE with a register twin of an ICM-20948 on it, which
//! moves as the frames on a serial line say.
//!
//! `emulated-pi3-bus /dev/ttyS1`, as root, with `cuse` loaded and no other `/dev/i2c-1`.
#![allow(
    unsafe_code,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    dead_code
)]

#[path = "../../fake_imu/mod.rs"]
mod fake_imu;
#[path = "../../emulated_pi/fuse.rs"]
mod fuse;
#[path = "../../emulated_pi/i2c.rs"]
mod i2c;
#[path = "../wire.rs"]
mod wire;

use fake_imu::FakeIcm20948;
use fuse::{Answer, Files, Ioctl};
use i2c::Bus;
use retroflex::hardware::rt::monotonic_ns;
use std::fs::File;
use std::io::Read;
use std::sync::{Arc, Mutex, PoisonError};

/// Address of the tip's IMU.
const ADDRESS: u8 = 0x68;

/// The bus, brought up to the present with every transfer.
struct Moving {
    bus: Bus,
    reached_ns: u64,
}

impl Moving {
    fn advance(&mut self) {
        let now_ns = monotonic_ns();
        // after a pause only the last of its conversions can be read
        let passed_s = ((now_ns - self.reached_ns) as f64 * 1e-9).min(0.05);
        self.reached_ns = now_ns;
        self.bus.chips.advance(passed_s);
    }
}

impl Files for Moving {
    fn find(&mut self, _: &str) -> Option<u64> {
        None
    }
    fn ioctl(&mut self, call: &Ioctl<'_>) -> Answer {
        self.advance();
        self.bus.ioctl(call)
    }
    fn released(&mut self, _: u64) {}
    fn device(&self) -> Option<&'static str> {
        Some("i2c-1")
    }
}

/// A serial line without any treatment of its bytes.
fn raw_line(path: &str) -> File {
    let done = std::process::Command::new("stty")
        .args(["-F", path, "raw", "-echo", "115200"])
        .status()
        .expect("stty is there");
    assert!(done.success(), "stty on {path}: {done}");
    File::open(path).expect("the serial line")
}

fn main() {
    let path = std::env::args().nth(1).expect("the serial line is named");
    let mut bus = Bus::default();
    bus.chips.attach(FakeIcm20948::new(ADDRESS, 1));
    let moving = Arc::new(Mutex::new(Moving {
        bus,
        reached_ns: monotonic_ns(),
    }));
    let (mut line, motions) = (raw_line(&path), moving.clone());
    std::thread::spawn(move || {
        let (mut decoder, mut bytes) = (wire::Decoder::default(), [0; 256]);
        while let Ok(n @ 1..) = line.read(&mut bytes) {
            if let Some(motion) = decoder.take(&bytes[..n]) {
                motions
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .bus
                    .chips
                    .set_motion(&motion);
            }
        }
        eprintln!("the serial line has ended");
    });
    let device = File::options()
        .read(true)
        .write(true)
        .open("/dev/cuse")
        .expect("/dev/cuse");
    fuse::serve(&device, &moving);
}
