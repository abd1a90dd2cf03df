//! `retroflex commission`: verifies that the machine is wired as its board file says, and that its lines are tight.

use crate::cli::inputs::within;
use crate::cli::{manual_motion, output};
use crate::config::{Board, place, source};
use crate::supervisor::commission::trial::{self, TrialConfig, TrialError};
use crate::supervisor::commission::wiring::{TURN_SMALL_RAD, Wiring};
use miette::{Result, bail, miette};
use nalgebra::{UnitQuaternion, Vector3};
use std::path::{Path, PathBuf};

/// Arguments of `commission`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file.
    #[arg(long)]
    board: PathBuf,
    /// Correct the board file where it differs from the machine.
    #[arg(long)]
    write: bool,
    /// Stroke of the wiring test, mm, 1 to 6.
    #[arg(long, default_value_t = 3.0, value_parser = within(1.0..=6.0, "mm"))]
    stroke: f64,
    /// Duration of the leak test of each line, s, up to 120; 0 skips it.
    #[arg(long, default_value_t = 10.0, value_parser = within(0.0..=120.0, "s"))]
    hold: f64,
}

/// Runs the command.
///
/// # Errors
/// A report: bad input, hardware that does not answer, or the reason that ended the procedure.
pub fn run(args: &Args) -> Result<bool> {
    let (board, mut machine) = manual_motion::open(&args.board, |_| ())?;
    let mut config = TrialConfig::new(board.geometry.law());
    (config.stroke_mm, config.hold_s) = (args.stroke, args.hold);
    let report = |e| match e {
        TrialError::Motion(e) => manual_motion::motion_error(e),
        e => miette!("{e}"),
    };
    let findings = manual_motion::with_manual_control(machine.as_mut(), report, |hand| {
        trial::run(hand, &config, &mut |step| eprintln!("{step}"))
    })?;
    drop(machine);
    output::print(findings.report());
    if let (true, Some(wiring)) = (args.write, &findings.wiring) {
        write_back(&args.board, &board, wiring)?;
    }
    Ok(findings.is_good())
}

/// Writes the wiring that was found into the board file and keeps everything else as it is.
fn write_back(path: &Path, board: &Board, wiring: &Wiring) -> Result<()> {
    if wiring.is_right() {
        return Ok(());
    }
    let file = path.display();
    if !path.exists() {
        bail!(
            "{file} is a board of the program; write it into a file with `retroflex board show {file} >board.toml`, and give that file"
        );
    }
    let text = source::text_of(path)?;
    let (new, changes) = rewired(&text, board, wiring).map_err(|key| {
        miette!("{file}: {key} is not written in the file, so it cannot be changed there; copy its table from `retroflex board show` and run again")
    })?;
    source::parse::<Board>(&file.to_string(), &new)?;
    output::write(path, &new)?;
    for change in changes {
        eprintln!("{file}: {change}");
    }
    Ok(())
}

/// The corrected text of a board file and the list of changes; or the key that the text lacks.
fn rewired(text: &str, board: &Board, wiring: &Wiring) -> Result<(String, Vec<String>), String> {
    let mut new = text.to_owned();
    let mut changes = Vec::new();
    let mut set = |key: String, value: String| -> Result<(), String> {
        changes.push(format!("{key} = {value}"));
        new = place::replace(&new, &key, &value).ok_or(key)?;
        Ok(())
    };
    let Some(pins) = &board.pins else {
        return Err("pins".to_owned());
    };
    for (i, &bellow) in wiring.reaches.iter().enumerate() {
        // the driver that is configured as channel i drives `bellow`
        let (from, channel) = (&pins.channels[i], format!("pins.channels.{bellow}"));
        if bellow != i {
            set(format!("{channel}.step"), from.step.to_string())?;
            set(format!("{channel}.dir"), from.dir.to_string())?;
        }
        let turned = from.dir_inverted != wiring.inverted[i];
        if turned != pins.channels[bellow].dir_inverted {
            set(format!("{channel}.dir_inverted"), turned.to_string())?;
        }
    }
    if let (Some(imu), true) = (&board.imu, wiring.turned_rad.abs() >= TURN_SMALL_RAD) {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), wiring.turned_rad);
        let mount_deg = (turn * imu.mount()).scaled_axis().map(f64::to_degrees);
        set(
            "imu.mount_deg".to_owned(),
            format!("{:.1?}", <[f64; 3]>::from(mount_deg)),
        )?;
    }
    Ok((new, changes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corrected_file_describes_the_wiring_that_was_found() {
        let text = include_str!("../../boards/pi4.toml");
        let board: Board = source::parse("pi4", text).unwrap();
        let wiring = Wiring {
            reaches: [1, 0, 2],
            inverted: [true, false, false],
            turned_rad: 0.7,
            residual_rad: 0.0,
        };
        let (new, changes) = rewired(text, &board, &wiring).unwrap();
        let mended: Board = source::parse("new", &new).unwrap();
        let (was, is) = (board.pins.unwrap().channels, mended.pins.unwrap().channels);
        // driver 1 drives bellow 2 and turns in the wrong direction
        assert_eq!(
            (is[1].step, is[1].dir, is[1].dir_inverted),
            (was[0].step, was[0].dir, true)
        );
        assert_eq!(
            (is[0].step, is[0].dir, is[0].dir_inverted),
            (was[1].step, was[1].dir, false)
        );
        assert_eq!(is[2], was[2]);
        assert!(
            (mended.imu.unwrap().mount().angle() - 0.7).abs() < 1e-3 && changes.len() == 6,
            "{changes:?}"
        );
        // comments and everything else are unchanged
        assert_eq!(new.lines().count(), text.lines().count());
        let sim: Board = source::parse("sim", include_str!("../../boards/sim.toml")).unwrap();
        assert_eq!(rewired("", &sim, &wiring).unwrap_err(), "pins");
    }
}
