//! The program on an emulated Raspberry Pi: pins, bus, permissions.

use crate::common::{flat, repo};
use crate::pi::{
    chip_board, on_a_shared_host, registers::Registers, rig::on_a_pi, run, server::ADDRESS,
    variant, world,
};

#[test]
fn pulses_through_the_device_file_are_counted_one_by_one() {
    on_a_pi(world("linux-gpiochip"), |rig| {
        let board = chip_board(rig);
        let (code, out, err) = run(
            rig,
            &[
                "bench",
                "rt",
                "--board",
                &board,
                "--rate",
                "4000",
                "--seconds",
                "3",
            ],
        );
        println!("{out}\n{err}");
        // a busy computer may be late, and then the answer is no; what is counted is right either way
        let good = out.contains(" 0 underruns") && !out.contains("FAULT");
        assert_eq!(code, i32::from(!good));
        let world = rig.world();
        assert!(world.chip.pulses > 20_000, "{}", world.chip.pulses);
        let told = out
            .split("steps in")
            .next()
            .unwrap()
            .split_whitespace()
            .last()
            .unwrap();
        assert_eq!(told.parse::<u64>().unwrap(), world.chip.pulses);
        // the bench never energises the drivers
        assert_eq!(
            (world.chip.lost, world.chip.counted, world.chip.torn),
            (world.chip.pulses, [0; 3], 0)
        );
    });
}

#[test]
fn a_jog_is_counted_exactly_and_leaves_no_current() {
    on_a_pi(world("linux-gpiochip"), |rig| {
        let board = chip_board(rig);
        let args = [
            "jog",
            "--board",
            &board,
            "--channel",
            "2",
            "--mm",
            "-4",
            "--speed",
            "8",
            "--hold",
            "0.2",
        ];
        let (code, out, err) = run(rig, &args);
        println!("{out}\n{err}");
        assert_eq!(code, 0);
        assert!(
            out.contains("(-136 steps)") && out.contains("now at 0.000 mm (0 steps)"),
            "{out}"
        );
        let chip = &rig.world().chip;
        // 136 out, 136 back, and none on the others
        assert_eq!(
            (chip.pulses, chip.counted, chip.lost, chip.torn),
            (272, [0; 3], 0, 0)
        );
        assert!(!chip.energised());
    });
}

