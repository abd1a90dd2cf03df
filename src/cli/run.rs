//! `retroflex run`: the service, in the foreground or under systemd.

use crate::cli::{CommandOutcome, Unreachable, inputs, logging, manual_motion};
use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::show;
use crate::config::supervisor::assemble;
use crate::hardware::machine::Hardware;
use crate::service::{ServiceError, Setup, serve};
use crate::simulation::link::{self, Link};
use crate::simulation::lockstep::Lockstep;
use crate::simulation::sim::Sim;
use crate::supervisor::machine::Machine;
use miette::{IntoDiagnostic, Result, miette};
use std::path::{Path, PathBuf};

/// Arguments of `run`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file; without it the paper twin, on its built-in plant.
    #[arg(long)]
    board: Option<PathBuf>,
    /// Run on a foreign plant: `exec:PROGRAM ARG…`.
    #[arg(long)]
    plant: Option<String>,
    /// Calibration file of the tip that is mounted.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// Gains file.
    #[arg(long)]
    gains: Option<PathBuf>,
    /// Identity of the tip that is mounted; without it the calibration's.
    #[arg(long)]
    tip: Option<String>,
    /// Use a calibration that was made on another tip, on purpose.
    #[arg(long)]
    foreign_calibration: bool,
    /// Socket for commands, in place of the board's; the status socket is made beside it.
    #[arg(long)]
    socket: Option<PathBuf>,
    /// Folder of what must survive, in place of the board's.
    #[arg(long)]
    state: Option<PathBuf>,
    /// Record a bend log with its tape from the first turn on.
    #[arg(long)]
    record: Option<PathBuf>,
    /// Which unit of the built-in plant's make.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Do not wait for the clock: a plant as fast as it goes.
    #[arg(long)]
    fast: bool,
}

/// Runs the command.
///
/// # Errors
/// A report that says what was wrong with the input, the machine or the system.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    logging::start();
    let mut setup = prepare(args)?;
    setup.service.socket = args.socket.clone().unwrap_or(setup.service.socket);
    if let Some(socket) = &args.socket {
        setup.service.status_socket = socket.with_file_name("status.sock");
    }
    setup.service.state = args.state.clone().unwrap_or(setup.service.state);
    match serve(setup) {
        Ok(()) => Ok(CommandOutcome::Good),
        Err(e @ (ServiceError::World(_) | ServiceError::Died)) => {
            Err(Unreachable { what: "the machine".to_owned(), why: e.to_string() }.into())
        }
        Err(e) => Err(miette!("{e}")),
    }
}

fn prepare(args: &Args) -> Result<Setup> {
    let board = inputs::board(args.board.as_deref())?;
    let gains = inputs::gains(args.gains.as_deref())?;
    let calibration = inputs::calibration(args.calib.as_deref())?;
    let tip = check_tip(args, &calibration)?;
    if args.fast && (args.plant.is_none() && board.plant.is_none()) {
        return Err(miette!("--fast: only a plant can run faster than the clock; give --plant, or a board with a [plant] table"));
    }
    let machine = open(args, &board, &calibration)?;
    let supervisor = assemble(&board, &calibration, &gains, machine.info());
    let texts = [show::compact(&board), show::compact(&gains), show::compact(&calibration)];
    Ok(Setup {
        machine,
        supervisor,
        service: board.service.clone(),
        config_hash: hash(&texts),
        texts,
        board,
        gains: args.gains.clone(),
        gains_now: gains,
        calibration,
        tip,
        fast: args.fast,
        record: args.record.clone(),
    })
}

/// The tip that is mounted, if the calibration is its own or is taken on purpose.
fn check_tip(args: &Args, calibration: &Calibration) -> Result<String> {
    let made_on = &calibration.transmission.tip;
    let Some(tip) = &args.tip else { return Ok(made_on.clone()) };
    // what the program carries is the prior of every tip of its make
    let own = args.calib.is_some();
    if own && !made_on.is_empty() && made_on != tip && !args.foreign_calibration {
        let path = args.calib.as_deref().unwrap_or(Path::new("")).display();
        return Err(miette!(
            "{path}: was made on tip `{made_on}`, mounted is `{tip}`; calibrate this tip (`retroflex calibrate transmission`), or say --foreign-calibration to use it all the same"
        ));
    }
    Ok(tip.clone())
}

/// Opens what the board describes, or the foreign plant.
///
/// # Errors
/// A report; [`Unreachable`] where hardware does not answer.
pub fn open(args: &Args, board: &Board, _calibration: &Calibration) -> Result<Box<dyn Machine>> {
    if let Some(plant) = &args.plant {
        let line = plant.strip_prefix("exec:").ok_or_else(|| miette!("--plant `{plant}`: expected `exec:PROGRAM ARG…`"))?;
        let mut words = link::words(line).map_err(|why| miette!("--plant `{plant}`: {why}"))?.into_iter();
        let program = words.next().ok_or_else(|| miette!("--plant `{plant}`: no program is named after `exec:`"))?;
        let args: Vec<String> = words.collect();
        return Ok(Box::new(Lockstep::new(Link::start(&program, &args).into_diagnostic()?)));
    }
    if let Some(config) = board.hardware() {
        let path = args.board.as_deref().unwrap_or(Path::new("the built-in board"));
        return Ok(Box::new(Hardware::open(&config).map_err(|e| manual_motion::hardware_error(path, e))?));
    }
    let section = board.plant.clone().ok_or_else(|| {
        miette!("this board has neither [pins] nor [plant], so there is nothing to run on; give --plant, or a board that describes one")
    })?;
    Ok(Box::new(Lockstep::new(Sim::new(&section.make(), args.seed, 1, section.period_s).into_diagnostic()?)))
}

/// FNV-1a over the texts, in hex: the same configuration has the same hash.
#[must_use]
pub fn hash(texts: &[String]) -> String {
    let bytes = texts.iter().flat_map(|t| t.bytes().chain([0]));
    format!("{:016x}", bytes.fold(0xcbf2_9ce4_8422_2325u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)))
}
