//! A flight with faults, logged, replays bit for bit on every filter, and its log stays bounded.

use crate::common::flight::fly;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::Field;
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::drill::bench::{Bench, bend};
use retroflex::log::bend_log;
use retroflex::motion::machine::Alarm;
use retroflex::primitives::ReadFault;
use retroflex::supervisor::cycle::order::Order;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// Duration of each flight, s; `RETROFLEX_FLIGHT_S=3600` flies for an hour.
fn duration_s() -> f64 {
    std::env::var("RETROFLEX_FLIGHT_S")
        .ok()
        .and_then(|s| s.parse().ok())
        .unwrap_or(40.0)
}

/// A pose every second and a fault every 7 s.
fn script(number: u64, bench: &mut Bench) -> Option<Order> {
    let ms = number % 7000;
    let machine = &mut bench.runner.machine;
    match (number / 7000 % 4, ms) {
        (0, 5000) => machine.bus = Some(ReadFault::Nack),
        (1, 5000) => machine.alarm = Some(Alarm::Pressure { kpa: 60.0 }),
        (2, 5000) => machine.emergency_stop = true,
        (3, 5000) => machine.stamp_offset_s = 0.3,
        (_, 5700) => machine.clear_faults(),
        _ => {}
    }
    match ms {
        3000 | 6200 => Some(Order::Arm),
        6000 => Some(Order::Reset),
        // the emergency stop takes the current away, and with it the position
        6050 => Some(Order::AssertStraight),
        n if n % 1000 == 500 && n > 3000 => Some(bend(
            10.0 + (number % 60_000) as f64 / 1000.0,
            (number / 100 % 360) as f64,
        )),
        6900 => Some(Order::Relax),
        _ => None,
    }
}

#[test]
fn a_flight_with_faults_replays_bit_for_bit_on_every_filter() {
    let folder = tempfile::tempdir().unwrap();
    for filter in ["bend", "madgwick", "vqf", "vqf-long", "mekf"] {
        let gains: Gains =
            source::parse("gains", &format!("[fuse]\nfilter = \"{filter}\"\n")).unwrap();
        let path = folder.path().join(format!("{filter}.mcap"));
        let (cycles, bytes) = fly(&path, gains, duration_s(), script);
        let since = Instant::now();
        let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
            .arg("replay")
            .arg(&path)
            .output()
            .unwrap();
        let elapsed_s = since.elapsed().as_secs_f64();
        let text = String::from_utf8_lossy(&out.stdout).into_owned()
            + &String::from_utf8_lossy(&out.stderr);
        assert!(
            out.status.success() && text.contains(&format!("{cycles} cycles replayed, 0 differ\n")),
            "{filter}: {text}"
        );
        let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
            .args(["log", "info"])
            .arg(&path)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&out.stdout).into_owned();
        assert!(
            text.contains("mode faulted") && text.contains("mode tracking"),
            "{filter}: {text}"
        );
        let mb_h = bytes as f64 * 3600.0 / duration_s() * 1e-6;
        eprintln!(
            "{filter}: {mb_h:.0} MB an hour, replayed at {:.0} × real time",
            duration_s() / elapsed_s
        );
        // this tip never rests
        assert!(mb_h < 150.0 * 1.1, "{filter}: {mb_h} MB an hour");
    }
}

/// What a replay with another filter writes is a flight log of its own: it replays bit for bit, and is shown as a page.
#[test]
fn a_replay_with_other_settings_is_a_flight_log() {
    let folder = tempfile::tempdir().unwrap();
    let [log, other, html] =
        ["flight.mcap", "other.mcap", "info.html"].map(|name| folder.path().join(name));
    fly(&log, Gains::default(), 8.0, script);
    let (code, text) = retroflex(&["replay", "--filter", "mekf", "--out"], &[&other, &log]);
    assert!(code == Some(0) && text.contains("speculation"), "{text}");
    let (code, text) = retroflex(&["replay"], &[&other]);
    assert!(
        code == Some(0) && text.contains("8000 cycles replayed, 0 differ\n"),
        "{text}"
    );
    let (code, text) = retroflex(&["log", "info", "--html"], &[&html, &other]);
    let page = std::fs::read_to_string(&html).unwrap();
    assert!(
        code == Some(0)
            && page.contains("<svg")
            && page.contains("mode faulted")
            && page.contains("gains.toml hash"),
        "{text}{page}"
    );
    // an existing file stays
    let before = std::fs::read(&other).unwrap();
    let (code, text) = retroflex(&["replay", "--out"], &[&other, &log]);
    assert!(
        code == Some(2) && text.contains("--out") && text.contains("exists"),
        "{text}"
    );
    assert!(std::fs::read(&other).unwrap() == before);
}

