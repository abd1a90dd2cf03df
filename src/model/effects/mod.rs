//! The catalogue: physical effects beyond the nominal model, one cause a file.
//!
//! An effect is a law with memory: from its parameters and a [`Memory`] it changes a signal on its way
//! through the chain `pistons → play → extension → bellows → lag → shape → sensor`. A stage that an effect
//! does not act in keeps the default method, which does nothing.
//!
//! A new effect is a file with its [`EffectInfo`] and its [`Effect`], a `mod` line and an entry in
//! [`catalogue`].

pub mod accel_bias;
pub mod asymmetry;
pub mod base_motion;
pub mod cable_stiffness;
pub mod clocking;
pub mod contact;
pub mod creep;
pub mod crosstalk;
pub mod curvature;
pub mod gas_compression;
pub mod gear_periodic;
pub mod gravity;
pub mod gyro_bias;
pub mod hard_iron;
pub mod hysteresis;
pub mod leak;
pub mod line_lag;
pub mod missed_steps;
pub mod motor_field;
pub mod mount_misalignment;
pub mod param;
mod prelude;
pub mod sensor_latency;
pub mod smooth;
pub mod softening;
pub mod stiffening;
pub mod thermal_drift;
pub mod torsion;
pub mod transport_delay;

pub use param::MODE_PARAMS;

use crate::named;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use std::fmt;

named! {
    /// Part of the machine that an effect acts in.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum Stage {
        /// Motor, rack and pinion.
        Drive = "drive",
        /// Air line from syringe to bellow.
        Transmission = "transmission",
        /// Rubber.
        Bellows = "bellows",
        /// From bellow lengths to tip orientation.
        Shape = "shape",
        /// IMU.
        Sensor = "sensor",
        /// Dead times.
        Timing = "timing",
        /// Attitude of the base.
        Base = "base",
    }
}

/// One parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Param {
    /// Name in reports and files.
    pub name: &'static str,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
    /// Channel 1 to 3 it belongs to; 0 if to none.
    pub channel: u8,
    /// Value at which the effect vanishes; a typical value for a parameter that only shapes it.
    pub start: f64,
    /// Typical size: unit of the fit's steps and standard deviation of the prior around `start`.
    pub scale: f64,
    /// Least physical value.
    pub low: f64,
    /// Largest physical value.
    pub high: f64,
}

/// Constant data of an effect, stated once in its own file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EffectInfo {
    /// Name in files and reports.
    pub name: &'static str,
    /// Stage of the chain that the effect acts in.
    pub stage: Stage,
    /// The signature it leaves in a log, one sentence.
    pub signature: &'static str,
    /// Names of the effects with a similar signature.
    pub confused_with: &'static [&'static str],
    /// The manoeuvre that separates it from those.
    pub separated_by: &'static str,
    /// Number of events, for an effect that happens at times of its own and therefore cannot be predicted from another log;
    /// 0 for one that acts all the time. The parameters of an event effect are one group per event, and then its periodic modes.
    pub events: usize,
    /// Parameters, in the order of the slices that the methods of [`Effect`] take.
    pub params: &'static [Param],
    /// Starting points of a fit, where one at half a scale from `start` in each parameter does not do.
    pub starts: &'static [&'static [f64]],
}

impl EffectInfo {
    /// Whether the effect happens at times of its own.
    pub fn is_event(&self) -> bool {
        self.events > 0
    }
}

/// Starting points for a fit: several, where the error surface has several valleys.
pub type Starts = Vec<Vec<f64>>;

/// State of an effect; all zero at the start, with the pistons at zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Memory(pub [f64; 64]);

impl Default for Memory {
    fn default() -> Self {
        Self([0.0; 64])
    }
}

/// One instant of a log, besides the signal itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Time since the log or the service began, s.
    pub t_s: f64,
    /// Time since the last instant, s.
    pub dt_s: f64,
    /// Piston displacement as counted, mm.
    pub counted_mm: Vector3<f64>,
    /// Direction of up in the base frame, unit vector.
    pub up_base: Vector3<f64>,
    /// Extension gains k_ε of the nominal model.
    pub k_epsilon: Vector3<f64>,
    /// Distance of the bellows from the backbone, mm.
    pub r_mm: f64,
    /// Seconds since any piston last moved.
    pub idle_s: f64,
}

/// Tip shape on its way from bellow lengths to orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Bend vector, rad.
    pub bend: Vector2<f64>,
    /// Rotation of the tip about its own axis, rad.
    pub twist: f64,
    /// Bellow length changes it came from, mm.
    pub bellow_mm: Vector3<f64>,
}

/// Predicted reading of the tip IMU, sensor frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuPrediction {
    /// Specific force, m/s².
    pub acc_m_s2: Vector3<f64>,
    /// Rate, rad/s.
    pub gyro_rad_s: Vector3<f64>,
    /// Field, µT.
    pub mag_ut: Vector3<f64>,
    /// Sensor to base, for fields that are fixed in the world.
    pub r_base_sensor: UnitQuaternion<f64>,
}

