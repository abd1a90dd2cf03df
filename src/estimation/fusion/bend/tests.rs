//! The bend filter against a known truth and its own covariance.

use super::bank::{DRIFTS, DRIFTS_SLOWLY, M, SWAYS};
use super::config::BendFilterConfig;
use super::kalman::N;
use super::state::BendFilter;
use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::base::BaseTurn;
use crate::estimation::fusion::filter::{TipEstimator, TipSample};
use crate::model::Bend;
use crate::primitives::{ImuSample, Seconds};
use nalgebra::{SMatrix, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};

const DT_S: f64 = 0.005;

fn taken(imu: ImuSample, still: bool) -> TipSample {
    TipSample {
        imu,
        dt_s: DT_S,
        acc: true,
        mag: true,
        still,
        base: BaseTurn::default(),
    }
}

fn noise(rng: &mut StdRng, sigma: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| {
        sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng)
    })
}

/// A sensor with bias and hard iron on a tip whose base has the attitude `base`.
struct Sensor {
    rng: StdRng,
    base: UnitQuaternion<f64>,
    acc_bias: Vector3<f64>,
    iron: Vector3<f64>,
    /// Field of the motors, different in every pose, µT.
    motors: Vector3<f64>,
    /// Bias and scale error of the gyroscope.
    gyro_bias: Vector3<f64>,
    gyro_scale: f64,
    before: UnitQuaternion<f64>,
    t_s: f64,
}

impl Sensor {
    fn new(seed: u64, base: UnitQuaternion<f64>) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        let (acc_bias, iron) = (noise(&mut rng, 0.2), noise(&mut rng, 5.0));
        Self {
            rng,
            base,
            acc_bias,
            iron,
            motors: Vector3::zeros(),
            gyro_bias: Vector3::zeros(),
            gyro_scale: 0.0,
            before: base,
            t_s: 0.0,
        }
    }
    fn gravity(&self, q: &UnitQuaternion<f64>) -> Vector3<f64> {
        (self.base * q).inverse() * Vector3::new(0.0, 0.0, 9.81) + self.acc_bias
    }
    fn field(&self, q: &UnitQuaternion<f64>) -> Vector3<f64> {
        (self.base * q).inverse() * Vector3::new(20.0, 0.0, -44.0) + self.iron + self.motors
    }
    fn alignment(&self) -> Alignment {
        let straight = UnitQuaternion::identity();
        Alignment {
            gyro_bias_rad_s: Vector3::zeros(),
            acc_rest_m_s2: self.gravity(&straight),
            mag_rest_ut: Some(self.field(&straight)),
            gyro_sigma_rad_s: 0.002,
            acc_sigma_m_s2: 0.02,
            mag_sigma_ut: 0.35,
            duration_s: 2.0,
            samples: 400,
            mag_samples: 400,
            repeated: 0,
        }
    }
    fn sample(&mut self, bend: &Bend, mag: bool) -> ImuSample {
        let q = bend.rotation().quat();
        let whole = self.base * q;
        let rate = (self.before.inverse() * whole).scaled_axis() / DT_S;
        (self.before, self.t_s) = (whole, self.t_s + DT_S);
        ImuSample {
            t: Seconds(self.t_s),
            gyro_rad_s: rate * (1.0 + self.gyro_scale)
                + self.gyro_bias
                + noise(&mut self.rng, 0.002),
            acc_m_s2: self.gravity(&q) + noise(&mut self.rng, 0.02),
            mag_ut: mag.then(|| self.field(&q) + noise(&mut self.rng, 0.35)),
        }
    }
}

fn tilted(tilt: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_euler_angles(0.3, tilt, -0.7)
}

/// The sensor of these tests rotates without translation.
fn turning_only() -> BendFilterConfig {
    BendFilterConfig {
        arc_mm: 0.0,
        beyond_mm: 0.0,
        ..BendFilterConfig::default()
    }
}

