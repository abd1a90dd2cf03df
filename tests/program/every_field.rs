//! Every file that the program reads, with one field at a time at a value that no machine has: the command ends with a result or with
//! one short message, in bounded time and memory.

use crate::common::repo;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::fmt::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

/// Longest time of a command without optimisation, s of one processor, and its memory, KiB.
const LIMITS: &str = "ulimit -t 20; ulimit -v 500000; exec \"$0\" \"$@\"";
/// Longest message, bytes: a field of megabytes is not quoted whole.
const MESSAGE_MAX: usize = 4000;
/// Drawn files of each reader; `RETROFLEX_FIELDS` sets another number.
const DRAWN: usize = 12;

/// A plant that says hello with one line of a file, and answers with the other.
const PLANT: &str = "#!/usr/bin/env python3
import sys
hello, reply = open('plant.json', errors='surrogateescape').read().split('\\n')[:2]
sys.stdout.reconfigure(errors='surrogateescape')
print(hello, flush=True)
for n, _ in enumerate(sys.stdin, 1):
    print(reply.replace('T', f'{n * 0.005:.3f}'), flush=True)
";

/// A file and a command that reads it.
struct Reader {
    name: &'static str,
    args: &'static str,
    text: String,
    /// What separates the fields.
    separators: &'static [char],
}

/// A bend log of so many rows in which the tip goes to and fro.
fn bend_log(rows: u32) -> String {
    let mut text = "time_s,cmd_bend_deg,cmd_dir_deg,cmd_len_mm,piston1_mm,piston2_mm,piston3_mm,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s,mag_x_ut,mag_y_ut,mag_z_ut,temp_c,pressure1_kpa,pressure2_kpa,pressure3_kpa,base_acc_x_m_s2,base_acc_y_m_s2,base_acc_z_m_s2,base_gyr_x_rad_s,base_gyr_y_rad_s,base_gyr_z_rad_s,base_mag_x_ut,base_mag_y_ut,base_mag_z_ut\n".to_owned();
    for k in 0..rows {
        // at rest first
        let (t_s, phase) = (f64::from(k) * 0.02, f64::from(k.saturating_sub(150)) * 0.01);
        let mm = [0.0, 2.1, 4.2].map(|a: f64| 3.0 * ((phase + a).sin() - a.sin()));
        let (s, c) = (0.3 * phase.sin()).sin_cos();
        let _ = writeln!(
            text,
            "{t_s:.3},10.0,0.0,20.0,{:.4},{:.4},{:.4},{:.4},0.01,{:.4},0.001,{:.4},0.002,{:.3},1.5,-40.0,30.1,2.0,2.1,2.2,0.01,0.02,9.81,0.0,0.001,0.0,20.0,1.5,-40.0",
            mm[0],
            mm[1],
            mm[2],
            9.81 * s,
            9.81 * c,
            if k > 150 { 0.15 * phase.cos() } else { 0.0 },
            20.0 * c
        );
    }
    text
}

/// A recording of an IMU with a reference.
fn recording() -> String {
    let mut text = "time_s,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z,mag_x,mag_y,mag_z,ref_qw,ref_qx,ref_qy,ref_qz,moving\n".to_owned();
    for k in 0..600 {
        let t_s = f64::from(k) * 0.01;
        let (s, c) = (0.1 * t_s).sin_cos();
        let (s2, c2) = (0.05 * t_s).sin_cos();
        let _ = writeln!(
            text,
            "{t_s:.2},0.0,{:.5},{:.5},0.1,0.0,0.0,20.0,{:.4},{:.4},{c2:.6},{s2:.6},0.0,0.0,1",
            9.81 * s,
            9.81 * c,
            -40.0 * s,
            -40.0 * c
        );
    }
    text
}

