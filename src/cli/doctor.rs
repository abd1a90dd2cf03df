//! `retroflex doctor`: the board file against the machine, line by line: pass, warn or fail, each with
//! the mend.

use crate::cli::{CommandOutcome, inputs, output};
use crate::config::board::Board;
use crate::hardware::machine::Sensor;
use crate::hardware::rt::{self, Grant, RtRequest};
use miette::Result;
use serde::Serialize;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Arguments of `doctor`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file; without it the paper twin.
    #[arg(long)]
    board: Option<PathBuf>,
    /// Write the lines as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// How a line came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// As it should be.
    Pass,
    /// It will run, less well.
    Warn,
    /// It will not run.
    Fail,
}

/// One line.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What was looked at.
    pub what: String,
    /// How it came out.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What to do about it; empty where nothing is to be done.
    pub mend: String,
}

impl Finding {
    /// A line.
    pub fn new(what: &str, verdict: Verdict, found: impl Into<String>, mend: &str) -> Self {
        let mend = if verdict == Verdict::Pass { String::new() } else { mend.to_owned() };
        Self { what: what.to_owned(), verdict, found: found.into(), mend }
    }
}

/// Runs the command.
///
/// # Errors
/// A report for a board file that is not one.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let files: Vec<&Path> = args.board.iter().map(PathBuf::as_path).collect();
    output::check(&[("--json", args.json.as_deref())], &files)?;
    let board = inputs::board(args.board.as_deref())?;
    let findings = examine(&board);
    output::json(args.json.as_deref(), &findings)?;
    let mut text = String::new();
    for f in &findings {
        let mark = match f.verdict {
            Verdict::Pass => "pass",
            Verdict::Warn => "WARN",
            Verdict::Fail => "FAIL",
        };
        let mend = if f.mend.is_empty() { String::new() } else { format!("\n      → {}", f.mend) };
        text.push_str(&format!("{mark}  {:<18} {}{mend}\n", f.what, f.found));
    }
    output::show(&text, args.json.as_deref());
    let failed = findings.iter().any(|f| f.verdict == Verdict::Fail);
    Ok(if failed { CommandOutcome::NotGoodEnough } else { CommandOutcome::Good })
}

/// Everything that can be seen without driving anything.
#[must_use]
pub fn examine(board: &Board) -> Vec<Finding> {
    let mut findings = vec![model(), kernel()];
    findings.extend(devices(board));
    findings.extend(real_time(board));
    findings.extend([clock(), throttling(), disk(&board.service.state), folder("socket folder", board.service.socket.parent())]);
    findings
}

fn read(path: &str) -> Option<String> {
    std::fs::read_to_string(path).ok().map(|t| t.trim_end_matches(['\0', '\n']).to_owned())
}

fn model() -> Finding {
    match read("/proc/device-tree/model") {
        Some(model) if model.contains("Raspberry Pi") => Finding::new("computer", Verdict::Pass, model, ""),
        Some(model) => Finding::new("computer", Verdict::Warn, model, "not a Raspberry Pi: pins through the GPIO character device only"),
        None => Finding::new("computer", Verdict::Warn, std::env::consts::ARCH, "no device tree: plants and replays only"),
    }
}

fn kernel() -> Finding {
    let release = read("/proc/sys/kernel/osrelease").unwrap_or_default();
    let preempt = read("/sys/kernel/realtime").as_deref() == Some("1") || release.contains("-rt");
    let verdict = if preempt { Verdict::Pass } else { Verdict::Warn };
    Finding::new(
        "kernel",
        verdict,
        release,
        "not a PREEMPT_RT kernel: rare late steps, see `retroflex bench rt`; a latched fault guards against harm",
    )
}

/// Buses, chips and pins that the board names; the sensors are asked who they are, nothing is driven.
fn devices(board: &Board) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (what, section) in [("tip IMU", &board.imu), ("base IMU", &board.base_imu)] {
        let Some(imu) = section else { continue };
        findings.push(device(&format!("{what}, bus"), Path::new(&imu.bus), "enable I²C (`dtparam=i2c_arm=on`) and join group i2c"));
        findings.extend(bus_speed(&imu.bus));
    }
    if let Some(pins) = &board.pins
        && pins.chip.starts_with("/dev/")
    {
        findings.push(device(
            "pins",
            Path::new(&pins.chip),
            "join group gpio; on a Raspberry Pi 5 with an older kernel the header is on /dev/gpiochip4",
        ));
    }
    let Some(machine) = board.hardware() else { return findings };
    for (what, sensor) in [("tip IMU", &machine.imu), ("base IMU", &machine.base_imu)] {
        let Some(config) = sensor else { continue };
        findings.push(match Sensor::start(config) {
            Ok(s) => {
                let i = s.identity();
                Finding::new(what, Verdict::Pass, format!("{} at {:#04x}, {:.0} Hz", i.inertial.part, i.inertial.address, i.rate_hz), "")
            }
            Err(e) => Finding::new(what, Verdict::Fail, e.to_string(), "check plug, supply, address and part; see [imu] of the board file"),
        });
    }
    findings
}

