//! Hours of random commands and faults, with memory use and learned gains monitored.

use crate::drill::bench::{Bench, BenchConfig, bend};
use crate::drill::list::specs;
use crate::drill::spec::{Injection, Spec};
use crate::supervisor::{MachineError, Mode, Order};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde::Serialize;

/// Result of a soak.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Soak {
    /// Simulated time, h.
    pub hours: f64,
    /// Commanded poses.
    pub poses: u64,
    /// Injected faults.
    pub faults: u64,
    /// Trips of the gate.
    pub trips: u64,
    /// Resident memory after a tenth of the time and at the end, KiB.
    pub rss_kib: [u64; 2],
    /// Largest change of a learned gain, as a share of 1 + k_ε at its start.
    pub gain_range: f64,
    /// Allowed change.
    pub gain_allowed: f64,
    /// Error of the held poses without a fault, median and maximum, degrees.
    pub error_deg: [f64; 2],
    /// Every requirement was met.
    pub ok: bool,
    /// The requirements that were not met.
    pub why: Vec<String>,
}

/// Length of a session with one unit, s.
const SESSION_S: f64 = 600.0;
/// Share of the moves with a fault.
const FAULT_SHARE: f64 = 0.15;

/// Runs for a number of simulated hours; `progress` receives the hours that have passed.
///
/// # Errors
/// [`MachineError`].
pub fn run(
    config: &BenchConfig,
    hours: f64,
    seed: u64,
    progress: &mut dyn FnMut(f64),
) -> Result<Soak, MachineError> {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut specs = specs();
    specs.retain(|spec| spec.base_sway_deg.is_none());
    let prior = config.supervisor.tick.lines.map(|line| line.k_epsilon);
    let mut soak = Soak {
        gain_allowed: config.supervisor.tick.refine.range,
        ..Soak::default()
    };
    let mut errors: Vec<f64> = Vec::new();
    let (mut elapsed_s, mut session) = (0.0, 0);
    while elapsed_s < hours * 3600.0 {
        session += 1;
        let mut bench = config.bench(1 + session % 5, session)?;
        while bench.now_s < SESSION_S {
            if !to_armed(&mut bench)? {
                let mode = bench.runner.supervisor.mode();
                let why = format!("session {session}: stuck in mode {mode}");
                soak.why.push(why);
                break;
            }
            soak.poses += 1;
            errors.extend(one_move(&mut bench, &specs, &mut rng, &mut soak)?);
            let lines = bench.runner.supervisor.state().lines();
            for (line, prior) in lines.iter().zip(&prior) {
                let change = (line.k_epsilon - prior).abs() / (1.0 + prior);
                soak.gain_range = soak.gain_range.max(change);
            }
        }
        let before = elapsed_s;
        elapsed_s += bench.now_s;
        let tenth = hours * 360.0;
        if before < tenth && elapsed_s >= tenth || soak.rss_kib[0] == 0 {
            soak.rss_kib[0] = rss_kib();
        }
        progress(elapsed_s / 3600.0);
    }
    soak.hours = elapsed_s / 3600.0;
    soak.rss_kib[1] = rss_kib();
    errors.sort_by(f64::total_cmp);
    let middle = errors.get(errors.len() / 2);
    soak.error_deg = [middle, errors.last()].map(|deg| deg.copied().unwrap_or(0.0));
    assess(&mut soak);
    Ok(soak)
}

