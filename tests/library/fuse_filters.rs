//! Required behaviour of every generic orientation filter, on a simulated sensor with known orientation.

use nalgebra::{UnitQuaternion, Vector3};
use retroflex::estimation::fusion::mekf::{Mekf, MekfConfig};
use retroflex::estimation::fusion::{Filter, FilterName, OrientationFilter, Periods};
use retroflex::primitives::sample::ImuSample;
use retroflex::primitives::units::Seconds;

const PERIOD_S: f64 = 0.005;
const EARTH_UT: Vector3<f64> = Vector3::new(16.0, 0.0, -41.0);

/// A sensor that stands still, then turns and shakes by hand. Every error is zero unless set.
#[derive(Clone)]
struct Sensor {
    r_world_sensor: UnitQuaternion<f64>,
    t_s: f64,
    still_s: f64,
    swing_rad_s: f64,
    bias: Vector3<f64>,
    scale: f64,
    iron_ut: Vector3<f64>,
    room_ut: Vector3<f64>,
    latency_s: f64,
    past_mag: Vec<Vector3<f64>>,
}

impl Sensor {
    fn new(start: UnitQuaternion<f64>) -> Self {
        Self {
            r_world_sensor: start,
            t_s: 0.0,
            still_s: 5.0,
            swing_rad_s: 1.5,
            bias: Vector3::zeros(),
            scale: 1.0,
            iron_ut: Vector3::zeros(),
            room_ut: Vector3::zeros(),
            latency_s: 0.0,
            past_mag: Vec::new(),
        }
    }

    fn rate(&self, t_s: f64) -> Vector3<f64> {
        let t = t_s - self.still_s;
        if t < 0.0 {
            return Vector3::zeros();
        }
        let ramp = t.min(1.0);
        Vector3::new(
            (1.1 * t).sin(),
            (0.7 * t + 1.0).cos(),
            0.8 * (0.5 * t).sin() + 0.3,
        ) * (self.swing_rad_s * ramp)
    }

    /// The next sample, `dt_s` after the last.
    fn sample(&mut self, dt_s: f64) -> ImuSample {
        const STEPS: u32 = 10;
        let mut mean = Vector3::zeros();
        for _ in 0..STEPS {
            let part_s = dt_s / f64::from(STEPS);
            let rate = self.rate(self.t_s + 0.5 * part_s);
            self.r_world_sensor *= UnitQuaternion::from_scaled_axis(rate * part_s);
            self.t_s += part_s;
            mean += rate / f64::from(STEPS);
        }
        let to_sensor = self.r_world_sensor.inverse();
        let t = (self.t_s - self.still_s).max(0.0);
        let shake = Vector3::new((5.0 * t).sin(), (6.3 * t).sin(), (4.1 * t).sin()) * t.min(1.0);
        self.past_mag
            .push(to_sensor * (EARTH_UT + self.room_ut) + self.iron_ut);
        let late = self.past_mag.len() - 1;
        let then = late.saturating_sub((self.latency_s / dt_s).round() as usize);
        ImuSample {
            t: Seconds(self.t_s),
            gyro_rad_s: mean / self.scale + self.bias,
            acc_m_s2: to_sensor * (Vector3::new(0.0, 0.0, 9.81) + shake),
            mag_ut: Some(self.past_mag[then]),
        }
    }
}

fn build(name: FilterName) -> Filter {
    name.build(Periods {
        imu_s: PERIOD_S,
        mag_s: PERIOD_S,
    })
}

fn error_deg(filter: &dyn OrientationFilter, sensor: &Sensor) -> f64 {
    filter
        .orientation()
        .quat()
        .angle_to(&sensor.r_world_sensor)
        .to_degrees()
}

/// Runs for `seconds` at the nominal period; returns the largest error on the way, degrees.
fn run(filter: &mut dyn OrientationFilter, sensor: &mut Sensor, seconds: f64) -> f64 {
    let mut worst = 0.0_f64;
    for _ in 0..(seconds / PERIOD_S).round() as usize {
        filter.update(&sensor.sample(PERIOD_S), PERIOD_S);
        worst = worst.max(error_deg(filter, sensor));
    }
    worst
}

fn starts() -> [UnitQuaternion<f64>; 5] {
    [
        UnitQuaternion::identity(),
        UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::PI),
        UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0),
        UnitQuaternion::from_euler_angles(0.4, -1.2, 2.8),
        UnitQuaternion::from_euler_angles(-2.0, 0.3, -1.6),
    ]
}

#[test]
fn the_first_samples_determine_attitude_and_heading() {
    for name in FilterName::ALL {
        for start in starts() {
            let (mut filter, mut sensor) = (build(name), Sensor::new(start));
            assert!(
                !filter.status().levelled && !filter.status().north_found,
                "{name}"
            );
            for _ in 0..3 {
                filter.update(&sensor.sample(PERIOD_S), PERIOD_S);
            }
            let error = error_deg(&*filter, &sensor);
            assert!(
                error < 1.0,
                "{name}: {error} deg after three samples from {start}"
            );
            assert!(
                filter.status().levelled && filter.status().north_found,
                "{name}"
            );
        }
    }
}

