//! Destination of log events: the journal, with structured fields, under systemd; standard error otherwise.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Starts logging for as long as the result lives. The environment variable `RETROFLEX_LOG` sets the filter; the default is `info`.
pub fn start() -> Logging {
    let filter = std::env::var("RETROFLEX_LOG")
        .ok()
        .and_then(|targets| targets.parse().ok())
        .unwrap_or_else(|| Targets::new().with_default(LevelFilter::INFO));
    let registry = tracing_subscriber::registry().with(filter);
    // systemd sets this variable if standard error is connected to the journal
    let journal = std::env::var_os("JOURNAL_STREAM").and_then(|_| tracing_journald::layer().ok());
    let started = match journal {
        Some(journal) => registry
            .with(journal.with_field_prefix(Some("RETROFLEX".to_owned())))
            .try_init(),
        None => {
            let colours = std::io::stderr().is_terminal();
            let people = tracing_subscriber::fmt::layer()
                .with_writer(Lines::start())
                .with_target(false)
                .with_ansi(colours);
            registry.with(people).try_init()
        }
    };
    if started.is_err() {
        // events go to the subscriber that is already installed, as in tests
        tracing::debug!("logging has already been started");
    }
    Logging
}

/// Lines that may wait for a reader of standard error. Further ones are lost.
const WAITING_MAX: usize = 1024;
/// Longest wait for that reader at the end of the program.
const END_MAX: Duration = Duration::from_millis(200);
/// Lines that wait now.
static WAITING: AtomicUsize = AtomicUsize::new(0);

/// Hands lines to a thread that writes them, so that a terminal or a pipe that nobody reads blocks no other thread.
#[derive(Clone)]
struct Lines(SyncSender<Vec<u8>>);

impl Lines {
    /// Starts the thread and returns what makes the writer of a line.
    fn start() -> impl Fn() -> Self {
        let (lines, waiting) = sync_channel::<Vec<u8>>(WAITING_MAX);
        // without a thread the service runs without a log
        let _ = std::thread::Builder::new()
            .name("log".into())
            .spawn(move || {
                for line in waiting {
                    // whoever has closed standard error wants no log
                    let _ = io::stderr().write_all(&line);
                    WAITING.fetch_sub(1, Relaxed);
                }
            });
        move || Self(lines.clone())
    }
}

impl Write for Lines {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        WAITING.fetch_add(1, Relaxed);
        if self.0.try_send(one_line(line)).is_err() {
            WAITING.fetch_sub(1, Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// An event as one line: what a client or a file says in it must not look like an event of its own. Colours are the subscriber's, which
/// escapes those in a message itself.
fn one_line(event: &[u8]) -> Vec<u8> {
    let text = String::from_utf8_lossy(event);
    let text = text.strip_suffix('\n').unwrap_or(&text);
    let shown = |c: char| match c.is_control() && c != '\x1b' {
        true => c.escape_default().to_string(),
        false => c.to_string(),
    };
    (text.chars().map(shown).collect::<String>() + "\n").into_bytes()
}

/// Waits at its end until the lines are written, but not for a reader that does not read.
pub struct Logging;

impl Drop for Logging {
    fn drop(&mut self) {
        let since = Instant::now();
        while WAITING.load(Relaxed) > 0 && since.elapsed() < END_MAX {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_is_one_line() {
        let forged = "2026 INFO bad key `a\nERROR: the tip moves\r\x07`\n";
        let line = String::from_utf8(one_line(forged.as_bytes())).unwrap();
        assert_eq!(line.matches('\n').count(), 1);
        assert!(line.contains(r"`a\nERROR: the tip moves\r\u{7}`"), "{line}");
    }
}