#[test]
fn hardware_that_is_not_there_is_exit_code_3_with_words() {
    on_a_pi(world("linux-gpiochip"), |rig| {
        let board = repo("boards/linux-gpiochip.toml")
            .to_str()
            .unwrap()
            .to_owned();
        let jog = |board: &str, words: &[&str]| {
            let (code, _, err) = run(
                rig,
                &["jog", "--board", board, "--channel", "1", "--mm", "1"],
            );
            let said = flat(&err);
            println!("{said}");
            assert_eq!(code, 3, "{said}");
            words
                .iter()
                .for_each(|w| assert!(said.contains(w), "`{w}` is not in: {said}"));
        };
        // what a jog cannot open, the doctor does not pass
        let doctor = |board: &str, words: &[&str]| {
            let said = flat(&run(rig, &["doctor", "--board", board]).1);
            println!("{said}");
            assert!(said.contains("FAIL pins"), "{said}");
            words
                .iter()
                .for_each(|w| assert!(said.contains(w), "`{w}` is not in: {said}"));
        };
        let chip = "chip = \"/dev/gpiochip0\"";
        for (label, path, words) in [
            ("pinctrl-rp1", "/dev/gpiochip0", &["\"pinctrl-rp1\""][..]),
            (
                "pinctrl-bcm9",
                "/dev/gpiochip0",
                &["\"pinctrl-bcm9\"", "pins.chip_label"],
            ),
            ("", "/dev/gpiochip9", &["no GPIO chip at /dev/gpiochip9"]),
            ("", "/dev/zero", &["/dev/zero is not a GPIO chip"]),
        ] {
            let (other, label) = (
                format!("chip = \"{path}\""),
                format!("chip_label = \"{label}\""),
            );
            let keys = [(chip, other.as_str()), ("chip_label = \"\"", &label)];
            let board = variant(rig, "linux-gpiochip", &keys);
            jog(&board, words);
            doctor(&board, words);
        }
        rig.world().chip.held.insert(27, "spi0 CS1");
        jog(
            &board,
            &["GPIO 27 is in use by \"spi0 CS1\"", "choose another pin"],
        );
        rig.world().chip.held.clear();
        jog(
            &variant(
                rig,
                "linux-gpiochip",
                &[("chip = \"/dev/gpiochip0\"", "chip = \"/dev/gpiochip7\"")],
            ),
            &["no GPIO chip at /dev/gpiochip7"],
        );
        jog(
            &variant(
                rig,
                "linux-gpiochip",
                &[("chip = \"/dev/gpiochip0\"", "chip = \"/dev/null\"")],
            ),
            &["/dev/null is not a GPIO chip"],
        );
        jog(
            &variant(rig, "linux-gpiochip", &[("step = 22", "step = 60")]),
            &["has no line 60, only 0 to 53"],
        );
        rig.world().chip.stuck.insert(5, true);
        jog(
            &board,
            &[
                "EN on GPIO 5 stays high when driven low",
                "do not rely on the emergency stop",
            ],
        );
        rig.world().chip.stuck.clear();

        let commission = |board: &str, words: &[&str]| {
            let (code, _, err) = run(rig, &["commission", "--board", board, "--hold", "0"]);
            let said = flat(&err);
            println!("{said}");
            assert_eq!(code, 3, "{said}");
            words
                .iter()
                .for_each(|w| assert!(said.contains(w), "`{w}` is not in: {said}"));
        };
        commission(
            &variant(
                rig,
                "linux-gpiochip",
                &[("bus = \"/dev/i2c-1\"", "bus = \"/dev/i2c-9\"")],
            ),
            &["no I²C bus at /dev/i2c-9", "dtparam=i2c_arm=on"],
        );
        commission(
            &variant(rig, "linux-gpiochip", &[("address = 104", "address = 105")]),
            &["ICM-20948 at 0x69 does not answer", "i2cdetect"],
        );
        rig.world()
            .bus
            .chips
            .spoil(ADDRESS, |q| q.wrong_id = Some(0x71));
        commission(&board, &["WHO_AM_I at 0x68 is 0x71", "imu.chip.part"]);
        rig.world().bus.chips.spoil(ADDRESS, |q| q.wrong_id = None);
        rig.world().bus.hangs = true;
        commission(&board, &["/dev/i2c-1 hangs", "cycle the power of the IMU"]);
        rig.unhang();
    });
}

#[test]
fn a_user_without_permission_is_told_the_device_and_its_group() {
    on_a_pi(world("linux-gpiochip"), |rig| {
        let stranger = |command: &str, board: &str, more: &[&str], words: &[&str]| {
            let text = std::fs::read_to_string(repo(&format!("boards/{board}.toml"))).unwrap();
            let out = rig
                .command_of_a_stranger(command, &text)
                .unwrap()
                .args(more)
                .output()
                .unwrap();
            let said = flat(&String::from_utf8_lossy(&out.stderr));
            println!("{said}");
            assert_eq!(out.status.code(), Some(3), "{said}");
            words
                .iter()
                .for_each(|w| assert!(said.contains(w), "`{w}` is not in: {said}"));
        };
        let jog = ["--channel", "1", "--mm", "1"];
        let folder = tempfile::tempdir().unwrap();
        std::fs::set_permissions(
            folder.path(),
            std::os::unix::fs::PermissionsExt::from_mode(0o777),
        )
        .unwrap();
        let (state, socket) = (
            folder.path().join("state"),
            folder.path().join("control.sock"),
        );
        let folders = [
            "--state",
            state.to_str().unwrap(),
            "--socket",
            socket.to_str().unwrap(),
        ];
        rig.world().guarded = Some("i2c-1");
        stranger(
            "run",
            "linux-gpiochip",
            &folders,
            &[
                "no permission for /dev/i2c-1",
                "group i2c",
                "usermod -aG i2c",
            ],
        );
        rig.world().guarded = Some("gpiochip0");
        stranger(
            "jog",
            "linux-gpiochip",
            &jog,
            &[
                "no permission for /dev/gpiochip0",
                "group gpio",
                "usermod -aG gpio",
            ],
        );
        rig.world().guarded = None;
        std::fs::set_permissions(
            "/dev/gpiomem",
            std::os::unix::fs::PermissionsExt::from_mode(0o600),
        )
        .unwrap();
        stranger(
            "jog",
            "pi3",
            &jog,
            &["no permission for /dev/gpiomem", "group gpio"],
        );
    });
}

