//! `retroflex board`: a file with everything that it leaves out, and whether a board is safe to run.

use crate::cli::{ResultFile, inputs, output};
use crate::config::{Header, PressureBound, show};
use crate::report::wiring::{self, Device, Wire};
use miette::{Result, bail};
use std::path::PathBuf;

commands! {
    /// Boards, gains and calibrations.
    pub enum BoardCommand;

    /// Print a whole file as TOML, with the meaning, unit, default and range of every key.
    Show(ShowArgs) => show,
    /// Draw the wiring of a board as SVG.
    Draw(DrawArgs) => draw,
    /// Check a board: its file, and that the pressure stays bounded if the program fails.
    Check(CheckArgs) => check,
}

/// Arguments of `board check`.
#[derive(Debug, clap::Args)]
pub struct CheckArgs {
    /// Board file, or the name of a board that comes with the program.
    board: PathBuf,
}

/// Arguments of `board draw`.
#[derive(Debug, clap::Args)]
pub struct DrawArgs {
    /// Board file, or the name of a board that comes with the program.
    board: PathBuf,
    /// File of the drawing (`-`: standard output).
    #[arg(long, value_name = "FILE", default_value = "-")]
    svg: ResultFile,
}

/// Arguments of `board show`.
#[derive(Debug, clap::Args)]
pub struct ShowArgs {
    /// File, or the name of a board that comes with the program (`sim`, `pi4`, …); left out: the default file.
    file: Option<PathBuf>,
    /// The file holds gains.
    #[arg(long, conflicts_with = "calib")]
    gains: bool,
    /// The file holds a calibration.
    #[arg(long)]
    calib: bool,
}

fn show(args: &ShowArgs) -> Result<()> {
    let file = args.file.as_deref();
    output::print(match (args.gains, args.calib) {
        (true, _) => show::whole(&inputs::gains(file)?),
        (_, true) => show::whole(&inputs::calibration(file)?),
        _ => show::whole(&inputs::board(file)?),
    });
    Ok(())
}

/// Draws the drivers, the IMU and the emergency stop of a board at the lines that it names.
fn draw(args: &DrawArgs) -> Result<()> {
    let board = inputs::board(Some(&args.board))?;
    let path = args.board.display();
    let Some(pins) = &board.pins else {
        bail!("{path}: this board has no [pins], so there is nothing to wire");
    };
    let raspberry = board.machine.header == Header::RaspberryPi;
    let wire = |name: &str, wire| (name.to_owned(), wire);
    let supply = |name, position| raspberry.then(|| wire(name, Wire::Position(position)));
    let uses = pins.uses();
    let mut devices = Vec::new();
    let mut device = |name, terminals: Vec<_>| devices.push(Device { name, terminals });
    for (i, ground) in [9, 14, 20].into_iter().enumerate() {
        let channel = format!("channels.{i}.");
        let own = uses.iter().filter(|u| u.key.starts_with(&channel));
        let lines = own.map(|u| wire(&u.name.to_uppercase(), Wire::Line(u.pin)));
        let terminals = lines.chain(supply("GND", ground)).collect();
        device(format!("driver of bellow {}", i + 1), terminals);
    }
    if let Some(imu) = &board.imu {
        let bus = imu.bus_lines.into_iter().flatten().zip(["SDA", "SCL"]);
        let bus = bus.map(|(pin, name)| wire(name, Wire::Line(pin)));
        let power = supply("3.3 V", 1).into_iter();
        let terminals = power.chain(bus).chain(supply("GND", 6)).collect();
        device(format!("IMU at the tip, {}", imu.bus), terminals);
    }
    if let Some(stop) = pins.emergency_stop {
        let contact = wire("NC", Wire::Line(stop.pin));
        let terminals = [contact].into_iter().chain(supply("GND", 39)).collect();
        device("emergency stop".to_owned(), terminals);
    }
    let title = format!("Wiring of {}", board.machine.name);
    output::write(&args.svg, wiring::draw(&title, raspberry, &devices))
}

/// Exit code 1 if nothing outside the program bounds the pressure.
fn check(args: &CheckArgs) -> Result<bool> {
    let board = inputs::board(Some(&args.board))?;
    let bound = PressureBound::of(&board);
    output::print(format!("file      consistent\npressure  {}\n", bound.says));
    Ok(bound.is_bounded)
}
