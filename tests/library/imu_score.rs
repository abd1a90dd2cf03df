//! The generic filters against an optical reference: nine recordings of BROAD (CC BY 4.0, Laidig et al. 2021).
//!
//! The recordings are not part of the package. The tests search `RETROFLEX_IMU_DATA` and `../shared/data/imu`; without
//! recordings they print "skipped" and pass.

use nalgebra::Vector2;
use retroflex::estimation::fusion::FilterName;
use retroflex::estimation::fusion::mekf::saturation::Saturation;
use retroflex::experiment::score::{self, FileScore, Score};
use retroflex::log::recording::{self, Recording};
use std::path::PathBuf;
use std::sync::OnceLock;

/// Errors of the authors' reference implementation of VQF on these files: total, heading, inclination, degrees.
const VQF_PUBLISHED: [(&str, [f64; 3]); 9] = [
    ("02_undisturbed_slow_rotation_B", [1.38, 1.31, 0.43]),
    ("06_undisturbed_fast_rotation_A", [4.03, 3.95, 0.80]),
    ("11_undisturbed_slow_translation_B", [0.90, 0.79, 0.42]),
    ("15_undisturbed_fast_translation_A", [2.31, 2.26, 0.47]),
    ("21_undisturbed_fast_combined", [4.08, 3.70, 1.72]),
    ("24_disturbed_tapping_A", [1.55, 1.42, 0.61]),
    ("27_disturbed_phone_vibration_B", [6.73, 6.72, 0.37]),
    ("28_disturbed_stationary_magnet_A", [4.04, 3.86, 1.21]),
    ("33_disturbed_attached_magnet_2cm", [3.75, 3.70, 0.60]),
];

fn folder() -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data/imu");
    let folder = std::env::var_os("RETROFLEX_IMU_DATA").map_or(beside, PathBuf::from);
    folder.is_dir().then_some(folder)
}

/// All rows of all filters, computed once; `None` without recordings.
fn rows() -> Option<&'static [FileScore]> {
    static ROWS: OnceLock<Option<Vec<FileScore>>> = OnceLock::new();
    ROWS.get_or_init(|| {
        let folder = folder()?;
        let files: Vec<PathBuf> = VQF_PUBLISHED
            .iter()
            .map(|(trial, _)| folder.join(format!("broad_{trial}.csv.gz")))
            .collect();
        Some(score::run(&files, None, true).unwrap())
    })
    .as_deref()
    .or_else(|| {
        println!("skipped: no recordings in RETROFLEX_IMU_DATA nor in ../shared/data/imu");
        None
    })
}

fn mean(filter: FilterName) -> Option<Score> {
    score::mean(rows()?, filter)
}

#[test]
fn vqf_matches_the_published_filter_in_every_trial() {
    let Some(rows) = rows() else { return };
    for (trial, published) in VQF_PUBLISHED {
        let row = rows
            .iter()
            .find(|r| r.filter == FilterName::Vqf && r.file.contains(trial))
            .unwrap();
        let ours = [
            row.score.total_deg,
            row.score.heading_deg,
            row.score.inclination_deg,
        ];
        for (ours, published) in ours.iter().zip(published) {
            assert!(
                (ours - published).abs() < 0.02,
                "{trial}: {row:?}, published {published}"
            );
        }
    }
    let mean = mean(FilterName::Vqf).unwrap();
    assert!(
        mean.total_deg <= 3.21 && mean.inclination_deg <= 0.75,
        "{mean:?}"
    );
}

#[test]
fn madgwick_keeps_its_accuracy() {
    let Some(mean) = mean(FilterName::Madgwick) else {
        return;
    };
    assert!(
        mean.total_deg <= 2.95 && mean.inclination_deg <= 0.95,
        "{mean:?}"
    );
}

#[test]
fn vqf_long_keeps_its_accuracy() {
    let Some(mean) = mean(FilterName::VqfLong) else {
        return;
    };
    assert!(
        mean.total_deg <= 2.90 && mean.inclination_deg <= 0.75,
        "{mean:?}"
    );
}

