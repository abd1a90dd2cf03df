//! Board files: those that are shipped are read, every key has its paragraph, and a board that
//! contradicts itself is refused with the place in the file.

use crate::common::repo;
use retroflex::config::board::Board;
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::{show, source};
use retroflex::hardware::pins::{self, Backend};
use retroflex::primitives::parameters::{Check, Shape, Table, join};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Names of all board files with pins, so that a new board is tested without a change here.
fn hardware() -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(repo("boards"))
        .unwrap()
        .filter_map(|entry| {
            entry
                .unwrap()
                .file_name()
                .into_string()
                .unwrap()
                .strip_suffix(".toml")
                .map(str::to_owned)
        })
        .filter(|name| !["sim", "demo", "gains"].contains(&name.as_str()))
        .collect();
    names.sort();
    assert!(names.len() >= 5, "{names:?}");
    names
}

/// The whole of a board, as `retroflex board show` prints it.
fn text(name: &str) -> String {
    let board: Board = source::read(&repo(&format!("boards/{name}.toml"))).unwrap();
    show::whole(&board)
}

#[test]
fn every_board_is_read_and_its_wiring_laid_out() {
    for name in hardware() {
        let board: Board = source::read(&repo(&format!("boards/{name}.toml"))).unwrap();
        let wiring = board.pins.as_ref().unwrap();
        assert!(board.imu.is_some() && board.plant.is_none(), "{name}");
        let rehearsal = pins::PinsConfig {
            backend: Backend::Mock,
            ..wiring.clone()
        };
        pins::open(&rehearsal, board.drive.microsteps).unwrap();
        let expected = if name == "linux-gpiochip" {
            Backend::Cdev
        } else {
            Backend::Rppal
        };
        assert_eq!(wiring.backend, expected, "{name}");
        let (power, pitch_mm) = (&board.power, board.drive.pinion_pitch_diameter_mm);
        let kept_kpa = power.detent_torque_n_mm / power.torque_n_mm(1.0, pitch_mm);
        let share = kept_kpa / board.limits.pressure_max_kpa;
        assert!(
            (0.11..0.14).contains(&share),
            "{name} says an eighth is left without current, the law says {share}"
        );
    }
    let sim: Board = source::read(&repo("boards/sim.toml")).unwrap();
    assert!(sim.plant.is_some() && sim.pins.is_none());
}

/// What is left out is what the paragraph says it is: the files state the defaults.
#[test]
fn boards_state_the_defaults_except_where_they_say_so() {
    let bare: Board = source::parse("bare", "").unwrap();
    for name in hardware() {
        let b: Board = source::read(&repo(&format!("boards/{name}.toml"))).unwrap();
        assert_eq!(
            (b.geometry, b.drive, b.motion, b.limits),
            (bare.geometry, bare.drive, bare.motion, bare.limits),
            "{name}"
        );
        assert_eq!(
            (b.power, b.safety, &b.service, b.homing),
            (bare.power, bare.safety, &bare.service, bare.homing),
            "{name}"
        );
        let step = retroflex::motion::StepperConfig {
            cpu: None,
            late_max_us: 1000.0,
            lead_ms: 4.0,
            ..b.stepper
        };
        assert_eq!(step, bare.stepper, "{name}");
        let imu = b.imu.unwrap();
        let expected = (name != "linux-gpiochip").then_some([2, 3]);
        assert_eq!(
            imu.bus_lines, expected,
            "{name}: only a Raspberry Pi can return the lines to the bus"
        );
        let bare = retroflex::hardware::machine::ImuSection::default();
        let another_part = name.ends_with("lsm6dsv16x");
        assert_eq!(imu.chip != bare.chip, another_part, "{name}");
        assert_eq!(
            retroflex::hardware::machine::ImuSection {
                bus_lines: None,
                chip: bare.chip.clone(),
                ..imu
            },
            bare,
            "{name}"
        );
    }
}

/// Adds every dotted key of a table and those below it. Entries of a list are written `[]`.
fn add_keys(table: &Table, at: &str, out: &mut Vec<String>) {
    for row in table.rows {
        let key = join(at, row.key);
        add_keys_below(&row.shape, &key, out);
        out.push(key);
    }
}

fn add_keys_below(shape: &Shape, at: &str, out: &mut Vec<String>) {
    match shape {
        Shape::Table(table) => add_keys(table, at, out),
        Shape::Optional(inner) => add_keys_below(inner, at, out),
        Shape::List(inner) => add_keys_below(inner, &format!("{at}[]"), out),
        Shape::Tagged(tag, alternatives) => {
            out.push(join(at, tag));
            alternatives
                .iter()
                .for_each(|(_, table)| add_keys(table, at, out));
        }
        Shape::Scalar | Shape::Choice(_) | Shape::Opaque => {}
    }
}

