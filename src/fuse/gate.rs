//! What may be believed: usable numbers, rest, and the magnetic field.
//!
//! * [`usable`] keeps what is not a number, or not a possible one, out of every filter.
//! * [`RestDetector`] says when the gyroscope reads nothing but its bias: both sensors stay close to
//!   their own slow mean for a while (after Laidig & Seel 2023, section 3.4.1).
//! * [`FieldGate`] compares strength and dip of the magnetic field with a slow reference and refuses
//!   a field that differs, for a bounded time; a different field that stays the same while the sensor
//!   turns becomes the new reference (after Laidig & Seel 2023, section 3.6).

use crate::sample::ImuSample;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Longest step that is still integrated, seconds; after a longer one a filter levels itself anew.
pub const GAP_MAX_S: f64 = 1.0;
/// Largest believable angular rate, rad/s: beyond every MEMS part's range (4000 °/s), with margin.
const GYRO_MAX_RAD_S: f64 = 100.0;
/// Largest believable specific force, m/s²: 400 g, beyond every part's range.
const ACC_MAX_M_S2: f64 = 4000.0;
/// Smallest specific force that has a direction, m/s²; all zeros is a dead bus, less than this free fall.
const ACC_MIN_M_S2: f64 = 0.1;
/// Largest believable field, µT: the full range of the AK09916 is 4900.
const MAG_MAX_UT: f64 = 50_000.0;
/// Smallest field that has a direction, µT.
const MAG_MIN_UT: f64 = 0.1;

/// The parts of a sample that a filter may use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usable {
    /// Angular rate, rad/s, unless lost.
    pub gyro_rad_s: Option<Vector3<f64>>,
    /// Specific force, m/s², unless lost or without direction.
    pub acc_m_s2: Option<Vector3<f64>>,
    /// Magnetic field, µT, unless lost, without direction or not sampled.
    pub mag_ut: Option<Vector3<f64>>,
}

/// Leaves out of a sample what no sensor can have meant.
#[must_use]
pub fn usable(sample: &ImuSample) -> Usable {
    let within = |v: &Vector3<f64>, min: f64, max: f64| {
        let norm = v.norm();
        norm.is_finite() && norm >= min && norm <= max
    };
    Usable {
        gyro_rad_s: Some(sample.gyro_rad_s).filter(|v| within(v, 0.0, GYRO_MAX_RAD_S)),
        acc_m_s2: Some(sample.acc_m_s2).filter(|v| within(v, ACC_MIN_M_S2, ACC_MAX_M_S2)),
        mag_ut: sample.mag_ut.filter(|v| within(v, MAG_MIN_UT, MAG_MAX_UT)),
    }
}

/// What a filter should make of the time since the last sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// Integrate over this many seconds.
    Go(f64),
    /// Too long to bridge: level anew.
    Gap,
    /// No time has passed, or the clock is broken: ignore the sample.
    Ignore,
}

/// Judges a time step in seconds.
#[must_use]
pub fn step(dt_s: f64) -> Step {
    if !dt_s.is_finite() || dt_s <= 0.0 {
        Step::Ignore
    } else if dt_s > GAP_MAX_S {
        Step::Gap
    } else {
        Step::Go(dt_s)
    }
}

/// Share by which a first-order low-pass of time constant `tau_s` moves in `dt_s`.
#[must_use]
pub fn share(dt_s: f64, tau_s: f64) -> f64 {
    1.0 - (-dt_s / tau_s).exp()
}

/// When is the sensor still?
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RestConfig {
    /// Time constant of the slow mean both sensors are compared with, seconds. Default 0.5. Bigger:
    /// slow turning is told from rest more surely, rest is noticed later.
    pub mean_tau_s: f64,
    /// How long both must stay close to their mean before it counts as rest, seconds. Default 1.5.
    /// Bigger: fewer false rests, fewer true ones.
    pub min_s: f64,
    /// Largest deviation of the angular rate from its mean at rest, °/s. Default 2. Bigger: a shaking
    /// bench still counts as rest, and so does gentle motion.
    pub gyro_deviation_deg_s: f64,
    /// Largest deviation of the specific force from its mean at rest, m/s². Default 0.5. Bigger: as above.
    pub acc_deviation_m_s2: f64,
    /// Largest mean rate that can still be bias, °/s on one axis. Default 3. Bigger: worse gyroscopes
    /// are served, and steady slow turning is taken for bias.
    pub bias_max_deg_s: f64,
}