#[test]
fn mekf_keeps_its_accuracy_and_is_never_far_from_vqf() {
    let (Some(rows), Some(mean)) = (rows(), mean(FilterName::Mekf)) else {
        return;
    };
    assert!(
        mean.total_deg <= 2.05 && mean.heading_deg <= 1.85 && mean.inclination_deg <= 0.70,
        "{mean:?}"
    );
    for (trial, [vqf, ..]) in VQF_PUBLISHED {
        let row = rows
            .iter()
            .find(|r| r.filter == FilterName::Mekf && r.file.contains(trial))
            .unwrap();
        assert!(
            row.score.total_deg < vqf + 0.1,
            "{trial}: {row:?}, VQF {vqf}"
        );
    }
}

/// Recordings whose gyroscope is limited to a share of what it measured, drawn within limits in which it loses 0.5 to 15 % of the
/// samples.
#[test]
fn a_saturated_gyroscope_is_recognised_and_costs_mekf_no_more_than_vqf() {
    let Some(folder) = folder() else {
        return println!("skipped: no recordings");
    };
    let mut means = [Vector2::zeros(); 3];
    for (k, (trial, _)) in VQF_PUBLISHED.iter().enumerate() {
        let mut recording = recording::read(&folder.join(format!("broad_{trial}.csv.gz"))).unwrap();
        let saturated = |recording: &Recording| {
            let mut range = Saturation::default();
            let rates = recording.rows.iter().map(|row| row.sample.gyro_rad_s);
            rates.filter(|rate| range.update(rate).is_some()).count()
        };
        assert_eq!(saturated(&recording), 0, "{trial} is within its range");
        let mut sizes: Vec<f64> = recording
            .rows
            .iter()
            .map(|row| row.sample.gyro_rad_s.amax())
            .collect();
        sizes.sort_by(f64::total_cmp);
        for (level, limited) in [0.005, 0.02, 0.05 + 0.01 * k as f64]
            .into_iter()
            .enumerate()
        {
            let limit = sizes[((1.0 - limited) * sizes.len() as f64) as usize].max(1.1);
            let limited =
                sizes.iter().filter(|size| **size >= limit).count() as f64 / sizes.len() as f64;
            for row in &mut recording.rows {
                row.sample
                    .gyro_rad_s
                    .apply(|rate| *rate = rate.clamp(-limit, limit));
            }
            let share = saturated(&recording) as f64 / recording.rows.len() as f64;
            let total = |filter: FilterName| {
                let mut filter = filter.build(score::periods(&recording));
                score::score(&recording, &mut *filter).unwrap().total_deg
            };
            let (mekf, vqf) = (total(FilterName::Mekf), total(FilterName::Vqf));
            println!(
                "{trial}: {:.0} °/s, {:.3} of the samples, {share:.3} recognised: mekf {mekf:.2}°, vqf {vqf:.2}°",
                limit.to_degrees(),
                limited
            );
            assert!(share > 0.5 * limited && mekf < 1.2 * vqf);
            means[level] += Vector2::new(mekf, vqf) / VQF_PUBLISHED.len() as f64;
        }
    }
    for (level, mean) in means.iter().enumerate() {
        println!(
            "level {level}: mekf {:.1}°, vqf {:.1}° in the mean",
            mean.x, mean.y
        );
    }
}

#[test]
fn a_single_filter_can_be_selected() {
    let Some(folder) = folder() else {
        return println!("skipped: no recordings");
    };
    let files = [folder.join("broad_02_undisturbed_slow_rotation_B.csv.gz")];
    let rows = score::run(&files, Some(FilterName::Vqf), false).unwrap();
    assert_eq!((rows.len(), rows[0].filter), (1, FilterName::Vqf));
    assert_eq!(rows[0].file, "broad_02_undisturbed_slow_rotation_B.csv.gz");
    let rows = score::run(&files, None, false).unwrap();
    assert_eq!(rows[0].filter, score::DEFAULT_FILTER);
    println!("{rows:#?}");
}
