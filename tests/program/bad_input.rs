//! Bad input over every command: exit code 2 and one message that names the place and the mend. The snapshot holds all of them.

use crate::common::flat;
use std::fmt::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

/// Files that the cases name. They are read in an empty folder, so that the messages do not depend on it.
const FILES: [(&str, &str); 45] = [
    ("empty.csv", ""),
    ("other.csv", "a,b\n1,2\n"),
    ("no-rows.csv", "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n"),
    (
        "text.csv",
        "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n0,0,20,5,10\n10,0,long,1,10\n",
    ),
    (
        "far.csv",
        "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n0,0,20,5,10\n400,0,20,1,10\n",
    ),
    (
        "cut.csv",
        "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n0,0,20,5,10\n10,0,2",
    ),
    (
        "clock.csv",
        "time_s,piston1_mm,piston2_mm,piston3_mm\n0,0,0,0\n0.1,0,0,0\n0.1,0,0,0\n",
    ),
    (
        "words.csv",
        "time_s,piston1_mm,piston2_mm,piston3_mm\n0,0,0,0\n0.1,0,zero,0\n",
    ),
    ("pistons.csv", "time_s,piston1_mm,piston2_mm\n0,0,0\n"),
    ("damaged.csv.gz", "\u{1f}not gzip"),
    (
        "type.calib.toml",
        "[transmission]\nk_epsilon = [2.22, \"a\", 2.21]\nk_lambda_mm = [0.87, 0.92, 0.81]\n",
    ),
    (
        "two.calib.toml",
        "[transmission]\nk_epsilon = [2.22, 2.21]\nk_lambda_mm = [0.87, 0.92, 0.81]\n",
    ),
    (
        "one.calib.toml",
        "[transmission]\nk_epsilon = 2\nk_lambda_mm = [0.87, 0.92, 0.81]\n",
    ),
    (
        "typo.calib.toml",
        "[transmission]\nk_epsilom = [2.22, 2.2, 2.21]\nk_lambda_mm = [0.87, 0.92, 0.81]\n",
    ),
    ("open.calib.toml", "[transmission\n"),
    ("number.calib.toml", "transmission = 3\n"),
    (
        "half.calib.toml",
        "[transmission]\nk_epsilon = [2.22, 2.2, 2.21]\n",
    ),
    (
        "twice.calib.toml",
        "[transmission]\nk_epsilon = [2, 2, 2]\nk_epsilon = [2, 2, 2]\nk_lambda_mm = [0.8, 0.8, 0.8]\n",
    ),
    (
        "range.calib.toml",
        "[transmission]\nk_epsilon = [2.2, 2.2, 2.2]\nk_lambda_mm = [0.9, 0.9, -0.1]\n",
    ),
    ("bus.toml", "base = \"pi4\"\n[imu]\nbus = 3\n"),
    (
        "chip.toml",
        "base = \"pi4\"\n[imu.chip]\npart = \"bno055\"\n",
    ),
    (
        "channel.toml",
        "base = \"pi4\"\n[[pins.channels]]\nstep = 17\n",
    ),
    ("base.toml", "base = \"pi9\"\n"),
    ("loop.toml", "base = \"loop.toml\"\n"),
    ("whole.toml", "base = \"pi4\"\n[service]\npriority = 1.5\n"),
    (
        "word.toml",
        "base = \"pi4\"\n[homing]\nmethod = \"switch\"\n",
    ),
    ("travel.toml", "base = \"pi4\"\n[limits]\ntravel_mm = -3\n"),
    ("cpu.toml", "base = \"pi4\"\n[stepper]\ncpu = -1\n"),
    ("effect.toml", "base = \"sim\"\n[plant.effects.leek]\n"),
    (
        "flag.toml",
        "base = \"pi4\"\n[imu]\nmount_deg = [true, 1, 2]\n",
    ),
    ("step.toml", "base = \"pi4\"\n[drive]\nmicrosteps = 5\n"),
    ("bare.toml", "[geometry]\ntriangle_side_mm = 7.0\n"),
    ("text.gains.toml", "[loop]\nki_1_s = \"100 ms\"\n"),
    ("range.gains.toml", "[loop]\nki_1_s = 10000\n"),
    ("part.model.toml", "schema = 1\nsource = \"x\"\n"),
    ("map.toml", "every = 0\noutput = \"y\"\n"),
    ("one-row.path.csv", "t_s,bend_deg,dir_deg\n0,30,0\n"),
    (
        "clock.path.csv",
        "t_s,bend_deg,dir_deg\n0,30,0\n1,30,90\n1,30,180\n",
    ),
    ("far.path.csv", "t_s,bend_deg,dir_deg\n0,30,0\n1,120,0\n"),
    ("no-flight.csv", "time_s\n"),
    ("garbage.mcap", "not an MCAP file\n"),
    ("empty.mcap", ""),
    ("good.token", "0123456789abcdef\n"),
    ("short.token", "secret\n"),
    ("open.token", "0123456789abcdef\n"),
];

