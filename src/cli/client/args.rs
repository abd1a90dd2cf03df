//! Arguments of the commands to a running service.

use super::At;
use std::path::PathBuf;

/// Arguments of `bend`.
#[derive(Debug, clap::Args)]
pub struct BendArgs {
    /// Where the service is.
    #[command(flatten)]
    pub(super) at: At,
    /// Bend angle, degrees.
    pub(super) bend: f64,
    /// Bend direction, degrees.
    #[arg(long, default_value_t = 0.0)]
    pub(super) toward: f64,
    /// Centre length, mm; without it that at rest.
    #[arg(long)]
    pub(super) length: Option<f64>,
    /// Speed of the set-point, °/s; without it that of the gains file.
    #[arg(long)]
    pub(super) speed: Option<f64>,
    /// Follow the move and end when it has settled.
    #[arg(long)]
    pub(super) wait: bool,
}

/// Arguments of `status`.
#[derive(Debug, clap::Args)]
pub struct StatusArgs {
    /// Where the service is.
    #[command(flatten)]
    pub(super) at: At,
    /// As JSON.
    #[arg(long)]
    pub(super) json: bool,
    /// Again and again.
    #[arg(long)]
    pub(super) watch: bool,
}

/// Arguments of `record`.
#[derive(Debug, clap::Args)]
pub struct RecordArgs {
    /// Where the service is.
    #[command(flatten)]
    pub(super) at: At,
    /// Begin or end.
    #[arg(value_enum)]
    pub(super) action: Action,
    /// Name of the recording.
    pub(super) name: Option<String>,
}

/// Begin or end.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Action {
    /// Begin.
    Start,
    /// End.
    Stop,
}

/// Arguments of `play`.
#[derive(Debug, clap::Args)]
pub struct PlayArgs {
    /// Where the service is.
    #[command(flatten)]
    pub(super) at: At,
    /// Rows `bend_deg,dir_deg,len_mm,hold_s,speed_mm_s`.
    #[arg(value_name = "SCHEDULE.csv")]
    pub(super) schedule: PathBuf,
    /// Record it under this name.
    #[arg(long)]
    pub(super) record: Option<String>,
}

/// Arguments of `subscribe`.
#[derive(Debug, clap::Args)]
pub struct SubscribeArgs {
    /// Where the service is.
    #[command(flatten)]
    pub(super) at: At,
    /// Frames a second.
    #[arg(long, default_value_t = 20.0)]
    pub(super) rate: f64,
}

/// Arguments of `calibrate transmission`.
#[derive(Debug, clap::Args)]
pub struct TransmissionArgs {
    /// Where the service is.
    #[command(flatten)]
    pub(super) at: At,
    /// Twenty-four poses with the calibration in use as prior, in place of Algorithm 1 from zero.
    #[arg(long, conflicts_with_all = ["accept", "discard"])]
    pub(super) short: bool,
    /// Put what was found in use.
    #[arg(long, conflicts_with = "discard")]
    pub(super) accept: bool,
    /// Forget what was found.
    #[arg(long)]
    pub(super) discard: bool,
}