fn readers() -> Vec<Reader> {
    let csv: &[char] = &[',', '\n'];
    let json: &[char] = &[',', ':', '[', ']', '{', '}', '\n'];
    let toml: &[char] = &['=', ',', '[', ']', '\n'];
    let shipped = |path: &str| {
        let text = std::fs::read_to_string(repo(path)).unwrap();
        // values only: a comment may say anything
        let lines = text
            .lines()
            .map(|line| line.split('#').next().unwrap().trim_end());
        lines
            .filter(|line| !line.is_empty())
            .collect::<Vec<_>>()
            .join("\n")
            + "\n"
    };
    let reader = |name, args, text, separators| Reader {
        name,
        args,
        text,
        separators,
    };
    let path = "t_s,bend_deg,dir_deg\n0,0,0\n1,10,0\n2,20,30\n3,20,60\n4,0,0\n".to_owned();
    let map = "input = [\"u\"]\noutput = \"y\"\ntime = \"t\"\n";
    let rig = "schema = 1\nversion = \"0.1.0\"\nsource = \"x.csv\"\nclosed = 0.9\nclosed_ci95 = [0.8, 0.95]\nwith_effects = [0.5]\nspread = 1.0\n[gap]\nrecalibrated = 0.6\nexplained = 0.1\nnoise_floor = 0.05\n[map]\ninput = \"u\"\noutput = \"y\"\ntime = \"t\"\noutput_unit = \"N\"\n[nominal]\nweights = [1.9]\nmiddle = 5.7\nhalf = 5.7\nm_low = 0.0\nm_range = 6.0\n[[effect]]\nname = \"play\"\nvalue = 0.1\nci95 = [0.09, 0.11]\nsizes = [4.0]\n";
    let table = (0..60).fold("t,u,y\n".to_owned(), |mut text, k| {
        let _ = writeln!(text, "{}.0,{},{}", k, k % 7, 2 * (k % 7));
        text
    });
    let (log, imu, model) = (
        bend_log(1100),
        recording(),
        shipped("tests/corpus/model.toml"),
    );
    let plant = "{\"plant\":\"x\",\"protocol\":1,\"imu_period_s\":0.005,\"step_mm\":0.029452,\"rest_length_mm\":20.0,\"base_imu\":true}\n{\"t\":T,\"imu\":{\"acc\":[0.0,0.1,9.81],\"gyr\":[0.001,0.0,0.002],\"mag\":[20.0,0.5,-40.0]},\"ref\":{\"quat\":[1.0,0.0,0.0,0.0],\"base_quat\":[1.0,0.0,0.0,0.0]},\"base\":{\"acc\":[0.0,0.0,9.81],\"gyr\":[0.0,0.0,0.0],\"mag\":null}}\n";
    let gap_map = "gap diagnose table.csv --map map.toml";
    vec![
        reader("log.csv", "gap diagnose log.csv", log.clone(), csv),
        reader("map.toml", gap_map, map.to_owned(), toml),
        reader("table.csv", gap_map, table, csv),
        reader(
            "rig.toml",
            "gap check rig.toml table.csv",
            rig.to_owned(),
            toml,
        ),
        reader("model.toml", "gap apply model.toml", model.clone(), toml),
        reader(
            "model.toml",
            "evaluate --plant model:model.toml --track path.csv --calib tip.toml",
            model,
            toml,
        ),
        reader("imu.csv", "imu score imu.csv", imu.clone(), csv),
        reader(
            "imu.csv",
            "calibrate imu gyro imu.csv --out new.toml",
            imu.clone(),
            csv,
        ),
        reader(
            "imu.csv",
            "calibrate imu accel imu.csv --out new.toml",
            imu.clone(),
            csv,
        ),
        reader(
            "imu.csv",
            "calibrate imu mag imu.csv --out new.toml",
            imu,
            csv,
        ),
        reader(
            "log.csv",
            "calibrate imu mount log.csv --out new.toml",
            log.clone(),
            csv,
        ),
        reader(
            "log.csv",
            "calibrate imu motors log.csv --out new.toml",
            log,
            csv,
        ),
        reader("path.csv", "play path.csv", path.clone(), csv),
        reader(
            "path.csv",
            "evaluate --track path.csv --calib tip.toml",
            path,
            csv,
        ),
        reader(
            "plant.json",
            "evaluate --plant exec:./plant.py --track path.csv --calib tip.toml",
            plant.to_owned(),
            json,
        ),
        reader(
            "board.toml",
            "board check board.toml",
            shipped("boards/sim.toml"),
            toml,
        ),
        reader(
            "pins.toml",
            "board check pins.toml",
            shipped("boards/pi5-lsm6dsv16x.toml"),
            toml,
        ),
        reader(
            "gains.toml",
            "evaluate --gains gains.toml --track path.csv --calib tip.toml",
            shipped("boards/gains.toml"),
            toml,
        ),
        reader(
            "tip.toml",
            "evaluate --calib tip.toml --track path.csv",
            shipped("calib/paper.toml"),
            toml,
        ),
    ]
}

