//! `retroflex foxglove`: the topics of the flight log, live, for Foxglove and Lichtblick.
//!
//! The command follows the log that the service writes and serves each message as it stands there, so that live and recorded data
//! have the same topics and schemas, and the service itself keeps no network. A viewer that comes later is shown what each topic has shown last.

mod viewers;

use crate::cli::{inputs, output};
use crate::service::flight::log::flights;
use crate::service::flight::read::Tail;
use crate::service::paths::flight_folders;
use miette::{IntoDiagnostic, Result, bail};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use viewers::Viewers;

/// Time until it is looked again whether more has been written.
const AGAIN: Duration = Duration::from_millis(50);
/// The service writes several messages at once. They are served over this share of the time that lies between them, so that what is
/// shown moves smoothly; over the second one if more is written already.
const PACE: [f64; 2] = [0.9, 0.5];
/// Longest such time, s.
const PACED_MAX_S: f64 = 1.0;

/// Arguments of `foxglove`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of the flight logs; default: that of this user's service or the system's, whichever writes.
    #[arg(long, value_name = "FOLDER")]
    flights: Option<PathBuf>,
    /// Address and port. Whoever reaches the address may watch.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8765")]
    listen: SocketAddr,
}

/// Serves until the process is ended.
///
/// # Errors
/// A report about the folder or the address.
pub fn run(args: &Args) -> Result<()> {
    let folders = match &args.flights {
        Some(folder) if !folder.is_dir() => bail!(
            "--flights {}: there is no such folder; name the folder `flights` in the state folder of the service",
            folder.display()
        ),
        Some(folder) => vec![folder.clone()],
        None => flight_folders(),
    };
    let (address, listener) = inputs::listen(args.listen)?;
    output::print(format!("ws://{address}\n"));
    let viewers = Viewers::start(listener).into_diagnostic()?;
    let (mut followed, mut said) = (Followed::default(), String::new());
    loop {
        let (written, remark) = match followed.next(&folders) {
            Ok(None) if followed.log.is_none() => (None, waiting(&folders)),
            Ok(written) => (written, String::new()),
            Err(e) => (None, format!("the flight log cannot be read: {e}\n")),
        };
        // once, and again only after something else
        if remark != said {
            eprint!("{remark}");
            said = remark;
        }
        match written {
            Some(written) => serve(&viewers, written),
            None => std::thread::sleep(AGAIN),
        }
    }
}

/// What is said as long as no service writes a log.
fn waiting(folders: &[PathBuf]) -> String {
    let found = folders.iter().map(|folder| {
        let why = flights(folder).map_or_else(|e| e.kind().to_string(), |_| "empty".to_owned());
        format!("{} ({why})", folder.display())
    });
    let found = found.collect::<Vec<_>>().join(" or ");
    format!("there is no flight log yet; waiting for one in {found}\n")
}

/// Serves messages in their own time.
fn serve(viewers: &Viewers, (messages, pace): Written) {
    let (began, first_ns) = (Instant::now(), messages.first().map_or(0, |m| m.log_time));
    for message in messages {
        let since_s = message.log_time.saturating_sub(first_ns) as f64 * 1e-9;
        let due_s = since_s.min(PACED_MAX_S) * pace.unwrap_or(0.0);
        let left_s = due_s - began.elapsed().as_secs_f64();
        std::thread::sleep(Duration::try_from_secs_f64(left_s).unwrap_or_default());
        viewers.show(&message, pace.is_some());
    }
}

/// Messages, and over which share of their time they are to be served; without it they are only kept.
type Written = (Vec<mcap::Message<'static>>, Option<f64>);

/// The log that is followed.
#[derive(Default)]
struct Followed {
    log: Option<(PathBuf, Tail)>,
    /// What was written before the command began has been read.
    live: bool,
    /// More was written when the last messages had been served.
    behind: bool,
}

impl Followed {
    /// What is written next; `None` if there is nothing more at present.
    fn next(&mut self, folders: &[PathBuf]) -> std::io::Result<Option<Written>> {
        if let Some((_, tail)) = &mut self.log
            && let Some(messages) = tail.next_record()?
        {
            let pace = self.live.then_some(PACE[usize::from(self.behind)]);
            self.behind = true;
            return Ok(Some((messages, pace)));
        }
        self.behind = false;
        let newest = newest(folders);
        if newest.as_deref() == self.log.as_ref().map(|(path, _)| path.as_path()) {
            self.live = true;
            return Ok(None);
        }
        let open = |path: PathBuf| Tail::open(&path).map(|tail| (path, tail));
        self.log = newest.map(open).transpose()?;
        Ok(None)
    }
}

/// The log that was written last.
fn newest(folders: &[PathBuf]) -> Option<PathBuf> {
    let written = |path: &PathBuf| path.metadata().and_then(|m| m.modified()).ok();
    let newest = |folder: &PathBuf| flights(folder).ok()?.pop();
    folders.iter().filter_map(newest).max_by_key(written)
}
