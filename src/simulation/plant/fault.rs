//! Things that break while the plant runs, for drills.
//!
//! A fault acts from the step after it is injected until all are cleared. Clearing repairs the cause,
//! never the consequence: steps that were lost stay lost, air that escaped is gone, a base that was
//! turned stays turned.

use crate::simulation::plant::Plant;
use crate::simulation::plant::shape::contact::{Contact, Touching};
use nalgebra::Vector3;

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
    /// In order.
    pub const ALL: [Self; 3] = [Self::One, Self::Two, Self::Three];

    /// 0 to 2.
    #[must_use]
    pub fn index(self) -> usize {
        match self {
            Self::One => 0,
            Self::Two => 1,
            Self::Three => 2,
        }
    }
}

/// Something that breaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum InjectedFault {
    /// The IMU does not answer (bus error, pulled plug): no sample at all.
    NoSample,
    /// The IMU repeats its last reading under new time stamps.
    FrozenSample,
    /// The IMU's reading holds what is no number.
    NanSample,
    /// One reading is off by so much on every axis, then none.
    Spike {
        /// Added to the gyroscope, °/s.
        gyro_deg_s: f64,
        /// Added to the accelerometer, g.
        acc_g: f64,
    },
    /// Gyroscope and accelerometer read full scale.
    Saturation,
    /// The magnetometer alone says nothing.
    NoMag,
    /// The gyroscope's bias jumps.
    GyroBias {
        /// By how much, °/s per axis.
        deg_s: [f64; 3],
    },
    /// The accelerometer's bias jumps.
    AccBias {
        /// By how much, mg per axis.
        mg: [f64; 3],
    },
    /// A rotor slips.
    StepLoss {
        /// Which.
        channel: Channel,
        /// Microsteps that the rotor falls behind (below 0: runs ahead).
        microsteps: i32,
    },
    /// A motor turns the wrong way.
    Inverted {
        /// Which.
        channel: Channel,
    },
    /// A driver is switched off: the rack stays where it is.
    Disabled {
        /// Which.
        channel: Channel,
    },
    /// A rack meets a stop; what is sent beyond is lost.
    EndStop {
        /// Which.
        channel: Channel,
        /// Where, mm of piston from zero; the side is the sign.
        at_mm: f64,
    },
    /// A line begins to leak.
    Leak {
        /// Which.
        channel: Channel,
        /// Share of the held displacement lost per second, 1/s.
        rate_per_s: f64,
    },
    /// A line comes off or a bellow tears: open to the air.
    Burst {
        /// Which.
        channel: Channel,
    },
    /// Air comes into a line: it gives way more.
    AirBubble {
        /// Which.
        channel: Channel,
        /// Factor on its compliance k_ε.
        factor: f64,
    },
    /// A lumen is kinked shut: what is in the bellow stays in.
    Blocked {
        /// Which.
        channel: Channel,
    },
    /// A bellow moves by more or less than before.
    Gain {
        /// Which.
        channel: Channel,
        /// Factor on its length change.
        factor: f64,
    },
    /// Somebody turns the base.
    BaseTurn {
        /// Axis in the world, any length but 0.
        axis: [f64; 3],
        /// Angle, degrees.
        angle_deg: f64,
        /// How long it takes, s; 0 is at once.
        over_s: f64,
    },
    /// A magnet comes near: a field is added in the world.
    Magnet {
        /// The field, µT.
        field_ut: [f64; 3],
    },
    /// Somebody pushes the tip aside.
    Push {
        /// By how much bend, degrees.
        bend_deg: f64,
        /// In which direction, degrees.
        dir_deg: f64,
    },
    /// A soft wall stands in the way from now on.
    Wall {
        /// Bend at which the tip meets it, degrees.
        at_deg: f64,
        /// Bend direction in which it lies, degrees.
        dir_deg: f64,
    },
}

/// Rate at which an open line empties, 1/s.
const BURST_PER_S: f64 = 25.0;
/// Give of a wall that is put in the way, degrees.
const WALL_GIVE_DEG: f64 = 4.0;