/// One physical cause. Parameters `p` are in the order of [`EffectInfo::params`].
pub trait Effect: Send + Sync {
    /// The catalogue entry.
    fn info(&self) -> &'static EffectInfo;
    /// [`EffectInfo::name`].
    fn name(&self) -> &'static str {
        self.info().name
    }
    /// [`EffectInfo::stage`].
    fn stage(&self) -> Stage {
        self.info().stage
    }
    /// [`EffectInfo::params`].
    fn params(&self) -> &'static [Param] {
        self.info().params
    }
    /// Number of periodic modes, each a group of [`MODE_PARAMS`] parameters after those of the events: its frequency, Hz, which is 0 for
    /// an absent mode, and the three offsets of its sine and of its cosine.
    fn modes(&self) -> usize {
        0
    }
    /// Number of parameters of one event, or of all for an effect without events.
    fn event_params(&self) -> usize {
        (self.params().len() - self.modes() * MODE_PARAMS) / self.info().events.max(1)
    }
    /// Starting points of a fit.
    fn starts(&self) -> Starts {
        let half_a_scale = |p: &Param| (p.start + 0.5 * p.scale).clamp(p.low, p.high);
        match self.info().starts {
            [] => vec![self.params().iter().map(half_a_scale).collect()],
            starts => starts.iter().map(|start| start.to_vec()).collect(),
        }
    }
    /// True piston positions, mm.
    fn pistons(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _u_mm: &mut Vector3<f64>) {}
    /// Outputs of the play operators, before the extension, mm: `w = (1 + k_ε) q` in the nominal model.
    fn play_output(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _w_mm: &mut Vector3<f64>) {}
    /// Bellow length changes after the extension, mm.
    fn bellows(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _q_mm: &mut Vector3<f64>) {}
    /// Shape after constant curvature.
    fn shape(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _pose: &mut Pose) {}
    /// Rotation of the base since the start: base now → base at the start.
    fn base(&self, _p: &[f64], _at: &Moment) -> Option<UnitQuaternion<f64>> {
        None
    }
    /// Constant rotation from sensor to tip.
    fn mount(&self, _p: &[f64]) -> Option<UnitQuaternion<f64>> {
        None
    }
    /// Replaces the parameters by those that a report names, among all that give the same orientations;
    /// `k_epsilon` are the nominal gains.
    fn canonical(&self, _p: &mut [f64], _k_epsilon: &Vector3<f64>) {}
    /// Part of the squared size of the parameters, 0 to 1, that no usual form of the cause has. A law with more freedom than its
    /// cause also fits other causes; this part then shows it.
    fn unusual(&self, _p: &[f64]) -> f64 {
        0.0
    }
    /// Reading of the sensor.
    fn sensor(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _reading: &mut ImuPrediction) {}
    /// Dead time from command to motion, s.
    fn transport_s(&self, _p: &[f64]) -> f64 {
        0.0
    }
    /// Dead time from motion to sample, s.
    fn latency_s(&self, _p: &[f64]) -> f64 {
        0.0
    }
    /// True if its contribution to a reading changes with every single step of the motors.
    fn follows_motors(&self) -> bool {
        false
    }
    /// True if the effect does not change the motion of the tip, so that a fit need not simulate it again.
    fn sensing_only(&self) -> bool {
        matches!(self.stage(), Stage::Sensor | Stage::Base)
    }
}

impl fmt::Debug for dyn Effect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Effects are equal if they have the same name.
impl PartialEq for dyn Effect {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

/// The whole catalogue, in the order of the signal and of the published table.
pub fn catalogue() -> &'static [&'static dyn Effect] {
    &[
        &missed_steps::MissedSteps,
        &gear_periodic::GearPeriodic,
        &leak::Leak,
        &gas_compression::GasCompression,
        &line_lag::LineLag,
        &thermal_drift::ThermalDrift,
        &crosstalk::Crosstalk,
        &stiffening::Stiffening,
        &asymmetry::Asymmetry,
        &hysteresis::Hysteresis,
        &creep::Creep,
        &softening::Softening,
        &gravity::Gravity,
        &curvature::Curvature,
        &clocking::Clocking,
        &cable_stiffness::CableStiffness,
        &torsion::Torsion,
        &contact::Contact,
        &gyro_bias::GyroBias,
        &accel_bias::AccelBias,
        &hard_iron::HardIron,
        &motor_field::MotorField,
        &mount_misalignment::MountMisalignment,
        &transport_delay::TransportDelay,
        &sensor_latency::SensorLatency,
        &base_motion::BaseMotion,
    ]
}

/// The effect of that name; `None` if the catalogue has no such effect.
pub fn by_name(name: &str) -> Option<&'static dyn Effect> {
    catalogue().iter().copied().find(|e| e.name() == name)
}

/// Name in the catalogue of an effect or of its variant: what follows a dot is a variant, so `hysteresis.folds` is a hysteresis.
pub fn entry(name: &'static str) -> &'static str {
    name.split_once('.').map_or(name, |(entry, _)| entry)
}

/// Names of effects, divided into those that the catalogue has and the others.
pub fn by_catalogue(names: impl Iterator<Item = &'static str>) -> [Vec<&'static str>; 2] {
    let (inside, outside) = names.partition(|name| by_name(entry(name)).is_some());
    [inside, outside]
}

#[cfg(test)]
mod tests;