/// A path through the poses of a session, with pauses near straight.
fn path(t_s: f64) -> Bend {
    let swing = (t_s * 0.9).sin().powi(3);
    Bend::from_polar(
        crate::primitives::units::Rad(1.1 * swing.abs()),
        crate::primitives::units::Rad(0.4 * t_s),
    )
}

fn simulate(
    filter: &mut BendFilter,
    sensor: &mut Sensor,
    seconds: f64,
    mag: bool,
    mut each: impl FnMut(&BendFilter, &Bend),
) {
    for _ in 0..(seconds / DT_S) as usize {
        let bend = path(sensor.t_s + DT_S);
        let sample = sensor.sample(&bend, mag);
        filter.update(&taken(sample, false));
        each(filter, &bend);
    }
}

#[test]
fn covariance_stays_symmetric_and_positive() {
    let mut sensor = Sensor::new(2, tilted(1.2));
    let mut filter = BendFilter::new(&turning_only(), &sensor.alignment());
    simulate(&mut filter, &mut sensor, 600.0, true, |_, _| ());
    let p = &filter.bank.filters[0].p;
    // the base stands unless it sways
    let scale = SMatrix::<f64, N, 1>::from_fn(|i, _| p[i][i].sqrt().max(1e-9));
    let correlation = SMatrix::<f64, N, N>::from_fn(|i, j| p[i][j] / (scale[i] * scale[j]));
    assert!(
        (correlation - correlation.transpose()).amax() < 1e-6,
        "after ten minutes"
    );
    assert!(correlation.symmetric_eigen().eigenvalues.min() > -1e-9);
}

#[test]
fn biases_converge_within_their_standard_deviations() {
    for seed in 0..8 {
        let mut sensor = Sensor::new(10 + seed, tilted(0.5 + 0.2 * seed as f64));
        let mut filter = BendFilter::new(&turning_only(), &sensor.alignment());
        let (mut sum, mut n) = (0.0, 0.0);
        simulate(&mut filter, &mut sensor, 60.0, true, |f, truth| {
            sum += (f.bend().0 - truth.0).norm_squared();
            n += 1.0;
        });
        let rms_deg = f64::sqrt(sum / n).to_degrees();
        assert!(rms_deg < 0.6, "seed {seed}: {rms_deg}");
        let known = filter.known_errors();
        for (bias, three_sigma, truth) in [
            (known.acc_bias_m_s2, known.acc_margin_m_s2, sensor.acc_bias),
            (known.iron_ut, known.iron_margin_ut, sensor.iron),
        ] {
            let (error, sigma) = ((bias - truth).amax(), three_sigma / 3.0);
            assert!(error < 4.0 * sigma, "seed {seed}: {error} with σ {sigma}");
        }
    }
}

/// Nothing corrects a bend about the vertical without a field, and the covariance must show it.
#[test]
fn the_covariance_is_consistent_where_gravity_does_not_observe() {
    let flat = UnitQuaternion::from_euler_angles(0.0, std::f64::consts::FRAC_PI_2, 0.0);
    let (mut nees, mut n, mut unobserved, mut observed) = (0.0, 0.0, 0.0f64, 0.0f64);
    for seed in 0..12 {
        let mut sensor = Sensor::new(50 + seed, flat);
        sensor.acc_bias *= 0.2;
        let mut filter = BendFilter::new(&turning_only(), &sensor.alignment());
        simulate(&mut filter, &mut sensor, 40.0, false, |_, _| ());
        let mut straight = Bend::STRAIGHT;
        for _ in 0..4000 {
            let sample = sensor.sample(&straight, false);
            filter.update(&taken(sample, false));
            straight = Bend::STRAIGHT;
        }
        let (error, c) = (filter.bend().0, filter.covariance().unwrap());
        nees += error.dot(&(c.try_inverse().unwrap() * error)) / 2.0;
        n += 1.0;
        let sigmas = c
            .symmetric_eigen()
            .eigenvalues
            .map(|v| v.sqrt().to_degrees());
        unobserved = unobserved.max(sigmas.max());
        observed = observed.max(sigmas.min());
    }
    assert!(
        unobserved > 3.0 * observed,
        "1 σ: {unobserved}° unobserved, {observed}° observed"
    );
    assert!(
        nees / n < 3.0,
        "mean NEES per degree of freedom {}",
        nees / n
    );
}