#[test]
fn an_ideal_sensor_is_tracked() {
    for name in FilterName::ALL {
        for start in starts() {
            let (mut filter, mut sensor) = (build(name), Sensor::new(start));
            let worst = run(&mut *filter, &mut sensor, 60.0);
            assert!(worst < 2.5, "{name}: {worst} deg from {start}");
        }
    }
}

#[test]
fn the_bias_is_estimated_at_standstill_and_subtracted() {
    let bias = Vector3::new(0.02, -0.025, 0.03);
    for name in FilterName::ALL {
        let (mut filter, mut sensor) = (
            build(name),
            Sensor {
                bias,
                ..Sensor::new(starts()[3])
            },
        );
        run(&mut *filter, &mut sensor, 4.9);
        assert!(filter.status().standstill, "{name}");
        let off = (filter.status().gyro_bias_rad_s - bias).norm().to_degrees();
        assert!(
            off < 0.1,
            "{name}: {off} deg/s of {}",
            bias.norm().to_degrees()
        );
        let worst = run(&mut *filter, &mut sensor, 60.0);
        assert!(!filter.status().standstill, "{name}");
        assert!(worst < 4.0, "{name}: {worst} deg");
    }
}

/// Invalid values that a faulty bus delivers.
fn invalid(sample: &ImuSample, k: usize) -> ImuSample {
    let mut s = *sample;
    match k % 8 {
        0 => s.acc_m_s2.x = f64::NAN,
        1 => s.gyro_rad_s.y = f64::NAN,
        2 => s.mag_ut = Some(Vector3::new(f64::NAN, 0.0, 0.0)),
        3 => (s.acc_m_s2, s.mag_ut) = (Vector3::zeros(), Some(Vector3::zeros())),
        4 => s.gyro_rad_s = Vector3::new(f64::INFINITY, 0.0, f64::NEG_INFINITY),
        5 => (s.gyro_rad_s, s.acc_m_s2) = (Vector3::repeat(1e300), Vector3::repeat(-1e300)),
        6 => s.mag_ut = Some(Vector3::repeat(f64::MAX)),
        _ => s.mag_ut = None,
    }
    s
}

#[test]
fn invalid_samples_never_corrupt_the_state() {
    for name in FilterName::ALL {
        let (mut filter, mut sensor) = (build(name), Sensor::new(starts()[4]));
        for k in 0..8 {
            let sample = sensor.sample(PERIOD_S);
            filter.update(&invalid(&sample, k), PERIOD_S);
            assert!(
                filter
                    .orientation()
                    .quat()
                    .coords
                    .iter()
                    .all(|x| x.is_finite()),
                "{name}: first samples"
            );
        }
        run(&mut *filter, &mut sensor, 15.0);
        for k in 0..2000 {
            let sample = sensor.sample(PERIOD_S);
            let sample = if k % 3 == 0 {
                invalid(&sample, k / 3)
            } else {
                sample
            };
            filter.update(&sample, PERIOD_S);
            assert!(
                filter
                    .orientation()
                    .quat()
                    .coords
                    .iter()
                    .all(|x| x.is_finite()),
                "{name}: sample {k}"
            );
            assert!(
                filter
                    .status()
                    .gyro_bias_rad_s
                    .iter()
                    .all(|x| x.is_finite()),
                "{name}: bias, sample {k}"
            );
        }
        let held = error_deg(&*filter, &sensor);
        run(&mut *filter, &mut sensor, 30.0);
        let after = error_deg(&*filter, &sensor);
        assert!(
            held < 6.0 && after < 2.5,
            "{name}: {held} deg with invalid samples, {after} deg after"
        );
    }
}

#[test]
fn varying_steps_are_integrated_and_invalid_steps_ignored() {
    for name in FilterName::ALL {
        let (mut filter, mut sensor) = (build(name), Sensor::new(starts()[1]));
        let mut worst = 0.0_f64;
        let mut t_s = 0.0;
        for k in 0..12_000_u32 {
            let dt_s = PERIOD_S * [0.4, 1.0, 2.6, 1.2, 0.8][(k % 5) as usize];
            let sample = sensor.sample(dt_s);
            filter.update(&sample, dt_s);
            t_s += dt_s;
            if k % 50 == 0 {
                for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
                    filter.update(&sample, bad);
                }
            }
            worst = worst.max(error_deg(&*filter, &sensor));
        }
        assert!(worst < 2.5, "{name}: {worst} deg over {t_s} s");
    }
}