/// What `board show` prints is read back as the same board, and every key has a paragraph.
#[test]
fn a_printed_board_is_the_board_and_every_key_has_its_paragraph() {
    for name in hardware()
        .into_iter()
        .chain(["sim", "demo"].map(str::to_owned))
    {
        let board: Board = source::read(&repo(&format!("boards/{name}.toml"))).unwrap();
        let printed: Board = source::parse("printed", &show::whole(&board)).unwrap();
        assert_eq!(printed, board, "{name}");
        let compact: Board = source::parse("compact", &show::compact(&board)).unwrap();
        assert_eq!(compact, board, "{name}");
    }
    let mut keys = Vec::new();
    add_keys(<Board as Check>::TABLE.unwrap(), "", &mut keys);
    add_keys(<Gains as Check>::TABLE.unwrap(), "", &mut keys);
    add_keys(<Calibration as Check>::TABLE.unwrap(), "", &mut keys);
    assert!(keys.len() > 200, "{}", keys.len());
    for name in hardware() {
        let mut paragraph = 0;
        for line in text(&name).lines() {
            if line.starts_with('#') {
                paragraph += line.len();
            } else {
                assert!(
                    !line.contains(" = ") || paragraph >= 30,
                    "{name}: `{line}` has no paragraph"
                );
                paragraph = 0;
            }
        }
    }
}

/// The gains file is printed from the table; `REFRESH=1 cargo test --test program boards::the_gains_file` writes it anew.
#[test]
fn the_gains_file_states_every_key_at_its_default() {
    let (path, printed) = (repo("boards/gains.toml"), show::whole(&Gains::default()));
    if std::env::var_os("REFRESH").is_some() {
        std::fs::write(&path, &printed).unwrap();
    }
    assert_eq!(source::read::<Gains>(&path).unwrap(), Gains::default());
    assert!(
        std::fs::read_to_string(&path).unwrap() == printed,
        "boards/gains.toml is not what the table prints: refresh it"
    );
}

/// Every dotted key that a string in the source names exists, so that no advice points at a key that does not.
#[test]
fn every_key_that_a_message_names_exists() {
    let mut keys = Vec::new();
    add_keys(<Board as Check>::TABLE.unwrap(), "", &mut keys);
    add_keys(<Gains as Check>::TABLE.unwrap(), "", &mut keys);
    add_keys(<Calibration as Check>::TABLE.unwrap(), "", &mut keys);
    let keys: BTreeSet<String> = keys.into_iter().map(|k| k.replace("[]", "")).collect();
    let tables: BTreeSet<&str> = keys.iter().filter_map(|k| k.split('.').next()).collect();
    let mut named = 0;
    for path in sources(&repo("src")) {
        // the plant's own messages name its keys below [plant]
        if path.starts_with(repo("src/simulation")) {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let product = text.split("#[cfg(test)]").next().unwrap();
        for line in product
            .lines()
            .filter(|l| !l.trim_start().starts_with("//"))
        {
            for string in line.split('"').skip(1).step_by(2) {
                for word in string.split(|c: char| {
                    !(c.is_ascii_lowercase() || c.is_ascii_digit() || "_.[]".contains(c))
                }) {
                    let key = word.trim_matches('.').replace("[]", "");
                    let file = [".toml", ".rs", ".d", ".conf"]
                        .iter()
                        .any(|end| key.ends_with(end));
                    if !key.contains('.')
                        || file
                        || !tables.contains(key.split('.').next().unwrap())
                    {
                        continue;
                    }
                    named += 1;
                    // a key that is completed at run time is named by its table
                    let known = keys.iter().any(|k| {
                        *k == key || k.starts_with(&format!("{key}.")) || key.starts_with("plant.")
                    });
                    assert!(known, "{}: `{word}` is not a key: {string}", path.display());
                }
            }
        }
    }
    assert!(named > 40, "{named}");
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path());
    entries
        .flat_map(|p| if p.is_dir() { sources(&p) } else { vec![p] })
        .filter(|p| p.extension().is_some_and(|e| e == "rs"))
        .collect()
}

/// The board with one line replaced, and the number of that line.
fn with(name: &str, old: &str, nth: usize, new: &str) -> (String, usize) {
    let text = text(name);
    let line = text
        .lines()
        .enumerate()
        .filter(|(_, l)| *l == old)
        .nth(nth)
        .unwrap_or_else(|| panic!("`{old}`"))
        .0;
    let lines: Vec<&str> = text
        .lines()
        .enumerate()
        .map(|(n, l)| if n == line { new } else { l })
        .collect();
    (lines.join("\n") + "\n", line + 1)
}

