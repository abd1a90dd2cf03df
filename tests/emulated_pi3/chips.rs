//! Chips on the real I²C controller: register files that never change, as the contents of serial EEPROMs,
//! which QEMU has and whose protocol (register, then data, with automatic increment) is that of the sensors.
//!
//! An EEPROM that cannot be written keeps its bytes, so it holds what a sensor shows once it is set up.

use std::io;
use std::path::{Path, PathBuf};

/// Address of a chip that says it is another one.
pub const IMPOSTOR: u8 = 0x69;
/// What it says it is.
pub const IMPOSTOR_ID: u8 = 0x71;
/// Address of the LSM6DSO.
pub const LSM6DSO: u8 = 0x6A;
/// Address at which nothing is.
pub const NOBODY: u8 = 0x6B;
/// Address of the LIS2MDL.
pub const LIS2MDL: u8 = 0x1E;

/// Registers of an LSM6DSO at 52 Hz, 4 g and 500 °/s that lies still (DS12140).
fn lsm6dso() -> [u8; 256] {
    let mut r = [0; 256];
    r[0x0F] = 0x6C; // WHO_AM_I
    r[0x10..0x13].copy_from_slice(&[0x38, 0x34, 0x44]); // CTRL1_XL, CTRL2_G, CTRL3_C as they are set
    r[0x1E] = 0x03; // new acceleration, new rate
    for (at, count) in [
        (0x22, 3),
        (0x24, -5),
        (0x26, 2),
        (0x28, 41),
        (0x2A, -67),
        (0x2C, 8197_i16),
    ] {
        r[at..at + 2].copy_from_slice(&count.to_le_bytes());
    }
    r
}

/// Registers of a LIS2MDL at 100 Hz in a field of 20 and −45 µT (DS12144).
fn lis2mdl() -> [u8; 256] {
    let mut r = [0; 256];
    r[0x4F] = 0x40; // WHO_AM_I
    r[0x60..0x63].copy_from_slice(&[0x8C, 0x02, 0x10]); // CFG_REG_A to CFG_REG_C as they are set
    r[0x67] = 0x08; // new field
    for (at, count) in [(0x68, 133), (0x6A, 4), (0x6C, -300_i16)] {
        r[at..at + 2].copy_from_slice(&count.to_le_bytes());
    }
    r
}

/// Registers of an ICM-20948 that was replaced by another part.
fn impostor() -> [u8; 256] {
    let mut r = [0; 256];
    r[0x00] = IMPOSTOR_ID;
    r
}

/// Writes the images and says how QEMU is told of them.
pub fn on_the_controller(folder: &Path) -> io::Result<Vec<String>> {
    let mut words = Vec::new();
    for (name, address, registers) in [
        ("impostor", IMPOSTOR, impostor()),
        ("lsm6dso", LSM6DSO, lsm6dso()),
        ("lis2mdl", LIS2MDL, lis2mdl()),
    ] {
        let path: PathBuf = folder.join(format!("{name}.bin"));
        // a drive has whole sectors: the registers twice
        std::fs::write(&path, [registers, registers].concat())?;
        words.extend([
            "-drive".to_owned(),
            format!("if=none,id={name},format=raw,file={}", path.display()),
            "-device".to_owned(),
            format!("at24c-eeprom,bus=i2c-bus.1,address={address:#x},drive={name},rom-size=512,address-size=1,writable=off"),
        ]);
    }
    Ok(words)
}
