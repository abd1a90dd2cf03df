//! The IMU: what a chip in the tip says of where the tip is.
//!
//! Only at sample times, from the true pose: rate = rotation since the last sample over its time
//! (so that integrating it gives the rotation back), specific force `f = R' (a + g ẑ)` with `a` the
//! second difference of the position, field `R' B`. Then, in the order in which it happens to a chip:
//! age, mounting, scale and bias, noise, range, digits.

pub mod accel_bias;
pub mod chip;
mod feeling;
pub mod gyro_bias;
pub mod hard_iron;
pub mod motor_field;
pub mod mount_misalignment;
pub mod scale;

use crate::primitives::frames::{Rotation, Tip, World};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::Seconds;
use crate::simulation::plant::config::PlantConfig;
use crate::simulation::plant::effects::Effects;
use crate::simulation::plant::plant_effect::active;
use crate::simulation::plant::rng::{PlantRng, Stream};
use crate::simulation::plant::timing::{ClockDrift, DeadTime, SensorFreeze};
use accel_bias::AccelBias;
use chip::{Chip, ImuConfig};
pub(crate) use feeling::{Feeling, GRAVITY_M_S2};
use gyro_bias::Drifting;
use hard_iron::Iron;
use mount_misalignment::MountMisalignment;
use nalgebra::{UnitQuaternion, Vector3};
use scale::{AccScale, GSensitivity, GyroScale, SoftIron};

/// Where a chip is and what surrounds it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surroundings {
    /// Time, s.
    pub(crate) t: f64,
    /// Orientation in the world.
    pub(crate) r_world_tip: Rotation<World, Tip>,
    /// Position in the world, mm.
    pub(crate) at_mm: Vector3<f64>,
    /// Magnetic field in the world, µT.
    pub(crate) field_ut: Vector3<f64>,
}

/// Imperfections of a chip and of how it sits.
#[derive(Debug, Clone, Default)]
struct Flaws {
    mount: Option<MountMisalignment>,
    gyro_scale: Option<GyroScale>,
    g_sensitivity: Option<GSensitivity>,
    acc_scale: Option<AccScale>,
    soft_iron: Option<SoftIron>,
    gyro_bias: Option<Drifting>,
    accel_bias: Option<AccelBias>,
    iron: Option<Iron>,
    clock: Option<ClockDrift>,
    freeze: Option<SensorFreeze>,
}

/// One IMU with what it remembers.
#[derive(Debug, Clone)]
pub(crate) struct Imu {
    chip: Chip,
    mount: Option<UnitQuaternion<f64>>,
    flaws: Flaws,
    age: Option<DeadTime<Feeling>>,
    due_s: f64,
    mag_due_s: f64,
    last: Surroundings,
    speed_m_s: Vector3<f64>,
    shown: Option<ImuSample>,
    /// What was broken at run time.
    pub(crate) broken: Broken,
}

/// Breakages of an IMU.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Broken {
    /// Says nothing.
    pub(crate) silent: bool,
    /// Repeats itself.
    pub(crate) frozen: bool,
    /// Says what is no number.
    pub(crate) nan: bool,
    /// Reads full scale.
    pub(crate) saturated: bool,
    /// Magnetometer says nothing.
    pub(crate) mag_silent: bool,
    /// Added to the next sample only: rate (rad/s) and force (m/s²).
    pub(crate) spike: Option<(Vector3<f64>, Vector3<f64>)>,
    /// Added to every rate, rad/s.
    pub(crate) rate: Vector3<f64>,
    /// Added to every force, m/s².
    pub(crate) force: Vector3<f64>,
}

impl Imu {
    /// The tip's, with all that is wrong with it, starting at rest at `here`.
    pub(crate) fn tip(config: &PlantConfig, seed: u64, here: Surroundings) -> Self {
        let flaws = Flaws::of(&config.effects, seed);
        let mut imu = Self::new(&config.imu, flaws, PlantRng::new(seed, Stream::TipImu), here);
        let rest = imu.feel(&here, config.imu.period_s);
        imu.age = active(config.effects.sensor_latency.as_ref()).map(|c| DeadTime::latency(&c, rest, seed));
        imu
    }
    /// The base's, of the same make but without bias or flaw.
    pub(crate) fn base(config: &PlantConfig, seed: u64, here: Surroundings) -> Self {
        Self::new(&config.imu.unbiased(), Flaws::default(), PlantRng::new(seed, Stream::BaseImu), here)
    }
    fn new(config: &ImuConfig, flaws: Flaws, rng: PlantRng, here: Surroundings) -> Self {
        let turn = Vector3::from(config.mount_deg).map(f64::to_radians);
        Self {
            chip: Chip::new(config, rng),
            mount: (turn.norm() > 0.0).then(|| UnitQuaternion::from_scaled_axis(turn)),
            flaws,
            age: None,
            due_s: config.period_s,
            mag_due_s: config.mag_period_s,
            last: here,
            speed_m_s: Vector3::zeros(),
            shown: None,
            broken: Broken::default(),
        }
    }

    /// True when a sample is due at `t`: only then is the pose needed.
    pub(crate) fn due(&self, t: f64) -> bool {
        t >= self.due_s - 1e-9
    }

