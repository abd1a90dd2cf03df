//! Cross-validation of the settings of the generic filters: `cargo test --release --test slow fuse_cv -- --nocapture`.
//!
//! Every setting of a coarse grid is scored on the nine recordings of `docs/fusion.md` except the held-out ones, and the
//! best setting on the held-out ones. A second test adds a magnet of several strengths to the undisturbed recordings.
//! Both are slow and run on request only.

use nalgebra::Vector3;
use rayon::prelude::*;
use retroflex::estimation::fusion::madgwick::{Madgwick, MadgwickConfig};
use retroflex::estimation::fusion::mekf::{Mekf, MekfConfig};
use retroflex::estimation::fusion::vqf::Vqf;
use retroflex::estimation::fusion::{Filter, FilterName};
use retroflex::experiment::score;
use retroflex::log::recording::{self, Recording};
use std::path::PathBuf;

type Maker = Box<dyn Fn(&Recording) -> Filter + Sync>;

/// One setting and its total error on each recording, degrees.
struct Candidate {
    name: String,
    total_deg: Vec<f64>,
}

/// Kind of motion or disturbance; recordings of one kind are held out together.
fn kind(name: &str) -> &'static str {
    [
        "rotation",
        "translation",
        "combined",
        "tapping",
        "vibration",
        "magnet",
    ]
    .into_iter()
    .find(|k| name.contains(k))
    .map_or("other", |k| if k == "tapping" { "vibration" } else { k })
}

fn recordings() -> Option<Vec<Recording>> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data/imu");
    let folder = std::env::var_os("RETROFLEX_IMU_DATA").map_or(beside, PathBuf::from);
    let Ok(entries) = std::fs::read_dir(&folder) else {
        println!("skipped: no recordings in {}", folder.display());
        return None;
    };
    let mut files: Vec<PathBuf> = entries.map(|e| e.unwrap().path()).collect();
    files.retain(|f| f.to_string_lossy().ends_with(".csv.gz"));
    files.sort();
    Some(
        files
            .par_iter()
            .map(|f| recording::read(f).unwrap())
            .collect(),
    )
}

fn totals(recordings: &[Recording], make: &Maker) -> Vec<f64> {
    recordings
        .par_iter()
        .map(|r| score::score(r, &mut *make(r)).unwrap().total_deg)
        .collect()
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    values.clone().sum::<f64>() / values.count() as f64
}

/// Mean over held-out recordings, each scored with the setting that is best on the others.
fn held_out(tried: &[Candidate], together: impl Fn(usize, usize) -> bool) -> f64 {
    let count = tried[0].total_deg.len();
    mean((0..count).map(|out| {
        let training = |t: &Candidate| {
            mean(
                (0..count)
                    .filter(|k| !together(*k, out))
                    .map(|k| t.total_deg[k]),
            )
        };
        let best = tried
            .iter()
            .min_by(|a, b| training(a).total_cmp(&training(b)))
            .unwrap();
        best.total_deg[out]
    }))
}

/// Prints the cross-validation of a grid; returns the mean over leave-one-kind-out.
fn validate(title: &str, recordings: &[Recording], grid: Vec<(String, Maker)>) -> f64 {
    let tried: Vec<Candidate> = grid
        .into_iter()
        .map(|(name, make)| Candidate {
            name,
            total_deg: totals(recordings, &make),
        })
        .collect();
    let overall = |t: &Candidate| mean(t.total_deg.iter().copied());
    let best = tried
        .iter()
        .min_by(|a, b| overall(a).total_cmp(&overall(b)))
        .unwrap();
    let worst = tried.iter().map(overall).fold(0.0, f64::max);
    let trial = held_out(&tried, |a, b| a == b);
    let by_kind = held_out(&tried, |a, b| {
        kind(&recordings[a].name) == kind(&recordings[b].name)
    });
    println!(
        "{title}: {} settings, best in sample {:.2} ({}), worst {worst:.2}, leave one out {trial:.2}, leave one kind out {by_kind:.2}",
        tried.len(),
        overall(best),
        best.name
    );
    by_kind
}

fn vqf_grid() -> Vec<(String, Maker)> {
    let point = |tau_mag_s: f64| -> (String, Maker) {
        (
            format!("tau_mag {tau_mag_s}"),
            Box::new(move |r| Filter::Vqf(Vqf::new(score::periods(r), tau_mag_s))),
        )
    };
    [9.0, 12.0, 15.0, 20.0, 25.0, 30.0, 40.0].map(point).into()
}