/// Command lines, one or more for each command.
const CASES: &[&str] = &[
    "",
    "evaluat",
    "bend",
    "bend sixty",
    "bend nan",
    "bend 400",
    "bend 30 --toward up",
    "bend 30 --speed -1",
    "bend 30 --length 0.02",
    "arm now",
    "disarm --now",
    "hold 3",
    "stop 1",
    "relax --speed 3",
    "zero --bent",
    "reset-fault 4",
    "reload gains.toml",
    "status --watsh",
    "monitor",
    "monitor missing.mcap",
    "monitor garbage.mcap",
    "monitor garbage.mcap --speed 0",
    "monitor garbage.mcap --socket x.sock",
    "monitor --speed 2",
    "stream 30 40",
    "subscribe --rate 0",
    "page --listen localhost",
    "page --listen 127.0.0.1:99999",
    "page --listen 0.0.0.0:8088",
    "page --listen 192.0.2.1:8088 --token-file good.token",
    "page --token-file short.token",
    "page --token-file empty.csv",
    "page --token-file open.token",
    "page --token-file folder",
    "page --token-file nowhere/page.token",
    "page --rate 50",
    "record",
    "record begin",
    "play",
    "play folder",
    "play missing.csv",
    "play empty.csv",
    "play other.csv",
    "play no-rows.csv",
    "play text.csv",
    "play far.csv",
    "play cut.csv",
    "evaluate --calib folder",
    "evaluate --calib missing.toml",
    "evaluate --calib binary.toml",
    "evaluate --calib type.calib.toml",
    "evaluate --calib two.calib.toml",
    "evaluate --calib one.calib.toml",
    "evaluate --calib typo.calib.toml",
    "evaluate --calib open.calib.toml",
    "evaluate --calib number.calib.toml",
    "evaluate --calib half.calib.toml",
    "evaluate --calib twice.calib.toml",
    "evaluate --calib range.calib.toml",
    "evaluate --gains text.gains.toml",
    "evaluate --gains range.gains.toml",
    "evaluate --board bare.toml",
    "evaluate --arms open",
    "evaluate --live",
    "evaluate --track no-rows.csv",
    "evaluate --track one-row.path.csv",
    "evaluate --track clock.path.csv --live",
    "evaluate --track far.path.csv",
    "evaluate --track none.path.csv",
    "evaluate --seed -1",
    "evaluate --plant ./plant",
    "evaluate --json folder",
    "evaluate --html nowhere/page.html",
    "board show bus.toml",
    "board show chip.toml",
    "board show channel.toml",
    "board show base.toml",
    "board show loop.toml",
    "board show whole.toml",
    "board show word.toml",
    "board show cpu.toml",
    "board show effect.toml",
    "board show flag.toml",
    "board show bus.toml --gains",
    "board show pi9",
    "board check step.toml",
    "doctor --board travel.toml",
    "release --board folder",
    "jog",
    "jog --board sim.toml --channel 4 --mm 1",
    "jog --board sim.toml --channel 1 --mm 50",
    "home --board folder",
    "commission --board missing.toml",
    "commission --board pi4.toml --stroke 20",
    "bench rt --seconds 0",
    "bench rt --rate fast",
    "calibrate transmission --short --accept",
    "calibrate imu mag",
    "calibrate imu spin rest.csv",
    "calibrate imu gyro missing.csv --out tip.toml",
    "imu score",
    "imu score other.csv",
    "imu score missing.csv",
    "imu score other.csv --filter kalman",
    "gap diagnose",
    "gap diagnose folder",
    "gap diagnose missing.csv",
    "gap diagnose clock.csv",
    "gap diagnose words.csv",
    "gap diagnose pistons.csv",
    "gap diagnose damaged.csv.gz",
    "gap diagnose other.csv --map map.toml",
    "gap check part.model.toml other.csv",
    "gap check missing.toml other.csv",
    "gap excite",
    "gap excite --out folder",
    "gap excite --out nowhere/schedule.csv",
    "gap exam --every few",
    "replay folder",
    "replay missing.csv",
    "replay no-flight.csv",
    "replay garbage.mcap",
    "replay empty.mcap",
    "replay empty.mcap --filter kalman",
    "log",
    "log info folder",
    "log info missing.mcap",
    "log info garbage.mcap",
    "log export garbage.mcap --csv out.csv",
    "log export garbage.mcap",
    "log export garbage.mcap --parquet empty.csv",
    "log export garbage.mcap --parquet garbage.mcap",
    "log cut garbage.mcap --out cut.mcap",
    "log cut garbage.mcap --from 3 --to 2 --out cut.mcap",
    "log cut garbage.mcap --from long --out cut.mcap",
    "drill --kills many",
    "drill --soak long",
    "run --board missing.toml",
    "run --calib type.calib.toml",
    "run --fast --board pi4.toml",
    "completions tcsh",
    "man nowhere",
];

