//! The catalogue: physical effects that the nominal model leaves out, one cause a file.
//!
//! An effect is a pure law with memory: parameters and a [`Memory`] go in, a signal is changed on its
//! way through the chain `pistons → play → slack → extension → bellows → lag → shape → sensor`. The
//! same functions serve the simulator, the fit of the diagnosis and the controller's feedforward; none
//! of them knows which of the three is calling. A stage that an effect does not touch keeps the
//! default method, which does nothing.

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
#[cfg(test)]
mod proof;
pub mod sensor_latency;
pub mod smooth;
pub mod softening;
pub mod stiffening;
pub mod thermal_drift;
pub mod torsion;
pub mod transport_delay;

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use std::fmt::Write as _;

/// Where in the machine an effect lives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Motor, rack and pinion.
    Drive,
    /// Air line from syringe to bellow.
    Transmission,
    /// Rubber.
    Bellows,
    /// From bellow lengths to tip orientation.
    Shape,
    /// IMU.
    Sensor,
    /// Dead times.
    Timing,
    /// What the base stands on.
    Base,
}

impl Stage {
    /// All stages, in the order of the signal.
    pub const ALL: [Self; 7] = [Self::Drive, Self::Transmission, Self::Bellows, Self::Shape, Self::Sensor, Self::Timing, Self::Base];

    /// Name as files and reports write it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Drive => "drive",
            Self::Transmission => "transmission",
            Self::Bellows => "bellows",
            Self::Shape => "shape",
            Self::Sensor => "sensor",
            Self::Timing => "timing",
            Self::Base => "base",
        }
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
    /// Value at which the effect does nothing (or, for a parameter that only shapes it, a usual one).
    pub start: f64,
    /// Typical size: the fit's unit step and the standard deviation of its prior around `start`.
    pub scale: f64,
    /// Least physical value.
    pub low: f64,
    /// Largest physical value.
    pub high: f64,
}

/// What an effect is: constant data, written once in the effect's own file.
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
    /// True for an effect that happens once, at a time of its own, and therefore cannot be predicted
    /// from another log.
    pub is_event: bool,
    /// Parameters, in the order of the slices that the methods of [`Effect`] take.
    pub params: &'static [Param],
}

/// Starting points for a fit: several, where the error surface has several valleys.
pub type Starts = Vec<Vec<f64>>;

/// Room for an effect's state; all zero at the pistons' rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Memory(pub [f64; 64]);

impl Default for Memory {
    fn default() -> Self {
        Self([0.0; 64])
    }
}

/// What is known at one instant besides the signal itself.
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
    /// Extension gains k_ε in use, for laws that need the pressure behind a bellow.
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
    /// Turn of the tip about its own axis, rad.
    pub twist: f64,
    /// Bellow length changes it came from, mm.
    pub bellow_mm: Vector3<f64>,
}

/// What the tip IMU should read, sensor frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuPrediction {
    /// Specific force, m/s².
    pub acc_m_s2: Vector3<f64>,
    /// Rate, rad/s.
    pub gyro_rad_s: Vector3<f64>,
    /// Field, µT.
    pub mag_ut: Vector3<f64>,
    /// Sensor in the base, for fields that stand still in the world.
    pub r_base_sensor: UnitQuaternion<f64>,
}

/// One physical cause.
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
    /// Points a fit should start from; by default one, half a scale from nothing in each parameter.
    fn starts(&self) -> Starts {
        vec![self.params().iter().map(|p| (p.start + 0.5 * p.scale).clamp(p.low, p.high)).collect()]
    }
    /// Piston positions as they really are, mm.
    fn pistons(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _u_mm: &mut Vector3<f64>) {}
    /// Slack positions after the play and before the extension, mm: `w = (1 + k_ε) q` in the nominal
    /// model.
    fn play_output(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _w_mm: &mut Vector3<f64>) {}
    /// Bellow length changes after the extension, mm.
    fn bellows(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _q_mm: &mut Vector3<f64>) {}
    /// Shape after constant curvature.
    fn shape(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _pose: &mut Pose) {}
    /// Turn of the base away from how it stood at rest: base now → base at rest.
    fn base(&self, _p: &[f64], _at: &Moment) -> Option<UnitQuaternion<f64>> {
        None
    }
    /// Constant turn from sensor to tip.
    fn mount(&self, _p: &[f64]) -> Option<UnitQuaternion<f64>> {
        None
    }
    /// Of all parameters that leave the same orientations, the one a report should name, in place;
    /// `k_epsilon` are the nominal gains.
    fn canonical(&self, _p: &mut [f64], _k_epsilon: &Vector3<f64>) {}
    /// What the sensor makes of the truth.
    fn sensor(&self, _p: &[f64], _m: &mut Memory, _at: &Moment, _reading: &mut ImuPrediction) {}
    /// Dead time from command to motion, s.
    fn transport_s(&self, _p: &[f64]) -> f64 {
        0.0
    }
    /// Dead time from motion to sample, s.
    fn latency_s(&self, _p: &[f64]) -> f64 {
        0.0
    }
    /// True when what it adds to a reading changes with every single step of the motors.
    fn follows_motors(&self) -> bool {
        false
    }
    /// True when the effect leaves the tip's motion as it is (a fit then need not simulate it again).
    fn sensing_only(&self) -> bool {
        matches!(self.stage(), Stage::Sensor | Stage::Base)
    }
}

