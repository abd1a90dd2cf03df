//! The machine behind the device files: a GPIO chip, an I²C bus and the built-in plant between them.
//!
//! Pulses move the plant, and the plant moves the sensor's registers. Time is real: every transfer and every access from
//! outside first advances the plant to the present in steps of a millisecond.

use super::fuse::{Answer, Files, Ioctl};
use super::gpio::{Chip, HANDLES};
use super::i2c::Bus;
use crate::fake_imu::{Device, FakeIcm20948, Motion, Noise};
use retroflex::config::board::{Board, PlantSection};
use retroflex::hardware::rt::monotonic_ns;
use retroflex::primitives::units::Steps;
use retroflex::simulation::plant::{Plant, Truth};

/// Nodes of the files; handles follow the last.
const BUS: u64 = 2;
const CHIP: u64 = 3;
const FIRST_HANDLE: u64 = 4;
/// One step of the plant, ns.
const PLANT_NS: u64 = 1_000_000;
/// Address of the tip's IMU.
pub const ADDRESS: u8 = 0x68;

/// Everything behind the files.
pub struct World {
    /// Lines.
    pub chip: Chip,
    /// Sensor bus.
    pub bus: Bus,
    /// Name of a file that root alone may open.
    pub guarded: Option<&'static str>,
    plant: Plant,
    reached_ns: u64,
    truth: Option<Truth>,
    last_motion: Motion,
}

impl World {
    /// The board's wiring, with a plant behind it.
    pub fn new(board: &Board, plant: &PlantSection, seed: u64) -> Self {
        let wiring = board.pins.as_ref().expect("a board with pins");
        let mut bus = Bus::default();
        let mut imu = FakeIcm20948::new(ADDRESS, seed);
        // the plant's own chip has the noise; twice would be too much
        imu.set_noise(Noise::NONE);
        bus.chips.attach(imu);
        let mut make = plant.clone();
        make.drive.step_mm = board.drive.law().step_mm;
        Self {
            chip: Chip::new(wiring, "pinctrl-bcm2835"),
            bus,
            guarded: None,
            plant: Plant::new(&make, seed).expect("the board's plant"),
            reached_ns: monotonic_ns(),
            truth: None,
            last_motion: Motion::default(),
        }
    }

    /// Brings the plant up to the present.
    pub fn advance(&mut self) {
        let now_ns = monotonic_ns();
        while self.reached_ns + PLANT_NS <= now_ns {
            self.reached_ns += PLANT_NS;
            let out = self
                .plant
                .step(&Steps(self.chip.counted), PLANT_NS as f64 * 1e-9);
            self.truth = Some(out.truth);
            if let Some(s) = out.imu {
                let last_mag = s.mag_ut;
                self.motion(|m| {
                    (m.acc_m_s2, m.gyro_rad_s) = (s.acc_m_s2, s.gyro_rad_s);
                    m.mag_ut = last_mag.unwrap_or(m.mag_ut);
                });
            }
            self.bus.chips.advance(PLANT_NS as f64 * 1e-9);
        }
    }

    fn motion(&mut self, change: impl FnOnce(&mut Motion)) {
        change(&mut self.last_motion);
        self.bus.chips.set_motion(&self.last_motion);
    }

    /// The truth at present.
    pub fn truth(&mut self) -> Truth {
        self.advance();
        self.truth.expect("time has passed")
    }
}

impl Files for World {
    fn find(&mut self, name: &str) -> Option<u64> {
        match name {
            "i2c-1" => Some(BUS),
            "gpiochip0" => Some(CHIP),
            _ => {
                let handle: u64 = name.strip_prefix("lines")?.parse().ok()?;
                (handle < HANDLES as u64).then_some(FIRST_HANDLE + handle)
            }
        }
    }

    fn ioctl(&mut self, call: &Ioctl<'_>) -> Answer {
        match call.node {
            BUS => {
                self.advance();
                self.bus.ioctl(call)
            }
            CHIP => self.chip.on_chip(call),
            node => {
                self.advance();
                self.chip.on_handle((node - FIRST_HANDLE) as usize, call)
            }
        }
    }

    fn mode(&self, node: u64) -> u32 {
        let guarded = match self.guarded {
            Some("i2c-1") => node == BUS,
            Some("gpiochip0") => node == CHIP,
            _ => false,
        };
        if guarded { 0o600 } else { 0o666 }
    }

    fn released(&mut self, node: u64) {
        if node >= FIRST_HANDLE {
            self.chip.release((node - FIRST_HANDLE) as usize);
        }
    }
}
