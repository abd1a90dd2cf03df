//! `monitor`: the state of the tip on the terminal, of a running service, or of a flight log.

pub mod draw;
pub mod player;
pub mod view;

use super::connection::{At, Connection, report, socket};
use super::keys::{Key, keys};
use crate::cli::{flight, inputs, within};
use crate::service::{Failure, Request, paths};
use miette::{IntoDiagnostic, Result, bail};
use player::Player;
use ratatui::DefaultTerminal;
use serde_json::Value;
use std::io::{IsTerminal, Read, stdin, stdout};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};
use view::View;

/// Time between two frames.
const PERIOD: Duration = Duration::from_millis(100);
/// Silence after which a service counts as lost, s.
const SILENT_S: f64 = 1.0;
/// Step of the arrow keys in a log, s.
const SEEK_S: f64 = 5.0;

/// Ctrl-C on a terminal that does not translate it.
const INTERRUPT: char = '\u{3}';

/// Arguments of `monitor`.
#[derive(Debug, clap::Args)]
pub struct MonitorArgs {
    #[command(flatten)]
    at: At,
    /// Flight log to show, or bend log that was recorded with one. Default: the running service.
    #[arg(conflicts_with = "socket")]
    log: Option<PathBuf>,
    /// Pace of a log, in multiples of real time.
    #[arg(long, default_value_t = 1.0, requires = "log", value_parser = within(0.1..=100.0, "times real time"))]
    speed: f64,
}

/// Where the frames come from.
trait Source {
    /// Shows what has come since the last frame.
    fn update(&mut self, view: &mut View);

    /// Acts on a key.
    fn key(&mut self, key: Key);
}

/// Shows the state until the operator ends it.
///
/// # Errors
/// A report about a log or a terminal that cannot be used, or a service that cannot be reached.
pub fn monitor(args: &MonitorArgs) -> Result<()> {
    let open = |log: &PathBuf| Player::open(&flight::flight_of(log)?, args.speed);
    let log = args.log.as_ref().map(open).transpose()?;
    if !stdin().is_terminal() || !stdout().is_terminal() {
        bail!("the monitor needs a terminal; elsewhere, use `retroflex status --watch`");
    }
    let mut source: Box<dyn Source> = match log {
        Some(player) => Box::new(player),
        None => Box::new(Live::start(socket(&args.at)?)?),
    };
    let ended = inputs::ended()?;
    // this also restores the terminal after a panic
    let mut terminal = ratatui::try_init().into_diagnostic()?;
    let (keys, mut view) = (pressed(), View::default());
    while !ended.load(Relaxed) && show(&mut terminal, &keys, &mut *source, &mut view) {}
    // a terminal that is gone cannot be restored
    let _ = (terminal.show_cursor(), ratatui::try_restore());
    std::mem::forget(terminal);
    Ok(())
}

/// Draws once and handles the keys until the next frame is due; false if the operator ends the monitor, or the terminal is gone.
fn show(
    terminal: &mut DefaultTerminal,
    keys: &Receiver<Key>,
    source: &mut dyn Source,
    view: &mut View,
) -> bool {
    let due = Instant::now() + PERIOD;
    source.update(view);
    let mut drawn = terminal.draw(|frame| draw::draw(frame, view)).is_ok();
    while drawn && Instant::now() < due {
        match keys.recv_timeout(due.saturating_duration_since(Instant::now())) {
            Ok(Key::Char('q' | INTERRUPT)) | Err(RecvTimeoutError::Disconnected) => drawn = false,
            Ok(key) => source.key(key),
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
    drawn
}

/// The keys of the terminal, until that is gone. A thread of its own reads them, so that no input delays the screen.
fn pressed() -> Receiver<Key> {
    let (send, pressed) = channel();
    spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(n @ 1..) = stdin().lock().read(&mut bytes) {
            for key in keys(&bytes[..n]) {
                // the monitor may have ended
                let _ = send.send(key);
            }
        }
    });
    pressed
}

impl Source for Player {
    fn update(&mut self, view: &mut View) {
        self.advance(PERIOD.as_secs_f64(), view);
    }

    fn key(&mut self, key: Key) {
        match key {
            Key::Char(' ') => self.paused = !self.paused,
            Key::Left => self.seek(-SEEK_S),
            Key::Right => self.seek(SEEK_S),
            _ => {}
        }
    }
}

/// A status, or what became of a command.
type News = std::result::Result<Value, String>;

/// A running service. A thread of its own reads the status, from the socket that only reads where there is one.
struct Live {
    socket: PathBuf,
    news: Receiver<News>,
    send: Sender<News>,
    heard: Instant,
}

impl Live {
    fn start(socket: PathBuf) -> Result<Self> {
        let status = Some(paths::status_socket(&socket)).filter(|status| status.exists());
        let status = status.unwrap_or(socket.clone());
        Connection::connect(&status).map_err(report)?;
        let (send, news) = channel();
        let to = send.clone();
        spawn(move || while read(&status, &to).is_err() {});
        Ok(Self {
            socket,
            news,
            send,
            heard: Instant::now(),
        })
    }

    /// Sends a command from a thread of its own, so that a service that does not answer does not delay the screen.
    fn order(&self, request: Request) {
        let (socket, send) = (self.socket.clone(), self.send.clone());
        spawn(move || {
            let answer = match request {
                Request::Stop {} => Connection::stop(&socket),
                _ => Connection::connect(&socket).and_then(|mut to| to.request(&request)),
            };
            let became = answer.map_or_else(|failure| failure.message, |_| "accepted".to_owned());
            // the monitor may have ended
            let _ = send.send(Err(format!("{}: {became}", request.name())));
        });
    }
}

impl Source for Live {
    fn update(&mut self, view: &mut View) {
        view.source = format!("live, {}", self.socket.display());
        view.keys = "h hold   s stop   r relax   q quit";
        for news in self.news.try_iter() {
            match news {
                Ok(value) => {
                    self.heard = Instant::now();
                    view.take(value);
                }
                Err(note) => view.note(&note),
            }
        }
        let silent_s = self.heard.elapsed().as_secs_f64();
        view.silent_s = Some(silent_s).filter(|silent_s| *silent_s > SILENT_S);
    }

    fn key(&mut self, key: Key) {
        match key {
            Key::Char('h') => self.order(Request::Hold {}),
            Key::Char('s') => self.order(Request::Stop {}),
            Key::Char('r') => self.order(Request::Relax {}),
            _ => {}
        }
    }
}

/// Sends the status ten times a second, until the service is gone or, without an error, until nobody receives it.
fn read(socket: &Path, to: &Sender<News>) -> std::result::Result<(), Failure> {
    // also the time between two attempts to reach a lost service
    sleep(PERIOD);
    let mut connection = Connection::connect(socket)?;
    loop {
        let status = connection.request(&Request::Status {})?;
        if to.send(Ok(status)).is_err() {
            return Ok(());
        }
        sleep(PERIOD);
    }
}
