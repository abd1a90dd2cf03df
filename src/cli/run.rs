//! `retroflex run`: the service, in the foreground or under systemd.

use crate::cli::{Unreachable, inputs, logging, manual_motion, within};
use crate::config::{Board, Calibration, PressureBound, ServiceSection, source, supervisor};
use crate::hardware::machine::{Hardware, HardwareError, MachineConfig};
use crate::service::flight::start::hash;
use crate::service::paths::Paths;
use crate::service::record::{flight_path, make_room};
use crate::service::{Claim, Notifier, RunConfig, ServiceError, disk, serve};
use crate::simulation::link::Link;
use crate::simulation::lockstep::Lockstep;
use crate::supervisor::Machine;
use miette::{IntoDiagnostic, Result, bail, miette};
use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time until hardware that is not there is looked for again.
const HARDWARE_AGAIN: Duration = Duration::from_secs(1);

/// Arguments of `run`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file, or the name of a board that comes with the program. Default: ~/.config/retroflex/board.toml, else
    /// /etc/retroflex/board.toml, else a healthy simulated tip.
    #[arg(long)]
    board: Option<PathBuf>,
    /// Run on an external plant: `exec:PROGRAM ARG…`.
    #[arg(long)]
    plant: Option<String>,
    /// Calibration file of the mounted tip.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// Model saved by `gap diagnose --save` for the feedforward; default: the one that the calibration names, if any.
    #[arg(long, value_name = "MODEL.toml")]
    feedforward: Option<PathBuf>,
    /// Gains file.
    #[arg(long)]
    gains: Option<PathBuf>,
    /// Identity of the mounted tip. Default: that of the calibration.
    #[arg(long)]
    tip: Option<String>,
    /// Accept a calibration that was made on another tip.
    #[arg(long)]
    foreign_calibration: bool,
    /// Socket for commands, instead of the board's; the status socket is created beside it.
    #[arg(long)]
    socket: Option<PathBuf>,
    /// Folder of the persistent state, instead of the board's.
    #[arg(long)]
    state: Option<PathBuf>,
    /// Record a bend log from the first cycle on, with a flight log beside it.
    #[arg(long)]
    record: Option<PathBuf>,
    /// Number of the simulated unit.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Run a simulation this many times as fast as real time; without a number, as fast as possible. Default 1.
    #[arg(long, value_name = "FACTOR", num_args = 0..=1, default_missing_value = "inf", value_parser = within(0.1..=f64::INFINITY, "or nothing"))]
    fast: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// A report about the input, the machine or the system.
pub fn run(args: &Args) -> Result<()> {
    let _logging = logging::start();
    let foreign = args.plant.is_some();
    let own_board = || inputs::own_board().filter(|_| !foreign);
    let path = args.board.clone().or_else(own_board);
    let own = Path::new(if foreign { "sim" } else { "demo" });
    let mut board = inputs::board(Some(path.as_deref().unwrap_or(own)))?;
    let shown = path.as_ref().map(|p| p.display().to_string());
    let shown = shown.unwrap_or("a simulated tip, because there is no board file".to_owned());
    let gains = inputs::gains(args.gains.as_deref())?;
    let calibration = inputs::calibration(args.calib.as_deref())?;
    let tip = check_tip(args, &calibration)?;
    if args.fast.is_some() && !foreign && board.plant.is_none() {
        bail!(
            "--fast: only a simulation can run faster than real time; give --plant, or a board with a [plant] table"
        );
    }
    tracing::info!(event = "board", "board: {shown}");
    let feedforward = inputs::feedforward(&args.feedforward, &args.calib, &calibration, &board)?;
    let mut texts = inputs::texts(&board, &gains, &calibration);
    if let Some((path, _)) = &feedforward {
        texts.push(source::text_of(path)?);
    }
    place(args, &mut board.service)?;
    let bound = PressureBound::of(&board);
    if !foreign && !bound.is_bounded {
        tracing::warn!("pressure: {}; {}", bound.says, PressureBound::REMEDY);
    }
    let claim = Claim::new(&board.service).map_err(report)?;
    let machine = open(args, path.as_deref(), &board)?;
    let mut supervisor = supervisor::assemble(&board, &calibration, &gains, machine.info());
    let mut model = None;
    if let Some((path, machine)) = feedforward {
        supervisor.tick = supervisor.tick.fed_forward(machine);
        model = Some(path);
    }
    let config = RunConfig {
        supervisor,
        service: board.service.clone(),
        config_hash: hash(texts.iter().map(String::as_str)),
        texts,
        board,
        gains: args.gains.clone(),
        calibration,
        calib: args.calib.clone(),
        feedforward: model,
        tip,
    };
    let pace = args.fast.or(machine.is_simulated().then_some(1.0));
    serve(claim, machine, config, pace, args.record.clone()).map_err(report)
}

