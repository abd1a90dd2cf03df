//! Hours of random commands and faults at full speed, with memory and gains watched.

use crate::drill::bench::{Make, bend};
use crate::drill::list::{Strike, specs};
use crate::supervisor::cycle::order::Order;
use crate::supervisor::machine::MachineError;
use crate::supervisor::mode::Mode;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde::Serialize;

/// What a soak came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Soak {
    /// Simulated time, h.
    pub hours: f64,
    /// Poses commanded.
    pub poses: u64,
    /// Faults put in.
    pub faults: u64,
    /// Times the gate tripped.
    pub trips: u64,
    /// Resident memory after a tenth of the time and at the end, KiB.
    pub rss_kib: [u64; 2],
    /// Range that every refined gain kept to, as a share of 1 + k_ε around its start.
    pub gain_range: f64,
    /// … of which so much is allowed.
    pub gain_allowed: f64,
    /// Error of the held poses without a fault, median and largest, degrees.
    pub error_deg: [f64; 2],
    /// All that was promised held.
    pub ok: bool,
    /// What did not.
    pub why: Vec<String>,
}

/// Runs for so many simulated hours.
///
/// # Errors
/// The plant's.
pub fn run(make: &Make, hours: f64, seed: u64, progress: &mut dyn FnMut(f64)) -> Result<Soak, MachineError> {
    let mut dice = StdRng::seed_from_u64(seed);
    let specs = specs();
    let refine = make.gains.refine;
    let prior = make.calibration.transmission.k_epsilon;
    let mut soak = Soak {
        hours,
        poses: 0,
        faults: 0,
        trips: 0,
        rss_kib: [0; 2],
        gain_range: 0.0,
        gain_allowed: refine.range,
        error_deg: [0.0; 2],
        ok: true,
        why: Vec::new(),
    };
    let mut errors: Vec<f64> = Vec::new();
    let mut elapsed_s = 0.0;
    let mut session = 0;
    while elapsed_s < hours * 3600.0 {
        // a session is one tip: bent for some minutes, with a fault now and then
        session += 1;
        let mut bench = make.bench(1 + session % 5, session)?;
        let session_s = 600.0;
        let begun = |b: &crate::drill::bench::Bench| b.now_s;
        while begun(&bench) < session_s {
            if !to_armed(&mut bench)? {
                soak.why.push(format!("session {session}: stuck in {}", bench.runner.supervisor.mode()));
                break;
            }
            let (angle, dir) = (75.0 * dice.random::<f64>().sqrt(), 360.0 * dice.random::<f64>());
            let wanted = crate::model::bend::Bend::from_deg(angle, dir);
            bench.turn(Some(bend(angle, dir)))?;
            soak.poses += 1;
            let strikes = dice.random::<f64>() < 0.15;
            if strikes {
                let spec = &specs[dice.random_range(0..specs.len())];
                bench.run(0.05 + 0.4 * dice.random::<f64>())?;
                soak.faults += 1;
                let (first, second) = spec.strike.strike(&mut bench);
                bench.turn(first)?;
                bench.turn(second)?;
                let turned = bench.run(1.0 + 3.0 * dice.random::<f64>())?;
                soak.trips += u64::from(turned.latched.is_some());
                bench.runner.machine.mend();
                if matches!(spec.strike, Strike::Plant(..)) {
                    // what broke in the plant leaves traces: back to rest and begin there
                    if bench.runner.supervisor.mode().moves() || bench.runner.supervisor.mode() == Mode::Faulted {
                        bench.turn(Some(Order::Reset))?;
                        bench.turn(Some(Order::Relax))?;
                        bench.until(15.0, |t| t.mode != Mode::Relaxing)?;
                    }
                    begin_at_rest(&mut bench)?;
                }
            } else {
                let turned = bench.run(2.0 + 3.0 * dice.random::<f64>())?;
                soak.trips += u64::from(turned.tripped.is_some());
                if turned.mode == Mode::Holding && !turned.frame.blocked {
                    errors.push((bench.true_bend().0 - wanted.0).norm().to_degrees());
                }
            }
            let k = bench.runner.supervisor.state().lines().map(|l| l.k_epsilon);
            for (k, prior) in k.iter().zip(&prior) {
                soak.gain_range = soak.gain_range.max((k - prior).abs() / (1.0 + prior));
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
    soak.error_deg = [errors.get(errors.len() / 2).copied().unwrap_or(0.0), errors.last().copied().unwrap_or(0.0)];
    judge(&mut soak);
    Ok(soak)
}

fn judge(soak: &mut Soak) {
    if soak.gain_range > soak.gain_allowed + 1e-9 {
        soak.why.push(format!("a gain left its guard: {:.2} of {:.2}", soak.gain_range, soak.gain_allowed));
    }
    if soak.rss_kib[1] > soak.rss_kib[0] + soak.rss_kib[0] / 10 + 2048 {
        soak.why.push(format!("memory grew from {} to {} KiB", soak.rss_kib[0], soak.rss_kib[1]));
    }
    soak.ok = soak.why.is_empty();
}

/// Racks back to their marks by hand, lines vented, and the rest found again.
fn begin_at_rest(bench: &mut crate::drill::bench::Bench) -> Result<(), MachineError> {
    // what was mended shows first, then what is left is put back
    bench.run(2.0)?;
    bench.runner.machine.put_back();
    bench.run(10.0)?;
    bench.turn(Some(Order::Reset))?;
    bench.turn(Some(Order::Zero))?;
    bench.until(8.0, |t| t.mode != Mode::Aligning)?;
    bench.call_straight();
    Ok(())
}

/// Whatever state it is in, as an operator would: to armed.
fn to_armed(bench: &mut crate::drill::bench::Bench) -> Result<bool, MachineError> {
    for attempt in 0..10 {
        match bench.runner.supervisor.mode() {
            Mode::Holding | Mode::Tracking => return Ok(true),
            Mode::Boot | Mode::Aligning => {
                bench.until(10.0, |t| t.mode != Mode::Aligning && t.mode != Mode::Boot)?;
            }
            // what comes back after a reset needs the rest found again
            Mode::Disarmed if attempt > 4 && bench.runner.supervisor.keep().steps.0 == [0; 3] => {
                bench.turn(Some(Order::Reset))?;
                bench.turn(Some(Order::Zero))?;
                bench.until(8.0, |t| t.mode != Mode::Aligning)?;
                bench.turn(Some(Order::Arm))?;
                bench.run(0.05)?;
            }
            Mode::Disarmed if attempt > 4 => {
                bench.turn(Some(Order::Relax))?;
            }
            Mode::Disarmed => {
                bench.turn(Some(Order::Reset))?;
                bench.turn(Some(Order::Arm))?;
                bench.run(0.05)?;
            }
            Mode::Relaxing => {
                bench.until(20.0, |t| t.mode != Mode::Relaxing)?;
            }
            Mode::Faulted => {
                bench.run(0.5)?;
                bench.turn(Some(Order::Reset))?;
            }
            Mode::Lost => begin_at_rest(bench)?,
            Mode::Calibrating => {
                bench.turn(Some(Order::Stop))?;
            }
        }
    }
    Ok(bench.runner.supervisor.mode().moves())
}

/// Resident memory of this process, KiB.
fn rss_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    line.and_then(|l| l.trim().trim_end_matches(" kB").trim().parse().ok()).unwrap_or(0)
}
