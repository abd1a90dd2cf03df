//! A real systemd starts the units as they are shipped: notify, watchdog, restart, state, stop, release after a failure.
//!
//! It is the first process of its own namespaces and has its own unit folder, so it does not touch the machine that
//! the tests run on. The tests need root, `unshare`, systemd and version 2 of control groups; otherwise they print what
//! is missing and are skipped.

use crate::common::repo;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The script that becomes the first process: mounts, a user, then systemd.
const BOOT: &str = r#"
set -e
mount --make-rprivate /
mount -t proc proc /proc
umount -R /sys/fs/cgroup 2>/dev/null || true
mount -t cgroup2 cgroup2 /sys/fs/cgroup
mount -t tmpfs tmpfs /run
mkdir -p /run/rf /run/units
cp -r "$1"/. /run/rf/
cp /etc/passwd /run/rf/passwd; cp /etc/group /run/rf/group
grep -q ^retroflex: /run/rf/passwd || echo 'retroflex:x:64997:64997::/var/lib/retroflex:/usr/sbin/nologin' >> /run/rf/passwd
for g in retroflex:64997 i2c:64998 gpio:64999; do
  grep -q "^${g%%:*}:" /run/rf/group || echo "${g%%:*}:x:${g##*:}:" >> /run/rf/group