#[test]
fn contradictions_are_refused_with_their_place() {
    let valve = "# relief_valve_kpa is left out.";
    let cases: [(&str, usize, &str, &[&str]); 21] = [
        (
            valve,
            0,
            "relief_valve_kpa = 41.0",
            &[
                "safety.relief_valve_kpa",
                "41 kPa leaks below limits.pressure_max_kpa = 41.3 kPa",
            ],
        ),
        (
            valve,
            0,
            "relief_valve_kpa = 90.0",
            &[
                "safety.relief_valve_kpa",
                "90 kPa never opens",
                "86 kPa at most",
            ],
        ),
        (
            "dir = 24",
            0,
            "dir = 17",
            &[
                "pins.channels[2].dir",
                "line 17 is already pins.channels[1].step",
                "its own line",
            ],
        ),
        (
            "enable = 5",
            2,
            "enable = 27",
            &[
                "pins.channels[3].enable",
                "line 27 is already pins.channels[2].step",
            ],
        ),
        (
            "step = 22",
            0,
            "step = 28",
            &[
                "pins.channels[3].step",
                "the header has no GPIO 28",
                "2 to 27",
            ],
        ),
        (
            "step = 17",
            0,
            "step = 1",
            &["pins.channels[1].step", "identification EEPROM"],
        ),
        (
            "step = 17",
            0,
            "step = 3",
            &["pins.channels[1].step", "SDA or SCL of /dev/i2c-1"],
        ),
        ("step = 17", 0, "step = -1", &["-1"]),
        (
            "# [pins.channels.home] is left out.",
            0,
            "home = { pin = 27 }",
            &[
                "pins.channels[2].step",
                "line 27 is already pins.channels[1].home.pin",
            ],
        ),
        (
            "# ms is left out.",
            0,
            "ms = [6, 13, 6]",
            &[
                "pins.channels[1].ms[3]",
                "line 6 is already pins.channels[1].ms[1]",
            ],
        ),
        (
            "priority = 80",
            0,
            "priority = 74",
            &[
                "machine.imu_priority",
                "75 is not below stepper.priority = 74",
            ],
        ),
        (
            "speed_max_mm_s = 30.0",
            0,
            "speed_max_mm_s = 150.0",
            &[
                "stepper.step_interval_min_us",
                "200 must be at most 176.7",
                "lower it",
            ],
        ),
        (
            "acceleration_max_mm_s2 = 600.0",
            0,
            "acceleration_max_mm_s2 = 14.0",
            &["limits.travel_mm", "a stop from full speed takes"],
        ),
        (
            "holding_torque_n_mm = 260.0",
            0,
            "holding_torque_n_mm = 120.0",
            &["power.holding_torque_n_mm", "125 N·mm", "stronger motor"],
        ),
        (
            "pressure = \"relax\"",
            0,
            "pressure = \"float\"",
            &["float", "hold", "relax", "release"],
        ),
        (
            "method = \"operator\"",
            0,
            "method = \"switches\"",
            &["homing.method", "channel 1 has none"],
        ),
        (
            "lead_ms = 4.0",
            0,
            "lead_ms = 1.0",
            &["stepper.lead_ms", "less than one turn of the loop, 2 ms"],
        ),
        (
            "address = 104",
            0,
            "address = 0x42",
            &[
                "imu.chip.address",
                "66 is not 104 or 105",
                "104 (0x68) or 105 (0x69)",
            ],
        ),
        (
            "part = \"icm20948\"",
            0,
            "part = \"bno055\"",
            &["bno055", "icm20948"],
        ),
        (
            "microsteps = 16",
            0,
            "microstep = 16",
            &["`drive.microstep` is not a known key", "microsteps"],
        ),
        (
            "pulse_high_us = 2.0",
            0,
            "pulse_high_us = 0.5",
            &["stepper.pulse_high_us", "0.5", "1 to 1000 µs"],
        ),
    ];
    for (old, nth, new, words) in cases {
        let (text, line) = with("pi4", old, nth, new);
        let error = source::parse::<Board>("b.toml", &text).expect_err(new);
        let miette_help = format!(
            "{error} {}",
            miette::Diagnostic::help(&error).map_or(String::new(), |h| h.to_string())
        );
        for w in words {
            assert!(miette_help.contains(w), "`{w}` is not in: {miette_help}");
        }
        // the line that was changed, unless the other half of a contradiction is named
        let told: usize = error
            .to_string()
            .split("line ")
            .nth(1)
            .unwrap()
            .split(':')
            .next()
            .unwrap()
            .parse()
            .unwrap();
        let changed = new.split(' ').next().unwrap();
        assert!(
            told > 1 && (told == line || !words[0].split(['.', '[']).any(|part| part == changed)),
            "{error}: line {line} was changed"
        );
    }
}

