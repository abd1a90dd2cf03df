//! Faults that are injected while the plant runs.
//!
//! A fault acts from the step after its injection until all are cleared. Clearing ends the cause, not the
//! consequence: lost steps stay lost, escaped air is gone, a base that was turned stays turned.

use crate::model::Bend;
use crate::simulation::plant::bellows::BellowFaults;
use crate::simulation::plant::chain::Plant;
use crate::simulation::plant::drive::DriveFaults;
use crate::simulation::plant::effects::contact::{Contact, Touching};
use crate::simulation::plant::imu::ImuFaults;
use crate::simulation::plant::imu::stimulus::GRAVITY_M_S2;
use nalgebra::{Vector2, Vector3};

/// One of the three channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Channel 1.
    One,
    /// Channel 2.
    Two,
    /// Channel 3.
    Three,
}

impl Channel {
    /// All channels, in order.
    pub const ALL: [Self; 3] = [Self::One, Self::Two, Self::Three];

    /// Index from 0.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// A fault of the plant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum InjectedFault {
    /// The IMU repeats its last reading under new time stamps.
    FrozenSample,
    /// Readings of the IMU contain NaN.
    NanSample,
    /// One reading is off on every axis.
    Spike {
        /// Added to the gyroscope, °/s.
        gyro_deg_s: f64,
        /// Added to the accelerometer, g.
        acc_g: f64,
    },
    /// Gyroscope and accelerometer read full scale.
    Saturation,
    /// The gyroscope's bias jumps.
    GyroBias {
        /// Change, °/s per axis.
        deg_s: [f64; 3],
    },
    /// Of the samples of the IMU on the base, only one in so many comes. Not for the tip's.
    Slow {
        /// Samples per one that comes.
        one_in: u32,
    },
    /// A magnet at the IMU itself adds a field in its axes.
    HardIron {
        /// The field, µT.
        field_ut: [f64; 3],
    },
    /// One of the faults above of the IMU on the base instead of the tip's.
    OfBaseImu(&'static InjectedFault),
    /// A rotor slips.
    StepLoss {
        /// Channel at fault.
        channel: Channel,
        /// Microsteps that the rotor falls behind (below 0: runs ahead).
        microsteps: i32,
    },
    /// A motor turns the wrong way.
    Inverted {
        /// Channel at fault.
        channel: Channel,
    },
    /// A driver is switched off: the rack stays where it is.
    Disabled {
        /// Channel at fault.
        channel: Channel,
    },
    /// A rack meets a stop; steps beyond it are lost.
    EndStop {
        /// Channel at fault.
        channel: Channel,
        /// Position, mm of piston from zero; its sign is the side.
        at_mm: f64,
    },
    /// A line begins to leak.
    Leak {
        /// Channel at fault.
        channel: Channel,
        /// Share of the held displacement lost per second, 1/s.
        rate_per_s: f64,
    },
    /// A line comes off or a bellow tears: open to the air.
    Burst {
        /// Channel at fault.
        channel: Channel,
    },
    /// A bubble enters a line, which becomes more compliant.
    AirBubble {
        /// Channel at fault.
        channel: Channel,
        /// Factor on its compliance k_ε.
        factor: f64,
    },
    /// A lumen is kinked shut: the air in the bellow stays.
    Blocked {
        /// Channel at fault.
        channel: Channel,
    },
    /// A bellow moves by more or less than before.
    Gain {
        /// Channel at fault.
        channel: Channel,
        /// Factor on its length change.
        factor: f64,
    },
    /// The base is turned.
    BaseTurn {
        /// Axis in the world, any length but 0.
        axis: [f64; 3],
        /// Angle, degrees.
        angle_deg: f64,
        /// Duration, s; 0 is instantaneous.
        over_s: f64,
    },
    /// A magnet nearby adds a field in the world.
    Magnet {
        /// The field, µT.
        field_ut: [f64; 3],
    },
    /// The tip is pushed aside.
    Push {
        /// Change of the bend, degrees.
        bend_deg: f64,
        /// Direction of the change, degrees.
        dir_deg: f64,
    },
    /// A soft wall obstructs the tip.
    Wall {
        /// Bend at which the tip meets it, degrees.
        at_deg: f64,
        /// Bend direction in which it lies, degrees.
        dir_deg: f64,
    },
}

impl InjectedFault {
    /// No sample comes.
    pub const SILENT: Self = Self::Slow { one_in: u32::MAX };
}

/// Rate at which an open line empties, 1/s: within a tenth of a second.
const BURST_PER_S: f64 = 25.0;
/// Give of an injected wall, degrees of bend: soft tissue.
const WALL_GIVE_DEG: f64 = 4.0;

impl Plant {
    /// Injects a fault.
    pub fn inject(&mut self, fault: InjectedFault) {
        use InjectedFault as F;
        let (drive, bellows) = (&mut self.drive, &mut self.bellows.faults);
        let (fault, imu) = match (fault, &mut self.base_imu) {
            (F::OfBaseImu(fault), Some(imu)) => (*fault, &mut imu.faults),
            _ => (fault, &mut self.imu.faults),
        };
        match fault {
            F::OfBaseImu(_) => {}
            F::Slow { one_in } => imu.slow = Some((one_in, 0)),
            F::HardIron { field_ut } => imu.field_ut = Vector3::from(field_ut),
            F::FrozenSample => imu.frozen = true,
            F::NanSample => imu.nan = true,
            F::Spike { gyro_deg_s, acc_g } => {
                imu.spike = Some((
                    Vector3::repeat(gyro_deg_s.to_radians()),
                    Vector3::repeat(acc_g * GRAVITY_M_S2),
                ));
            }
            F::Saturation => imu.saturated = true,
            F::GyroBias { deg_s } => imu.rate = Vector3::from(deg_s).map(f64::to_radians),
            F::StepLoss {
                channel,
                microsteps,
            } => drive.slip(channel.index(), -f64::from(microsteps)),
            F::Inverted { channel } => drive.faults.gain[channel.index()] = -1.0,
            F::Disabled { channel } => drive.faults.gain[channel.index()] = 0.0,
            F::EndStop { channel, at_mm } => drive.faults.stop_mm[channel.index()] = Some(at_mm),
            F::Leak {
                channel,
                rate_per_s,
            } => self.line.faults.leak(channel.index(), rate_per_s),
            F::Burst { channel } => self.line.faults.leak(channel.index(), BURST_PER_S),
            F::Blocked { channel } => self.line.faults.blocked[channel.index()] = true,
            F::AirBubble { channel, factor } => bellows.compliance[channel.index()] = factor,
            F::Gain { channel, factor } => bellows.gain[channel.index()] = factor,
            F::BaseTurn {
                axis,
                angle_deg,
                over_s,
            } => {
                let axis = Vector3::from(axis).try_normalize(1e-9).unwrap_or_default();
                self.stand
                    .begin_turn(axis * angle_deg.to_radians(), self.t, over_s);
            }
            F::Magnet { field_ut } => self.magnet_ut = Vector3::from(field_ut),
            F::Push { bend_deg, dir_deg } => self.shape.push = Bend::from_deg(bend_deg, dir_deg).0,
            F::Wall { at_deg, dir_deg } => {
                let wall = Contact {
                    block: 1.0,
                    direction_deg: dir_deg,
                    at_deg,
                    give_deg: WALL_GIVE_DEG,
                    ..Contact::default()
                };
                self.shape.wall = Some(Touching::new(wall));
            }
        }
    }

    /// Opens the lines, pistons at zero, and closes them again: the air that leaked flows back.
    pub fn vent(&mut self) {
        self.line.vent(&mut self.laws);
    }

    /// Ends everything that was injected; consequences stay.
    pub fn clear(&mut self) {
        self.imu.faults = ImuFaults::default();
        self.base_imu
            .iter_mut()
            .for_each(|imu| imu.faults = ImuFaults::default());
        self.drive.faults = DriveFaults::default();
        self.bellows.faults = BellowFaults::default();
        self.line.faults.clear();
        self.stand.settle(self.t);
        self.magnet_ut = Vector3::zeros();
        self.shape.push = Vector2::zeros();
        self.shape.wall = None;
        self.laws.iter_mut().for_each(|law| law.release());
    }
}
