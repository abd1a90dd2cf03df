//! `retroflex replay LOG`: what was recorded, through the pilot of today. Every decision must come out
//! again bit for bit; if not, the software has changed.

use crate::cli::CommandOutcome;
use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::source;
use crate::config::supervisor::assemble;
use crate::control::pi::Dynamics;
use crate::model::transmission::Line;
use crate::service::record::tape_of;
use crate::service::tape::{Header, Reader, digest};
use crate::supervisor::cycle::Supervisor;
use crate::supervisor::machine::MachineInfo;
use miette::{Result, miette};
use std::path::PathBuf;

/// Arguments of `replay`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Bend log that was recorded with a tape (`LOG.tape` beside it).
    log: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// A report that names what is wrong with the tape.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let path = tape_of(&args.log);
    if !args.log.exists() {
        return Err(miette!("{}: no such bend log", args.log.display()));
    }
    let bytes = std::fs::read(&path).map_err(|e| {
        miette!("{}: {e}; only a log that was recorded from rest has a tape: `retroflex run --record LOG`, or `retroflex record start` while disarmed", path.display())
    })?;
    let end = bytes.iter().position(|b| *b == b'\n').ok_or_else(|| miette!("{}: has no header line", path.display()))?;
    let header: Header = serde_json::from_slice(&bytes[..end]).map_err(|e| miette!("{}, line 1: {e}", path.display()))?;
    if header.tape != 1 {
        return Err(miette!("{}, line 1: tape version {}, this program reads 1", path.display(), header.tape));
    }
    let mut supervisor = supervisor_of(&header)?;
    let mut reader = Reader::new(&bytes[end + 1..]);
    let (mut turns, mut first_off, mut off) = (0u64, None, 0u64);
    while let Some(record) = reader.turn() {
        let turned = supervisor.turn(&record.sensed, record.order);
        turns += 1;
        if digest(&turned) != record.digest {
            off += 1;
            first_off.get_or_insert((turns, record.sensed.t.0));
        }
    }
    if turns == 0 {
        return Err(miette!("{}: has no turns", path.display()));
    }
    let cut = if reader.is_done() { "" } else { "; the tape is cut short" };
    println!("{turns} turns replayed, {off} differ{cut}");
    match first_off {
        None => Ok(CommandOutcome::Good),
        Some((n, t)) => {
            eprintln!("the first is turn {n} at {t:.3} s: the software has changed since {} wrote it", header.program);
            Ok(CommandOutcome::NotGoodEnough)
        }
    }
}

fn supervisor_of(header: &Header) -> Result<Supervisor> {
    let board: Board = source::parse("board of the tape", &header.texts[0])?;
    let gains: Gains = source::parse("gains of the tape", &header.texts[1])?;
    let calibration: Calibration = source::parse("calibration of the tape", &header.texts[2])?;
    let info = MachineInfo {
        name: header.machine.clone(),
        period_s: header.period_s,
        step_mm: header.step_mm,
        rest_length_mm: header.rest_length_mm,
    };
    let mut config = assemble(&board, &calibration, &gains, &info);
    config.tick.lines = header.lines.map(|[k_epsilon, k_lambda_mm]| Line { k_epsilon, k_lambda_mm });
    config.tick.dynamics = Dynamics { lag_s: header.dynamics[0], delay_s: header.dynamics[1] };
    let mut supervisor = Supervisor::new(config, header.kept);
    if header.doubted {
        supervisor.doubt();
    }
    Ok(supervisor)
}
