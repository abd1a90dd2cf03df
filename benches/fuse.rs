//! Time per update of each generic filter and of the bend filter, and its ratio to the bare `ahrs` Madgwick in the same run.
//!
//! Run with `cargo bench --bench fuse`. The samples simulate a sensor turned by hand at 500 Hz with a 100 Hz
//! magnetometer.

use ahrs::Ahrs;
use divan::{AllocProfiler, Bencher, black_box};
use nalgebra::{UnitQuaternion, Vector3};
use retroflex::estimation::fusion::align::Alignment;
use retroflex::estimation::fusion::base::BaseTurn;
use retroflex::estimation::fusion::bend::{BendFilter, BendFilterConfig};
use retroflex::estimation::fusion::{Filter, FilterName, Periods, TipEstimator, TipSample};
use retroflex::primitives::sample::ImuSample;
use retroflex::primitives::units::Seconds;
use std::time::Instant;

/// Counts allocations: an update must make none.
#[global_allocator]
static ALLOCATIONS: AllocProfiler = AllocProfiler::system();

const PERIOD_S: f64 = 0.002;
const SAMPLES: usize = 8192;

fn samples() -> Vec<ImuSample> {
    let mut q = UnitQuaternion::identity();
    (0..SAMPLES)
        .map(|k| {
            let t = k as f64 * PERIOD_S;
            let rate = Vector3::new((1.1 * t).sin(), (0.7 * t).cos(), (0.5 * t).sin()) * 2.0;
            q *= UnitQuaternion::from_scaled_axis(rate * PERIOD_S);
            let shake = Vector3::new((5.0 * t).sin(), (6.3 * t).sin(), (4.1 * t).sin());
            ImuSample {
                t: Seconds(t),
                gyro_rad_s: rate,
                acc_m_s2: q.inverse() * (Vector3::new(0.0, 0.0, 9.81) + shake),
                mag_ut: (k % 5 == 0).then(|| q.inverse() * Vector3::new(16.0, 0.0, -41.0)),
            }
        })
        .collect()
}

fn build(name: FilterName) -> Filter {
    name.build(Periods {
        imu_s: PERIOD_S,
        mag_s: 5.0 * PERIOD_S,
    })
}

fn bare_update(filter: &mut ahrs::Madgwick<f64>, s: &ImuSample) {
    let updated = match &s.mag_ut {
        Some(mag) => filter.update(&s.gyro_rad_s, &s.acc_m_s2, mag),
        None => filter.update_imu(&s.gyro_rad_s, &s.acc_m_s2),
    };
    _ = black_box(updated.is_ok());
}

#[divan::bench(name = "ahrs Madgwick, bare")]
fn bare(bencher: Bencher) {
    let samples = samples();
    let (mut filter, mut k) = (ahrs::Madgwick::new(PERIOD_S, 0.05), 0);
    bencher.bench_local(|| {
        bare_update(&mut filter, &samples[k % SAMPLES]);
        k += 1;
    });
}

#[divan::bench(args = FilterName::ALL)]
fn update(bencher: Bencher, name: FilterName) {
    let samples = samples();
    let (mut filter, mut k) = (build(name), 0);
    bencher.bench_local(|| {
        filter.update(black_box(&samples[k % SAMPLES]), PERIOD_S);
        k += 1;
    });
}

/// A bend filter that is aligned with the first sample.
fn bend_filter(first: &ImuSample) -> BendFilter {
    let alignment = Alignment {
        gyro_bias_rad_s: Vector3::zeros(),
        acc_rest_m_s2: first.acc_m_s2,
        mag_rest_ut: first.mag_ut,
        gyro_sigma_rad_s: 0.002,
        acc_sigma_m_s2: 0.02,
        mag_sigma_ut: 0.35,
        duration_s: 1.8,
        samples: 900,
        mag_samples: 180,
        repeated: 0,
    };
    BendFilter::new(&BendFilterConfig::default(), &alignment)
}

fn step(imu: &ImuSample) -> TipSample {
    TipSample {
        imu: *imu,
        dt_s: PERIOD_S,
        acc: true,
        mag: true,
        still: false,
        base: BaseTurn::default(),
    }
}

#[divan::bench]
fn bend(bencher: Bencher) {
    let samples = samples();
    let (mut filter, mut k) = (bend_filter(&samples[0]), 0);
    bencher.bench_local(|| {
        filter.update(&step(black_box(&samples[k % SAMPLES])));
        k += 1;
    });
}

/// Best of several passes, ns per update: the pass least disturbed by other load.
fn best_ns(mut pass: impl FnMut()) -> f64 {
    let once = |_| {
        let start = Instant::now();
        pass();
        start.elapsed().as_secs_f64() * 1e9 / SAMPLES as f64
    };
    (0..30).map(once).fold(f64::INFINITY, f64::min)
}

fn ratios() {
    let samples = samples();
    let mut filter = ahrs::Madgwick::new(PERIOD_S, 0.05);
    let bare_ns = best_ns(|| {
        samples
            .iter()
            .for_each(|s| bare_update(&mut filter, black_box(s)))
    });
    println!("{:<10} {bare_ns:8.0} ns per update", "bare ahrs");
    for name in FilterName::ALL {
        let mut filter = build(name);
        let ns = best_ns(|| {
            samples
                .iter()
                .for_each(|s| filter.update(black_box(s), PERIOD_S))
        });
        println!(
            "{name:<10} {ns:8.0} ns per update, {:5.1} x bare ahrs",
            ns / bare_ns
        );
    }
    let mut filter = bend_filter(&samples[0]);
    let ns = best_ns(|| {
        samples
            .iter()
            .for_each(|s| filter.update(&step(black_box(s))))
    });
    println!(
        "{:<10} {ns:8.0} ns per update, {:5.1} x bare ahrs",
        "bend",
        ns / bare_ns
    );
}

fn main() {
    ratios();
    divan::main();
}
