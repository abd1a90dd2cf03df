//! Destination of log events: the journal, with structured fields, under systemd; standard error otherwise.

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Starts logging. The environment variable `RETROFLEX_LOG` sets the filter; the default is `info`.
pub fn start() {
    let filter = EnvFilter::try_from_env("RETROFLEX_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    let registry = tracing_subscriber::registry().with(filter);
    // systemd sets this variable if standard error is connected to the journal
    let journal = std::env::var_os("JOURNAL_STREAM").and_then(|_| tracing_journald::layer().ok());
    let started = match journal {
        Some(journal) => registry.with(journal.with_field_prefix(Some("RETROFLEX".to_owned()))).try_init(),
        None => {
            let colours = std::io::stderr().is_terminal();
            let people = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_target(false).with_ansi(colours);
            registry.with(people).try_init()
        }
    };
    if started.is_err() {
        // events go to the subscriber that is already installed, as in tests
        tracing::debug!("logging has already been started");
    }
}