/// The table that `log export --parquet` writes holds the values of the bend log that `--csv` writes, nulls where that is empty, and in its
/// metadata the units and the time of its zero. Numbers in the bend log have a decimal point, and its readers know all of its columns.
#[test]
fn a_parquet_table_equals_the_bend_log() {
    let folder = tempfile::tempdir().unwrap();
    let [log, csv, parquet] =
        ["flight.mcap", "flight.csv", "flight.parquet"].map(|name| folder.path().join(name));
    fly(&log, Gains::default(), 4.0, script);
    let mut export = Command::new(env!("CARGO_BIN_EXE_retroflex"));
    export
        .args(["log", "export"])
        .arg(&log)
        .arg("--csv")
        .arg(&csv)
        .arg("--parquet")
        .arg(&parquet);
    assert!(export.status().unwrap().success());
    let text = std::fs::read_to_string(&csv).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let reader = SerializedFileReader::new(std::fs::File::open(&parquet).unwrap()).unwrap();
    let metadata = reader.metadata().file_metadata().key_value_metadata();
    let known = |key: &str| {
        let entry = metadata.unwrap().iter().find(|entry| entry.key == key);
        entry.and_then(|entry| entry.value.clone()).unwrap()
    };
    let units: serde_json::Value = serde_json::from_str(&known("units")).unwrap();
    assert_eq!(
        [
            &units["time_s"],
            &units["gyr_x_rad_s"],
            &units["estimate_bend_deg"]
        ],
        ["s", "rad/s", "°"]
    );
    // the flight begins with the epoch
    assert!(
        known("start_time").starts_with("1970-01-01T00:00:00"),
        "{}",
        known("start_time")
    );
    let (mut rows, mut nulls, mut tracking) = (0, 0, 0);
    for row in reader.get_row_iter(None).unwrap() {
        let row = row.unwrap();
        let written: Vec<&str> = lines.next().unwrap().split(',').collect();
        for ((k, (name, field)), (known, text)) in row
            .get_column_iter()
            .enumerate()
            .zip(names.iter().zip(written))
        {
            assert_eq!(name, known);
            match field {
                Field::Null => (assert_eq!(text, "", "{name} in row {rows}"), nulls += 1).1,
                Field::Str(mode) => {
                    (
                        assert_eq!(mode, text),
                        tracking += usize::from(text == "tracking"),
                    )
                        .1
                }
                Field::Double(_) if !text.contains('.') => panic!("{name} in row {rows}: {text}"),
                // the time has six digits in the bend log
                Field::Double(value) if k == 0 => assert_eq!(format!("{value:.6}"), text),
                Field::Double(value) => {
                    assert_eq!(*value, text.parse::<f64>().unwrap(), "{name} in row {rows}")
                }
                other => panic!("{name}: {other}"),
            }
        }
        rows += 1;
    }
    assert!(rows > 500 && lines.next().is_none(), "{rows} rows");
    // the magnetometer is slower than the other sensors, and no pressure is measured
    assert!(nulls > 3 * rows, "{nulls}");
    assert!(tracking > 50, "{tracking} rows while the tip moves");
    assert_eq!(bend_log::read(&csv).unwrap().ignored, Vec::<String>::new());
    let last = text
        .lines()
        .next_back()
        .unwrap()
        .split(',')
        .collect::<Vec<_>>();
    let value = |name: &str| -> f64 {
        last[names.iter().position(|n| *n == name).unwrap()]
            .parse()
            .unwrap()
    };
    assert!(
        (value("setpoint_bend_deg") - value("estimate_bend_deg")).abs() < 5.0,
        "{last:?}"
    );
    assert!(value("k_epsilon1") > 1.0, "{last:?}");
}

/// A compressed chunk without a checksum, whose only record claims to have this length.
fn chunk_with(length: u64) -> Vec<u8> {
    let record = [&[5][..], &length.to_le_bytes(), &[0; 91]].concat();
    // a frame of one segment with one raw block (RFC 8878)
    let size = record.len() as u32;
    let block = &((size << 3) | 1).to_le_bytes()[..3];
    let frame = [&[0x28, 0xb5, 0x2f, 0xfd, 0x20, size as u8], block, &record].concat();
    let mut body = [[0; 16].as_slice(), &u64::from(size).to_le_bytes(), &[0; 4]].concat();
    body.extend(b"\x04\0\0\0zstd");
    body.extend((frame.len() as u64).to_le_bytes());
    body.extend(frame);
    [&[6][..], &(body.len() as u64).to_le_bytes(), &body].concat()
}

