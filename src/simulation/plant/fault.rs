//! Faults that are injected while the plant runs.
//!
//! A fault acts from the step after its injection until all are cleared (`Plant::clear`). Clearing ends the cause, not the
//! consequence: lost steps stay lost, escaped air is gone, a base that was turned stays turned.

use crate::model::Bend;
use nalgebra::Vector3;

/// The faults that act at present. Channels count from 0.
#[derive(Debug, Clone)]
pub struct Faults {
    /// 1, or −1 where a motor turns the wrong way, or 0 where a driver is off and the rack stays where it is.
    pub drive_gain: Vector3<f64>,
    /// Where a rack meets a stop, mm of piston from zero; its sign is the side. Steps beyond it are lost.
    pub stop_mm: [Option<f64>; 3],
    /// Share of the held displacement that each line loses per second, 1/s.
    pub leak_per_s: [f64; 3],
    /// Lumens that are kinked shut: the air in the bellow stays.
    pub blocked: [bool; 3],
    /// Factor on the compliance k_ε of the air in each line; above 1 with a bubble.
    pub compliance: Vector3<f64>,
    /// Factor on the length change of each bellow.
    pub bellow_gain: Vector3<f64>,
    /// The tip is pushed aside: change of its bend.
    pub push: Bend,
    /// A magnet nearby: its field in the world, µT.
    pub magnet_ut: Vector3<f64>,
    /// Faults of the tip's IMU.
    pub imu: ImuFaults,
    /// Faults of the IMU on the base, if there is one.
    pub base_imu: ImuFaults,
}

impl Default for Faults {
    fn default() -> Self {
        let one = Vector3::repeat(1.0);
        Self {
            drive_gain: one,
            stop_mm: [None; 3],
            leak_per_s: [0.0; 3],
            blocked: [false; 3],
            compliance: one,
            bellow_gain: one,
            push: Bend::STRAIGHT,
            magnet_ut: Vector3::zeros(),
            imu: ImuFaults::default(),
            base_imu: ImuFaults::default(),
        }
    }
}

/// Rate at which a line that comes off, or a torn bellow, empties, 1/s: within a tenth of a second.
pub const BURST_PER_S: f64 = 25.0;

/// Injected faults of an IMU.
#[derive(Debug, Clone, Copy, Default)]
pub struct ImuFaults {
    /// Every sample repeats the last one under a new time stamp.
    pub frozen: bool,
    /// Readings contain NaN.
    pub nan: bool,
    /// Rate and force read full scale.
    pub saturated: bool,
    /// Added to the next sample only, on every axis: rate, °/s, and force, g.
    pub spike: Option<(f64, f64)>,
    /// Added to every rate, °/s.
    pub rate_deg_s: [f64; 3],
    /// Of the samples of the IMU on the base, only one in so many comes; those since the last one.
    pub slow: Option<(u32, u32)>,
    /// Added to the field in the axes of the chip, µT: a magnet at the chip itself.
    pub field_ut: Vector3<f64>,
}

impl ImuFaults {
    /// [`slow`](Self::slow) for an IMU on the base of which no sample comes.
    pub const SILENT: Option<(u32, u32)> = Some((u32::MAX, 0));

    /// Whether a sample comes.
    pub(crate) fn passes(&mut self) -> bool {
        self.slow.as_mut().is_none_or(|(one_in, since)| {
            *since = (*since + 1) % *one_in;
            *since == 0
        })
    }
}
