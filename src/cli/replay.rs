//! `retroflex replay LOG`: runs a recorded input through the present software and compares every decision bit for bit.

use crate::cli::{CommandOutcome, inputs};
use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::source;
use crate::config::supervisor::assemble;
use crate::control::pi::{Dynamics, DynamicsPrior};
use crate::log::error::why_unreadable;
use crate::log::table;
use crate::model::transmission::Line;
use crate::service::record::tape_path;
use crate::service::start::Start;
use crate::service::tape::{Header, Reader, digest};
use crate::supervisor::cycle::Supervisor;
use crate::supervisor::machine::MachineInfo;
use miette::{Result, miette};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Arguments of `replay`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Bend log that was recorded with a tape (`LOG.tape` beside it).
    log: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// A report that names the defect of the tape.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    if args.log.is_dir() || !args.log.exists() {
        let error = std::io::ErrorKind::NotFound.into();
        return Err(miette!("{}: {}", args.log.display(), why_unreadable(&args.log, &error)));
    }
    let tape = tape_path(&args.log);
    let path = tape.display();
    let bytes = read(&tape).map_err(|e| {
        miette!("{path}: {}; a log has a tape only if it was recorded with `retroflex run --record LOG`, or with `retroflex record start` while disarmed at rest", why_unreadable(&tape, &e))
    })?;
    let end = bytes.iter().position(|b| *b == b'\n').ok_or_else(|| miette!("{path}: has no header line"))?;
    let header: Header = serde_json::from_slice(&bytes[..end]).map_err(|e| miette!("{path}, line 1: {e}"))?;
    if header.tape != 1 {
        return Err(miette!("{path}, line 1: tape version {}; this program reads version 1", header.tape));
    }
    let program = header.program.clone();
    let mut supervisor = supervisor(header)?;
    let mut reader = Reader::new(&bytes[end + 1..]);
    let (mut cycles, mut different, mut first) = (0u64, 0u64, None);
    for record in &mut reader {
        let output = supervisor.turn(&record.sensed, record.order);
        cycles += 1;
        if digest(&output) != record.digest {
            different += 1;
            first.get_or_insert((cycles, record.sensed.t.0));
        }
    }
    if cycles == 0 {
        return Err(miette!("{path}: has no records"));
    }
    let cut = if reader.is_done() { "" } else { "; the tape is truncated" };
    println!("{cycles} cycles replayed, {different} differ{cut}");
    let Some((n, t)) = first else { return Ok(CommandOutcome::Good) };
    eprintln!("the first difference is in cycle {n} at {t:.3} s: the software has changed since version {program} wrote the tape");
    Ok(CommandOutcome::NotGoodEnough)
}

/// The content of a tape, compressed or not; of a truncated one, what is there.
fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut content = Vec::new();
    match table::reader(path)?.read_to_end(&mut content) {
        Err(e) if e.kind() != io::ErrorKind::UnexpectedEof => Err(e),
        _ => Ok(content),
    }
}

fn supervisor(header: Header) -> Result<Supervisor> {
    let board: Board = source::parse("board of the tape", &header.texts[0])?;
    let gains: Gains = source::parse("gains of the tape", &header.texts[1])?;
    let calibration: Calibration = source::parse("calibration of the tape", &header.texts[2])?;
    let info =
        MachineInfo { name: header.machine, period_s: header.period_s, step_mm: header.step_mm, rest_length_mm: header.rest_length_mm };
    let mut config = assemble(&board, &calibration, &gains, &info);
    if let Some(text) = header.texts.get(3) {
        let machine = inputs::described_by("model of the tape", source::parse("model of the tape", text)?, &board)?;
        config.tick = config.tick.fed_forward(machine);
    }
    config.tick.lines = header.lines.map(|[k_epsilon, k_lambda_mm]| Line { k_epsilon, k_lambda_mm });
    let [lag_s, delay_s, uncertainty_s] = header.dynamics;
    config.tick.dynamics = DynamicsPrior { expected: Dynamics { lag_s, delay_s }, uncertainty_s };
    Ok(Start { config, restart: header.restart, belief: header.belief, unverified: false }.supervisor())
}