/// A log with an inverted bit in its middle, or a chunk twice: what can be read is read, the damage is reported with code 1 and stays
/// reported in what is made of the log, and no part of a second is lost besides.
#[test]
fn damage_is_reported_and_only_the_damaged_chunk_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    fly(&file("whole.mcap"), Gains::default(), 8.0, script);
    let whole = std::fs::read(file("whole.mcap")).unwrap();
    let chunks: Vec<usize> = (0..whole.len() - 45)
        .filter(|k| whole[*k] == 6 && whole[k + 37..k + 45] == *b"\x04\0\0\0zstd")
        .collect();
    let [at, next] = [chunks[5], chunks[6]];
    let flipped = |k: usize| [&whole[..k], &[whole[k] ^ 8], &whole[k + 1..]].concat();
    let damaged = [
        ("content", flipped((at + next) / 2)),
        ("length", flipped(at + 4)),
        ("short length", flipped(at + 2)),
        ("kind", flipped(at)),
    ];
    // lengths inside the chunk that no memory holds
    let claims = [1 << 40, 6_551_466_485_182_743_132, u64::MAX - 8, u64::MAX];
    let claims = claims.map(|length| {
        let bytes = [&whole[..at], &chunk_with(length), &whole[next..]].concat();
        ("inner length", bytes)
    });
    let twice = ("twice", [&whole[..next], &whole[at..]].concat());
    for (name, bytes) in damaged.into_iter().chain(claims).chain([twice]) {
        let log = file(name);
        std::fs::write(&log, bytes).unwrap();
        let (info, replay) = (
            retroflex(&["log", "info"], &[&log]),
            retroflex(&["replay"], &[&log]),
        );
        let export = retroflex(&["log", "export", "--csv"], &[&file("bend.csv"), &log]);
        let cut = retroflex(&["log", "cut", "--out"], &[&file("cut.mcap"), &log]);
        let again = retroflex(&["log", "info"], &[&file("cut.mcap")]);
        std::fs::remove_file(file("cut.mcap")).unwrap();
        for (code, text) in [&info, &replay, &export, &cut, &again] {
            assert!(
                *code == Some(1) && text.contains("damaged at byte"),
                "{name}: {code:?} {text}"
            );
        }
        let (lost, cycles) = if name == "twice" {
            ("0.00 s lost", 8000)
        } else {
            ("0.50 s lost", 7500)
        };
        assert!(
            info.1.contains(lost) && info.1.contains(&format!("cycles: {cycles}")),
            "{name}: {}",
            info.1
        );
        assert_eq!(
            info.1.contains("gap: 500 cycles") && replay.1.contains("gap: 500 cycles"),
            name != "twice",
            "{name}: {}",
            info.1
        );
        assert!(
            !info.1.contains("gap: 0") && replay.1.contains(" 0 differ"),
            "{name}: {}",
            replay.1
        );
    }
    // a part of a run that is damaged is named by what follows it
    let parts = ["flight-000001-001.mcap", "flight-000001-002.mcap"].map(file);
    std::fs::write(&parts[0], flipped((at + next) / 2)).unwrap();
    std::fs::write(&parts[1], &whole).unwrap();
    let (code, text) = retroflex(&["replay"], &[&parts[1]]);
    assert!(
        code == Some(1) && text.contains("001.mcap: damaged at byte"),
        "{text}"
    );
    for text in ["", "a text"] {
        std::fs::write(file("text"), text).unwrap();
        let (code, text) = retroflex(&["log", "info"], &[&file("text")]);
        assert!(code == Some(2) && text.contains("no MCAP file"), "{text}");
    }
}

/// A cut has the cycles of the times that were asked for, and begins with them.
#[test]
fn a_cut_is_exact_to_the_cycle() {
    let folder = tempfile::tempdir().unwrap();
    let [log, out] = ["whole.mcap", "part.mcap"].map(|name| folder.path().join(name));
    fly(&log, Gains::default(), 4.0, script);
    for (from, to, cycles) in [
        ("0", "1.2345", 1235),
        ("2.05", "2.0512", 2),
        ("1.2505", "3.1005", 1850),
    ] {
        let (code, text) = retroflex(
            &["log", "cut", "--from", from, "--to", to, "--out"],
            &[&out, &log],
        );
        assert_eq!(code, Some(0), "{text}");
        let (_, text) = retroflex(&["log", "info", "--json", "-"], &[&out]);
        let info: serde_json::Value = serde_json::from_str(
            text.split("\nflight")
                .next()
                .unwrap()
                .split("\n/")
                .next()
                .unwrap(),
        )
        .unwrap();
        let duration_s = info["duration_s"].as_f64().unwrap()
            - (to.parse::<f64>().unwrap() - from.parse::<f64>().unwrap());
        assert!(
            info["cycles"] == cycles && (-0.002..=0.001).contains(&duration_s),
            "{from} to {to}: {info}"
        );
        std::fs::remove_file(&out).unwrap();
    }
}

fn retroflex(args: &[&str], files: &[&Path]) -> (Option<i32>, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(args)
        .args(files)
        .output()
        .unwrap();
    (
        out.status.code(),
        String::from_utf8_lossy(&[out.stdout, out.stderr].concat()).into_owned(),
    )
}