/// A killed service leaves EN low through `rppal`; `release` takes the current away.
#[test]
fn drivers_that_a_killed_program_left_energised_are_released() {
    on_a_pi(world("pi3"), |rig| {
        let path = std::path::Path::new("/dev/gpiomem");
        // GPIO 5 is an output and low: energised
        let mut memory = vec![0_u8; 4096];
        memory[..4].copy_from_slice(&(1_u32 << 15).to_le_bytes());
        std::fs::write(path, memory).unwrap();
        let registers = Registers::watch(path);
        let (code, out, err) = run(
            rig,
            &[
                "release",
                "--board",
                repo("boards/pi3.toml").to_str().unwrap(),
            ],
        );
        let seen = registers.done();
        assert!(code == 0 && out.contains("drivers released"), "{out} {err}");
        assert!(seen.level >> 5 & 1 == 1, "EN is high");
    });
}

#[test]
fn rppal_writes_the_registers_of_a_raspberry_pi_3() {
    on_a_pi(world("pi3"), |rig| {
        let board = on_a_shared_host(
            rig,
            "pi3",
            "late_max_us = 1000.0",
            "lead_ms = 4.0",
            &[("cpu = 3", "# cpu = 3")],
        );
        // 68 steps out and 68 back, each a store to GPSET0 and one to GPCLR0. A host that stops the watch for a moment hides
        // pulses from it, so that fewer are no answer; more are.
        let seen = (0..4).find_map(|_| {
            let registers = Registers::watch(std::path::Path::new("/dev/gpiomem"));
            let (code, out, err) = run(
                rig,
                &[
                    "jog",
                    "--board",
                    &board,
                    "--channel",
                    "1",
                    "--mm",
                    "2",
                    "--speed",
                    "4",
                    "--hold",
                    "0.1",
                ],
            );
            println!("{out}\n{err}");
            assert_eq!(code, 0);
            assert!(out.contains("(68 steps)"), "{out}");
            let seen = registers.done();
            println!("{} of 136 pulses seen", seen.pulses[17]);
            assert!(seen.pulses[17] <= 136);
            (seen.pulses[17] == 136).then_some(seen)
        });
        let seen = seen.expect("one of four watches sees every pulse");
        // GPIO 5 in GPFSEL0, 17 in GPFSEL1, 22 to 25 and 27 in GPFSEL2: outputs, three bits a line, 001
        let output = |line: u32| 1 << (line % 10 * 3);
        assert_eq!(seen.select[0], output(5));
        assert_eq!(seen.select[1], output(17));
        assert_eq!(
            seen.select[2],
            [22, 23, 24, 25, 27].map(output).iter().sum::<u32>()
        );
        assert_eq!((seen.pulses[27], seen.pulses[22]), (0, 0));
        // EN ends high
        assert!(seen.level >> 5 & 1 == 1 && seen.level >> 17 & 1 == 0);
    });
}

#[test]
fn a_machine_that_is_no_raspberry_pi_is_told_so() {
    on_a_pi(world("pi3"), |rig| {
        std::fs::write("/sys/firmware/devicetree/base/compatible", "acme,board\0").unwrap();
        let (code, _, err) = run(
            rig,
            &[
                "jog",
                "--board",
                repo("boards/pi3.toml").to_str().unwrap(),
                "--channel",
                "1",
                "--mm",
                "1",
            ],
        );
        let said = flat(&err);
        assert_eq!(code, 3, "{said}");
        assert!(
            said.contains("not a Raspberry Pi that rppal supports")
                && said.contains("pins.backend = \"cdev\""),
            "{said}"
        );
    });
}
