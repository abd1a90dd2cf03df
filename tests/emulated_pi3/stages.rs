//! What is asked of the machine before the service runs on it: files, the I²C controller, pins.

use super::chips;
use super::service::Scene;

/// Kernel, systemd and the files that the project installs.
pub fn machine(scene: &mut Scene) {
    let took_s = scene.guest.ready(300.0);
    let about = scene.guest.run("udevadm settle; uname -r; systemctl --version | head -1; tr -d '\\0' </proc/device-tree/model");
    scene.verdicts.say(&format!(
        "booted in {took_s:.0} s of the host's: {}",
        about.text.replace('\n', ", ")
    ));
    scene.verdicts.says(
        "it is a Raspberry Pi 3",
        &about.text,
        &["arm64", "systemd 2", "Raspberry Pi 3 Model B"],
    );
    let user = scene.guest.run("id retroflex; stat -c '%n %G %a' /dev/gpiochip0 /dev/i2c-1; stat -c '%n %a' /etc/retroflex").text;
    let words = [
        "retroflex",
        "(i2c)",
        "(gpio)",
        "/dev/gpiochip0 gpio 660",
        "/dev/i2c-1 i2c 660",
        "/etc/retroflex 755",
    ];
    scene.verdicts.says(
        "user, groups and permissions are as sysusers, udev rules and tmpfiles say",
        &user,
        &words,
    );
    let loaded = scene
        .guest
        .run("systemd-analyze verify /etc/systemd/system/retroflex.service && echo sound")
        .text;
    scene
        .verdicts
        .hold("the unit is sound", loaded == "sound", &loaded);
}

/// A board file of the guest with another sensor section.
fn sensor(scene: &mut Scene, name: &str, chip: &str) -> String {
    let path = format!("/run/{name}.toml");
    let cut = format!(
        "sed '/^\\[imu\\]/,$d' /etc/retroflex/board.toml >{path}; printf '[imu]\\n[imu.chip]\\n{chip}\\n' >>{path}"
    );
    assert_eq!(scene.guest.run(&cut).code, 0);
    path
}

/// The real I²C controller, i2c-bcm2835: who answers, who does not, and a sensor that is read and judged.
pub fn controller(scene: &mut Scene) {
    let driver = scene
        .guest
        .run("readlink /sys/class/i2c-adapter/i2c-1/device/driver")
        .text;
    scene.verdicts.says(
        "/dev/i2c-1 is the controller of the chip",
        &driver,
        &["i2c-bcm2835"],
    );
    let st = format!(
        "part = \"lsm6dso_lis2mdl\"\\naddress = {}\\nrate_hz = 50.0",
        chips::LSM6DSO
    );
    let cases = [
        (
            "nobody",
            format!("part = \"icm20948\"\\naddress = {}", 0x68),
            "ICM-20948 at 0x68 does not answer",
        ),
        (
            "nobody",
            st.replace(&chips::LSM6DSO.to_string(), &chips::NOBODY.to_string()),
            "LSM6DSO at 0x6b does not answer",
        ),
        (
            "impostor",
            format!("part = \"icm20948\"\\naddress = {}", chips::IMPOSTOR),
            "WHO_AM_I at 0x69 is 0x71",
        ),
    ];
    for (name, chip, words) in cases {
        let board = sensor(scene, name, &chip);
        let done = scene.retroflex(&format!("run --board {board}"));
        let what = format!("exit code 3 and words: {words}");
        scene.verdicts.hold(
            &what,
            done.code == 3 && done.flat().contains(words),
            &format!("exit {}: {}", done.code, done.flat()),
        );
    }
    let board = sensor(scene, "static", &st);
    let done = scene.retroflex(&format!("doctor --board {board}"));
    scene.verdicts.says(
        "doctor finds the sensor through the controller",
        &done.flat(),
        &["LSM6DSO at 0x6a, 52 Hz"],
    );
    // a sensor whose numbers never change is read, and not believed
    let own = "mkdir -p /run/systemd/system/retroflex.service.d && printf '[Service]\\nExecStart=\\nExecStart=/usr/bin/retroflex run --board /run/static.toml\\n' >/run/systemd/system/retroflex.service.d/static.conf && systemctl daemon-reload && systemctl start retroflex";
    let started = scene.guest.run(own);
    scene.verdicts.hold(
        "the service starts on the controller",
        started.code == 0,
        &format!("{} {}", started.code, started.text),
    );
    let status = scene.until(60.0, |s| {
        s["sensor"]["active"].to_string().contains("frozen")
    });
    let found = format!(
        "mode {}, in force {}",
        status["mode"], status["sensor"]["active"]
    );
    let holds =
        status["mode"] == "aligning" && status["sensor"]["active"].to_string().contains("frozen");
    scene.verdicts.hold(
        "a sensor whose numbers never change is called frozen, and nothing is aligned on it",
        holds,
        &found,
    );
    scene.guest.run("systemctl stop retroflex; rm /run/systemd/system/retroflex.service.d/static.conf; systemctl daemon-reload");
}

/// One piston by hand, and the registers.
pub fn pins(scene: &mut Scene) {
    let before = scene.tip.lines_at_rest();
    let done = scene.retroflex(
        "jog --board /etc/retroflex/board.toml --channel 2 --mm -2 --speed 4 --hold 0.2",
    );
    let lines = scene.tip.lines_at_rest();
    let made: Vec<u64> = lines
        .pulses
        .iter()
        .zip(before.pulses)
        .map(|(a, b)| a - b)
        .collect();
    scene.verdicts.hold(
        "a jog of 68 steps and back is 136 pulses on its line",
        made == [0, 136, 0],
        &format!("{made:?}, exit {}", done.code),
    );
    scene.verdicts.says(
        "and the program says so",
        &done.flat(),
        &["(-68 steps)", "(0 steps)"],
    );
    let outputs = lines.named().into_iter().all(|l| lines.is_output(l));
    scene.verdicts.hold(
        "all lines of the board are outputs",
        outputs,
        &format!("GPFSEL {:#x?}", lines.select),
    );
    let counts = (lines.counted, lines.lost, lines.torn, lines.energised());
    scene.verdicts.hold(
        "no step without current, none torn, no current left",
        counts == ([0; 3], 0, 0, false),
        &format!("{counts:?}"),
    );
}