#[test]
fn after_a_gap_the_filter_levels_again_and_keeps_the_bias() {
    let bias = Vector3::new(0.015, 0.01, -0.02);
    for name in FilterName::ALL {
        let mut sensor = Sensor {
            bias,
            still_s: 1e9,
            ..Sensor::new(starts()[3])
        };
        let mut filter = build(name);
        run(&mut *filter, &mut sensor, 10.0);
        sensor.r_world_sensor = starts()[4];
        filter.update(&sensor.sample(PERIOD_S), 20.0);
        for _ in 0..3 {
            filter.update(&sensor.sample(PERIOD_S), PERIOD_S);
        }
        let error = error_deg(&*filter, &sensor);
        assert!(error < 2.0, "{name}: {error} deg");
        assert!(
            (filter.status().gyro_bias_rad_s - bias).norm().to_degrees() < 0.1,
            "{name}"
        );
    }
}

/// A magnet is near for 15 s: in the room, or on the body.
#[test]
fn the_heading_is_kept_near_a_magnet() {
    let in_room = |s: &mut Sensor, on: bool| {
        s.room_ut = if on {
            Vector3::new(-5.0, 28.0, 12.0)
        } else {
            Vector3::zeros()
        }
    };
    let on_body = |s: &mut Sensor, on: bool| {
        s.iron_ut = if on {
            Vector3::new(18.0, -16.0, 14.0)
        } else {
            Vector3::zeros()
        }
    };
    for name in FilterName::ALL {
        for (place, magnet) in [
            ("room", &in_room as &dyn Fn(&mut Sensor, bool)),
            ("body", &on_body),
        ] {
            let (mut filter, mut sensor) = (build(name), Sensor::new(starts()[3]));
            run(&mut *filter, &mut sensor, 40.0);
            assert!(!filter.status().field_disturbed, "{name}");
            magnet(&mut sensor, true);
            let mut detected = 0;
            let mut worst = 0.0_f64;
            for _ in 0..3000 {
                filter.update(&sensor.sample(PERIOD_S), PERIOD_S);
                detected += usize::from(filter.status().field_disturbed);
                worst = worst.max(error_deg(&*filter, &sensor));
            }
            magnet(&mut sensor, false);
            assert!(
                detected > 30,
                "{name}: a magnet in the {place} was detected in {detected} samples"
            );
            worst = worst.max(run(&mut *filter, &mut sensor, 20.0));
            assert!(
                worst < 6.0,
                "{name}: {worst} deg with a magnet on the {place}"
            );
        }
    }
}

#[test]
fn without_a_magnetometer_the_tilt_is_accurate() {
    for name in FilterName::ALL {
        let (mut filter, mut sensor) = (build(name), Sensor::new(starts()[3]));
        let mut worst = 0.0_f64;
        for _ in 0..8000 {
            let sample = ImuSample {
                mag_ut: None,
                ..sensor.sample(PERIOD_S)
            };
            filter.update(&sample, PERIOD_S);
            let up = filter
                .orientation()
                .apply(&(sensor.r_world_sensor.inverse() * Vector3::z()));
            worst = worst.max(up.angle(&Vector3::z()).to_degrees());
        }
        assert!(worst < 2.5, "{name}: {worst} deg of tilt");
        assert!(
            filter.status().levelled && !filter.status().north_found,
            "{name}"
        );
    }
}

#[test]
fn mekf_estimates_the_simulated_sensor_errors() {
    let iron_ut = Vector3::new(6.0, -4.0, 5.0);
    let bias = Vector3::new(0.01, -0.01, 0.005);
    let mut sensor = Sensor {
        bias,
        scale: 1.008,
        latency_s: 0.02,
        swing_rad_s: 4.0,
        ..Sensor::new(starts()[1])
    };
    let mut filter = Mekf::new(MekfConfig::default());
    run(&mut filter, &mut sensor, 60.0);
    sensor.iron_ut = iron_ut;
    run(&mut filter, &mut sensor, 120.0);
    let diagonal = filter.estimate().scale;
    for k in 0..3 {
        assert!((diagonal[k] - 0.008).abs() < 0.003, "scale {diagonal}");
        assert!(diagonal[k + 3].abs() < 0.003, "skew {diagonal}");
    }
    assert!(
        (filter.estimate().latency_s - 0.02).abs() < 0.004,
        "latency {} s",
        filter.estimate().latency_s
    );
    assert!(
        (filter.estimate().iron_ut - iron_ut).norm() < 1.5,
        "iron {}",
        filter.estimate().iron_ut
    );
    assert!(
        (filter.status().gyro_bias_rad_s - bias).norm().to_degrees() < 0.3,
        "bias {}",
        filter.status().gyro_bias_rad_s
    );
    assert!(
        error_deg(&filter, &sensor) < 2.0,
        "{} deg",
        error_deg(&filter, &sensor)
    );
}

#[test]
fn equal_samples_give_identical_results() {
    for name in FilterName::ALL {
        let (mut one, mut two) = (build(name), build(name));
        let mut sensor = Sensor::new(starts()[4]);
        for _ in 0..4000 {
            let sample = sensor.sample(PERIOD_S);
            one.update(&sample, PERIOD_S);
            two.update(&sample, PERIOD_S);
        }
        assert_eq!(one.orientation(), two.orientation(), "{name}");
    }
}
