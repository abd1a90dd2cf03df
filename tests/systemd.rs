//! A real systemd starts the unit as it is shipped: notify, watchdog, restart, state, stop.
//!
//! It is the first process of namespaces of its own, with a unit folder of its own, so nothing of the
//! machine that the tests run on is touched. Needs root, `unshare`, systemd and version 2 of control
//! groups; without them it says so and passes over.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::repo;
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
        let out = Command::new("nsenter").args(["-t", &self.pid.to_string(), "-m", "-p", "-C", "-u", "-i"]).args(args).output().unwrap();
        let text = String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr);
        (out.status.success(), text.trim().to_owned())
    }
    fn systemctl(&self, args: &[&str]) -> (bool, String) {
        let mut all = vec!["systemctl"];
        all.extend(args);
        self.enter(&all)
    }
    fn show(&self, property: &str) -> String {
        self.systemctl(&["show", "retroflex", "-p", property, "--value"]).1
    }
    fn retroflex(&self, args: &[&str]) -> (bool, String) {
        let mut all = vec!["/run/rf/retroflex"];
        all.extend(args);
        self.enter(&all)
    }
    fn status(&self) -> serde_json::Value {
        let (_, text) = self.retroflex(&["status", "--json"]);
        serde_json::from_str(text.lines().next().unwrap_or("null")).unwrap_or(serde_json::Value::Null)
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
        // the first process of its namespace takes all others with it
        let _ = Command::new("kill").args(["-9", &self.pid.to_string()]).status();
        let _ = self.outer.wait();
    }
}

fn is_root() -> bool {
    std::fs::read_to_string("/proc/self/status").unwrap().lines().any(|l| l.starts_with("Uid:\t0\t"))
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
    if tried.is_ok_and(|s| s.success()) { Ok(()) } else { Err("no namespace with control groups of its own") }
}

fn boot(folder: &Path) -> Booted {
    let units = folder.join("units");
    std::fs::create_dir_all(units.join("retroflex.service.d")).unwrap();
    std::fs::copy(env!("CARGO_BIN_EXE_retroflex"), folder.join("retroflex")).unwrap();
    std::fs::copy(repo("systemd/retroflex.service"), units.join("retroflex.service")).unwrap();
    let here = "[Service]\nExecStart=\nExecStart=/run/rf/retroflex run\n";
    std::fs::write(units.join("retroflex.service.d/here.conf"), here).unwrap();
    for target in ["default", "basic", "sysinit", "shutdown", "multi-user"] {
        std::fs::write(units.join(format!("{target}.target")), format!("[Unit]\nDescription={target}\nDefaultDependencies=no\n")).unwrap();
    }
    let log = std::fs::File::create(folder.join("boot.log")).unwrap();
    #[allow(clippy::zombie_processes, reason = "waited for when `Booted` is dropped")]
    let outer = Command::new("unshare")
        .args(["--fork", "--pid", "--mount", "--cgroup", "--uts", "--ipc", "bash", "-c", BOOT, "boot"])
        .arg(folder)
        .stdin(Stdio::null())
        .stdout(log.try_clone().unwrap())
        .stderr(log)
        .spawn()
        .unwrap();
    let children = format!("/proc/{0}/task/{0}/children", outer.id());
    let begun = Instant::now();
    loop {
        let pid = std::fs::read_to_string(&children).ok().and_then(|t| t.split_whitespace().next()?.parse().ok());
        if let Some(pid) = pid {
            let booted = Booted { outer, pid };
            booted.until("systemd", |b| {
                b.systemctl(&["is-system-running"]).1.contains("running") || b.systemctl(&["is-system-running"]).1.contains("degraded")
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
        eprintln!("passed over: {why}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let booted = boot(folder.path());
    let (started, said) = booted.systemctl(&["start", "retroflex"]);
    assert!(started, "{said}\n{}", booted.systemctl(&["status", "retroflex", "--no-pager", "-n", "30"]).1);
    assert_eq!(booted.show("ActiveState"), "active");
    assert_eq!(booted.show("User"), "retroflex");
    booted.until("alignment", |b| b.status()["mode"] == "disarmed");
    booted.until("STATUS", |b| b.show("StatusText").starts_with("disarmed"));
    let grants = booted.status()["real_time"].to_string();
    assert!(grants.contains("SCHED_FIFO"), "{grants}");

    // it works: armed, bent
    assert!(booted.retroflex(&["arm"]).0);
    let (settled, said) = booted.retroflex(&["bend", "40", "--toward", "30", "--wait"]);
    assert!(settled, "{said}");

    // SIGSTOP: nobody feeds the watchdog any more; systemd kills and starts anew
    let first = booted.show("MainPID");
    assert!(booted.enter(&["kill", "-STOP", &first]).0);
    let took_s = booted.until("the restart", |b| b.show("NRestarts") == "1" && b.show("ActiveState") == "active");
    assert!((1.0..12.0).contains(&took_s), "{took_s} s");
    assert_ne!(booted.show("MainPID"), first);

    // the state is there again: bent was remembered, straight is felt, so it asks
    booted.until("a decision", |b| b.status()["mode"] == "lost");
    assert_ne!(booted.status()["counted"], serde_json::json!([0, 0, 0]));
    let (armed, said) = booted.retroflex(&["arm"]);
    assert!(!armed && said.contains("zero"), "{said}");
    assert!(booted.retroflex(&["zero"]).0);
    booted.until("alignment", |b| b.status()["mode"] == "disarmed");

    // stop while bent: relaxed first
    assert!(booted.retroflex(&["arm"]).0);
    assert!(booted.retroflex(&["bend", "35", "--wait"]).0);
    let (stopped, said) = booted.systemctl(&["stop", "retroflex"]);
    assert!(stopped, "{said}");
    assert_eq!((booted.show("Result").as_str(), booted.show("ActiveState").as_str()), ("success", "inactive"));
    let (_, memory) = booted.enter(&["/run/rf/retroflex", "drill", "--recall", "/var/lib/retroflex"]);
    assert!(memory.contains("recalled 0 0 0 0 ."), "left relaxed: {memory}");
}

#[test]
fn the_unit_is_hardened() {
    let out = Command::new("systemd-analyze").args(["security", "--offline=yes"]).arg(repo("systemd/retroflex.service")).output();
    let Ok(out) = out else {
        eprintln!("passed over: no systemd-analyze");
        return;
    };
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    let line = text.lines().find(|l| l.contains("Overall exposure level")).unwrap_or_else(|| panic!("{text}"));
    let level: f64 = line.split(':').nth(1).and_then(|r| r.split_whitespace().next()).and_then(|n| n.parse().ok()).unwrap();
    assert!(level <= 1.0, "{line}");
}
