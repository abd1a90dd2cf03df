//! Log events go to standard error, for the journal with the priority of each line (`sd-daemon(3)`). A thread writes them, so that
//! nobody waits for a reader.

use crate::cli::output::escaped;
use std::io::{self, IsTerminal, Write};
use std::os::unix::fs::MetadataExt;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};
use tracing::{Level, Metadata};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::prelude::*;

/// Starts logging for as long as the result lives. The environment variable `RETROFLEX_LOG` sets the filter; the default is `info`.
pub fn start() -> Logging {
    let filter = std::env::var("RETROFLEX_LOG")
        .ok()
        .and_then(|text| text.parse().ok());
    let filter = filter.unwrap_or_else(|| Targets::new().with_default(LevelFilter::INFO));
    let journal = is_journal();
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(Lines::start(journal))
        .with_target(false)
        .with_level(!journal)
        .with_ansi(std::io::stderr().is_terminal());
    let lines = if journal {
        lines.without_time().boxed()
    } else {
        lines.boxed()
    };
    let registry = tracing_subscriber::registry().with(lines.with_filter(filter));
    if registry.try_init().is_err() {
        // events go to the subscriber that is already installed, as in tests
        tracing::debug!("logging has already been started");
    }
    Logging
}

/// True if standard error is the journal: systemd names its device and inode.
fn is_journal() -> bool {
    let there = std::fs::metadata("/proc/self/fd/2");
    let there = there.map(|file| format!("{}:{}", file.dev(), file.ino()));
    there.is_ok_and(|there| std::env::var("JOURNAL_STREAM").is_ok_and(|named| named == there))
}

/// Lines that may wait for a reader of standard error. Further ones are lost.
const WAITING_MAX: usize = 1024;
/// Longest wait for that reader at the end of the program.
const END_MAX: Duration = Duration::from_millis(200);
/// Lines that wait now.
static WAITING: AtomicUsize = AtomicUsize::new(0);

/// Hands lines to a thread that writes them, so that a terminal, a pipe or a journal that nobody reads blocks no other thread.
struct Lines {
    waiting: SyncSender<Vec<u8>>,
    journal: bool,
}

impl Lines {
    /// Starts the thread.
    fn start(journal: bool) -> Self {
        let (waiting, lines) = sync_channel::<Vec<u8>>(WAITING_MAX);
        let work = move || {
            for line in lines {
                // whoever has closed standard error wants no log
                let _ = io::stderr().write_all(&line);
                WAITING.fetch_sub(1, Relaxed);
            }
        };
        // without a thread the service runs without a log
        let _ = std::thread::Builder::new().name("log".into()).spawn(work);
        Self { waiting, journal }
    }
}

impl<'a> MakeWriter<'a> for Lines {
    type Writer = Line<'a>;

    fn make_writer(&'a self) -> Line<'a> {
        Line(&self.waiting, "")
    }

    fn make_writer_for(&'a self, event: &Metadata<'_>) -> Line<'a> {
        let priority = match *event.level() {
            _ if !self.journal => "",
            Level::ERROR => "<3>",
            Level::WARN => "<4>",
            Level::INFO => "<6>",
            _ => "<7>",
        };
        Line(&self.waiting, priority)
    }
}

/// The writer of one line, which begins with its priority.
struct Line<'a>(&'a SyncSender<Vec<u8>>, &'static str);

impl Write for Line<'_> {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        WAITING.fetch_add(1, Relaxed);
        let line_with_priority = [self.1.as_bytes(), &one_line(line)].concat();
        if self.0.try_send(line_with_priority).is_err() {
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
    (escaped(text, |c| !c.is_control() || c == '\x1b') + "\n").into_bytes()
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
