//! `kill -9` at random instants while a child works with the memory, and damage to the memory afterwards.

use super::plan::Plan;
use crate::drill::bench::{BenchConfig, distance};
use crate::drill::row::{FaultResult, require};
use crate::primitives::Steps;
use crate::service::store::{Found, Recall, SLOTS};
use crate::service::{Belief, Start, Store};
use crate::supervisor::{MachineError, Mode, Runner};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::io::{self, BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Largest error of a believed position, mm of bellow.
const BELIEVED_MAX_MM: f64 = 1.0;
const RECALLED: &str = "the last acknowledged write is recalled, or the memory counts as lost; no microstep; at most 1 mm of what is believed is false";
const LOST: &str = "the position is lost; no microstep";

/// What happens to the memory after a kill.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Damage {
    None,
    Truncated,
    Zeroed,
    Swapped,
}

impl Damage {
    /// All, each with its row and what the row requires.
    const ALL: [(Self, &'static str, &'static str); 4] = [
        (Self::None, "sigkill", RECALLED),
        (Self::Truncated, "sigkill_memory_truncated", LOST),
        (Self::Zeroed, "sigkill_memory_zeroed", LOST),
        (Self::Swapped, "sigkill_memory_swapped", LOST),
    ];

    /// The slots after the damage, which concerns one of them or exchanges both.
    fn apply(self, mut slots: [Vec<u8>; 2], one: usize) -> [Vec<u8>; 2] {
        let size = slots[one].len();
        match self {
            Self::None => {}
            Self::Truncated => slots[one].truncate(size / 3),
            Self::Zeroed => slots[one] = vec![0; size],
            Self::Swapped => slots.swap(0, 1),
        }
        slots
    }
}

/// One row for each damage, which is done to a copy of the memory after each of the kills.
pub fn rows(plan: &Plan<'_>) -> io::Result<Vec<FaultResult>> {
    let folder = &plan.scratch.join("kill");
    let all = Damage::ALL.into_iter().filter(|d| (plan.selected)(d.1));
    let row = |(damage, name, requires)| (damage, FaultResult::new(name, requires), [0; 3]);
    let mut rows: Vec<(Damage, FaultResult, [u32; 3])> = all.map(row).collect();
    if rows.is_empty() {
        return Ok(Vec::new());
    }
    let mut rng = StdRng::seed_from_u64(1);
    for n in 0..plan.kills {
        let after = Duration::from_micros(rng.random_range(0..40_000));
        let acknowledged = kill_after(plan.program, folder, after)?;
        let paths = SLOTS.map(|name| folder.join(name));
        let slots = [std::fs::read(&paths[0])?, std::fs::read(&paths[1])?];
        for (damage, row, count) in &mut rows {
            let damaged = damage.apply(slots.clone(), n as usize % 2);
            for (path, slot) in paths.iter().zip(damaged) {
                std::fs::write(path, slot)?;
            }
            let started = Instant::now();
            let (_, recall) = Store::open(folder).map_err(io::Error::other)?;
            let slowest_s = row.detected_s.unwrap_or(0.0);
            row.detected_s = Some(slowest_s.max(started.elapsed().as_secs_f64()));
            if *damage == Damage::None {
                // the kill may have torn a write, or cut its acknowledgement
                let newest = (acknowledged..=acknowledged + 1).contains(&recall.sequence);
                let recalled = recall.sequence;
                require!(row: recall.found == Found::Damaged || newest;
                    "kill {n}: recalled {recalled} after {acknowledged}");
            } else {
                require!(row: recall.belief() == Belief::Lost;
                    "kill {n}: a damaged memory is believed");
            }
            let mode = start_at_rest(plan.config, &recall, row, n).map_err(io::Error::other)?;
            let known = [Mode::Disarmed, Mode::Lost].iter().position(|m| *m == mode);
            count[known.unwrap_or(2)] += 1;
        }
    }
    let mut concluded = Vec::new();
    for (_, mut row, [believed, lost, undecided]) in rows {
        require!(row: undecided == 0; "{undecided} starts came to no decision");
        row.message = format!("believed after {believed} kills, lost after {lost}");
        concluded.push(row.ending("lost"));
    }
    Ok(concluded)
}

/// Starts a supervisor from the memory on a machine whose pistons are at rest. It must not move, and what it believes must
/// be true. Returns its mode.
fn start_at_rest(
    config: &BenchConfig,
    recall: &Recall,
    row: &mut FaultResult,
    n: u32,
) -> Result<Mode, MachineError> {
    let restart = recall.memory.as_ref().and_then(|memory| memory.restart);
    let mut bench = config.bench(0, 3)?;
    let start = Start {
        config: config.supervisor.clone(),
        restart,
        belief: recall.belief(),
        unverified: false,
    };
    bench.runner = Runner::new(bench.runner.machine, start.supervisor());
    let output = bench.run(3.0)?;
    let recounted = bench.runner.supervisor.keep();
    // the remembered counts are declared, not driven
    let steps = distance(
        &output.counted,
        &restart.map_or(Steps::default(), |r| r.steps),
    );
    row.steps_after += steps;
    require!(row: steps == 0; "kill {n}: moved by {steps} microsteps at the restart");
    if output.mode == Mode::Disarmed {
        let radius_mm = bench.runner.supervisor.config().tick.geometry.r_mm;
        let false_mm = recounted.bend_rad[0].hypot(recounted.bend_rad[1]) * radius_mm;
        row.error_deg_after = row.error_deg_after.max((false_mm / radius_mm).to_degrees());
        require!(row: false_mm <= BELIEVED_MAX_MM; "kill {n}: {false_mm:.2} mm are believed falsely");
    }
    Ok(output.mode)
}

/// Kills an exercise after a time. Returns the sequence number of the last acknowledged write.
fn kill_after(program: &Path, folder: &Path, after: Duration) -> io::Result<u64> {
    std::fs::create_dir_all(folder)?;
    let mut child = Command::new(program)
        .args(["drill", "--exercise"])
        .arg(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()?;
    let pipe = child.stdout.take().ok_or(io::Error::other("no pipe"))?;
    let mut lines = BufReader::new(pipe).lines();
    // the time counts from the first write, so that short times do not end before it
    let first = lines.next().transpose()?;
    std::thread::sleep(after);
    child.kill()?;
    child.wait()?;
    // a line without its end was cut by the kill and is not an acknowledgement
    let all = first.into_iter().chain(lines.map_while(Result::ok));
    let last = all
        .filter_map(|line| line.strip_suffix(" .")?.parse().ok())
        .last();
    last.ok_or(io::Error::other("the exercise wrote nothing"))
}
