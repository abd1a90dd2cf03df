//! Laws of training units: those of the catalogue with a random change of form, and random laws that the catalogue lacks.

use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};
use rand::RngExt;
use rand::rngs::StdRng;
use rand_distr::StandardNormal;
use retroflex::model::effects::{Effect, EffectInfo, ImuPrediction, Memory, Moment, Pose, Stage};
use std::f64::consts::TAU;

/// Piston travel of about one radian of a form, mm.
const TRAVEL_MM: f64 = 8.0;
/// Time of about one radian of a form, s.
const TIME_S: f64 = 60.0;
/// Factors by which the travel and the time of a wave may be shorter.
const SHORTER: [f64; 2] = [4.0, 10.0];
/// Standard deviation of the waves' amplitudes in a law that the catalogue lacks.
pub const FOREIGN_DEPTH: f64 = 0.8;

/// A smooth random function of the pistons and the time with values around 1, or around 0.
#[derive(Debug, Clone)]
pub struct Form {
    /// Amplitude, factors of the three pistons and of the time, and phase of each wave.
    waves: [(f64, Vector3<f64>, f64, f64); 3],
    /// Mean: 1, or 0 if the sign changes.
    mean: f64,
}

impl Form {
    /// A form around `mean` whose waves have amplitudes of the standard deviation `depth`.
    pub fn draw(rng: &mut StdRng, mean: f64, depth: f64) -> Self {
        let waves = [(); 3].map(|()| {
            let [travel, time] = SHORTER.map(|most| most.powf(rng.random()));
            let travel = normal(rng) * travel / TRAVEL_MM;
            let [size, rate] = [(); 2].map(|()| rng.sample::<f64, _>(StandardNormal));
            (
                depth * size,
                travel,
                rate * time / TIME_S,
                rng.random_range(0.0..TAU),
            )
        });
        Self { waves, mean }
    }

    /// The function at these pistons, mm, and this time, s.
    pub fn at(&self, pistons_mm: &Vector3<f64>, t_s: f64) -> f64 {
        let wave = |(size, travel, time, phase): &(f64, Vector3<f64>, f64, f64)| {
            size * (travel.dot(pistons_mm) + time * t_s + phase).sin()
        };
        let factor = self.mean + self.waves.iter().map(wave).sum::<f64>();
        if self.mean > 0.0 {
            factor.max(0.0)
        } else {
            factor
        }
    }
}

fn normal(rng: &mut StdRng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.sample(StandardNormal))
}

/// An effect of the catalogue whose changes of the signal are multiplied by a random function of the pistons and the time.
///
/// A constant mount and a constant delay keep their form.
pub struct Deformed {
    effect: &'static dyn Effect,
    form: Form,
}

impl Deformed {
    /// The effect with a form drawn to this depth.
    pub fn new(effect: &'static dyn Effect, rng: &mut StdRng, depth: f64) -> Self {
        Self {
            effect,
            form: Form::draw(rng, 1.0, depth),
        }
    }

    /// A law that the catalogue lacks: the effect with a factor whose sign changes.
    pub fn foreign(effect: &'static dyn Effect, rng: &mut StdRng) -> Self {
        Self {
            effect,
            form: Form::draw(rng, 0.0, FOREIGN_DEPTH),
        }
    }

    fn change(&self, at: &Moment, signal: &mut Vector3<f64>, law: impl FnOnce(&mut Vector3<f64>)) {
        let before = *signal;
        law(signal);
        *signal = before + (*signal - before) * self.form.at(&at.counted_mm, at.t_s);
    }
}