fn device(what: &str, path: &Path, mend: &str) -> Finding {
    match std::fs::File::options().read(true).write(true).open(path) {
        Ok(_) => Finding::new(what, Verdict::Pass, path.display().to_string(), ""),
        Err(e) => Finding::new(what, Verdict::Fail, format!("{}: {e}", path.display()), mend),
    }
}

/// Clock of a bus as the device tree has it, Hz, big-endian.
fn bus_speed(bus: &str) -> Option<Finding> {
    let name = Path::new(bus).file_name()?.to_str()?;
    let bytes = std::fs::read(format!("/sys/class/i2c-adapter/{name}/of_node/clock-frequency")).ok()?;
    let hz = u32::from_be_bytes(bytes.get(..4)?.try_into().ok()?);
    let verdict = if hz >= 400_000 { Verdict::Pass } else { Verdict::Warn };
    Some(Finding::new(
        "bus speed",
        verdict,
        format!("{} kHz", hz / 1000),
        "set `dtparam=i2c_arm_baudrate=400000` in config.txt and restart",
    ))
}

/// What the kernel grants, asked for in a thread of its own that gives it back by ending.
fn real_time(board: &Board) -> Vec<Finding> {
    let wish = RtRequest { priority: board.service.priority, cpu: board.service.cpu };
    let asked = std::thread::spawn(move || rt::enter(&wish).0);
    let Ok(status) = asked.join() else { return vec![Finding::new("real time", Verdict::Fail, "could not be asked", "")] };
    let line = |(name, grant): (&'static str, Grant)| match grant {
        Grant::NotRequested => None,
        Grant::Granted => Some(Finding::new(name, Verdict::Pass, "granted", "")),
        Grant::Denied(d) => Some(Finding::new(name, Verdict::Warn, format!("{} denied", d.request), d.remedy)),
    };
    status.into_iter().filter_map(line).collect()
}

fn clock() -> Finding {
    let source = read("/sys/devices/system/clocksource/clocksource0/current_clocksource").unwrap_or_else(|| "unknown".to_owned());
    let good = ["arch_sys_counter", "tsc", "kvm-clock"].contains(&source.as_str());
    let verdict = if good { Verdict::Pass } else { Verdict::Warn };
    Finding::new("clock", verdict, source, "a slow clock source makes every look at the time expensive")
}

/// Bits of the firmware's word (`vcgencmd get_throttled`): 0 under-voltage now, 1 capped, 2 throttled,
/// 16 to 18 the same since boot.
fn throttling() -> Finding {
    let Some(word) = read("/sys/devices/platform/soc/soc:firmware/get_throttled") else {
        return Finding::new("power", Verdict::Pass, "no firmware to ask", "");
    };
    let bits = u32::from_str_radix(word.trim_start_matches("0x"), 16).unwrap_or(0);
    let names = [
        (0, "under-voltage now"),
        (1, "frequency capped now"),
        (2, "throttled now"),
        (16, "under-voltage since boot"),
        (18, "throttled since boot"),
    ];
    let set: Vec<&str> = names.iter().filter(|(bit, _)| bits >> bit & 1 == 1).map(|(_, name)| *name).collect();
    if set.is_empty() {
        return Finding::new("power", Verdict::Pass, "no under-voltage, not throttled", "");
    }
    let verdict = if bits & 1 == 1 { Verdict::Fail } else { Verdict::Warn };
    Finding::new("power", verdict, set.join(", "), "use the official supply, and feed the motors from one of their own")
}

fn disk(state: &Path) -> Finding {
    let mut folder = state;
    while !folder.exists() {
        match folder.parent() {
            Some(parent) => folder = parent,
            None => break,
        }
    }
    let out = std::process::Command::new("df").args(["-Pk"]).arg(folder).output();
    let free_kib = out.ok().and_then(|o| {
        let text = String::from_utf8_lossy(&o.stdout).into_owned();
        text.lines().nth(1)?.split_whitespace().nth(3)?.parse::<u64>().ok()
    });
    match free_kib {
        None => Finding::new("disk", Verdict::Warn, "free space unknown", "see that the state folder can be written"),
        Some(k) if k < 1024 => Finding::new(
            "disk",
            Verdict::Fail,
            format!("{k} KiB free under {}", folder.display()),
            "make room: memory and recordings need it",
        ),
        Some(k) if k < 512 * 1024 => Finding::new(
            "disk",
            Verdict::Warn,
            format!("{} MiB free under {}", k / 1024, folder.display()),
            "a recording takes 15 MiB a minute",
        ),
        Some(k) => Finding::new("disk", Verdict::Pass, format!("{} MiB free under {}", k / 1024, folder.display()), ""),
    }
}

fn folder(what: &str, path: Option<&Path>) -> Finding {
    let Some(path) = path else { return Finding::new(what, Verdict::Fail, "none", "name the socket with its folder") };
    match std::fs::metadata(path) {
        Ok(m) => Finding::new(what, Verdict::Pass, format!("{} ({:o}, {}:{})", path.display(), m.mode() & 0o777, m.uid(), m.gid()), ""),
        Err(e) => Finding::new(
            what,
            Verdict::Warn,
            format!("{}: {e}", path.display()),
            "the unit's RuntimeDirectory= makes it; by hand use --socket",
        ),
    }
}