/// Poses whose bend is about the vertical, with a field of the motors that differs from pose to pose.
#[test]
fn a_field_that_the_motors_disturb_does_no_harm_and_a_clean_one_helps() {
    let flat = UnitQuaternion::from_euler_angles(0.0, std::f64::consts::FRAC_PI_2, 0.0);
    let rms_deg = |motors_ut: f64, mag: bool, stands: bool| {
        let (mut sum, mut n) = (0.0, 0.0);
        for seed in 0..8 {
            let mut sensor = Sensor::new(80 + seed, flat);
            sensor.iron *= 0.2;
            if stands {
                sensor.gyro_scale = if seed % 2 == 0 { 0.01 } else { -0.01 };
            } else {
                sensor.gyro_bias = Vector3::repeat(0.003);
            }
            let mut filter = BendFilter::new(&turning_only(), &sensor.alignment());
            let mut offsets = StdRng::seed_from_u64(seed);
            for pose in 0..60 {
                sensor.motors = noise(&mut offsets, motors_ut);
                for step in 0..300 {
                    // half a second from one side to the other, then a second of rest
                    let swing = (f64::from(step) * DT_S / 0.5).min(1.0) * std::f64::consts::PI;
                    let side = if pose % 2 == 0 { 1.2 } else { -1.2 };
                    let beta = if pose == 0 {
                        0.5 * side * (1.0 - swing.cos())
                    } else {
                        -side * swing.cos()
                    };
                    let bend = Bend([0.1, beta].into());
                    let sample = sensor.sample(&bend, mag);
                    let still = stands && step > 120;
                    filter.update(&taken(sample, still));
                    if step > 240 && pose > 10 {
                        sum += (filter.bend().0 - bend.0).norm_squared();
                        n += 1.0;
                    }
                }
            }
        }
        f64::sqrt(sum / n).to_degrees()
    };
    let alone = rms_deg(0.0, false, true);
    for motors_ut in [0.0, 0.1, 0.3, 1.0, 3.0, 8.0, 20.0] {
        let with = rms_deg(motors_ut, true, true);
        println!("{motors_ut} µT: {with:.2}°, without magnetometer {alone:.2}°");
        assert!(
            with < 1.2 * alone,
            "{motors_ut} µT: {with}°, without {alone}°"
        );
    }
    // without standstill the gyroscope drifts, and the field bounds it
    let (with, alone) = (rms_deg(0.0, true, false), rms_deg(0.0, false, false));
    println!("no standstill: {with:.2}° with a clean field, {alone:.2}° without magnetometer");
    assert!(with < 0.7 * alone);
}

