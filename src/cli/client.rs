//! The commands that talk to a running service, one request each.

use crate::cli::CommandOutcome;
use crate::service::protocol::{RecordAction, Request};
use args::{Action, BendArgs, PlayArgs, RecordArgs, StatusArgs, SubscribeArgs};
use connection::{At, ask_and_print, connect};
use miette::Result;

pub mod args;
pub mod connection;
pub mod follow;
pub mod keys;
pub mod monitor;
pub mod page;
pub mod play;
pub mod status;
pub mod steer;
pub mod stream;

/// Commands to a running service.
#[derive(Debug, clap::Subcommand)]
pub enum Client {
    /// Bend the tip.
    #[command(allow_negative_numbers = true)]
    Bend(BendArgs),
    /// Decelerate smoothly and hold.
    Hold(Plain),
    /// Brake at once and hold; motion is refused until `arm`.
    Stop(Plain),
    /// Return to rest slowly, then de-energise.
    Relax(Plain),
    /// Energise the drivers and hold the present pose.
    ///
    /// Waits for the end of an alignment that is in progress.
    Arm(Plain),
    /// Accept no more motion.
    Disarm(Plain),
    /// Define the present pose as zero bend.
    Zero(ZeroArgs),
    /// Show the state of the service.
    Status(StatusArgs),
    /// Watch tip, lines and gains, live or from a flight log.
    Monitor(monitor::MonitorArgs),
    /// Clear a fault whose cause has been removed.
    ResetFault(Plain),
    /// Read the gains file again and apply it without a jump.
    Reload(Plain),
    /// Start or stop a recording.
    Record(RecordArgs),
    /// Run a schedule of `gap excite`: its poses, speeds and holds.
    Play(PlayArgs),
    /// Stream set-points from standard input.
    ///
    /// One per line, `BEND DIR` or `BEND DIR T` (degrees, and seconds if the tip shall follow a smooth curve through them). The tip stops when
    /// the stream pauses, and comes to rest at the last set-point when it ends.
    Stream(Plain),
    /// Bend the tip by hand, with a joystick or the arrow keys.
    ///
    /// It moves while a button is held.
    Steer(steer::SteerArgs),
    /// Serve a page for a tablet: the tip in 3-D, bend by hand, stop.
    Page(page::PageArgs),
    /// Print frames as JSON lines.
    Subscribe(SubscribeArgs),
}

/// A command without arguments of its own.
#[derive(Debug, clap::Args)]
pub struct Plain {
    #[command(flatten)]
    at: At,
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

/// Runs a command.
///
/// # Errors
/// A report with the service's message.
pub fn run(command: &Client) -> Result<CommandOutcome> {
    match command {
        Client::Bend(args) => follow::bend(args),
        Client::Hold(p) => send(&p.at, &Request::Hold {}),
        Client::Stop(p) => connection::stop(&p.at),
        Client::Relax(p) => send(&p.at, &Request::Relax {}),
        Client::Arm(p) => follow::arm(&p.at),
        Client::Disarm(p) => send(&p.at, &Request::Disarm {}),
        Client::Zero(args) => send_and_align(
            &args.at,
            &Request::Zero {
                straight: args.straight,
            },
        ),
        Client::ResetFault(p) => send(&p.at, &Request::ResetFault {}),
        Client::Reload(p) => send(&p.at, &Request::Reload {}),
        Client::Status(args) => status::status(args),
        Client::Monitor(args) => monitor::monitor(args),
        Client::Record(args) => {
            let request = |action| Request::Record {
                action,
                name: args.name.clone(),
                owned: false,
            };
            match args.action {
                // a recording that starts at rest starts with a new alignment
                Action::Start => send_and_align(&args.at, &request(RecordAction::Start)),
                Action::Stop => send(&args.at, &request(RecordAction::Stop)),
            }
        }
        Client::Play(args) => play::play(args),
        Client::Steer(args) => steer::steer(args),
        Client::Stream(p) => stream::stream(&p.at),
        Client::Page(args) => page::page(args),
        Client::Subscribe(args) => status::subscribe(args),
    }
}

fn send(at: &At, request: &Request) -> Result<CommandOutcome> {
    ask_and_print(&mut connect(at)?, request)
}

/// Sends a request that starts an alignment, and waits for its end.
fn send_and_align(at: &At, request: &Request) -> Result<CommandOutcome> {
    let mut connection = connect(at)?;
    match ask_and_print(&mut connection, request)? {
        CommandOutcome::Good => follow::aligned(&mut connection),
        refused => Ok(refused),
    }
}
