//! The base's own IMU: by how much the base has turned since the rest, so that a base that turns is
//! not mistaken for bending.
//!
//! A complementary attitude filter (Mahony, Hamel & Pflimlin 2008, explicit form): the turn
//! `T` (base now → base at rest) follows the gyroscope, and the reading of a vector that was `v₀` at
//! the rest is expected to be `Tᵀ v₀`; what it differs by turns `T` slowly,
//!
//! `ω̂ = ω − b_g + k_a (a × Tᵀ a₀)/|a||a₀| + k_m (m × Tᵀ m₀)/|m||m₀|`.
//!
//! The bias b_g comes from the rest, and from every later stretch in which nothing turns. The base
//! IMU's axes are those of the tip's IMU at rest, up to a configured mount; where the two disagree on
//! where up is, the smallest rotation that mends it is added.

use crate::estimation::fusion::align::{AlignConfig, AlignState, Alignment};
use crate::estimation::fusion::intake::{self, Step};
use crate::parameters;
use crate::primitives::sample::ImuSample;
use nalgebra::{UnitQuaternion, Vector3};

/// By how much the base has turned since the rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BaseTurn {
    /// Coordinates in the base as it stands now to those in the base at rest.
    pub r_rest_now: UnitQuaternion<f64>,
    /// Rate of the base in its present axes, rad/s.
    pub rate_rad_s: Vector3<f64>,
}

impl BaseTurn {
    /// A base that stands.
    #[must_use]
    pub fn none() -> Self {
        Self { r_rest_now: UnitQuaternion::identity(), rate_rad_s: Vector3::zeros() }
    }
}

parameters! {
    /// The IMU on the base, where there is one.
    pub struct BaseConfig: Copy {
        /// Rotation vector from the axes of the base IMU to those of the tip IMU at rest. The default is mounted alike. An
        /// error tilts the correction of the tip by as much, in proportion to the turn of the base.
        mount_deg: [f64; 3] = [0.0; 3], "deg", -180.0..=180.0, "[0, 0, 0] is mounted like the tip's IMU";
        /// Time constant with which gravity levels the attitude of the base. A larger value resists shaking better and a
        /// gyroscope bias worse.
        gravity_time_s: f64 = 2.0, "s", 0.05..=1000.0, "2 suits a base that is moved by hand";
        /// Time constant with which the field corrects the heading of the base; 0 does not use the field. A larger value is
        /// disturbed less by the motors' fields and drifts longer with the gyroscope.
        field_time_s: f64 = 20.0, "s", 0.0..=10_000.0, "20; 0 does not use the field";
        /// Rate below which the base counts as standing. A larger value learns the bias more often, and takes a slow turn for
        /// bias.
        still_rate_rad_s: f64 = 0.02, "rad/s", 0.0001..=1.0, "0.02 is 1.1 °/s";
    }
}

/// The base's alignment and attitude.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum BaseTracker {
    /// No sample of a base IMU has come.
    #[default]
    Absent,
    /// Its rest is being averaged.
    Aligning(AlignState),
    /// It is being followed.
    Following(Follow),
}

/// Attitude since the rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Follow {
    rest: Alignment,
    q_rest_now: UnitQuaternion<f64>,
    bias_rad_s: Vector3<f64>,
    rate_rad_s: Vector3<f64>,
    to_tip: UnitQuaternion<f64>,
    last_t_s: f64,
    slow_rate: Vector3<f64>,
    window: Window,
    before: Option<Window>,
}

/// What the gyroscope said over a while, without the bias known by then.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Window {
    turn_rad: Vector3<f64>,
    length_s: f64,
}

/// Time constant of the rate that stillness is judged by, s.
const STILL_TAU_S: f64 = 0.5;
/// Time constant of the bias while the base stands, s.
const BIAS_TAU_S: f64 = 20.0;
/// Length of the windows that bias is learnt in, s.
const WINDOW_S: f64 = 1.0;

impl BaseTracker {
    /// Takes a sample; `tip_up` is the tip's mean specific force at rest once it is aligned.
    pub fn update(&mut self, config: &BaseConfig, align: &AlignConfig, sample: &ImuSample, tip_up: Option<&Vector3<f64>>) {
        if !sample.is_finite() {
            return;
        }
        match self {
            Self::Absent => *self = Self::Aligning(AlignState::default()),
            Self::Aligning(state) => {
                if let (Some(rest), Some(up)) = (state.add(align, sample), tip_up) {
                    *self = Self::Following(Follow::new(config, &rest, up, sample.t.0));
                }
            }
            Self::Following(follow) => follow.update(config, sample),
        }
    }

    /// The turn since the rest, in the tip IMU's rest axes.
    #[must_use]
    pub fn turn(&self) -> BaseTurn {
        match self {
            Self::Absent | Self::Aligning(_) => BaseTurn::none(),
            Self::Following(f) => {
                BaseTurn { r_rest_now: f.to_tip * f.q_rest_now * f.to_tip.inverse(), rate_rad_s: f.to_tip * f.rate_rad_s }
            }
        }
    }

    /// True while a base IMU speaks and is aligned.
    #[must_use]
    pub fn follows(&self) -> bool {
        matches!(self, Self::Following(_))
    }

    /// Forgets the turn: the present attitude is the new rest. Begins a new average.
    pub fn restart(&mut self) {
        if !matches!(self, Self::Absent) {
            *self = Self::Aligning(AlignState::default());
        }
    }
}

