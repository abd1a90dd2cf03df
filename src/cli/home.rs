//! `retroflex home`: zero by home switches, or by a person who brings the pistons to rest.

use crate::cli::{CommandOutcome, manual_motion, output};
use crate::config::board::Board;
use crate::config::hardware::HomingMethod;
use crate::config::source;
use crate::supervisor::commission::homing::{self, HomingConfig};
use miette::{Result, miette};
use std::io::BufRead;
use std::path::PathBuf;

/// Arguments of `home`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file.
    #[arg(long)]
    board: PathBuf,
    /// The tip is off or its lines are vented: switches stand at the end of travel, where a closed line
    /// would be at its full pressure.
    #[arg(long)]
    vented: bool,
    /// The pistons were brought to rest by hand; without it a question is asked.
    #[arg(long)]
    at_rest: bool,
}

/// Runs the command.
///
/// # Errors
/// A report: bad input, hardware that does not answer, or why zero was not found.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let board: Board = source::read(&args.board)?;
    let text = match board.homing.method {
        HomingMethod::Switches => by_switches(args, &board)?,
        HomingMethod::Operator => by_operator(args)?,
    };
    output::print(&text);
    Ok(CommandOutcome::Good)
}

fn by_switches(args: &Args, board: &Board) -> Result<String> {
    if !args.vented {
        return Err(miette!("homing drives every piston to the end of its travel: take the tip off or vent its lines, then say --vented"));
    }
    let (h, travel_mm) = (board.homing, board.limits.travel_mm);
    let search_max_mm = 2.0 * travel_mm + h.back_off_mm;
    let config = HomingConfig {
        speed_mm_s: h.speed_mm_s,
        back_off_mm: h.back_off_mm,
        repeat_max_mm: h.repeat_max_mm,
        at_mm: h.at_mm,
        search_max_mm,
    };
    let (_, mut machine) = manual_motion::open(&args.board, |c| {
        (c.imu, c.base_imu) = (None, None);
        // where the pistons are is not known yet, so the rack's length is no limit on the count
        c.motion.travel_max_mm = search_max_mm + 2.0 * travel_mm;
    })?;
    let homed = manual_motion::at_hand(machine.as_mut(), |hand| {
        hand.energise(true).map_err(manual_motion::ended)?;
        let homed = homing::with_switches(hand, &config).map_err(|e| match e {
            homing::HomingError::Motion(e) => manual_motion::ended(e),
            e => miette!("{e}"),
        })?;
        hand.energise(false).map_err(manual_motion::ended)?;
        Ok(homed)
    })?;
    let row = |v: [f64; 3]| v.map(|x| format!("{x:.3}")).join(", ");
    Ok(format!(
        "zero found: it was off by {} mm; closings repeat within {} mm; pistons at zero, drivers released\n",
        row(homed.moved_mm),
        row(homed.repeat_mm)
    ))
}

/// Drivers stay off: a person can turn the pinions, and air equalises.
fn by_operator(args: &Args) -> Result<String> {
    if !args.at_rest {
        eprintln!("Open the lines, bring every piston to its rest mark by hand, close the lines; then type `rest` and press Enter.");
        let mut line = String::new();
        let read = std::io::stdin().lock().read_line(&mut line);
        if read.is_err() || line.trim() != "rest" {
            return Err(miette!("not confirmed; zero is where it was"));
        }
    }
    let (_, mut machine) = manual_motion::open(&args.board, |c| (c.imu, c.base_imu) = (None, None))?;
    manual_motion::at_hand(machine.as_mut(), |hand| {
        let mut all = || {
            hand.energise(true)?;
            hand.stand(0.2, &mut |_| ())?;
            hand.energise(false)
        };
        all().map_err(manual_motion::ended)
    })?;
    Ok("zero is here: pistons at rest as confirmed, drivers answer and are released\n".to_owned())
}