/// A base that swings by 20° with an IMU of its own, while the tip moves.
#[test]
fn a_base_whose_turn_is_known_or_measured_leaves_no_error() {
    let turned_by = |rest: &UnitQuaternion<f64>, now: &UnitQuaternion<f64>, v: Vector3<f64>| {
        now.inverse() * v - rest.inverse() * v
    };
    for (seed, measured) in (0..4).flat_map(|seed| [(seed, false), (seed, true)]) {
        let rest = tilted(0.4 + 0.3 * seed as f64);
        let mut sensor = Sensor::new(120 + seed, rest);
        (sensor.acc_bias, sensor.iron) = (Vector3::zeros(), Vector3::zeros());
        let mut filter = BendFilter::new(&turning_only(), &sensor.alignment());
        let (mut sum, mut n) = (0.0, 0.0);
        for k in 0..8000 {
            let t_s = f64::from(k) * DT_S;
            let (swing, axis) = (0.35 * (1.8 * t_s).sin(), Vector3::new(0.6, 0.48, 0.64));
            let turned = UnitQuaternion::from_scaled_axis(axis * swing);
            sensor.base = rest * turned;
            let bend = path(t_s + DT_S);
            let base = BaseTurn {
                // what is measured stands for the attitude, which may drift
                r_rest_now: turned * tilted(0.1).powf(f64::from(u8::from(measured))),
                rate_rad_s: axis * (0.35 * 1.8 * (1.8 * t_s).cos()),
                acc_change_m_s2: measured
                    .then(|| turned_by(&rest, &sensor.base, Vector3::new(0.0, 0.0, 9.81))),
                mag_change_ut: (measured && k % 2 == 0)
                    .then(|| turned_by(&rest, &sensor.base, Vector3::new(20.0, 0.0, -44.0))),
            };
            filter.update(&TipSample {
                base,
                ..taken(sensor.sample(&bend, true), false)
            });
            if k > 1000 {
                sum += (filter.bend().0 - bend.0).norm_squared();
                n += 1.0;
            }
        }
        let rms_deg = f64::sqrt(sum / n).to_degrees();
        println!("seed {seed}, measured {measured}: {rms_deg:.3}°");
        assert!(rms_deg < 0.25, "seed {seed}: {rms_deg}°");
    }
}

/// Holds and moves in turn, with a disturbance of the sensor or of the base; the mean probability of each hypothesis.
fn believed(seed: u64, disturb: impl Fn(&mut Sensor, f64)) -> [f64; M] {
    let mut sensor = Sensor::new(seed, tilted(0.3 + 0.1 * (seed % 10) as f64));
    let mut filter = BendFilter::new(&turning_only(), &sensor.alignment());
    let (mut sum, mut n) = ([0.0; M], 0.0);
    for k in 0..12_000 {
        let t_s = f64::from(k) * DT_S;
        // half a second from pose to pose, then a second of rest
        let (pose, since_s) = ((t_s / 1.5).floor(), t_s % 1.5);
        let at = |pose: f64| Bend::from_deg(20.0 + 25.0 * (pose * 1.3).sin().abs(), 70.0 * pose);
        let share = 0.5 - 0.5 * ((since_s / 0.5).min(1.0) * std::f64::consts::PI).cos();
        let bend = Bend(at(pose).0 * (1.0 - share) + at(pose + 1.0).0 * share);
        disturb(&mut sensor, t_s);
        filter.update(&taken(sensor.sample(&bend, true), since_s > 0.6));
        if t_s > 20.0 {
            for (sum, p) in sum.iter_mut().zip(filter.probabilities()) {
                *sum += p;
            }
            n += 1.0;
        }
    }
    sum.map(|p| p / n)
}

#[test]
fn each_hypothesis_is_believed_where_it_holds_and_not_elsewhere() {
    for seed in 200..206 {
        let size = 0.6 + 0.2 * (seed - 200) as f64;
        let steady = believed(seed, |_, _| ());
        let drifts = believed(seed, |s, t_s| {
            s.gyro_bias = Vector3::new(0.5, -0.6, 0.62) * (0.05 * size * (0.25 * t_s).sin());
        });
        let base = tilted(0.3 + 0.1 * (seed % 10) as f64);
        let sways = believed(seed, |s, t_s| {
            let swing = 0.07 * size * (1.2 * t_s).sin();
            s.base = base * UnitQuaternion::from_scaled_axis(Vector3::new(0.5, 0.5, 0.7) * swing);
        });
        println!("{size:.1}: {steady:.2?} {drifts:.2?} {sways:.2?}");
        let drift = |p: &[f64; M]| p[DRIFTS] + p[DRIFTS_SLOWLY];
        assert!(steady[0] > 0.8, "{steady:?}");
        assert!(
            drift(&drifts) > 0.5 && sways[SWAYS] > 0.5,
            "{drifts:?} {sways:?}"
        );
        assert!(
            drifts[SWAYS] < 0.3 && drift(&sways) < 0.3,
            "{drifts:?} {sways:?}"
        );
    }
}
