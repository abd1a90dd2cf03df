//! Faults that are injected while the plant runs.
//!
//! A fault acts from the step after its injection until all are cleared. Clearing ends the cause, not the
//! consequence: lost steps stay lost, escaped air is gone, a base that was turned stays turned.

use crate::model::Bend;
use crate::simulation::plant::chain::Plant;
use crate::simulation::plant::effects::contact::{Contact, Touching};
use crate::simulation::plant::imu::ImuFaults;
use crate::simulation::plant::law::each;
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
/// Give of an injected wall, degrees of bend: soft tissue.
const WALL_GIVE_DEG: f64 = 4.0;

impl Plant {
    /// Lets the rotor of a channel fall behind by microsteps that nothing counts; below 0 it runs ahead.
    pub fn slip(&mut self, channel: usize, microsteps: i32) {
        self.drive.rotor[channel] -= f64::from(microsteps);
    }

    /// Turns the base about an axis in the world of any length but 0, within a time; 0 is instantaneous.
    pub fn turn_base(&mut self, axis: [f64; 3], angle_deg: f64, over_s: f64) {
        let axis = Vector3::from(axis).try_normalize(1e-9).unwrap_or_default();
        self.stand
            .begin_turn(axis * angle_deg.to_radians(), self.t, over_s);
    }

    /// Puts a soft wall in the way of the tip, at a bend in a direction, degrees.
    pub fn put_wall(&mut self, at_deg: f64, direction_deg: f64) {
        self.shape.wall = Some(Touching::new(Contact {
            block: 1.0,
            direction_deg,
            at_deg,
            give_deg: WALL_GIVE_DEG,
            ..Contact::default()
        }));
    }

    /// Opens the lines, pistons at zero, and closes them again: the air that leaked flows back.
    pub fn vent(&mut self) {
        self.line.vent(&mut self.laws);
    }

    /// Ends everything that was injected; consequences stay.
    pub fn clear(&mut self) {
        self.faults = Faults::default();
        self.stand.settle(self.t);
        self.shape.wall = None;
        each(&mut self.laws, |law| law.release());
    }
}
