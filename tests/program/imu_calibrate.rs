//! `retroflex calibrate imu` as a command: results, refusals, and preservation of the rest of the file.

use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};
use std::fmt::Write;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;

const HEAD: &str = "time_s,piston1_mm,piston2_mm,piston3_mm,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s,mag_x_ut,mag_y_ut,mag_z_ut\n";

fn calibrate(args: &[&str]) -> (i32, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(["calibrate", "imu"])
        .args(args)
        .output()
        .unwrap();
    (
        out.status.code().unwrap(),
        String::from_utf8_lossy(&out.stderr).into_owned(),
    )
}

/// A log at 100 Hz of a sensor with a gyroscope bias and hard iron, with the field `field` in sensor axes.
fn log(path: &Path, seconds: f64, rate: [f64; 3], field: impl Fn(f64) -> [f64; 3]) {
    let mut rng = StdRng::seed_from_u64(5);
    let mut noise = |sigma: f64| -> f64 {
        sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng)
    };
    let mut text = HEAD.to_owned();
    for k in 0..(seconds * 100.0) as u32 {
        let t = f64::from(k + 1) * 0.01;
        let m = field(t);
        write!(text, "{t:.3},0,0,0").unwrap();
        for a in [0.0, 0.0, 9.81] {
            write!(text, ",{:.4}", a + noise(0.02)).unwrap();
        }
        for g in rate {
            write!(text, ",{:.6}", g + noise(0.002)).unwrap();
        }
        for m in m {
            write!(text, ",{:.3}", m + noise(0.3)).unwrap();
        }
        text.push('\n');
    }
    std::fs::write(path, text).unwrap();
}

#[test]
fn a_rest_gives_the_gyroscope_bias_and_the_file_is_preserved() {
    let folder = TempDir::new().unwrap();
    let (still, out) = (
        folder.path().join("still.csv"),
        folder.path().join("tip.toml"),
    );
    log(&still, 20.0, [0.012, -0.02, 0.004], |_| [20.0, 0.0, -45.0]);
    std::fs::write(
        &out,
        "[transmission]\nk_epsilon = [2.0, 2.1, 2.2]\nk_lambda_mm = [0.8, 0.8, 0.8]\n",
    )
    .unwrap();
    let (code, text) = calibrate(&[
        "gyro",
        still.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--date",
        "2025-01-31",
    ]);
    assert_eq!(code, 0, "{text}");
    let table: toml::Table = std::fs::read_to_string(&out).unwrap().parse().unwrap();
    let entry = &table["imu"]["gyro_bias_rad_s"];
    for (found, truth) in entry["value"]
        .as_array()
        .unwrap()
        .iter()
        .zip([0.012, -0.02, 0.004])
    {
        assert!(
            (found.as_float().unwrap() - truth).abs() < 3e-4,
            "{found} {truth}"
        );
    }
    assert!(
        entry["sigma"]
            .as_array()
            .unwrap()
            .iter()
            .all(|s| (1e-6..1e-3).contains(&s.as_float().unwrap()))
    );
    assert_eq!(entry["date"].as_str(), Some("2025-01-31"));
    assert!(entry["source"].as_str().unwrap().ends_with("still.csv"));
    assert_eq!(table["transmission"]["k_epsilon"][2].as_float(), Some(2.2));
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        2,
        "a temporary file was left behind"
    );
}

#[test]
fn a_tumble_gives_the_hard_iron_and_a_partial_one_is_refused() {
    let folder = TempDir::new().unwrap();
    let (tumble, out) = (
        folder.path().join("tumble.csv"),
        folder.path().join("imu.toml"),
    );
    // a spiral over the sphere; a short one stays near a pole and covers too little
    let on_sphere = |reach: f64| {
        move |t: f64| {
            let z = 1.0 - reach * t / 60.0;
            let (r, a) = ((1.0 - z * z).max(0.0).sqrt(), t * 2.4);
            [
                50.0 * r * a.cos() + 9.0,
                50.0 * r * a.sin() - 4.0,
                50.0 * z + 2.0,
            ]
        }
    };
    log(&tumble, 60.0, [0.0; 3], on_sphere(0.3));
    let (code, text) = calibrate(&[
        "mag",
        tumble.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(
        code == 1 && text.contains("refused") && !out.exists(),
        "{code} {text}"
    );
    log(&tumble, 60.0, [0.0; 3], on_sphere(2.0));
    let (code, text) = calibrate(&[
        "mag",
        tumble.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(code, 0, "{text}");
    let table: toml::Table = std::fs::read_to_string(&out).unwrap().parse().unwrap();
    for (found, truth) in table["imu"]["mag_bias_ut"]["value"]
        .as_array()
        .unwrap()
        .iter()
        .zip([9.0, -4.0, 2.0])
    {
        assert!(
            (found.as_float().unwrap() - truth).abs() < 0.3,
            "{found} {truth}"
        );
    }
}

#[test]
fn unusable_recordings_are_named() {
    let folder = TempDir::new().unwrap();
    let lost = folder.path().join("none.csv");
    let (code, text) = calibrate(&["gyro", lost.to_str().unwrap()]);
    assert!(code == 2 && text.contains("none.csv"), "{code} {text}");
    let moving = folder.path().join("turning.csv");
    log(&moving, 10.0, [0.0, 0.8, 0.0], |_| [20.0, 0.0, -45.0]);
    let out = folder.path().join("imu.toml");
    let (code, text) = calibrate(&[
        "gyro",
        moving.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(
        code == 1 && text.contains("refused") && !out.exists(),
        "{code} {text}"
    );
}
