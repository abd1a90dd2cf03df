//! Arguments of the commands to a running service.

use super::connection::At;
use crate::cli::inputs::within;
use crate::cli::output::ResultFile;
use crate::service::protocol::POSES;
use clap::builder::TypedValueParser;
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// Bends that may be asked for, degrees. How far the tip reaches in a direction depends on the machine, and the service says it.
pub(super) const BEND_DEG: RangeInclusive<f64> = -135.0..=135.0;
/// Directions that may be asked for, degrees.
pub(super) const DIR_DEG: RangeInclusive<f64> = -360.0..=360.0;

/// Arguments of `bend`.
#[derive(Debug, clap::Args)]
pub struct BendArgs {
    #[command(flatten)]
    pub(super) at: At,
    /// Bend angle, degrees.
    #[arg(value_parser = within(BEND_DEG, "degrees"))]
    pub(super) bend: f64,
    /// Bend direction, degrees.
    #[arg(long, default_value_t = 0.0, value_parser = within(DIR_DEG, "degrees"))]
    pub(super) toward: f64,
    /// Length of the centre line, mm. Default: the rest length.
    #[arg(long, value_parser = within(5.0..=200.0, "mm"))]
    pub(super) length: Option<f64>,
    /// Speed of the set-point, °/s. Default: that of the gains file.
    #[arg(long, value_parser = within(0.1..=720.0, "°/s"))]
    pub(super) speed: Option<f64>,
    /// Wait until the tip has settled.
    #[arg(long)]
    pub(super) wait: bool,
    /// Keep the orientation in the world that the bend has now, while the base turns. Needs an IMU on the base.
    #[arg(long, conflicts_with = "wait")]
    pub(super) world: bool,
}

/// Arguments of `status`.
#[derive(Debug, clap::Args)]
pub struct StatusArgs {
    #[command(flatten)]
    pub(super) at: At,
    /// Write the state as JSON to this file; without a name, or with `-`, to standard output.
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    pub(super) json: Option<ResultFile>,
    /// Repeat twice a second.
    #[arg(long)]
    pub(super) watch: bool,
}

/// Arguments of `record`.
#[derive(Debug, clap::Args)]
pub struct RecordArgs {
    #[command(flatten)]
    pub(super) at: At,
    /// Start or stop.
    #[arg(value_enum)]
    pub(super) action: Action,
    /// Name of the recording. Default: the next free number.
    pub(super) name: Option<String>,
}

/// What to do with a recording.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Action {
    /// Start a recording.
    Start,
    /// Stop it.
    Stop,
}

/// Arguments of `play`.
#[derive(Debug, clap::Args)]
pub struct PlayArgs {
    #[command(flatten)]
    pub(super) at: At,
    /// Rows `bend_deg,dir_deg,len_mm,hold_s,speed_mm_s`, or a path of rows `t_s,bend_deg,dir_deg[,len_mm]`.
    #[arg(value_name = "SCHEDULE.csv")]
    pub(super) schedule: PathBuf,
    /// Record the schedule under this name.
    #[arg(long)]
    pub(super) record: Option<String>,
}

/// Arguments of `subscribe`.
#[derive(Debug, clap::Args)]
pub struct SubscribeArgs {
    #[command(flatten)]
    pub(super) at: At,
    /// Frames per second.
    #[arg(long, default_value_t = 20.0, value_parser = within(0.1..=1000.0, "Hz"))]
    pub(super) rate: f64,
}

/// Arguments of `calibrate transmission`.
#[derive(Debug, clap::Args)]
pub struct TransmissionArgs {
    #[command(flatten)]
    pub(super) at: At,
    /// Use a few poses and the present calibration as prior, instead of Algorithm 1 from zero gains.
    #[arg(long, conflicts_with_all = ["accept", "discard"])]
    pub(super) short: bool,
    /// Poses of a short calibration, 6 to 24. With the prior of a fleet (`retroflex fleet --prior`), 12 do.
    #[arg(long, requires = "short", default_value_t = *POSES.end(), value_parser = clap::value_parser!(u8).range(6..=24).map(usize::from))]
    pub(super) poses: usize,
    /// Apply the proposed calibration.
    #[arg(long, conflicts_with = "discard")]
    pub(super) accept: bool,
    /// Discard the proposed calibration.
    #[arg(long)]
    pub(super) discard: bool,
    /// Write the proposed calibration as JSON to this file (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub(super) json: Option<ResultFile>,
    /// Write the proposed calibration as a page.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["accept", "discard"])]
    pub(super) html: Option<ResultFile>,
}
