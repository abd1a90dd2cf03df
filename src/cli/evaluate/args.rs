//! Arguments of `evaluate`.

use crate::cli::ResultFile;
use crate::experiment::evaluation::Arm;
use clap::builder::PossibleValue;
use std::path::PathBuf;

/// Arguments of `evaluate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Simulator to run on, `exec:PROGRAM ARG…` or `model:MODEL.toml`, the machine that a diagnosis describes; the default is the built-in plant of the board.
    #[arg(long)]
    pub(super) plant: Option<String>,
    /// Board file; the default is the paper twin.
    #[arg(long)]
    pub(super) board: Option<PathBuf>,
    /// Calibration file; by default the gains are first identified from zero.
    #[arg(long)]
    pub(super) calib: Option<PathBuf>,
    /// Gains file.
    #[arg(long)]
    pub(super) gains: Option<PathBuf>,
    /// Model saved by `gap diagnose --save`, through which the arms `diagnosed` and `closed` are fed forward. Without it,
    /// `diagnosed` records and diagnoses a log of its own and `closed` uses the nominal model.
    #[arg(long, value_name = "MODEL.toml", conflicts_with_all = ["sweep", "ablate"])]
    pub(super) feedforward: Option<PathBuf>,
    /// Write the result as JSON to this file (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub(super) json: Option<ResultFile>,
    /// Write the result as one HTML page with charts.
    #[arg(long)]
    pub(super) html: Option<ResultFile>,
    /// Write the charts as one SVG drawing.
    #[arg(long)]
    pub(super) svg: Option<ResultFile>,
    /// Arms to run; by default all five, and none with --track.
    #[arg(long, value_delimiter = ',')]
    pub(super) arms: Option<Vec<Arm>>,
    /// Path to drive in closed loop (CSV: t_s, bend_deg, dir_deg and, if wanted, len_mm), after a move to its first point.
    #[arg(long, value_name = "FILE")]
    pub(super) track: Option<PathBuf>,
    /// With --track: each point of the path becomes known only at its time, as from a joystick.
    #[arg(long, requires = "track", conflicts_with_all = ["sweep", "ablate"])]
    pub(super) live: bool,
    /// Seed of the built-in plant, which selects the simulated unit and its noise. A described machine (`model:`) takes its noise from
    /// it, a simulator (`exec:`) nothing.
    #[arg(long, default_value_t = 0)]
    pub(super) seed: u64,
    /// Instead of the arms: the closed loop and the best open loop over conditions, with the paper's calibration unless
    /// another is given; exit code 1 if a row fails.
    #[arg(long, group = "study", conflicts_with_all = ["plant", "html", "arms", "ablate", "track"])]
    pub(super) sweep: bool,
    /// With --sweep or --ablate: only the conditions whose name contains this text.
    #[arg(long, requires = "study", value_name = "TEXT")]
    pub(super) only: Option<String>,
    /// Instead of the arms: the closed loop with each of its mechanisms off in turn, over the conditions of --sweep.
    #[arg(long, group = "study", conflicts_with_all = ["plant", "html", "svg", "arms", "track"])]
    pub(super) ablate: bool,
}

impl clap::ValueEnum for Arm {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }
    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name()))
    }
}
