//! A disk that is full, and one that can only be read.

use crate::control::tick::RestartState;
use crate::drill::Row;
use crate::drill::bench::{Make, bend};
use crate::service::memory::{Memory, Store};
use crate::supervisor::cycle::order::Order;
use crate::supervisor::mode::Mode;
use std::io::{self, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

/// What an exercise does to its own disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Harm {
    /// Fills it.
    Fill,
    /// Has it remounted read-only.
    ReadOnly,
    /// Forbids itself to make files any larger or write beyond their begin.
    Limit,
}

/// The work of a service with its memory, at full speed, for `kill -9` to strike anywhere: align, arm
/// with the write ahead, bend here and there with checkpoints, relax, disarm, and again. Every
/// acknowledged write is one line: `armed a b c .`
///
/// # Errors
/// The system's, where it is not the harm that was done on purpose.
pub fn exercise(make: &Make, folder: &Path, harm: Option<Harm>) -> io::Result<()> {
    let other = |e: &dyn std::fmt::Display| io::Error::other(e.to_string());
    let (mut store, _) = Store::open(folder).map_err(|e| other(&e))?;
    let mut out = io::stdout().lock();
    let mut bench = make.bench(0, 1).map_err(|e| other(&e))?;
    bench.until(10.0, |t| t.mode == Mode::Disarmed).map_err(|e| other(&e))?;
    let mut keep = |armed: bool, kept: RestartState, out: &mut io::StdoutLock<'_>| -> io::Result<bool> {
        let memory = Memory { armed, kept: Some(kept), ..Memory::default() };
        match store.write(&memory) {
            Ok(_) => {
                let [a, b, c] = kept.steps.0;
                writeln!(out, "{} {a} {b} {c} .", i32::from(armed))?;
                out.flush()?;
                Ok(true)
            }
            Err(e) => {
                writeln!(out, "failed: {e}")?;
                out.flush()?;
                Ok(false)
            }
        }
    };
    for round in 0..u32::MAX {
        if !keep(true, bench.runner.supervisor.keep(), &mut out)? {
            // not written, not armed: that is all there is to it
            break;
        }
        bench.turn(Some(Order::Arm)).map_err(|e| other(&e))?;
        bench.run(0.05).map_err(|e| other(&e))?;
        for leg in 0..3u32 {
            let (angle, dir) = (20.0 + f64::from((round * 37 + leg * 53) % 45), f64::from((round * 71 + leg * 113) % 360));
            bench.turn(Some(bend(angle, dir))).map_err(|e| other(&e))?;
            for _ in 0..6 {
                bench.run(0.1).map_err(|e| other(&e))?;
                keep(true, bench.runner.supervisor.keep(), &mut out)?;
            }
        }
        match (harm, round) {
            (Some(harm), 1) => do_harm(folder, harm)?,
            (Some(_), 4) => break,
            _ => {}
        }
        bench.turn(Some(Order::Relax)).map_err(|e| other(&e))?;
        bench.until(15.0, |t| t.mode == Mode::Disarmed).map_err(|e| other(&e))?;
        keep(false, bench.runner.supervisor.keep(), &mut out)?;
    }
    Ok(())
}

#[allow(unsafe_code)]
fn do_harm(folder: &Path, harm: Harm) -> io::Result<()> {
    match harm {
        Harm::Fill => {
            let mut file = std::fs::File::create(folder.join("filler"))?;
            let block = [7u8; 4096];
            while file.write_all(&block).is_ok() {}
            println!("harm: the disk is full");
        }
        Harm::ReadOnly => {
            let done = Command::new("mount").args(["-o", "remount,ro"]).arg(folder).status()?.success();
            println!("harm: {}", if done { "the disk is read-only" } else { "remounting failed" });
        }
        Harm::Limit => {
            let none = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
            // SAFETY: the limit is a live struct that is only read; ignoring SIGXFSZ makes writes fail instead of killing
            let done = unsafe {
                libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
                libc::setrlimit(libc::RLIMIT_FSIZE, &none)
            };
            println!("harm: {}", if done == 0 { "no file may be written" } else { "the limit was refused" });
        }
    }
    Ok(())
}

/// A file system that fills up under the service: what was reserved can still be written over.
pub fn full(program: &Path, folder: &Path) -> io::Result<Row> {
    let mut row = harmed("disk_full", program, folder, Harm::Fill)?;
    row.demand(row.message.contains("0 writes failed"), |_| "writes in place failed on a full disk".to_owned());
    Ok(row)
}

/// A file system that becomes read-only: nothing is armed any more, nothing is lost.
pub fn read_only(program: &Path, folder: &Path) -> io::Result<Row> {
    let mut row = harmed("read_only_fs", program, folder, Harm::ReadOnly)?;
    row.demand(!row.message.contains(" 0 writes failed"), |_| "nothing was noticed".to_owned());
    Ok(row)
}

/// An exercise on a small file system of its own; where that cannot be had, with a limit on file size.
fn harmed(name: &str, program: &Path, folder: &Path, harm: Harm) -> io::Result<Row> {
    std::fs::create_dir_all(folder)?;
    let word = |h: Harm| match h {
        Harm::Fill => "fill",
        Harm::ReadOnly => "read-only",
        Harm::Limit => "limit",
    };
    let script = "mount -t tmpfs -o size=160k none \"$1\" && \"$2\" drill --exercise \"$1\" --harm \"$3\" && \"$2\" drill --recall \"$1\"";
    let begun = Instant::now();
    let own = |flags: &str| {
        Command::new("unshare")
            .arg(flags)
            .args(["sh", "-c", script, "sh"])
            .arg(folder)
            .arg(program)
            .arg(word(harm))
            .stderr(Stdio::inherit())
            .output()
    };
    let mut said = own("-m").ok().filter(|o| o.status.success());
    if said.is_none() {
        said = own("-Urm").ok().filter(|o| o.status.success());
    }
    let (text, how) = match said {
        Some(out) => (String::from_utf8_lossy(&out.stdout).into_owned(), "on a file system of its own"),
        None => {
            let out = Command::new(program).args(["drill", "--exercise"]).arg(folder).args(["--harm", word(Harm::Limit)]).output()?;
            let recall = Command::new(program).args(["drill", "--recall"]).arg(folder).output()?;
            let text = String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&recall.stdout);
            (text, "by a limit on file size, for lack of a file system of its own")
        }
    };
    Ok(judge(name, &text, how, begun.elapsed().as_secs_f64()))
}

/// Reads what an exercise said.
fn judge(name: &str, text: &str, how: &str, took_s: f64) -> Row {
    let mut row = Row::process(name, Some(took_s), "disarmed", String::new());
    let after: Vec<&str> = text.lines().skip_while(|l| !l.starts_with("harm:")).collect();
    row.demand(!after.is_empty(), |_| format!("the harm was not done: {text}"));
    let failed: Vec<&&str> = after.iter().filter(|l| l.starts_with("failed:")).collect();
    let last = text.lines().rfind(|l| l.ends_with('.') && !l.starts_with("recalled") && !l.starts_with("failed"));
    let recalled = text.lines().rfind(|l| l.starts_with("recalled"));
    row.demand(recalled.is_some_and(|r| Some(r.trim_start_matches("recalled ")) == last), |_| format!("kept `{last:?}`, {recalled:?}"));
    let reason = failed.first().map_or("", |f| **f);
    row.message = format!(
        "{} writes kept and {} writes failed after it, {how}; nothing lost. {reason}",
        after.len().saturating_sub(2 + failed.len()),
        failed.len()
    );
    if !failed.is_empty() {
        row.state = "disarmed".to_owned();
    }
    row
}