impl Default for RestConfig {
    fn default() -> Self {
        Self {
            mean_tau_s: 0.5,
            min_s: 1.5,
            gyro_deviation_deg_s: 2.0,
            acc_deviation_m_s2: 0.5,
            bias_max_deg_s: 3.0,
        }
    }
}

/// Tells rest from motion.
#[derive(Debug, Clone, Copy)]
pub struct RestDetector {
    config: RestConfig,
    means: Option<(Vector3<f64>, Vector3<f64>)>,
    still_s: f64,
}

impl RestDetector {
    /// A detector that has seen nothing yet.
    #[must_use]
    pub fn new(config: RestConfig) -> Self {
        Self { config, means: None, still_s: 0.0 }
    }
    /// Takes one pair of samples (rad/s, m/s²); true at rest.
    pub fn update(&mut self, gyro: &Vector3<f64>, acc: &Vector3<f64>, dt_s: f64) -> bool {
        let share = share(dt_s, self.config.mean_tau_s);
        let (gyro_mean, acc_mean) = self.means.get_or_insert((*gyro, *acc));
        *gyro_mean += share * (gyro - *gyro_mean);
        *acc_mean += share * (acc - *acc_mean);
        let still = (gyro - *gyro_mean).norm() < self.config.gyro_deviation_deg_s.to_radians()
            && (acc - *acc_mean).norm() < self.config.acc_deviation_m_s2
            && gyro_mean.amax() < self.config.bias_max_deg_s.to_radians();
        self.still_s = if still { self.still_s + dt_s } else { 0.0 };
        self.at_rest()
    }
    /// A sample was lost: nobody knows whether the sensor moved.
    pub fn interrupt(&mut self) {
        self.still_s = 0.0;
    }
    /// True when the sensor has been still for long enough.
    #[must_use]
    pub fn at_rest(&self) -> bool {
        self.still_s >= self.config.min_s
    }
    /// Slow mean of the angular rate, rad/s: the bias, when at rest.
    #[must_use]
    pub fn gyro_mean_rad_s(&self) -> Vector3<f64> {
        self.means.map_or_else(Vector3::zeros, |(gyro, _)| gyro)
    }
}

/// When is the magnetic field the Earth's?
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FieldConfig {
    /// Largest relative difference of the field's strength from the reference. Default 0.1. Bigger:
    /// weaker disturbances pass, a good field is refused less often.
    pub strength_share: f64,
    /// Largest difference of the dip angle from the reference, degrees. Default 10. Bigger: as above.
    pub dip_deg: f64,
    /// Time constant with which the reference follows an accepted field, seconds. Default 20. Bigger:
    /// a creeping disturbance is noticed later, but the reference is steadier.
    pub reference_tau_s: f64,
    /// How long the field must agree before it is believed again, seconds. Default 0.5. Bigger: a
    /// disturbance that passes through the reference's values is less often believed.
    pub regain_s: f64,
    /// Longest full refusal, seconds. Default 60. Bigger: the heading drifts longer on the gyroscope
    /// before a disturbed field is better than none.
    pub refuse_max_s: f64,
    /// Weight of a field that is still disturbed after that, 0 to 1. Default 0.5. Bigger: the
    /// heading follows a disturbed field sooner.
    pub refuse_after_weight: f64,
    /// How long another field must stay the same to become the reference, seconds of turning.
    /// Default 20. Bigger: moving into another room takes longer to accept.
    pub accept_s: f64,
    /// Turning rate that counts as turning, °/s. Default 20. Bigger: only brisk turning proves a field.
    pub turning_deg_s: f64,
}