impl Effect for Deformed {
    fn info(&self) -> &'static EffectInfo {
        self.effect.info()
    }
    fn pistons(&self, p: &[f64], m: &mut Memory, at: &Moment, u_mm: &mut Vector3<f64>) {
        self.change(at, u_mm, |u| self.effect.pistons(p, m, at, u));
    }
    fn play_output(&self, p: &[f64], m: &mut Memory, at: &Moment, w_mm: &mut Vector3<f64>) {
        self.change(at, w_mm, |w| self.effect.play_output(p, m, at, w));
    }
    fn bellows(&self, p: &[f64], m: &mut Memory, at: &Moment, q_mm: &mut Vector3<f64>) {
        self.change(at, q_mm, |q| self.effect.bellows(p, m, at, q));
    }
    fn shape(&self, p: &[f64], m: &mut Memory, at: &Moment, pose: &mut Pose) {
        let before = *pose;
        self.effect.shape(p, m, at, pose);
        let g = self.form.at(&at.counted_mm, at.t_s);
        pose.bend = before.bend + (pose.bend - before.bend) * g;
        pose.twist = before.twist + (pose.twist - before.twist) * g;
    }
    fn base(&self, p: &[f64], at: &Moment) -> Option<UnitQuaternion<f64>> {
        let turn = self.effect.base(p, at)?;
        Some(UnitQuaternion::from_scaled_axis(
            turn.scaled_axis() * self.form.at(&at.counted_mm, at.t_s),
        ))
    }
    fn mount(&self, p: &[f64]) -> Option<UnitQuaternion<f64>> {
        self.effect.mount(p)
    }
    fn sensor(&self, p: &[f64], m: &mut Memory, at: &Moment, reading: &mut ImuPrediction) {
        let before = *reading;
        self.effect.sensor(p, m, at, reading);
        let g = self.form.at(&at.counted_mm, at.t_s);
        reading.acc_m_s2 = before.acc_m_s2 + (reading.acc_m_s2 - before.acc_m_s2) * g;
        reading.gyro_rad_s = before.gyro_rad_s + (reading.gyro_rad_s - before.gyro_rad_s) * g;
        reading.mag_ut = before.mag_ut + (reading.mag_ut - before.mag_ut) * g;
    }
    fn transport_s(&self, p: &[f64]) -> f64 {
        self.effect.transport_s(p)
    }
    fn latency_s(&self, p: &[f64]) -> f64 {
        self.effect.latency_s(p)
    }
    fn follows_motors(&self) -> bool {
        self.effect.follows_motors()
    }
    fn sensing_only(&self) -> bool {
        self.effect.sensing_only()
    }
}

/// Description of the laws that no catalogue entry has.
static OUTSIDE: EffectInfo = EffectInfo {
    name: "outside",
    stage: Stage::Shape,
    signature: "none of the catalogue's",
    confused_with: &[],
    separated_by: "",
    events: 0,
    params: &[],
    starts: &[],
};

/// A random law that the catalogue lacks.
pub enum Outside {
    /// Waves over the travel: amplitude in each bellow (mm), wave vector over the pistons (1/mm), phase.
    Ripple(Vector3<f64>, Vector3<f64>, f64),
    /// A bend that swings with the time: amplitude (rad), angular frequency (rad/s).
    Swing(Vector2<f64>, f64),
    /// A sensor (0 to 2) with a wrong scale and cross-axis terms.
    Reading(usize, Matrix3<f64>),
    /// Products of two channels move the third: 1/mm.
    Product(Vector3<f64>),
    /// A gain that changes with the travel so far: share per m.
    Wear(Vector3<f64>),
    /// The bend is off while a low-passed channel is between zero and twice a length: channel, length (mm), time constant (s), bend (rad).
    Jump(usize, f64, f64, Vector2<f64>),
    /// The twist follows a memory of the bend: gain, time constant (s).
    Curl(Vector2<f64>, f64),
    /// Acceleration of a sensor that the tip carries on an arm, which every machine has: length of the arm (m).
    Acceleration(f64),
}