fn madgwick_grid() -> Vec<(String, Maker)> {
    let mut grid: Vec<(String, Maker)> = Vec::new();
    for beta_field in [0.003, 0.005, 0.008, 0.012, 0.02] {
        for input_tau_s in [1.0, 2.0, 3.0] {
            for beta_gravity in [0.01, 0.02, 0.03] {
                let config = MadgwickConfig {
                    beta_field,
                    input_tau_s,
                    beta_gravity,
                    ..MadgwickConfig::default()
                };
                let name =
                    format!("field {beta_field}, inputs {input_tau_s} s, gravity {beta_gravity}");
                grid.push((
                    name,
                    Box::new(move |_| Filter::Madgwick(Madgwick::new(config))),
                ));
            }
        }
    }
    grid
}

fn mekf_grid() -> Vec<(String, Maker)> {
    let mut grid: Vec<(String, Maker)> = Vec::new();
    for iron_sigma_ut in [0.3, 0.5, 1.0] {
        for field_memory_s in [1.0, 2.0, 4.0] {
            for rest_field_weight in [0.1, 0.3, 1.0] {
                for velocity_sigma_m_s in [0.3, 0.5, 1.0] {
                    for scale_sigma in [0.003, 0.005, 0.008] {
                        let config = MekfConfig {
                            iron_sigma_ut,
                            field_memory_s,
                            rest_field_weight,
                            velocity_sigma_m_s,
                            scale_sigma,
                            ..MekfConfig::default()
                        };
                        let name = format!(
                            "iron {iron_sigma_ut}, memory {field_memory_s}, rest {rest_field_weight}, velocity {velocity_sigma_m_s}, scale {scale_sigma}"
                        );
                        grid.push((name, Box::new(move |_| Filter::Mekf(Mekf::new(config)))));
                    }
                }
            }
        }
    }
    grid
}

#[test]
fn settings_generalise_to_held_out_recordings() {
    let Some(recordings) = recordings() else {
        return;
    };
    let vqf = mean(totals(&recordings, &vqf_grid()[0].1).into_iter());
    println!("vqf as published: {vqf:.2}");
    let long = validate("vqf-long", &recordings, vqf_grid());
    let madgwick = validate("madgwick", &recordings, madgwick_grid());
    let mekf = validate("mekf", &recordings, mekf_grid());
    assert!(long < vqf && madgwick < vqf && mekf < 0.75 * vqf);
}

/// Adds hard iron of the given strength over the middle three quarters of the motion.
fn with_magnet(recording: &Recording, strength_ut: f64, axis: usize) -> Recording {
    let mut changed = recording.clone();
    let moving: Vec<usize> = (0..changed.rows.len())
        .filter(|k| changed.rows[*k].moving)
        .collect();
    let (first, last) = (moving[moving.len() / 12], moving[moving.len() * 5 / 6]);
    let mut iron = Vector3::repeat(-0.4);
    iron[axis] = 1.0;
    let iron = iron.normalize() * strength_ut;
    for row in &mut changed.rows[first..last] {
        if let Some(mag) = &mut row.sample.mag_ut {
            *mag += iron;
        }
    }
    changed
}

#[test]
fn mekf_tolerates_a_magnet_on_the_body() {
    let Some(recordings) = recordings() else {
        return;
    };
    let clean: Vec<Recording> = recordings
        .into_iter()
        .filter(|r| r.name.contains("undisturbed"))
        .collect();
    println!(
        "{:>10} {:>9} {:>9} {:>9} {:>9}",
        "µT", "madgwick", "vqf", "vqf-long", "mekf"
    );
    for strength_ut in [0.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0] {
        let disturbed: Vec<Recording> = clean
            .iter()
            .enumerate()
            .map(|(k, r)| with_magnet(r, strength_ut, k % 3))
            .collect();
        let of = |name: FilterName| {
            let make: Maker = Box::new(move |r| name.build(score::periods(r)));
            mean(totals(&disturbed, &make).into_iter())
        };
        let errors = FilterName::ALL.map(of);
        println!(
            "{strength_ut:>10} {:>9.2} {:>9.2} {:>9.2} {:>9.2}",
            errors[0], errors[1], errors[2], errors[3]
        );
        assert!(errors[3] < 3.0, "{strength_ut} µT: mekf {} deg", errors[3]);
    }
}