impl Default for FieldConfig {
    fn default() -> Self {
        Self {
            strength_share: 0.1,
            dip_deg: 10.0,
            reference_tau_s: 20.0,
            regain_s: 0.5,
            refuse_max_s: 60.0,
            refuse_after_weight: 0.5,
            accept_s: 20.0,
            turning_deg_s: 20.0,
        }
    }
}

/// Strength (µT) and dip (rad, + when the field points down) of a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldShape {
    /// Strength, µT.
    pub strength_ut: f64,
    /// Dip below the horizon, rad.
    pub dip_rad: f64,
}

impl FieldShape {
    /// Shape of a field given in the world frame, µT.
    #[must_use]
    pub fn of(field_world: &Vector3<f64>) -> Self {
        Self { strength_ut: field_world.norm(), dip_rad: (-field_world.z).atan2(field_world.xy().norm()) }
    }
    fn near(&self, other: &Self, config: &FieldConfig) -> bool {
        (self.strength_ut - other.strength_ut).abs() < config.strength_share * other.strength_ut
            && (self.dip_rad - other.dip_rad).abs() < config.dip_deg.to_radians()
    }
    fn follow(&mut self, target: &Self, share: f64) {
        self.strength_ut += share * (target.strength_ut - self.strength_ut);
        self.dip_rad += share * (target.dip_rad - self.dip_rad);
    }
}

/// Accepts or refuses the magnetic field.
#[derive(Debug, Clone, Copy)]
pub struct FieldGate {
    config: FieldConfig,
    shapes: Option<Shapes>,
    agreed_s: f64,
    refused_s: f64,
    disturbed: bool,
}

/// The believed field and the one that may replace it.
#[derive(Debug, Clone, Copy)]
struct Shapes {
    reference: FieldShape,
    candidate: FieldShape,
    candidate_s: f64,
}

impl FieldGate {
    /// A gate that will believe the first field it sees.
    #[must_use]
    pub fn new(config: FieldConfig) -> Self {
        Self { config, shapes: None, agreed_s: 0.0, refused_s: 0.0, disturbed: false }
    }
    /// True while the field is not the reference.
    #[must_use]
    pub fn disturbed(&self) -> bool {
        self.disturbed
    }
    /// Takes the field in the world frame (µT), the turning rate (rad/s) and the time since the last
    /// field; returns the weight, 0 to 1, that its heading deserves.
    pub fn update(&mut self, field_world: &Vector3<f64>, turning_rad_s: f64, dt_s: f64) -> f64 {
        let now = FieldShape::of(field_world);
        let first = Shapes { reference: now, candidate: now, candidate_s: 0.0 };
        let mut shapes = self.shapes.unwrap_or(first);
        self.compare(&mut shapes, &now, dt_s);
        self.try_candidate(&mut shapes, &now, turning_rad_s, dt_s);
        self.shapes = Some(shapes);
        self.weigh(dt_s)
    }

    fn compare(&mut self, shapes: &mut Shapes, now: &FieldShape, dt_s: f64) {
        if !now.near(&shapes.reference, &self.config) {
            self.agreed_s = 0.0;
            self.disturbed = true;
            return;
        }
        self.agreed_s += dt_s;
        if self.agreed_s >= self.config.regain_s {
            self.disturbed = false;
            shapes.reference.follow(now, share(dt_s, self.config.reference_tau_s));
        }
    }

    fn try_candidate(&mut self, shapes: &mut Shapes, now: &FieldShape, turning_rad_s: f64, dt_s: f64) {
        if !now.near(&shapes.candidate, &self.config) {
            (shapes.candidate, shapes.candidate_s) = (*now, 0.0);
            return;
        }
        shapes.candidate.follow(now, share(dt_s, self.config.reference_tau_s));
        if turning_rad_s >= self.config.turning_deg_s.to_radians() {
            shapes.candidate_s += dt_s;
        }
        if self.disturbed && shapes.candidate_s >= self.config.accept_s {
            shapes.reference = shapes.candidate;
            self.agreed_s = self.config.regain_s;
            self.disturbed = false;
        }
    }