/// Only something outside the program counts: relief valves, or a motor that is too weak.
#[test]
fn a_board_whose_motor_can_exceed_the_pressure_limit_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let checked = |text: &str| {
        let path = folder.path().join("board.toml");
        std::fs::write(&path, format!("base = \"pi4\"\n{text}")).unwrap();
        let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
            .args(["board", "check"])
            .arg(&path)
            .output()
            .unwrap();
        (
            out.status.code().unwrap(),
            String::from_utf8_lossy(&out.stdout).into_owned(),
        )
    };
    let (code, said) = checked("");
    assert!(
        code == 1
            && said
                .contains("the motor makes 86 kPa, more than safety.pressure_max_kpa = 41.3 kPa"),
        "{said}"
    );
    let (code, said) = checked("[safety]\nrelief_valve_kpa = 50.0\n");
    assert!(
        code == 0 && said.contains("relief valves that open at 50 kPa"),
        "{said}"
    );
    // 124.5 N·mm hold 41.3 kPa and 126 N·mm stall at 41.8 kPa
    let (code, said) =
        checked("[power]\nholding_torque_n_mm = 126.0\n[safety]\npressure_max_kpa = 42.0\n");
    assert!(
        code == 0 && said.contains("bounded by the motor, which makes 41.8 kPa"),
        "{said}"
    );
    let (code, said) = checked("[pressure]\n");
    assert!(
        code == 0 && said.contains("pressure sensors, which trip the gate at 41.3 kPa"),
        "{said}"
    );
    let sim = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(["board", "check", "sim"])
        .status()
        .unwrap();
    assert!(sim.success(), "a simulated machine makes no pressure");

    let doctor = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(["doctor", "--board"])
        .arg(repo("boards/pi4.toml"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&doctor.stdout);
    assert!(
        said.contains("WARN  pressure") && said.contains("safety.relief_valve_kpa"),
        "{said}"
    );
}

#[test]
fn pressure_sensors_need_addresses_of_their_own_and_a_sufficient_range() {
    for (text, words) in [
        (
            "addresses = [24, 40, 24]",
            "pressure.addresses[3]: 0x18 on /dev/i2c-1 is already pressure.addresses[1]",
        ),
        (
            "addresses = [24, 40, 104]",
            "pressure.addresses[3]: 0x68 on /dev/i2c-1 is already imu.chip.address",
        ),
        (
            "high_kpa = 40.0",
            "pressure.high_kpa: -100 to 40 kPa does not contain ±safety.pressure_max_kpa = ±41.3 kPa",
        ),
    ] {
        let error =
            source::parse::<Board>("b.toml", &format!("base = \"pi4\"\n[pressure]\n{text}\n"))
                .unwrap_err()
                .to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn lines_of_the_bus_have_no_other_use() {
    let (text, _) = with("pi4", "bus_lines = [2, 3]", 0, "bus_lines = [27, 3]");
    let error = source::parse::<Board>(
        "b.toml",
        &text.replace("bus = \"/dev/i2c-1\"", "bus = \"/dev/i2c-3\""),
    )
    .unwrap_err();
    let said = error.to_string();
    assert!(
        said.contains("imu.bus_lines[1]: line 27 is already pins.channels[2].step"),
        "{said}"
    );
}

#[test]
fn two_sensors_at_one_address_are_refused() {
    let text = text("pi4") + "[base_imu]\n[base_imu.chip]\npart = \"icm20948\"\naddress = 104\n";
    let error = source::parse::<Board>("b.toml", &text)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("base_imu.chip.address: 0x68 on /dev/i2c-1 is already the tip's IMU"),
        "{error}"
    );
    assert!(
        error.contains(&format!("line {}", text.lines().count())),
        "{error}"
    );
}

#[test]
fn evaluate_says_clearly_that_a_hardware_board_has_no_plant() {
    for name in hardware() {
        let board = repo(&format!("boards/{name}.toml"));
        let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
            .args(["evaluate", "--board"])
            .arg(&board)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&out.stderr).replace(['\n', '│'], " ");
        let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(out.status.code(), Some(2), "{said}");
        assert!(
            said.contains("has no [plant] table") && said.contains("--plant"),
            "{said}"
        );
    }
}

/// `REFRESH=1 cargo test --test program boards::the_wiring` draws it anew.
#[test]
fn the_wiring_in_the_documents_is_that_of_the_board() {
    let drawn = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(["board", "draw"])
        .arg(repo("boards/pi4.toml"))
        .output()
        .unwrap()
        .stdout;
    let picture = repo("docs/wiring.svg");
    if std::env::var_os("REFRESH").is_some() {
        std::fs::write(&picture, &drawn).unwrap();
    }
    assert!(
        drawn.starts_with(b"<svg") && std::fs::read(&picture).unwrap() == drawn,
        "docs/wiring.svg is not what the program draws"
    );
}