#[test]
fn every_bad_input_ends_with_code_2_and_one_message() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    for (name, text) in FILES {
        std::fs::write(file(name), text).unwrap();
    }
    std::fs::write(file("damaged.csv.gz"), [0x1f, 0x8b, 8, 0, 1, 2, 3]).unwrap();
    std::fs::write(file("binary.toml"), [0xff, 0xfe, 0]).unwrap();
    std::fs::create_dir(file("folder")).unwrap();
    for (name, mode) in [
        ("empty.csv", 0o600),
        ("good.token", 0o600),
        ("short.token", 0o600),
        ("open.token", 0o644),
    ] {
        std::fs::set_permissions(file(name), std::fs::Permissions::from_mode(mode)).unwrap();
    }
    for board in ["sim.toml", "pi4.toml"] {
        std::fs::copy(
            Path::new(env!("CARGO_MANIFEST_DIR"))
                .join("boards")
                .join(board),
            file(board),
        )
        .unwrap();
    }
    let mut all = String::new();
    for case in CASES {
        let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
            .args(case.split_whitespace())
            .current_dir(folder.path())
            // no service, whoever runs the tests
            .env("XDG_RUNTIME_DIR", folder.path())
            .env("HOME", folder.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        let (stdout, stderr) = (
            String::from_utf8_lossy(&out.stdout),
            String::from_utf8_lossy(&out.stderr),
        );
        let message = flat(&stderr);
        assert_eq!(out.status.code(), Some(2), "{case}: {stderr}");
        assert!(stdout.is_empty() && !message.is_empty(), "{case}: {stdout}");
        assert!(stderr.matches("error: ").count() <= 1, "{case}: {stderr}");
        for internal in [
            "os error", "f64", "struct ", "panicked", "literal", "usize", "line 0",
        ] {
            assert!(
                !message.contains(internal),
                "{case}: `{internal}` is not a word of the user: {message}"
            );
        }
        // a help page is not a message
        let message = if case.is_empty() {
            message.split(" Move:").next().unwrap().to_owned()
        } else {
            message
        };
        let _ = writeln!(all, "$ retroflex {case}\n  {message}");
    }
    insta::assert_snapshot!(all);
}