impl Plant {
    /// Breaks something from now on.
    pub fn inject(&mut self, fault: InjectedFault) {
        match fault {
            InjectedFault::NoSample
            | InjectedFault::FrozenSample
            | InjectedFault::NanSample
            | InjectedFault::Spike { .. }
            | InjectedFault::Saturation
            | InjectedFault::NoMag
            | InjectedFault::GyroBias { .. }
            | InjectedFault::AccBias { .. } => self.break_sensor(fault),
            InjectedFault::StepLoss { .. }
            | InjectedFault::Inverted { .. }
            | InjectedFault::Disabled { .. }
            | InjectedFault::EndStop { .. } => self.break_drive(fault),
            InjectedFault::Leak { channel, rate_per_s } => self.line.broken.leak(channel.index(), rate_per_s),
            InjectedFault::Burst { channel } => self.line.broken.leak(channel.index(), BURST_PER_S),
            InjectedFault::Blocked { channel } => self.line.broken.block(channel.index()),
            InjectedFault::AirBubble { channel, factor } => self.bellows.broken.compliance[channel.index()] = factor,
            InjectedFault::Gain { channel, factor } => self.bellows.broken.gain[channel.index()] = factor,
            InjectedFault::BaseTurn { axis, angle_deg, over_s } => {
                let axis = Vector3::from(axis).try_normalize(1e-9).unwrap_or_default();
                self.stand.begin_turn(axis * angle_deg.to_radians(), self.t, over_s);
            }
            InjectedFault::Magnet { field_ut } => self.magnet_ut = Vector3::from(field_ut),
            InjectedFault::Push { bend_deg, dir_deg } => self.shape.push = crate::model::bend::Bend::from_deg(bend_deg, dir_deg).0,
            InjectedFault::Wall { at_deg, dir_deg } => {
                let wall = Contact { block: 1.0, direction_deg: dir_deg, at_deg, give_deg: WALL_GIVE_DEG, ..Contact::default() };
                self.shape.stand_in_the_way(Some(Touching::new(wall)));
            }
        }
    }

    /// A person opens the lines, pistons at rest, and closes them again: what had leaked flows back.
    pub fn vent(&mut self) {
        self.line.vent();
    }

    /// Repairs everything that was injected; consequences stay.
    pub fn clear(&mut self) {
        self.imu.broken = crate::simulation::plant::imu::Broken::default();
        self.drive.broken = crate::simulation::plant::drive::Broken::default();
        self.bellows.broken = crate::simulation::plant::bellows::Broken::default();
        self.line.broken.mend();
        self.stand.settle(self.t);
        self.magnet_ut = Vector3::zeros();
        self.shape.push = nalgebra::Vector2::zeros();
        self.shape.stand_in_the_way(None);
    }

    fn break_sensor(&mut self, fault: InjectedFault) {
        let g = crate::simulation::plant::imu::GRAVITY_M_S2;
        let broken = &mut self.imu.broken;
        match fault {
            InjectedFault::NoSample => broken.silent = true,
            InjectedFault::FrozenSample => broken.frozen = true,
            InjectedFault::NanSample => broken.nan = true,
            InjectedFault::Spike { gyro_deg_s, acc_g } => {
                broken.spike = Some((Vector3::repeat(gyro_deg_s.to_radians()), Vector3::repeat(acc_g * g)));
            }
            InjectedFault::Saturation => broken.saturated = true,
            InjectedFault::NoMag => broken.mag_silent = true,
            InjectedFault::GyroBias { deg_s } => broken.rate = Vector3::from(deg_s).map(f64::to_radians),
            InjectedFault::AccBias { mg } => broken.force = Vector3::from(mg) * (1e-3 * g),
            _ => {}
        }
    }

    fn break_drive(&mut self, fault: InjectedFault) {
        match fault {
            InjectedFault::StepLoss { channel, microsteps } => self.drive.slip(channel.index(), -f64::from(microsteps)),
            InjectedFault::Inverted { channel } => self.drive.broken.gain[channel.index()] = -1.0,
            InjectedFault::Disabled { channel } => self.drive.broken.gain[channel.index()] = 0.0,
            InjectedFault::EndStop { channel, at_mm } => self.drive.broken.stop_mm[channel.index()] = Some(at_mm),
            _ => {}
        }
    }
}