done
mount --bind /run/rf/passwd /etc/passwd
mount --bind /run/rf/group /etc/group
mount -t tmpfs tmpfs /var/lib/private 2>/dev/null || true
mkdir -p /run/lib && mount --bind /run/lib /var/lib
mv /run/rf/units/* /run/units/
export container=test SYSTEMD_UNIT_PATH=/run/units
exec /lib/systemd/systemd --system --unit=default.target
"#;

/// The private systemd.
struct Booted {
    outer: Child,
    pid: u32,
}

impl Booted {
    fn enter(&self, args: &[&str]) -> (bool, String) {
        let out = Command::new("nsenter")
            .args(["-t", &self.pid.to_string(), "-m", "-p", "-C", "-u", "-i"])
            .args(args)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&out.stdout).into_owned()
            + &String::from_utf8_lossy(&out.stderr);
        (out.status.success(), text.trim().to_owned())
    }
    fn systemctl(&self, args: &[&str]) -> (bool, String) {
        let mut all = vec!["systemctl"];
        all.extend(args);
        self.enter(&all)
    }
    fn show(&self, property: &str) -> String {
        self.show_of("retroflex", property)
    }
    fn show_of(&self, unit: &str, property: &str) -> String {
        self.systemctl(&["show", unit, "-p", property, "--value"]).1
    }
    fn retroflex(&self, args: &[&str]) -> (bool, String) {
        let mut all = vec!["/run/rf/retroflex"];
        all.extend(args);
        self.enter(&all)
    }
    fn status(&self) -> serde_json::Value {
        let (_, text) = self.retroflex(&["status", "--json"]);
        serde_json::from_str(text.lines().next().unwrap_or("null"))
            .unwrap_or(serde_json::Value::Null)
    }
    fn until(&self, what: &str, holds: impl Fn(&Self) -> bool) -> f64 {
        let begun = Instant::now();
        while !holds(self) {
            assert!(
                begun.elapsed() < Duration::from_secs(30),
                "{what} did not come; {}",
                self.systemctl(&["status", "retroflex", "--no-pager"]).1
            );
            std::thread::sleep(Duration::from_millis(50));
        }
        begun.elapsed().as_secs_f64()
    }
}

impl Drop for Booted {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!(
                "{}",
                self.enter(&["tail", "-n", "40", "/run/rf/retroflex.log"]).1
            );
        }
        // the first process of its namespace takes all others with it
        let _ = Command::new("kill")
            .args(["-9", &self.pid.to_string()])
            .status();
        let _ = self.outer.wait();
    }
}

fn is_root() -> bool {
    std::fs::read_to_string("/proc/self/status")
        .unwrap()
        .lines()
        .any(|l| l.starts_with("Uid:\t0\t"))
}

fn can_boot() -> Result<(), &'static str> {
    if !is_root() {
        return Err("not root");
    }
    if !Path::new("/lib/systemd/systemd").exists() {
        return Err("no /lib/systemd/systemd");
    }
    let tried = Command::new("unshare")
        .args([
            "--mount",
            "--pid",
            "--fork",
            "--cgroup",
            "sh",
            "-c",
            "mount --make-rprivate / && umount -R /sys/fs/cgroup; mount -t cgroup2 none /sys/fs/cgroup",
        ])
        .stderr(Stdio::null())
        .status();
    if tried.is_ok_and(|s| s.success()) {
        Ok(())
    } else {
        Err("no namespace with control groups of its own")
    }
}

fn boot(folder: &Path) -> Booted {
    let units = folder.join("units");
    std::fs::create_dir_all(&units).unwrap();
    std::fs::copy(env!("CARGO_BIN_EXE_retroflex"), folder.join("retroflex")).unwrap();
    std::fs::write(folder.join("pins.toml"), "[pins]\nbackend = \"mock\"\n").unwrap();
    for (unit, command) in [
        ("retroflex", "run"),
        (
            "retroflex-release",
            "release --hold --board /run/rf/pins.toml",
        ),
    ] {
        std::fs::copy(
            repo(&format!("systemd/{unit}.service")),
            units.join(format!("{unit}.service")),
        )
        .unwrap();
        let here = format!(
            "[Service]\nExecStart=\nExecStart=/run/rf/retroflex {command}\nStandardError=append:/run/rf/{unit}.log\n"
        );
        std::fs::create_dir_all(units.join(format!("{unit}.service.d"))).unwrap();
        std::fs::write(units.join(format!("{unit}.service.d/here.conf")), here).unwrap();
    }
    for target in ["default", "basic", "sysinit", "shutdown", "multi-user"] {
        std::fs::write(
            units.join(format!("{target}.target")),
            format!("[Unit]\nDescription={target}\nDefaultDependencies=no\n"),
        )
        .unwrap();
    }
    let log = std::fs::File::create(folder.join("boot.log")).unwrap();
    #[allow(
        clippy::zombie_processes,
        reason = "waited for when `Booted` is dropped"
    )]
    let outer = Command::new("unshare")
        .args([
            "--fork", "--pid", "--mount", "--cgroup", "--uts", "--ipc", "bash", "-c", BOOT, "boot",
        ])
        .arg(folder)
        .stdin(Stdio::null())
        .stdout(log.try_clone().unwrap())
        .stderr(log)
        .spawn()
        .unwrap();
    let children = format!("/proc/{0}/task/{0}/children", outer.id());
    let begun = Instant::now();
    loop {
        let pid = std::fs::read_to_string(&children)
            .ok()
            .and_then(|t| t.split_whitespace().next()?.parse().ok());
        if let Some(pid) = pid {
            let booted = Booted { outer, pid };
            booted.until("systemd", |b| {
                b.systemctl(&["is-system-running"]).1.contains("running")
                    || b.systemctl(&["is-system-running"]).1.contains("degraded")
            });
            return booted;
        }
        assert!(
            begun.elapsed() < Duration::from_secs(10),
            "no first process: {}",
            std::fs::read_to_string(folder.join("boot.log")).unwrap()
        );
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_real_systemd_starts_watches_restarts_and_stops_it() {
    if let Err(why) = can_boot() {
        eprintln!("skipped: {why}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let booted = boot(folder.path());
    let (started, said) = booted.systemctl(&["start", "retroflex"]);
    assert!(
        started,
        "{said}\n{}",
        booted
            .systemctl(&["status", "retroflex", "--no-pager", "-n", "30"])
            .1
    );
    assert_eq!(booted.show("ActiveState"), "active");
    assert_eq!(booted.show("User"), "retroflex");
    booted.until("alignment", |b| b.status()["mode"] == "disarmed");
    booted.until("STATUS", |b| b.show("StatusText").starts_with("disarmed"));
    let grants = booted.status()["real_time"].to_string();
    assert!(grants.contains("SCHED_FIFO"), "{grants}");

    // arm and bend
    assert!(booted.retroflex(&["arm"]).0);
    let (settled, said) = booted.retroflex(&["bend", "40", "--toward", "30", "--wait"]);
    assert!(settled, "{said}");

    // SIGSTOP ends the heartbeat; systemd kills the service and starts it again
    let first = booted.show("MainPID");
    assert!(booted.enter(&["kill", "-STOP", &first]).0);
    let took_s = booted.until("the restart", |b| {
        b.show("NRestarts") == "1" && b.show("ActiveState") == "active"
    });
    assert!((1.0..12.0).contains(&took_s), "{took_s} s");
    assert_ne!(booted.show("MainPID"), first);

    // the simulated plant begins at rest with the service, disarmed
    booted.until("alignment", |b| b.status()["mode"] == "disarmed");
    assert_eq!(booted.status()["counted"], serde_json::json!([0, 0, 0]));

    // a stop of the unit with a bent tip returns to rest first
    assert!(booted.retroflex(&["arm"]).0);
    assert!(booted.retroflex(&["bend", "35", "--wait"]).0);
    let (stopped, said) = booted.systemctl(&["stop", "retroflex"]);
    assert!(stopped, "{said}");
    assert_eq!(
        (
            booted.show("Result").as_str(),
            booted.show("ActiveState").as_str()
        ),
        ("success", "inactive")
    );
    let (_, memory) = booted.enter(&[
        "/run/rf/retroflex",
        "drill",
        "--recall",
        "/var/lib/retroflex",
    ]);
    assert!(
        memory.contains("armed false, steps [0, 0, 0]"),
        "left relaxed: {memory}"
    );
}

/// After the last restart nobody controls the drivers; another unit takes the current away, and ends when the service returns.
#[test]
fn a_service_that_has_failed_for_good_is_followed_by_the_release_of_the_drivers() {
    if let Err(why) = can_boot() {
        eprintln!("skipped: {why}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let booted = boot(folder.path());
    assert!(booted.systemctl(&["start", "retroflex"]).0);
    let state_of_release = |b: &Booted| b.show_of("retroflex-release", "ActiveState");
    for restarts in 0..5 {
        assert_eq!(
            state_of_release(&booted),
            "inactive",
            "after {restarts} restarts"
        );
        booted.until("a start", |b| {
            b.show("NRestarts") == restarts.to_string() && b.show("ActiveState") == "active"
        });
        assert!(booted.enter(&["kill", "-KILL", &booted.show("MainPID")]).0);
    }
    booted.until("the failure", |b| b.show("ActiveState") == "failed");
    booted.until("the release", |b| state_of_release(b) == "active");

    booted.systemctl(&["reset-failed", "retroflex"]);
    assert!(booted.systemctl(&["start", "retroflex"]).0);
    booted.until("the end of the release", |b| {
        state_of_release(b) == "inactive"
    });
    assert_eq!(booted.show_of("retroflex-release", "Result"), "success");
}

/// A bus that is not there when the unit starts: it is waited for without a restart, until the hardware was open once.
#[test]
fn a_unit_whose_bus_comes_late_does_not_give_up() {
    if let Err(why) = can_boot() {
        eprintln!("skipped: {why}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let booted = boot(folder.path());
    let here = "[Service]\nExecStart=\nExecStart=/run/rf/retroflex run --board pi4\n";
    let drop_in = "/run/units/retroflex.service.d/here.conf";
    assert!(
        booted
            .enter(&[
                "bash",
                "-c",
                &format!("printf '{here}' > {drop_in}; systemctl daemon-reload")
            ])
            .0
    );
    booted.systemctl(&["start", "retroflex", "--no-block"]);
    booted.until("its wait", |b| {
        b.show("StatusText").contains("waiting for the hardware")
    });
    std::thread::sleep(Duration::from_secs(9));
    assert_eq!(
        (
            booted.show("ActiveState").as_str(),
            booted.show("NRestarts").as_str()
        ),
        ("activating", "0")
    );
    // hardware that was open before: each failure counts, and in the end the drivers are released
    assert!(booted.enter(&["touch", "/run/retroflex/control.opened"]).0);
    booted.until("the failure", |b| b.show("ActiveState") == "failed");
    booted.until("the release", |b| {
        b.show_of("retroflex-release", "ActiveState") == "active"
    });
}

#[test]
fn the_units_are_hardened() {
    for unit in [
        "systemd/retroflex.service",
        "systemd/retroflex-release.service",
        "systemd/retroflex-page.service",
    ] {
        let out = Command::new("systemd-analyze")
            .args(["security", "--offline=yes"])
            .arg(repo(unit))
            .output();
        let Ok(out) = out else {
            eprintln!("skipped: no systemd-analyze");
            return;
        };
        let text = String::from_utf8_lossy(&out.stdout).into_owned();
        let line = text
            .lines()
            .find(|l| l.contains("Overall exposure level"))
            .unwrap_or_else(|| panic!("{text}"));
        let level: f64 = line
            .split(':')
            .nth(1)
            .and_then(|r| r.split_whitespace().next())
            .and_then(|n| n.parse().ok())
            .unwrap();
        assert!(level <= 1.0, "{unit}: {line}");
    }
}
