//! Where events go: to the journal with their fields under systemd, to stderr for people otherwise.

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Starts logging; `RETROFLEX_LOG` filters (default `info`).
pub fn start() {
    let filter = EnvFilter::try_from_env("RETROFLEX_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    let registry = tracing_subscriber::registry().with(filter);
    // systemd sets it where stderr is the journal
    let journal = std::env::var_os("JOURNAL_STREAM").and_then(|_| tracing_journald::layer().ok());
    let begun = match journal {
        Some(journal) => registry.with(journal.with_field_prefix(Some("RETROFLEX".to_owned()))).try_init(),
        None => {
            let colours = std::io::stderr().is_terminal();
            let people = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_target(false).with_ansi(colours);
            registry.with(people).try_init()
        }
    };
    if begun.is_err() {
        // somebody else's subscriber is there already: the events go to it
        tracing::debug!("logging was begun before");
    }
}