impl Follow {
    fn new(config: &BaseConfig, rest: &Alignment, tip_up: &Vector3<f64>, t_s: f64) -> Self {
        let mount = UnitQuaternion::from_scaled_axis(Vector3::from(config.mount_deg).map(f64::to_radians));
        let level = UnitQuaternion::rotation_between(&(mount * rest.acc_rest_m_s2), tip_up).unwrap_or_default();
        Self {
            rest: *rest,
            q_rest_now: UnitQuaternion::identity(),
            bias_rad_s: rest.gyro_bias_rad_s,
            rate_rad_s: Vector3::zeros(),
            to_tip: level * mount,
            last_t_s: t_s,
            slow_rate: Vector3::zeros(),
            window: Window::default(),
            before: None,
        }
    }

    fn update(&mut self, config: &BaseConfig, sample: &ImuSample) {
        let Step::Go(dt_s) = intake::step(sample.t.0 - self.last_t_s) else {
            self.last_t_s = sample.t.0;
            return;
        };
        self.last_t_s = sample.t.0;
        let seen = intake::usable(sample);
        let Some(gyro) = seen.gyro_rad_s else { return };
        self.rate_rad_s = gyro - self.bias_rad_s;
        let mut pull = Vector3::zeros();
        if let Some(acc) = seen.acc_m_s2 {
            pull += self.misfit(&acc, &self.rest.acc_rest_m_s2) / config.gravity_time_s;
        }
        if let (Some(mag), Some(rest), true) = (seen.mag_ut, self.rest.mag_rest_ut, config.field_time_s > 0.0) {
            // only what turns about the vertical: the field must not tilt
            let up = self.q_rest_now.inverse() * self.rest.acc_rest_m_s2.normalize();
            pull += up * (self.misfit(&mag, &rest).dot(&up) / config.field_time_s);
        }
        self.learn_bias(config, dt_s);
        self.q_rest_now *= UnitQuaternion::from_scaled_axis((self.rate_rad_s + pull) * dt_s);
        self.q_rest_now.renormalize_fast();
    }

    /// Turn, rad, that would lay the expected vector on the measured one, for small angles.
    fn misfit(&self, measured: &Vector3<f64>, rest: &Vector3<f64>) -> Vector3<f64> {
        let expected = self.q_rest_now.inverse() * rest;
        measured.cross(&expected) / (measured.norm() * rest.norm()).max(1e-9)
    }

    /// The mean rate of a still window is bias, but only once the next window was still as well: a turn
    /// that begins within a window is not yet seen when it ends.
    fn learn_bias(&mut self, config: &BaseConfig, dt_s: f64) {
        self.slow_rate += (self.rate_rad_s - self.slow_rate) * intake::share(dt_s, STILL_TAU_S);
        if self.slow_rate.amax() >= config.still_rate_rad_s {
            (self.window, self.before) = (Window::default(), None);
            return;
        }
        self.window.turn_rad += self.rate_rad_s * dt_s;
        self.window.length_s += dt_s;
        if self.window.length_s >= WINDOW_S {
            if let Some(before) = self.before.replace(self.window) {
                self.bias_rad_s += before.turn_rad / before.length_s * intake::share(before.length_s, BIAS_TAU_S);
            }
            self.window = Window::default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::units::Seconds;

    fn sample(t: f64, q: &UnitQuaternion<f64>, rate: Vector3<f64>) -> ImuSample {
        let back = q.inverse();
        let wiggle = 0.002 * (t * 300.0).sin();
        ImuSample {
            t: Seconds(t),
            gyro_rad_s: rate + Vector3::new(0.01 + wiggle, -0.02, 0.005),
            acc_m_s2: back * Vector3::new(2.0, 1.0, 9.5),
            mag_ut: Some(back * Vector3::new(20.0, 0.0, -40.0)),
        }
    }

    #[test]
    fn a_turn_is_followed_in_the_tips_axes() {
        // mounted a quarter turn about the vertical away from the tip IMU
        let config = BaseConfig { mount_deg: [0.0, 0.0, 90.0], ..BaseConfig::default() };
        let tip_up = UnitQuaternion::from_scaled_axis(Vector3::z() * std::f64::consts::FRAC_PI_2) * Vector3::new(2.0, 1.0, 9.5);
        let mut base = BaseTracker::default();
        assert!(!base.follows());
        let axis = Vector3::new(0.6, 0.0, 0.8);
        let (mut q, dt) = (UnitQuaternion::identity(), 0.002);
        for k in 0..10_000 {
            let t = f64::from(k) * dt;
            let rate = if (5.0..6.0).contains(&t) { axis * 10f64.to_radians() } else { Vector3::zeros() };
            q *= UnitQuaternion::from_scaled_axis(rate * dt);
            base.update(&config, &AlignConfig::default(), &sample(t, &q, rate), Some(&tip_up));
            if k == 2000 {
                assert!(base.follows() && base.turn().r_rest_now.angle().to_degrees() < 0.05);
            }
        }
        let want = Vector3::new(0.0, 0.6, 0.8) * 10f64.to_radians();
        let have = base.turn().r_rest_now.scaled_axis();
        assert!((have - want).norm().to_degrees() < 0.1, "{have} {want}");
        base.restart();
        assert_eq!(base.turn(), BaseTurn::none());
    }
}