/// One random move, sometimes with a fault. Returns the error of the held pose where it can be assessed, degrees.
fn one_move(
    bench: &mut Bench,
    specs: &[Spec],
    rng: &mut StdRng,
    soak: &mut Soak,
) -> Result<Option<f64>, MachineError> {
    let angle = 75.0 * rng.random::<f64>().sqrt();
    let dir = 360.0 * rng.random::<f64>();
    bench.turn(Some(bend(angle, dir)))?;
    if rng.random::<f64>() >= FAULT_SHARE {
        let output = bench.run(2.0 + 3.0 * rng.random::<f64>())?;
        soak.trips += u64::from(output.tripped.is_some());
        let holds = output.mode == Mode::Holding && !output.frame.blocked;
        return Ok(holds.then(|| bench.error_deg(angle, dir)));
    }
    let spec = &specs[rng.random_range(0..specs.len())];
    bench.run(0.05 + 0.4 * rng.random::<f64>())?;
    soak.faults += 1;
    for order in spec.injection.apply(bench) {
        bench.turn(order)?;
    }
    let output = bench.run(1.0 + 3.0 * rng.random::<f64>())?;
    soak.trips += u64::from(output.latched.is_some());
    bench.runner.machine.clear_faults();
    if matches!(spec.injection, Injection::Plant(..)) {
        // faults of the plant leave traces: return to rest and start again there
        let mode = bench.runner.supervisor.mode();
        if mode.moves() || mode == Mode::Faulted {
            bench.turn(Some(Order::Reset))?;
            bench.turn(Some(Order::Relax))?;
            bench.until(15.0, |t| t.mode != Mode::Relaxing)?;
        }
        restore_and_align(bench)?;
    }
    Ok(None)
}

fn assess(soak: &mut Soak) {
    let (range, allowed, [early, late]) = (soak.gain_range, soak.gain_allowed, soak.rss_kib);
    if range > allowed + 1e-9 {
        let why = format!("a learned gain changed by {range:.2}, allowed is {allowed:.2}");
        soak.why.push(why);
    }
    if late > early + early / 10 + 2048 {
        let why = format!("memory grew from {early} to {late} KiB");
        soak.why.push(why);
    }
    soak.ok = soak.why.is_empty();
}

/// Puts the racks back by hand, vents the lines and aligns again.
fn restore_and_align(bench: &mut Bench) -> Result<(), MachineError> {
    // the effect of the repair appears before the racks are restored
    bench.run(2.0)?;
    bench.runner.machine.restore_racks();
    bench.run(10.0)?;
    align(bench)?;
    bench.set_straight();
    Ok(())
}

fn align(bench: &mut Bench) -> Result<bool, MachineError> {
    bench.turn(Some(Order::Reset))?;
    bench.turn(Some(Order::AssertStraight))?;
    bench.until(8.0, |t| t.mode != Mode::Aligning)
}

/// Brings the machine from any state to an armed one, as an operator would.
fn to_armed(bench: &mut Bench) -> Result<bool, MachineError> {
    for attempt in 0..10 {
        match bench.runner.supervisor.mode() {
            Mode::Holding | Mode::Tracking => return Ok(true),
            Mode::Boot | Mode::Aligning => {
                bench.until(10.0, |t| t.mode != Mode::Aligning && t.mode != Mode::Boot)?;
            }
            // a fault that returns after a reset needs a new alignment
            Mode::Disarmed if attempt > 4 && bench.runner.supervisor.keep().steps.0 == [0; 3] => {
                align(bench)?;
                bench.arm()?;
            }
            Mode::Disarmed if attempt > 4 => {
                bench.turn(Some(Order::Relax))?;
            }
            Mode::Disarmed => {
                bench.turn(Some(Order::Reset))?;
                bench.arm()?;
            }
            Mode::Relaxing => {
                bench.until(20.0, |t| t.mode != Mode::Relaxing)?;
            }
            Mode::Faulted => {
                bench.run(0.5)?;
                bench.turn(Some(Order::Reset))?;
            }
            Mode::Lost => restore_and_align(bench)?,
            Mode::Calibrating => {
                bench.turn(Some(Order::Calibrate(false)))?;
            }
        }
    }
    Ok(bench.runner.supervisor.mode().moves())
}

/// Resident memory of this process, KiB.
fn rss_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    let kib = line.and_then(|l| l.trim().trim_end_matches(" kB").trim().parse().ok());
    kib.unwrap_or(0)
}
