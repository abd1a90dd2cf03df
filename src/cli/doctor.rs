//! `retroflex doctor`: compares this computer with the board file. Each line passes, warns or fails, and names the remedy.

use crate::cli::{ResultFile, inputs, output};
use crate::config::{Board, PressureBound};
use crate::hardware::lock::HardwareLock;
use crate::hardware::machine::{Sensor, slowness};
use crate::hardware::rt::{self, Grant, RtRequest};
use crate::hardware::{pins, supply};
use crate::service::{disk, paths};
use miette::Result;
use serde::Serialize;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use Verdict::{Fail, Pass, Warn};

/// Arguments of `doctor`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file; the default is the paper twin.
    #[arg(long)]
    board: Option<PathBuf>,
    /// Write the lines as JSON to this file (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    json: Option<ResultFile>,
}

/// Result of one check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Verdict {
    /// As required.
    Pass,
    /// The machine works, but less well.
    Warn,
    /// The machine does not work.
    Fail,
}

/// One line of the result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Finding {
    /// What was checked.
    what: String,
    /// The result.
    verdict: Verdict,
    /// What was found.
    found: String,
    /// What to do about it; empty if nothing is to be done.
    remedy: String,
}

impl Finding {
    fn new(what: &str, verdict: Verdict, found: impl Into<String>, remedy: &str) -> Self {
        Self {
            what: what.to_owned(),
            verdict,
            found: found.into(),
            remedy: if verdict == Pass { "" } else { remedy }.to_owned(),
        }
    }