impl Outside {
    /// A law of this size; 1 is typical.
    pub fn draw(rng: &mut StdRng, size: f64) -> Self {
        let two = |rng: &mut StdRng, s: f64| normal(rng).xy() * s * size;
        match rng.random_range(0..8) {
            0 => Self::Ripple(
                normal(rng) * 0.5 * size,
                normal(rng) * 0.8,
                rng.random_range(0.0..TAU),
            ),
            1 => Self::Swing(two(rng, 0.05), TAU / rng.random_range(1.5..9.0)),
            2 => Self::Reading(
                rng.random_range(0..3),
                Matrix3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal) * 0.06 * size),
            ),
            3 => Self::Product(normal(rng) * 0.03 * size),
            4 => Self::Wear(normal(rng) * 0.15 * size),
            5 => Self::Jump(
                rng.random_range(0..3),
                rng.random_range(-8.0..8.0),
                rng.random_range(0.05..8.0),
                two(rng, 0.08),
            ),
            // twice as often as the others
            _ => Self::Curl(two(rng, 0.1), rng.random_range(0.5..8.0)),
        }
    }
}

impl Effect for Outside {
    fn info(&self) -> &'static EffectInfo {
        &OUTSIDE
    }
    fn bellows(&self, _p: &[f64], m: &mut Memory, at: &Moment, q_mm: &mut Vector3<f64>) {
        match self {
            Self::Ripple(amplitude, wave, phase) => {
                *q_mm += amplitude * ((wave.dot(&at.counted_mm) + phase).sin() - phase.sin())
            }
            Self::Product(gain) => {
                let q = *q_mm;
                *q_mm += Vector3::new(gain.x * q.y * q.z, gain.y * q.z * q.x, gain.z * q.x * q.y);
            }
            Self::Wear(gain) => {
                let before = Vector3::new(m.0[0], m.0[1], m.0[2]);
                m.0[3] += (at.counted_mm - before).norm() * 1e-3;
                m.0[..3].copy_from_slice(at.counted_mm.as_slice());
                *q_mm += q_mm.component_mul(gain) * m.0[3];
            }
            _ => {}
        }
    }
    fn shape(&self, _p: &[f64], m: &mut Memory, at: &Moment, pose: &mut Pose) {
        match self {
            Self::Swing(bend, omega) => pose.bend += bend * (omega * at.t_s).sin(),
            Self::Jump(channel, bound_mm, tau_s, jump) => {
                m.0[0] += (pose.bellow_mm[*channel] - m.0[0]) * (1.0 - (-at.dt_s / tau_s).exp());
                if (m.0[0] - bound_mm).abs() < bound_mm.abs() {
                    pose.bend += jump;
                }
            }
            Self::Curl(gain, tau_s) => {
                m.0[0] += (gain.dot(&pose.bend) - m.0[0]) * (1.0 - (-at.dt_s / tau_s).exp());
                pose.twist += m.0[0];
            }
            _ => {}
        }
    }
    fn sensor(&self, _p: &[f64], m: &mut Memory, at: &Moment, reading: &mut ImuPrediction) {
        match self {
            Self::Reading(sensor, wrong) => {
                let of = [
                    &mut reading.acc_m_s2,
                    &mut reading.gyro_rad_s,
                    &mut reading.mag_ut,
                ];
                for (_, v) in of.into_iter().enumerate().filter(|(i, _)| i == sensor) {
                    *v += wrong * *v;
                }
            }
            Self::Acceleration(arm_m) => {
                let here = reading.r_base_sensor * Vector3::z() * *arm_m;
                let [before, last] = [0, 3].map(|k| Vector3::from_column_slice(&m.0[k..k + 3]));
                if m.0[6] > 1.0 {
                    let turned = reading.r_base_sensor.inverse() * (here - last * 2.0 + before);
                    reading.acc_m_s2 += turned / at.dt_s.powi(2);
                }
                m.0[..3].copy_from_slice(last.as_slice());
                m.0[3..6].copy_from_slice(here.as_slice());
                m.0[6] += 1.0;
            }
            _ => {}
        }
    }
}