    fn weigh(&mut self, dt_s: f64) -> f64 {
        if !self.disturbed {
            self.refused_s = (self.refused_s - 2.0 * dt_s).max(0.0);
            1.0
        } else if self.refused_s < self.config.refuse_max_s {
            self.refused_s += dt_s;
            0.0
        } else {
            self.config.refuse_after_weight
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Seconds;

    const EARTH: Vector3<f64> = Vector3::new(16.0, 0.0, -41.0);

    #[test]
    fn numbers_no_sensor_can_mean_are_left_out() {
        let sample = |gyro: f64, acc: f64, mag: f64| ImuSample {
            t: Seconds(0.0),
            gyro_rad_s: Vector3::new(gyro, 0.0, 0.0),
            acc_m_s2: Vector3::new(0.0, acc, 0.0),
            mag_ut: Some(Vector3::new(0.0, 0.0, mag)),
        };
        let good = usable(&sample(0.0, 9.81, 40.0));
        assert!(good.gyro_rad_s.is_some() && good.acc_m_s2.is_some() && good.mag_ut.is_some());
        for bad in [f64::NAN, f64::INFINITY, -1e30] {
            let u = usable(&sample(bad, bad, bad));
            assert_eq!((u.gyro_rad_s, u.acc_m_s2, u.mag_ut), (None, None, None), "{bad}");
        }
        assert_eq!(usable(&sample(0.0, 0.0, 40.0)).acc_m_s2, None);
        assert_eq!(usable(&sample(0.0, 9.81, 0.0)).mag_ut, None);
    }

    #[test]
    fn rest_needs_time_and_yields_the_bias() {
        let bias = Vector3::new(0.01, -0.02, 0.005);
        let up = Vector3::new(0.0, 0.0, 9.81);
        let mut rest = RestDetector::new(RestConfig::default());
        for k in 0..149 {
            assert!(!rest.update(&bias, &up, 0.01), "rest after {k} samples");
        }
        assert!((0..2).any(|_| rest.update(&bias, &up, 0.01)));
        assert!((rest.gyro_mean_rad_s() - bias).norm() < 1e-12);
        assert!(!rest.update(&Vector3::new(0.5, 0.0, 0.0), &up, 0.01));
    }

    #[test]
    fn steady_fast_turning_is_not_rest() {
        let mut rest = RestDetector::new(RestConfig::default());
        let (rate, up) = (Vector3::new(0.0, 0.0, 0.3), Vector3::new(0.0, 0.0, 9.81));
        assert!((0..1000).all(|_| !rest.update(&rate, &up, 0.01)));
    }

    #[test]
    fn a_magnet_is_refused_then_tolerated_then_forgotten() {
        let mut gate = FieldGate::new(FieldConfig::default());
        for _ in 0..500 {
            assert_eq!(gate.update(&EARTH, 0.0, 0.01), 1.0);
        }
        let magnet = EARTH + Vector3::new(0.0, 25.0, 10.0);
        for _ in 0..5900 {
            assert_eq!(gate.update(&magnet, 0.0, 0.01), 0.0);
        }
        assert!(gate.disturbed());
        for _ in 0..200 {
            gate.update(&magnet, 0.0, 0.01);
        }
        assert_eq!(gate.update(&magnet, 0.0, 0.01), 0.5, "refusal is bounded");
        for _ in 0..60 {
            gate.update(&EARTH, 0.0, 0.01);
        }
        assert_eq!(gate.update(&EARTH, 0.0, 0.01), 1.0);
    }

    #[test]
    fn another_room_is_accepted_only_when_turned_in() {
        let room = Vector3::new(22.0, 0.0, -52.0);
        for (turning, accepted) in [(0.0, false), (1.0, true)] {
            let mut gate = FieldGate::new(FieldConfig::default());
            for _ in 0..200 {
                gate.update(&EARTH, turning, 0.01);
            }
            for _ in 0..2500 {
                gate.update(&room, turning, 0.01);
            }
            assert_eq!(!gate.disturbed(), accepted, "turning at {turning} rad/s");
        }
    }
}