    fn line(&self) -> String {
        let mark = match self.verdict {
            Pass => "pass",
            Warn => "WARN",
            Fail => "FAIL",
        };
        let line = format!("{mark}  {:<18} {}\n", self.what, self.found);
        match self.remedy.as_str() {
            "" => line,
            remedy => format!("{line}      → {remedy}\n"),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A report that names what is wrong with the board file.
pub fn run(args: &Args) -> Result<bool> {
    let board = inputs::board(args.board.as_deref())?;
    let mut findings = vec![model(), kernel(), pressure(&board)];
    findings.extend(devices(&board));
    findings.extend(real_time(&board));
    let paths = paths::Paths::of(&board.service);
    let sockets = socket_folder(paths.control.parent());
    findings.extend([clock(), power(), disk(&paths.state), sockets]);
    let text: String = findings.iter().map(Finding::line).collect();
    output::answer(&args.json, &findings, text)?;
    Ok(findings.iter().all(|f| f.verdict != Fail))
}

fn pass_or_warn(good: bool) -> Verdict {
    if good { Pass } else { Warn }
}

fn read(path: &str) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    Some(text.trim_end_matches(['\0', '\n']).to_owned())
}

fn model() -> Finding {
    let another = "not a Raspberry Pi: use the GPIO character device for the pins";
    let none = "no device tree: only simulations and replays run here";
    let Some(model) = read("/proc/device-tree/model") else {
        return Finding::new("computer", Warn, std::env::consts::ARCH, none);
    };
    let verdict = pass_or_warn(model.contains("Raspberry Pi"));
    Finding::new("computer", verdict, model, another)
}

fn kernel() -> Finding {
    let release = read("/proc/sys/kernel/osrelease").unwrap_or_default();
    let preempt = read("/sys/kernel/realtime").as_deref() == Some("1") || release.contains("-rt");
    let remedy = "not a PREEMPT_RT kernel: single steps can be late, see `retroflex bench rt`; a step that is too late latches a fault";
    Finding::new("kernel", pass_or_warn(preempt), release, remedy)
}

fn pressure(board: &Board) -> Finding {
    let bound = PressureBound::of(board);
    let (verdict, found) = (pass_or_warn(bound.is_bounded), bound.says);
    Finding::new("pressure", verdict, found, PressureBound::REMEDY)
}

/// The remedy for a sensor that does not answer.
const UNSEEN: &str = "check connector, supply, address and part; see [imu] in the board file";

/// Buses, GPIO chips and sensors that the board names. Sensors are identified; no output is driven.
fn devices(board: &Board) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (what, section) in [("tip IMU", &board.imu), ("base IMU", &board.base_imu)] {
        let Some(imu) = section else { continue };
        let remedy = "enable I²C (`dtparam=i2c_arm=on`) and join the group i2c";
        let mut options = std::fs::File::options();
        let open = options.read(true).write(true).open(&imu.bus);
        let (verdict, found) = match open {
            Ok(_) => (Pass, imu.bus.clone()),
            Err(e) => (Fail, format!("{}: {e}", imu.bus)),
        };
        let what = format!("{what}, bus");
        findings.push(Finding::new(&what, verdict, found, remedy));
        findings.extend(bus_speed(&imu.bus));
    }
    match board.pins.as_ref().map(pins::probe) {
        Some(Ok(Some(path))) => findings.push(Finding::new("pins", Pass, path, "")),
        Some(Err(e)) => findings.push(Finding::new("pins", Fail, e.to_string(), "")),
        Some(Ok(None)) | None => {}
    }
    let Some(machine) = board.hardware() else {
        return findings;
    };
    let lock = HardwareLock::take();
    if let Err(path) = &lock {
        let remedy = "a running service (`retroflex status` shows its sensors) or another command uses the hardware: the sensors are not touched";
        let found = format!("{} is locked", path.display());
        findings.push(Finding::new("sensors", Warn, found, remedy));
        return findings;
    }
    for (what, sensor) in [("tip IMU", &machine.imu), ("base IMU", &machine.base_imu)] {
        let Some(config) = sensor else { continue };
        findings.push(match Sensor::start(config, machine.imu_priority) {
            Ok(s) => {
                let i = s.found.identity;
                let found = format!("{}, {:.0} Hz", i.inertial, i.rate_hz);
                let slow = slowness(s.found.read_s, i.rate_hz);
                let verdict = pass_or_warn(slow.is_none());
                Finding::new(what, verdict, found, &slow.unwrap_or_default())
            }
            Err(e) => Finding::new(what, Fail, e.to_string(), UNSEEN),
        });
    }
    findings
}

/// Clock frequency of a bus in the device tree, Hz as a big-endian 32-bit number; fast mode (400 kHz) is required for the sample rate.
fn bus_speed(bus: &str) -> Option<Finding> {
    let name = Path::new(bus).file_name()?.to_str()?;
    let path = format!("/sys/class/i2c-adapter/{name}/of_node/clock-frequency");
    let bytes = std::fs::read(path).ok()?;
    let hz = u32::from_be_bytes(bytes.get(..4)?.try_into().ok()?);
    let (verdict, found) = (pass_or_warn(hz >= 400_000), format!("{} kHz", hz / 1000));
    let remedy = "set `dtparam=i2c_arm_baudrate=400000` in config.txt and restart";
    Some(Finding::new("bus speed", verdict, found, remedy))
}

/// What the kernel grants, requested in a temporary thread so that this one keeps its scheduling.
fn real_time(board: &Board) -> Vec<Finding> {
    let (priority, cpu) = (board.service.priority, board.service.cpu);
    let request = RtRequest { priority, cpu };
    let Ok(status) = std::thread::spawn(move || rt::enter(&request).0).join() else {
        let found = "the test thread panicked";
        return vec![Finding::new("real time", Fail, found, "")];
    };
    let line = |(name, grant): (&'static str, Grant)| match grant {
        Grant::NotRequested => None,
        Grant::Granted => Some(Finding::new(name, Pass, "granted", "")),
        Grant::Denied {
            request, remedy, ..
        } => {
            let found = format!("{request} denied");
            Some(Finding::new(name, Warn, found, remedy))
        }
    };
    status.into_iter().filter_map(line).collect()
}

fn clock() -> Finding {
    let source = read("/sys/devices/system/clocksource/clocksource0/current_clocksource");
    let source = source.unwrap_or("unknown".to_owned());
    let good = ["arch_sys_counter", "tsc", "kvm-clock"].contains(&source.as_str());
    let remedy = "reading the time is slow with this clock source; select another in sysfs";
    Finding::new("clock", pass_or_warn(good), source, remedy)
}

fn power() -> Finding {
    let Some(troubles) = supply::troubles(Path::new("/")) else {
        return Finding::new("power", Pass, "no firmware status on this computer", "");
    };
    let (verdict, found) = if troubles.is_empty() {
        (Pass, "no under-voltage, not throttled".to_owned())
    } else if troubles.contains(&"under-voltage now") {
        (Fail, troubles.join(", "))
    } else {
        (Warn, troubles.join(", "))
    };
    Finding::new("power", verdict, found, supply::REMEDY)
}

/// Free space for state and recordings: 1 MiB holds the state, 512 MiB about half an hour of recording.
fn disk(state: &Path) -> Finding {
    let mut folders = state.ancestors();
    let folder = folders.find(|f| f.exists()).unwrap_or(Path::new("/"));
    let remedy = "make sure that this user may write there, and that the card is sound: a file system with errors becomes read-only";
    let Ok(free) = disk::free_bytes(folder) else {
        return Finding::new("disk", Warn, "free space unknown", remedy);
    };
    if let Err(e) = tempfile_in(folder) {
        let found = format!("nothing can be written under {}: {e}", folder.display());
        return Finding::new("disk", Fail, found, remedy);
    }
    let found = format!("{} MiB free under {}", free >> 20, folder.display());
    let scarce = "free some space: the state and recordings need it";
    match free >> 20 {
        0 => Finding::new("disk", Fail, found, scarce),
        1..512 => Finding::new("disk", Warn, found, "a recording takes 15 MiB per minute"),
        _ => Finding::new("disk", Pass, found, ""),
    }
}

/// Writes a file as the service does, and removes it.
fn tempfile_in(folder: &Path) -> std::io::Result<()> {
    let path = folder.join(format!(".doctor-{}", std::process::id()));
    std::fs::File::create_new(&path)?.sync_all()?;
    std::fs::remove_file(path)
}

fn socket_folder(path: Option<&Path>) -> Finding {
    let what = "socket folder";
    let Some(path) = path else {
        return Finding::new(what, Fail, "none", "give the socket's path with its folder");
    };
    let shown = path.display();
    let remedy =
        "RuntimeDirectory= of the systemd unit creates it; use --socket when starting by hand";
    let (verdict, found) = match std::fs::metadata(path) {
        Ok(m) => {
            let (mode, user, group) = (m.mode() & 0o777, m.uid(), m.gid());
            (Pass, format!("{shown} ({mode:o}, {user}:{group})"))
        }
        Err(e) => (Warn, format!("{shown}: {e}")),
    };
    Finding::new(what, verdict, found, remedy)
}
