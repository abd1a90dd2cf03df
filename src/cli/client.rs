//! The commands that talk to a running service, one request each.

use crate::service::protocol::{RecordAction, Request};
use connection::{At, ask_and_print, connect};
use miette::Result;

pub mod connection;
pub mod follow;
pub mod keys;
pub mod monitor;
pub mod page;
pub mod play;
pub mod status;
pub mod steer;
pub mod stream;

commands! {
    /// Commands to a running service.
    pub enum Client;

    /// Bend the tip.
    #[command(allow_negative_numbers = true)]
    Bend(follow::BendArgs) => follow::bend,
    /// Decelerate smoothly and hold.
    Hold(At) => |at: &At| send(at, &Request::Hold {}),
    /// Brake at once and hold; motion is refused until `arm`.
    Stop(At) => connection::stop,
    /// Return to rest slowly, then de-energise.
    Relax(At) => |at: &At| send(at, &Request::Relax {}),
    /// Energise the drivers and hold the present pose.
    ///
    /// Waits for the end of an alignment that is in progress.
    Arm(At) => follow::arm,
    /// Accept no more motion.
    Disarm(At) => |at: &At| send(at, &Request::Disarm {}),
    /// Define the present pose as zero bend.
    Zero(ZeroArgs) => zero,
    /// Show the state of the service.
    Status(status::StatusArgs) => status::status,
    /// Watch tip, lines and gains, live or from a flight log.
    Monitor(monitor::MonitorArgs) => monitor::monitor,
    /// Clear a fault whose cause has been removed.
    ResetFault(At) => |at: &At| send(at, &Request::ResetFault {}),
    /// Read the gains file again and apply it without a jump.
    Reload(At) => |at: &At| send(at, &Request::Reload {}),
    /// Start or stop a recording.
    Record(RecordArgs) => record,
    /// Run a schedule of `gap excite`: its poses, speeds and holds.
    Play(play::PlayArgs) => play::play,
    /// Stream set-points from standard input.
    ///
    /// One per line, `BEND DIR` or `BEND DIR T` (degrees, and seconds if the tip shall follow a smooth curve through them). The tip stops when
    /// the stream pauses, and comes to rest at the last set-point when it ends.
    Stream(At) => stream::stream,
    /// Bend the tip by hand, with a joystick or the arrow keys.
    ///
    /// It moves while a button is held.
    Steer(steer::SteerArgs) => steer::steer,
    /// Serve a page for a tablet: the tip in 3-D, bend by hand, stop.
    Page(page::PageArgs) => page::page,
    /// Print frames as JSON lines.
    Subscribe(status::SubscribeArgs) => status::subscribe,
}

/// Arguments of `zero`.
#[derive(Debug, clap::Args)]
pub struct ZeroArgs {
    #[command(flatten)]
    at: At,
    /// State that the tip is straight, where no remembered attitude confirms it. The status shows such a zero as unverified.
    #[arg(long)]
    straight: bool,
}

/// Arguments of `record`.
#[derive(Debug, clap::Args)]
pub struct RecordArgs {
    #[command(flatten)]
    at: At,
    /// Start or stop.
    #[arg(value_enum)]
    action: RecordAction,
    /// Name of the recording. Default: the next free number.
    name: Option<String>,
}

fn zero(args: &ZeroArgs) -> Result<()> {
    let straight = args.straight;
    send_and_align(&args.at, &Request::Zero { straight })
}

fn record(args: &RecordArgs) -> Result<()> {
    let request = Request::Record {
        action: args.action,
        name: args.name.clone(),
        owned: false,
    };
    match args.action {
        // a recording that starts at rest starts with a new alignment
        RecordAction::Start => send_and_align(&args.at, &request),
        RecordAction::Stop => send(&args.at, &request),
    }
}

fn send(at: &At, request: &Request) -> Result<()> {
    ask_and_print(&mut connect(at)?, request)
}

/// Sends a request that starts an alignment, and waits for its end.
fn send_and_align(at: &At, request: &Request) -> Result<()> {
    let mut connection = connect(at)?;
    ask_and_print(&mut connection, request)?;
    follow::aligned(&mut connection)
}
