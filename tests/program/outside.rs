//! What surrounds a service: a slow plant, a journal that nobody reads, hardware that is not there, a card that cannot be written,
//! other services.

use crate::common::repo;
use retroflex::drill::process::Daemon;
use retroflex::service::protocol::Request;
use serde_json::Value;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_retroflex"))
}

fn is_root() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    status.lines().any(|line| line.starts_with("Uid:\t0\t"))
}

/// Plants that take their time for every answer, with a child of their own: a stop is confirmed within a second, a signal ends the
/// service and everything that the plant has started.
#[test]
fn a_slow_plant_delays_neither_a_stop_nor_the_end() {
    let script = "import json, subprocess, sys, time\n\
        child = subprocess.Popen(['sleep', '300'])\n\
        open(sys.argv[2], 'w').write(str(child.pid))\n\
        say = lambda x: print(json.dumps(x), flush=True)\n\
        say({'plant': 'slow', 'protocol': 1, 'imu_period_s': 0.005, 'step_mm': 0.03, 'rest_length_mm': 20.0})\n\
        for line in sys.stdin:\n    time.sleep(float(sys.argv[1]))\n    say({'t': json.loads(line)['t'], 'imu': \
        {'acc': [0, 0, 9.81], 'gyr': [0, 0, 0], 'mag': [20, 0, -40]}})\n";
    for seconds in ["0.02", "0.2", "0.5"] {
        let folder = tempfile::tempdir().unwrap();
        let (file, pid) = (folder.path().join("slow.py"), folder.path().join("pid"));
        std::fs::write(&file, script).unwrap();
        let plant = format!(
            "exec:python3 '{}' {seconds} '{}'",
            file.display(),
            pid.display()
        );
        let daemon = Daemon::start_with(program(), folder.path(), &["--plant", &plant]).unwrap();
        std::thread::sleep(Duration::from_secs(1));
        let mut stop = Command::new(program());
        stop.args(["stop", "--socket"]).arg(&daemon.sockets()[0]);
        let since = Instant::now();
        let out = stop.output().unwrap();
        let stopped = since.elapsed();
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.success(), "{seconds}: {said}");
        assert!(
            stopped < Duration::from_millis(1500),
            "{seconds}: {stopped:?}"
        );
        let since = Instant::now();
        daemon.end().unwrap();
        let ended = since.elapsed();
        println!(
            "an answer every {seconds} s: stopped after {stopped:.1?}, ended after {ended:.1?}"
        );
        assert!(ended < Duration::from_secs(6), "{seconds}: {ended:?}");
        let child = std::fs::read_to_string(&pid).unwrap();
        let alive = || {
            let stat = std::fs::read_to_string(format!("/proc/{child}/stat"));
            stat.is_ok_and(|stat| !stat.contains(") Z"))
        };
        let since = Instant::now();
        while alive() {
            assert!(
                since.elapsed() < Duration::from_secs(2),
                "the child of the plant lives on"
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// Standard error as the journal, which is read at first, and then not, and one that is full from the start.
#[test]
fn a_journal_that_nobody_reads_delays_no_command() {
    for full in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let (mut journal, own) = UnixStream::pair().unwrap();
        if full {
            own.set_nonblocking(true).unwrap();
            while (&own).write(&[b' '; 4096]).map_err(|e| e.kind()) != Err(ErrorKind::WouldBlock) {}
            own.set_nonblocking(false).unwrap();
        }
        let there = std::fs::metadata(format!("/proc/self/fd/{}", own.as_raw_fd())).unwrap();
        let socket = folder.path().join("control.sock");
        let mut service = Command::new(program())
            .args(["run", "--board", "sim", "--socket"])
            .arg(&socket)
            .arg("--state")
            .arg(folder.path().join("state"))
            .env("JOURNAL_STREAM", format!("{}:{}", there.dev(), there.ino()))
            .env_remove("NOTIFY_SOCKET")
            .stderr(OwnedFd::from(own))
            .stdin(Stdio::null())
            .spawn()
            .unwrap();
        if !full {
            let mut text = [0; 64];
            journal.read_exact(&mut text).unwrap();
            let text = String::from_utf8_lossy(&text).into_owned();
            let priority = text.starts_with("<6>") || text.starts_with("<4>");
            assert!(priority && !text.contains("INFO"), "{text:?}");
        }
        let begun = Instant::now();
        let mut client = loop {
            match retroflex::service::client::Client::connect(&socket) {
                Ok(client) => break client,
                Err(e) => assert!(begun.elapsed() < Duration::from_secs(20), "{e:?}"),
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        // each kind of line comes at most once a second
        while begun.elapsed() < Duration::from_secs(5) {
            for request in [
                Request::Hold {},
                Request::Arm {},
                Request::Status {},
                Request::Stop {},
            ] {
                let since = Instant::now();
                let answer = client.request(&request);
                let took = since.elapsed();
                assert!(answer.map_or_else(|e| e.code == 1, |_| true), "{request:?}");
                assert!(took < Duration::from_secs(1), "{request:?}: {took:?}");
            }
        }
        assert!(
            Command::new("kill")
                .arg(service.id().to_string())
                .status()
                .unwrap()
                .success()
        );
        let since = Instant::now();
        while service.try_wait().unwrap().is_none() {
            assert!(since.elapsed() < Duration::from_secs(10), "it does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// Kills what it holds.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A bus that is not there yet: a person is told, a service manager sees a service that waits, and one that was there before fails.
#[test]
fn hardware_that_is_not_there_yet_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let board = folder.path().join("board.toml");
    std::fs::write(
        &board,
        "[pins]\nbackend = \"mock\"\n[imu]\nbus = \"/dev/i2c-none\"\n[imu.chip]\npart = \"icm20948\"\n",
    )
    .unwrap();
    let notify = folder.path().join("notify");
    let manager = UnixDatagram::bind(&notify).unwrap();
    manager
        .set_read_timeout(Some(Duration::from_secs(10)))
        .unwrap();
    let run = |managed: bool| {
        let mut command = Command::new(program());
        command.args(["run", "--board"]).arg(&board).arg("--socket");
        command
            .arg(folder.path().join("control.sock"))
            .arg("--state");
        command
            .arg(folder.path().join("state"))
            .env_remove("NOTIFY_SOCKET");
        if managed {
            command.env("NOTIFY_SOCKET", &notify);
        }
        command.stderr(Stdio::piped()).spawn().unwrap()
    };
    let by_hand = run(false).wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&by_hand.stderr).into_owned();
    assert_eq!(by_hand.status.code(), Some(3), "{said}");
    assert!(
        said.contains("/dev/i2c-none") && said.contains("modprobe i2c-dev"),
        "{said}"
    );
    let mut waits = Killed(run(true));
    let mut text = [0; 1024];
    for _ in 0..4 {
        let n = manager.recv(&mut text).unwrap();
        let text = String::from_utf8_lossy(&text[..n]).into_owned();
        assert!(text.contains("EXTEND_TIMEOUT_USEC="), "{text}");
        assert!(
            text.contains("STATUS=waiting for the hardware: no I²C bus"),
            "{text}"
        );
        assert!(waits.0.try_wait().unwrap().is_none());
    }
    drop(waits);
    // it was opened before: this is a failure
    std::fs::write(folder.path().join("control.opened"), "").unwrap();
    let again = run(true).wait_with_output().unwrap();
    assert_eq!(again.status.code(), Some(3));
}

/// Services of a user and of the system, in every combination of running and hung, in a mount namespace of their own.
#[test]
fn stop_without_a_socket_stops_every_service_and_names_the_one_that_does_not_answer() {
    if !is_root() {
        eprintln!("skipped: not root");
        return;
    }
    let script = r#"
mount --make-rprivate / && mount -t tmpfs tmpfs /run && mkdir -p /run/user/retroflex /run/retroflex || exit 77
export XDG_RUNTIME_DIR=/run/user RUNTIME_DIRECTORY=/run/user/retroflex
own=/run/user/retroflex/control.sock system=/run/retroflex/control.sock
trap 'kill -CONT $pids; kill -9 $pids' EXIT
for s in $own $system; do
  $1 run --board demo --socket $s --state $s.state >/run/log 2>&1 & pids="$pids $!"
done
for s in $own $system; do for _ in $(seq 100); do $1 status --socket $s 2>/dev/null | grep -q disarmed && break; sleep 0.1; done
  $1 arm --socket $s || exit 3; $1 bend 60 --speed 5 --socket $s; done
set -- $1 $pids
if [ "$HUNG" = own ]; then kill -STOP $2; elif [ "$HUNG" = system ]; then kill -STOP $3; fi
began=$(date +%s%N); $1 stop; code=$?; took=$(( ($(date +%s%N) - began) / 1000000 ))
echo "code $code after $took ms"
for s in $own $system; do timeout 3 $1 status --socket $s --json - 2>/dev/null | grep -o '"stopped":[a-z]*' | sed "s|^|$s |"; done
"#;
    for hung in ["", "own", "system"] {
        let out = Command::new("unshare")
            .args(["-m", "bash", "-c", script, "stop"])
            .arg(program())
            .env("HUNG", hung)
            .env_remove("RETROFLEX_SOCKET")
            .output()
            .unwrap();
        let (said, problem) = (
            String::from_utf8_lossy(&out.stdout).into_owned(),
            String::from_utf8_lossy(&out.stderr).into_owned(),
        );
        if out.status.code() == Some(77) || problem.contains("unshare failed") {
            eprintln!("skipped: no mount namespace");
            return;
        }
        println!("hung {hung:?}: {said}{problem}");
        let stopped = |path: &str| said.contains(&format!("{path} \"stopped\":true"));
        let paths = [
            "/run/user/retroflex/control.sock",
            "/run/retroflex/control.sock",
        ];
        for (name, path) in ["own", "system"].into_iter().zip(paths) {
            if name == hung {
                assert!(
                    problem.contains(path) || said.contains(path),
                    "{said}{problem}"
                );
                assert!(problem.contains("cut the power"), "{said}{problem}");
            } else {
                assert!(stopped(path), "{path}: {said}{problem}");
            }
        }
        let code = if hung.is_empty() { "code 0" } else { "code 3" };
        assert!(said.contains(code), "{said}{problem}");
        let took: u64 = said
            .split(" ms")
            .next()
            .unwrap()
            .rsplit(' ')
            .next()
            .unwrap()
            .parse()
            .unwrap();
        assert!(took < 2000, "{said}");
    }
}

/// A card that became read-only, as the doctor sees it.
#[test]
fn the_doctor_names_a_card_that_cannot_be_written() {
    if !is_root() {
        eprintln!("skipped: not root");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let board = folder.path().join("board.toml");
    let card = folder.path().join("card");
    std::fs::create_dir(&card).unwrap();
    std::fs::write(
        &board,
        format!(
            "base = \"demo\"\n[service]\nstate = \"{}/state\"\n",
            card.display()
        ),
    )
    .unwrap();
    let script = "mount --make-rprivate / && mount -t tmpfs -o size=1500m tmpfs $1 && mkdir $1/state || exit 77
[ $4 = rw ] || mount -o remount,ro $1; exec $2 doctor --board $3 --json -";
    for (mode, verdict) in [("rw", "pass"), ("ro", "fail")] {
        let out = Command::new("unshare")
            .args(["-m", "bash", "-c", script, "doctor"])
            .args([&card, program(), &board])
            .arg(mode)
            .output()
            .unwrap();
        if out.status.code() == Some(77) {
            eprintln!("skipped: no mount namespace");
            return;
        }
        let text = String::from_utf8_lossy(&out.stdout).into_owned();
        let findings: Value = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text}"));
        let disk = findings
            .as_array()
            .unwrap()
            .iter()
            .find(|f| f["what"] == "disk")
            .unwrap();
        assert_eq!(disk["verdict"], verdict, "{mode}: {disk}");
        if mode == "ro" {
            assert!(
                disk["found"].as_str().unwrap().contains("ead-only"),
                "{disk}"
            );
        }
    }
}

/// The package loads the bus, and no unit waits for what is not started.
#[test]
fn the_package_loads_the_bus_and_waits_for_nothing_that_does_not_come() {
    let read = |path: &str| std::fs::read_to_string(repo(path)).unwrap();
    assert!(
        read("systemd/retroflex.modules-load.conf")
            .lines()
            .any(|line| line == "i2c-dev")
    );
    assert!(read("Cargo.toml").contains("usr/lib/modules-load.d/retroflex.conf"));
    assert!(!read("systemd/retroflex.service").contains("udev-settle"));
}
