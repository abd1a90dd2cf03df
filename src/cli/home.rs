//! `retroflex home`: finds zero with home switches, or with the help of an operator.

use crate::cli::manual_motion::{self, motion_error, with_manual_control, without_sensors};
use crate::cli::{inputs, output};
use crate::config::Board;
use crate::primitives::Steps;
use crate::service::{Store, paths};
use crate::supervisor::commission::homing::{self, HomingError, HomingMethod};
use miette::{IntoDiagnostic, Result, bail, miette};
use std::io::BufRead;
use std::path::PathBuf;

/// Arguments of `home`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file.
    #[arg(long)]
    board: PathBuf,
    /// Confirm that the tip is removed or the lines are vented. The switches are at the end of travel, where a closed line would
    /// be at full pressure.
    #[arg(long)]
    vented: bool,
    /// Confirm that the pistons are at their rest marks; by default the command prompts for it.
    #[arg(long)]
    at_rest: bool,
}

/// Runs the command.
///
/// # Errors
/// A report: bad input, hardware that does not answer, or the reason why zero was not found.
pub fn run(args: &Args) -> Result<()> {
    let board = inputs::board(Some(&args.board))?;
    // the lock of the state folder also keeps a service from starting meanwhile
    let open = |_| Store::open(&paths::Paths::of(&board.service).state);
    let memory = board.hardware().map(open).transpose().into_diagnostic()?;
    let text = match board.homing.method {
        HomingMethod::Switches => by_switches(args, &board)?,
        HomingMethod::Operator => by_operator(args)?,
    };
    if let Some((mut store, recall)) = memory {
        let mut memory = recall.memory.unwrap_or_default();
        (memory.armed, memory.lost) = (false, false);
        // the switches measure; the operator's word is not verified
        memory.unverified = board.homing.method == HomingMethod::Operator;
        if let Some(restart) = &mut memory.restart {
            restart.steps = Steps::default();
            (restart.bend_rad, restart.play_output_mm) = ([0.0; 2], [0.0; 3]);
        }
        store.write(&memory).into_diagnostic()?;
    }
    output::print(text);
    Ok(())
}

fn by_switches(args: &Args, board: &Board) -> Result<String> {
    if !args.vented {
        bail!(
            "homing drives every piston to the end of its travel: remove the tip or vent its lines, then add --vented"
        );
    }
    let (config, travel_mm) = (&board.homing, board.limits.travel_mm);
    let search_max_mm = 2.0 * travel_mm + config.back_off_mm;
    let (_, mut machine) = manual_motion::open(&args.board, |c| {
        without_sensors(c);
        // the position is still unknown, so the count may exceed the length of the rack
        c.motion.limits.travel_max_mm = search_max_mm + 2.0 * travel_mm;
    })?;
    let report = |e| match e {
        HomingError::Motion(e) => motion_error(e),
        e => miette!("{e}"),
    };
    let homed = with_manual_control(machine.as_mut(), report, |hand| {
        hand.energise(true)?;
        let homed = homing::with_switches(hand, config, search_max_mm)?;
        hand.energise(false)?;
        Ok(homed)
    })?;
    let listed = |mm: [f64; 3]| mm.map(|x| format!("{x:.3}")).join(", ");
    let [moved, repeat] = [homed.moved_mm, homed.repeat_mm].map(listed);
    Ok(format!(
        "zero found: corrected by {moved} mm, switches repeat within {repeat} mm; pistons at zero, drivers released\n"
    ))
}

/// Keeps the drivers off while the operator turns the pinions and the pressure equalises.
fn by_operator(args: &Args) -> Result<String> {
    if !args.at_rest {
        eprintln!(
            "Open the lines, move every piston to its rest mark by hand and close the lines. Then type `rest` and press Enter."
        );
        let mut line = String::new();
        let read = std::io::stdin().lock().read_line(&mut line);
        if read.is_err() || line.trim() != "rest" {
            bail!("not confirmed; zero is unchanged");
        }
    }
    let (_, mut machine) = manual_motion::open(&args.board, without_sensors)?;
    with_manual_control(machine.as_mut(), motion_error, |hand| {
        hand.energise(true)?;
        hand.stand(0.2, &mut |_| ())?;
        hand.energise(false)
    })?;
    Ok("zero set: pistons at rest as confirmed; the drivers respond and are released\n".to_owned())
}