fn report(error: ServiceError) -> miette::Report {
    match error {
        ServiceError::Machine(_) | ServiceError::LoopPanicked => {
            Unreachable::report("the machine", error)
        }
        _ => miette!("{error}"),
    }
}

/// The folders and files that the command line names in place of the board's.
fn place(args: &Args, service: &mut ServiceSection) -> Result<()> {
    if args.socket.is_some() {
        (service.socket, service.status_socket) = (args.socket.clone(), None);
    }
    service.state = args.state.clone().or(service.state.take());
    let record = args.record.as_deref();
    record.map_or(Ok(()), |path| check_record(path, service))
}

/// Refuses a recording whose files exist already or cannot be written.
fn check_record(path: &Path, bounds: &ServiceSection) -> Result<()> {
    let shown = path.display();
    let refused = |e| {
        miette!("--record {shown}: {e}; give a new name in a folder that this user may write to")
    };
    make_room(path, bounds).map_err(refused)?;
    let try_out = |file: &Path| File::create_new(file).and_then(|_| std::fs::remove_file(file));
    let tried = try_out(path).and_then(|()| try_out(&flight_path(path)));
    tried.map_err(refused)
}

/// The mounted tip. A calibration file of another tip is refused unless it is accepted explicitly.
fn check_tip(args: &Args, calibration: &Calibration) -> Result<String> {
    let made_on = &calibration.transmission.tip;
    let Some(tip) = &args.tip else {
        return Ok(made_on.clone());
    };
    match &args.calib {
        Some(path) if !made_on.is_empty() && made_on != tip && !args.foreign_calibration => {
            Err(miette!(
                "{}: this calibration was made on tip `{made_on}`, but tip `{tip}` is mounted; calibrate this tip (`retroflex calibrate transmission`), or give --foreign-calibration to use it anyway",
                path.display()
            ))
        }
        _ => Ok(tip.clone()),
    }
}

/// Opens the hardware. For a service manager it is waited for, as after a boot, unless it was open since then: the file `opened` says
/// so, the drivers may be energised, and a failure counts as one.
fn open_patiently(config: &MachineConfig, opened: &Path) -> Result<Hardware, HardwareError> {
    let manager = Notifier::from_env();
    let mut said = String::new();
    loop {
        let error = match Hardware::open(config) {
            Ok(hardware) => {
                // without the file, a later failure is waited for too
                let _ = disk::open(OpenOptions::new().write(true).create(true), opened);
                return Ok(hardware);
            }
            Err(error) => error,
        };
        if !manager.is_there() || error.is_config() || opened.exists() {
            return Err(error);
        }
        let why = error.to_string();
        manager.notify(&format!(
            "EXTEND_TIMEOUT_USEC=30000000\nSTATUS=waiting for the hardware: {why}"
        ));
        if said != why {
            tracing::warn!(event = "waiting", "waiting for the hardware: {why}");
            said = why;
        }
        std::thread::sleep(HARDWARE_AGAIN);
    }
}

/// Opens the machine of the board, or the external plant.
fn open(args: &Args, path: Option<&Path>, board: &Board) -> Result<Box<dyn Machine>> {
    if let Some(plant) = &args.plant {
        let (program, args) = inputs::program(plant)?;
        let link = Link::start(&program, &args).into_diagnostic()?;
        return Ok(Box::new(Lockstep::new(link, &board.drive_limits())));
    }
    if let Some(config) = board.hardware() {
        let path = path.unwrap_or(Path::new("the built-in board"));
        let opened = Paths::of(&board.service).control.with_extension("opened");
        let refused = |e| manual_motion::hardware_error(path, e);
        return Ok(Box::new(open_patiently(&config, &opened).map_err(refused)?));
    }
    manual_motion::simulated(board, args.seed, 1)?.ok_or_else(|| {
        miette!("this board has neither [pins] nor [plant], so there is no machine to run; give --plant, or a board that describes one")
    })
}
