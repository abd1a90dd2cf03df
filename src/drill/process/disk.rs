//! A full disk and a read-only one.

use super::plan::Plan;
use crate::drill::bench::{BenchConfig, bend};
use crate::drill::row::{FaultResult, require};
use crate::service::{Memory, Store};
use crate::supervisor::{Mode, Order, RestartState};
use nix::sys::resource::{Resource, setrlimit};
use std::error::Error;
use std::io::{self, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Instant;

/// What an exercise does to its own disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Harm {
    /// Fill the file system.
    Fill,
    /// Remount it read-only.
    ReadOnly,
    /// Set the limit on file size to zero.
    Limit,
}

/// The work of a service with its memory, at full speed: align, arm with the write ahead, bend with checkpoints, relax,
/// disarm, and again. Every acknowledged write prints its number.
///
/// # Errors
/// Any error except the injected one.
pub fn exercise(
    config: &BenchConfig,
    folder: &Path,
    harm: Option<Harm>,
) -> Result<(), Box<dyn Error + Send + Sync>> {
    let (mut store, _) = Store::open(folder)?;
    let mut bench = config.bench(0, 1)?;
    bench.until(10.0, |t| t.mode == Mode::Disarmed)?;
    for round in 0..u32::MAX {
        if !write(&mut store, true, bench.runner.supervisor.keep())? {
            // without the write ahead the drivers are not armed
            break;
        }
        bench.arm()?;
        for leg in 0..3u32 {
            let angle = 20.0 + f64::from((round * 37 + leg * 53) % 45);
            let dir = f64::from((round * 71 + leg * 113) % 360);
            bench.turn(Some(bend(angle, dir)))?;
            for _ in 0..6 {
                bench.run(0.1)?;
                write(&mut store, true, bench.runner.supervisor.keep())?;
            }
        }
        match (harm, round) {
            (Some(harm), 1) => do_harm(folder, harm)?,
            (Some(_), 4) => break,
            _ => {}
        }
        bench.turn(Some(Order::Relax))?;
        bench.until(15.0, |t| t.mode == Mode::Disarmed)?;
        write(&mut store, false, bench.runner.supervisor.keep())?;
    }
    Ok(())
}

/// Writes the memory and prints the result.
fn write(store: &mut Store, armed: bool, restart: RestartState) -> io::Result<bool> {
    let restart = Some(restart);
    let written = store.write(&Memory {
        armed,
        restart,
        ..Memory::default()
    });
    let mut out = io::stdout().lock();
    match &written {
        Ok(sequence) => writeln!(out, "{sequence} .")?,
        Err(e) => writeln!(out, "failed: {e}")?,
    }
    out.flush()?;
    Ok(written.is_ok())
}

fn do_harm(folder: &Path, harm: Harm) -> io::Result<()> {
    let done = match harm {
        Harm::Fill => {
            let mut file = std::fs::File::create(folder.join("filler"))?;
            while file.write_all(&[7u8; 4096]).is_ok() {}
            "the disk is full"
        }
        Harm::ReadOnly => {
            let mut mount = Command::new("mount");
            let done = mount.args(["-o", "remount,ro"]).arg(folder).status()?;
            if done.success() {
                "the disk is read-only"
            } else {
                "the remount failed"
            }
        }
        Harm::Limit => {
            // a signal that is handled makes writes fail instead of killing
            signal_hook::flag::register(libc::SIGXFSZ, Arc::default())?;
            match setrlimit(Resource::RLIMIT_FSIZE, 0, 0) {
                Ok(()) => "no file can be written",
                Err(_) => "the limit was refused",
            }
        }
    };
    println!("harm: {done}");
    Ok(())
}

/// A file system that becomes full: the reserved slots can still be overwritten.
pub fn full(plan: &Plan<'_>, folder: &Path) -> io::Result<FaultResult> {
    let (mut row, failures) = harmed("disk_full", plan.program, folder, "fill")?;
    require!(row: failures == 0; "writes in place failed on a full disk");
    Ok(row)
}

/// A file system that becomes read-only: the drivers are not armed any more, and nothing is lost.
pub fn read_only(plan: &Plan<'_>, folder: &Path) -> io::Result<FaultResult> {
    let (mut row, failures) = harmed("read_only_fs", plan.program, folder, "read-only")?;
    require!(row: failures > 0; "no write failed");
    Ok(row)
}

/// Runs an exercise on a small file system of its own or, where that is not permitted, with a limit on file size. Returns the row
/// and how many writes failed.
fn harmed(
    name: &str,
    program: &Path,
    folder: &Path,
    harm: &str,
) -> io::Result<(FaultResult, usize)> {
    std::fs::create_dir_all(folder)?;
    let script = "mount -t tmpfs -o size=160k none \"$1\" && \"$2\" drill --exercise \"$1\" --harm \"$3\" && \"$2\" drill --recall \"$1\"";
    let started = Instant::now();
    let own_file_system = |flags: &&str| {
        let mut command = Command::new("unshare");
        command.args([flags, "sh", "-c", script, "sh"]);
        command.args([folder, program, Path::new(harm)]);
        let out = command.stderr(Stdio::inherit()).output();
        out.ok().filter(|out| out.status.success())
    };
    let (out, how) = match ["-m", "-Urm"].iter().find_map(own_file_system) {
        Some(out) => (out.stdout, "on a file system of its own"),
        None => {
            let drill = |option: &str, more: &[&str]| {
                let mut command = Command::new(program);
                command.args(["drill", option]).arg(folder);
                command.args(more).output()
            };
            let out = drill("--exercise", &["--harm", "limit"])?;
            let recall = drill("--recall", &[])?;
            let how = "with a limit on file size, because mounting is not permitted";
            ([out.stdout, recall.stdout].concat(), how)
        }
    };
    let requires = "the last acknowledged write is recalled; drivers are armed only if the state could be written";
    let mut row = FaultResult::new(name, requires).ending("disarmed");
    row.detected_s = Some(started.elapsed().as_secs_f64());
    let failures = assess(&String::from_utf8_lossy(&out), how, &mut row);
    Ok((row, failures))
}

/// Assesses the output of an exercise. Returns how many writes failed.
fn assess(text: &str, how: &str, row: &mut FaultResult) -> usize {
    let after = || text.lines().skip_while(|l| !l.starts_with("harm:"));
    require!(row: after().count() > 0; "the fault was not injected: {text}");
    let failed: Vec<&str> = after().filter(|l| l.starts_with("failed:")).collect();
    let written =
        |l: &&str| l.ends_with('.') && !l.starts_with("recalled") && !l.starts_with("failed");
    let acknowledged = text.lines().rfind(written);
    let recalled = text.lines().rfind(|l| l.starts_with("recalled"));
    let same = |(r, a): (&str, &str)| r.starts_with(&format!("recalled {a}"));
    require!(row: recalled.zip(acknowledged).is_some_and(same);
        "acknowledged {acknowledged:?}, recalled {recalled:?}");
    let failures = failed.len();
    let kept = after().count().saturating_sub(2 + failures);
    let reason = failed.first().copied().unwrap_or("");
    row.message = format!(
        "{kept} writes succeeded and {failures} writes failed afterwards, {how}; nothing lost. {reason}"
    );
    failures
}
