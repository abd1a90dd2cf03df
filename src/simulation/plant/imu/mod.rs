//! The IMU: what a chip in the tip measures.
//!
//! The true pose is evaluated at sample times only: rate = rotation since the last sample over its time (so that
//! integration returns the rotation), specific force `f = R' (a + g ẑ)` with `a` the second difference of the
//! position, field `R' B`. Dead time, mounting, effects, noise, range and quantisation follow in this order.

pub mod chip;
pub(crate) mod stimulus;

use crate::primitives::{ImuSample, Rotation, Seconds, Tip, World};
use crate::simulation::plant::fault::ImuFaults;
use crate::simulation::plant::law::{Laws, Moment, each};
use crate::simulation::plant::rng::{PlantRng, Stream};
use chip::{Chip, ImuConfig};
use nalgebra::{UnitQuaternion, Vector3};
use stimulus::{GRAVITY_M_S2, Stimulus};

/// Position and surroundings of a chip.
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

/// One IMU with its state.
#[derive(Debug)]
pub(crate) struct Imu {
    chip: Chip,
    mount: Option<UnitQuaternion<f64>>,
    due_s: f64,
    mag_due_s: f64,
    last: Surroundings,
    speed_m_s: Vector3<f64>,
    shown: Option<ImuSample>,
}

impl Imu {
    /// The tip's IMU, at rest at `here`. The laws act on this one alone.
    pub(crate) fn tip(config: &ImuConfig, seed: u64, here: Surroundings, laws: &mut Laws) -> Self {
        let mut imu = Self::new(config, PlantRng::new(seed, Stream::TipImu), here);
        let stimulus = imu.stimulus(&here, config.period_s);
        each(laws, |law| law.at_start(&stimulus));
        imu
    }
    /// The base's IMU.
    pub(crate) fn base(config: &ImuConfig, seed: u64, here: Surroundings) -> Self {
        Self::new(config, PlantRng::new(seed, Stream::BaseImu), here)
    }
    fn new(config: &ImuConfig, rng: PlantRng, here: Surroundings) -> Self {
        let turn = Vector3::from(config.mount_deg).map(f64::to_radians);
        Self {
            chip: Chip::new(config, rng),
            mount: (turn.norm() > 0.0).then(|| UnitQuaternion::from_scaled_axis(turn)),
            due_s: config.period_s,
            mag_due_s: config.mag_period_s,
            last: here,
            speed_m_s: Vector3::zeros(),
            shown: None,
        }
    }

    /// True when a sample is due at `t`: only then is the pose needed.
    pub(crate) fn due(&self, t: f64) -> bool {
        t >= self.due_s - 1e-9
    }

    /// The sample that is due.
    pub(crate) fn sample(
        &mut self,
        here: &Surroundings,
        laws: &mut Laws,
        faults: &mut ImuFaults,
    ) -> ImuSample {
        let (t, dt_s) = (here.t, here.t - self.last.t);
        let at = Moment { t, dt_s };
        self.due_s = next_due(self.due_s, self.chip.period_s, t);
        let mut stimulus = self.stimulus(here, at.dt_s);
        each(laws, |law| law.late(&mut stimulus, &at));
        if let Some(mount) = &self.mount {
            stimulus = stimulus.turned_by(mount);
        }
        each(laws, |law| law.sensor(&mut stimulus, &at));
        let (rate_deg_s, force_g) = faults.spike.take().unwrap_or_default();
        let bias = Vector3::from(faults.rate_deg_s).map(f64::to_radians);
        stimulus.rate = (stimulus.rate + bias).add_scalar(rate_deg_s.to_radians());
        stimulus.force = stimulus.force.add_scalar(force_g * GRAVITY_M_S2);
        stimulus.field += faults.field_ut;
        let fresh_mag = t >= self.mag_due_s - 1e-9;
        if fresh_mag {
            self.mag_due_s = next_due(self.mag_due_s, self.chip.mag_period_s, t);
        }
        let mut sample = self.chip.read(&stimulus, at.dt_s, fresh_mag);
        sample.t = Seconds(laws.iter().fold(t, |stamp, law| law.clock(stamp)));
        let hangs = faults.frozen || laws.iter().any(|law| law.hangs(t));
        self.output(sample, hangs, faults)
    }

    /// The output of a chip that may be faulty.
    fn output(&mut self, mut sample: ImuSample, hangs: bool, faults: &ImuFaults) -> ImuSample {
        let shown = *self.shown.get_or_insert(sample);
        if hangs {
            sample = ImuSample {
                t: sample.t,
                mag_ut: sample.mag_ut.and(shown.mag_ut),
                ..shown
            };
        } else {
            // a sample without a field keeps the field that is repeated
            self.shown = Some(ImuSample {
                mag_ut: sample.mag_ut.or(shown.mag_ut),
                ..sample
            });
        }
        if faults.saturated {
            self.chip.pin_to_range(&mut sample);
        }
        if faults.nan {
            sample.gyro_rad_s.x = f64::NAN;
            sample.acc_m_s2.z = f64::NAN;
        }
        sample
    }

    /// The quantities at the chip, from the pose now and at the last sample.
    fn stimulus(&mut self, here: &Surroundings, dt_s: f64) -> Stimulus {
        let turn = self.last.r_world_tip.inverse() * here.r_world_tip;
        let speed = (here.at_mm - self.last.at_mm) * (1e-3 / dt_s);
        let acceleration = (speed - self.speed_m_s) / dt_s;
        (self.last, self.speed_m_s) = (*here, speed);
        let r_tip_world = here.r_world_tip.inverse();
        Stimulus {
            rate: turn.quat().scaled_axis() / dt_s,
            force: r_tip_world.apply(&(acceleration + Vector3::z() * GRAVITY_M_S2)),
            field: r_tip_world.apply(&here.field_ut),
        }
    }
}

/// The next time of a periodic event after `t`; times that a long step passed over are dropped.
fn next_due(due_s: f64, period_s: f64, t: f64) -> f64 {
    let next = due_s + period_s;
    if next > t {
        next
    } else {
        t + period_s - (t - due_s) % period_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_keep_their_period_through_long_steps() {
        assert_eq!(next_due(0.002, 0.002, 0.002), 0.004);
        let next = next_due(0.002, 0.002, 0.0131);
        assert!(
            next > 0.0131
                && next < 0.0131 + 0.002 + 1e-12
                && ((next / 0.002).round() - next / 0.002).abs() < 1e-6
        );
    }
}