/// Places of the fields of a text, bytes.
fn fields(text: &str, separators: &[char]) -> Vec<(usize, usize)> {
    let mut begin = 0;
    let ends = text.char_indices().filter(|(_, c)| separators.contains(c));
    ends.map(|(end, _)| (std::mem::replace(&mut begin, end + 1), end))
        .collect()
}

fn run(folder: &Path, args: &str) -> Output {
    Command::new("sh")
        .args(["-c", LIMITS, env!("CARGO_BIN_EXE_retroflex")])
        .args(args.split(' '))
        .current_dir(folder)
        .env("XDG_RUNTIME_DIR", folder)
        .env("HOME", folder)
        .env("NO_COLOR", "1")
        // the address space then is what is used, and not what may be
        .env("MALLOC_ARENA_MAX", "1")
        .output()
        .unwrap()
}

#[test]
fn any_field_of_any_file_may_hold_anything() {
    let drawn = std::env::var("RETROFLEX_FIELDS").map_or(DRAWN, |n| n.parse().unwrap());
    let seed = std::env::var("RETROFLEX_SEED").map_or(1, |n| n.parse().unwrap());
    println!("seed {seed}, {drawn} files of each reader");
    let mut rng = StdRng::seed_from_u64(seed);
    let (readers, mut failures) = (readers(), 0);
    for reader in &readers {
        let folder = tempfile::tempdir().unwrap();
        for other in &readers {
            std::fs::write(folder.path().join(other.name), &other.text).unwrap();
        }
        let plant = folder.path().join("plant.py");
        std::fs::write(&plant, PLANT).unwrap();
        std::fs::set_permissions(&plant, std::fs::Permissions::from_mode(0o755)).unwrap();
        let whole = run(folder.path(), reader.args);
        let why = String::from_utf8_lossy(&whole.stderr);
        println!(
            "`{}` as it is: {:?} {}",
            reader.args,
            whole.status.code(),
            why.lines().next().unwrap_or("")
        );
        let fields = fields(&reader.text, reader.separators);
        // a run of the loop takes seconds without optimisation
        let slow = reader.args.starts_with("evaluate");
        for k in 0..if slow { drawn / 3 } else { drawn } {
            // the head as often as the rest
            let most = if rng.random_bool(0.3) {
                fields.len().min(40)
            } else {
                fields.len()
            };
            let (begin, end) = fields[rng.random_range(0..most)];
            let old = &reader.text[begin..end];
            let new = match k % 8 {
                0 => "NaN".to_owned(),
                1 => "1e308".to_owned(),
                2 => "-1e308".to_owned(),
                3 => u64::MAX.to_string(),
                4 => String::new(),
                5 => old.repeat(1_000_000),
                6 => "\u{1b}[2J\u{202e}".to_owned(),
                _ => "1e-320".to_owned(),
            };
            let text = [&reader.text[..begin], &new, &reader.text[end..]].concat();
            std::fs::write(folder.path().join(reader.name), text).unwrap();
            let out = run(folder.path(), reader.args);
            let said = String::from_utf8_lossy(&out.stderr);
            let shown = new.chars().take(30).collect::<String>();
            let what = format!(
                "`{}` with {shown:?} for {old:?} at byte {begin}: {}",
                reader.args,
                said.chars().take(MESSAGE_MAX).collect::<String>()
            );
            let code = out.status.code();
            let wrong = match code {
                Some(0..=3) if said.len() > MESSAGE_MAX => "a long message",
                Some(0..=3) if said.contains(['\u{1b}', '\u{202e}']) => "raw characters",
                Some(2)
                    if said
                        .lines()
                        .filter(|line| line.starts_with("error: "))
                        .count()
                        != 1 =>
                {
                    "not one message"
                }
                Some(0..=3) => continue,
                _ => "no end of its own",
            };
            println!("{wrong}, {code:?}: {what}");
            failures += 1;
        }
    }
    assert_eq!(failures, 0);
}