    /// The sample that is due.
    pub(crate) fn sample(&mut self, here: &Surroundings) -> Option<ImuSample> {
        let t = here.t;
        let dt_s = t - self.last.t;
        self.due_s = next_due(self.due_s, self.chip.period_s(), t);
        let mut feeling = self.feel(here, dt_s);
        if let Some(age) = &mut self.age {
            feeling = age.pass(t, dt_s, feeling);
        }
        if let Some(mount) = &self.mount {
            feeling = feeling.turned_by(mount);
        }
        self.flaws.distort(&mut feeling, t, dt_s);
        feeling.rate += self.broken.rate;
        feeling.force += self.broken.force;
        if let Some((rate, force)) = self.broken.spike.take() {
            feeling.rate += rate;
            feeling.force += force;
        }
        let fresh_mag = t >= self.mag_due_s - 1e-9;
        if fresh_mag {
            self.mag_due_s = next_due(self.mag_due_s, self.chip.mag_period_s(), t);
        }
        let mut sample = self.chip.read(&feeling, dt_s, fresh_mag && !self.broken.mag_silent);
        sample.t = Seconds(self.flaws.clock.as_ref().map_or(t, |c| c.shown(t)));
        self.said(sample, t)
    }

    /// What comes out of a chip that may be broken.
    fn said(&mut self, mut sample: ImuSample, t: f64) -> Option<ImuSample> {
        let hangs = self.broken.frozen || self.flaws.freeze.as_ref().is_some_and(|f| f.hangs(t));
        match self.shown {
            Some(shown) if hangs => sample = ImuSample { t: sample.t, mag_ut: sample.mag_ut.and(shown.mag_ut), ..shown },
            // a sample without a field keeps the field to repeat
            Some(shown) => self.shown = Some(ImuSample { mag_ut: sample.mag_ut.or(shown.mag_ut), ..sample }),
            None => self.shown = Some(sample),
        }
        if self.broken.saturated {
            self.chip.pin_to_range(&mut sample);
        }
        if self.broken.nan {
            sample.gyro_rad_s.x = f64::NAN;
            sample.acc_m_s2.z = f64::NAN;
        }
        (!self.broken.silent).then_some(sample)
    }

    /// What there is to feel, from the pose now and at the last sample.
    fn feel(&mut self, here: &Surroundings, dt_s: f64) -> Feeling {
        let turn = self.last.r_world_tip.inverse() * here.r_world_tip;
        let speed = (here.at_mm - self.last.at_mm) * (1e-3 / dt_s);
        let acceleration = (speed - self.speed_m_s) / dt_s;
        (self.last, self.speed_m_s) = (*here, speed);
        let r_tip_world = here.r_world_tip.inverse();
        Feeling {
            rate: turn.quat().scaled_axis() / dt_s,
            force: r_tip_world.apply(&(acceleration + Vector3::z() * GRAVITY_M_S2)),
            field: r_tip_world.apply(&here.field_ut),
        }
    }
}

/// The next moment of a periodic event after `t`; moments that a long step jumped over are dropped.
fn next_due(due_s: f64, period_s: f64, t: f64) -> f64 {
    let next = due_s + period_s;
    if next > t { next } else { t + period_s - (t - due_s) % period_s }
}

impl Flaws {
    fn of(effects: &Effects, seed: u64) -> Self {
        let outside = &effects.outside;
        Self {
            mount: active(effects.mount_misalignment.as_ref()),
            gyro_scale: active(outside.gyro_scale.as_ref()),
            g_sensitivity: active(outside.g_sensitivity.as_ref()),
            acc_scale: active(outside.acc_scale.as_ref()),
            soft_iron: active(outside.soft_iron.as_ref()),
            gyro_bias: active(effects.gyro_bias.as_ref()).map(|c| Drifting::new(c, seed)),
            accel_bias: active(effects.accel_bias.as_ref()),
            iron: active(effects.hard_iron.as_ref()).map(Iron::new),
            clock: active(outside.clock_drift.as_ref()),
            freeze: active(outside.sensor_freeze.as_ref()),
        }
    }
    fn distort(&mut self, feeling: &mut Feeling, t: f64, dt_s: f64) {
        if let Some(mount) = &self.mount {
            *feeling = feeling.turned_by(&mount.turn(&feeling.force));
        }
        if let Some(scale) = &self.gyro_scale {
            scale.apply(&mut feeling.rate);
        }
        if let Some(g) = &self.g_sensitivity {
            feeling.rate += g.rate(&feeling.force);
        }
        if let Some(scale) = &self.acc_scale {
            scale.apply(&mut feeling.force);
        }
        if let Some(bias) = &mut self.gyro_bias {
            feeling.rate += bias.rate(t, dt_s);
        }
        if let Some(bias) = &self.accel_bias {
            feeling.force += bias.force(&feeling.force);
        }
        if let Some(soft) = &self.soft_iron {
            soft.apply(&mut feeling.field);
        }
        if let Some(iron) = &mut self.iron {
            feeling.field += iron.field(&feeling.field, dt_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_keep_their_period_through_long_steps() {
        assert_eq!(next_due(0.002, 0.002, 0.002), 0.004);
        let next = next_due(0.002, 0.002, 0.0131);
        assert!(next > 0.0131 && next < 0.0131 + 0.002 + 1e-12 && ((next / 0.002).round() - next / 0.002).abs() < 1e-6);
    }
}