/// The whole catalogue, in the order of the signal and of the published table.
#[must_use]
pub fn catalogue() -> Vec<Box<dyn Effect>> {
    vec![
        Box::new(missed_steps::MissedSteps),
        Box::new(gear_periodic::GearPeriodic),
        Box::new(leak::Leak),
        Box::new(gas_compression::GasCompression),
        Box::new(line_lag::LineLag),
        Box::new(thermal_drift::ThermalDrift),
        Box::new(crosstalk::Crosstalk),
        Box::new(stiffening::Stiffening),
        Box::new(asymmetry::Asymmetry),
        Box::new(hysteresis::Hysteresis),
        Box::new(creep::Creep),
        Box::new(softening::Softening),
        Box::new(gravity::Gravity),
        Box::new(curvature::Curvature),
        Box::new(clocking::Clocking),
        Box::new(cable_stiffness::CableStiffness),
        Box::new(torsion::Torsion),
        Box::new(contact::Contact),
        Box::new(gyro_bias::GyroBias),
        Box::new(accel_bias::AccelBias),
        Box::new(hard_iron::HardIron),
        Box::new(motor_field::MotorField::default()),
        Box::new(mount_misalignment::MountMisalignment),
        Box::new(transport_delay::TransportDelay),
        Box::new(sensor_latency::SensorLatency),
        Box::new(base_motion::BaseMotion),
    ]
}

/// The effect of that name; `None` if the catalogue has no such effect.
#[must_use]
pub fn by_name(name: &str) -> Option<Box<dyn Effect>> {
    catalogue().into_iter().find(|e| e.name() == name)
}

/// The catalogue as a Markdown table, for the documentation command.
#[must_use]
pub fn describe() -> String {
    let mut out = String::from("| effect | stage | signature | confused with | separated by | parameters |\n|---|---|---|---|---|---|\n");
    for e in catalogue() {
        let confused = e.info().confused_with.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
        // writing to a String cannot fail
        let _ = writeln!(
            out,
            "| `{}` | {} | {} | {confused} | {} | {} |",
            e.name(),
            e.stage().name(),
            e.info().signature,
            e.info().separated_by,
            param::summary(e.params()),
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names and stages of the published table, in its order.
    const TABLE: [(&str, &str); 26] = [
        ("missed_steps", "drive"),
        ("gear_periodic", "drive"),
        ("leak", "transmission"),
        ("gas_compression", "transmission"),
        ("line_lag", "transmission"),
        ("thermal_drift", "transmission"),
        ("crosstalk", "transmission"),
        ("stiffening", "bellows"),
        ("asymmetry", "bellows"),
        ("hysteresis", "bellows"),
        ("creep", "bellows"),
        ("softening", "bellows"),
        ("gravity", "shape"),
        ("curvature", "shape"),
        ("clocking", "shape"),
        ("cable_stiffness", "shape"),
        ("torsion", "shape"),
        ("contact", "shape"),
        ("gyro_bias", "sensor"),
        ("accel_bias", "sensor"),
        ("hard_iron", "sensor"),
        ("motor_field", "sensor"),
        ("mount_misalignment", "sensor"),
        ("transport_delay", "timing"),
        ("sensor_latency", "timing"),
        ("base_motion", "base"),
    ];

    #[test]
    fn the_catalogue_is_the_published_table() {
        let got: Vec<_> = catalogue().iter().map(|e| (e.name(), e.stage().name())).collect();
        assert_eq!(got, TABLE);
        for (name, _) in TABLE {
            assert_eq!(by_name(name).map(|e| e.name()), Some(name));
        }
        assert!(by_name("ghost").is_none());
    }

    #[test]
    fn an_effect_is_only_taken_for_others_of_the_catalogue() {
        for e in catalogue() {
            assert!(!e.info().confused_with.is_empty(), "{}", e.name());
            for other in e.info().confused_with {
                assert!(by_name(other).is_some() && *other != e.name(), "{} / {other}", e.name());
            }
            assert!(e.info().signature.len() > 20 && e.info().separated_by.len() > 10, "{}", e.name());
        }
    }

    #[test]
    fn the_description_has_a_row_for_each() {
        let text = describe();
        assert_eq!(text.lines().count(), 2 + TABLE.len());
        for (line, (name, stage)) in text.lines().skip(2).zip(TABLE) {
            assert!(line.starts_with(&format!("| `{name}` | {stage} | ")), "{line}");
            assert_eq!(line.matches(" | ").count(), 5, "{line}");
        }
    }

    /// A fit runs a log of 26 000 samples hundreds of times: half a microsecond a sample is its budget.
    #[test]
    fn every_effect_is_cheap_enough_for_a_fit() {
        for e in catalogue() {
            let ns = proof::cost_ns(e.as_ref());
            println!("{:20} {ns:6.1} ns", e.name());
            assert!(ns < 500.0, "{} costs {ns:.0} ns a sample", e.name());
        }
    }
}
