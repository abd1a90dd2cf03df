//! systemd's notify socket (`sd_notify(3)`): READY, STATUS, STOPPING, and the watchdog's feed.
//!
//! The feed is a datagram that the loop thread sends by itself, without waiting, so a loop that hangs
//! is noticed whatever the other threads do.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

/// The service manager, if there is one.
#[derive(Debug, Default)]
pub struct Notifier {
    socket: Option<UnixDatagram>,
    every: Option<Duration>,
}

/// Feeds the watchdog.
#[derive(Debug)]
pub struct Feed {
    socket: UnixDatagram,
    /// How often it must be fed, s: half of what the manager waits.
    pub every_s: f64,
}

impl Notifier {
    /// From NOTIFY_SOCKET and WATCHDOG_USEC.
    #[must_use]
    pub fn from_env() -> Self {
        let socket = std::env::var_os("NOTIFY_SOCKET").and_then(|path| {
            let bytes = path.as_bytes();
            let address = match bytes.strip_prefix(b"@") {
                Some(name) => SocketAddr::from_abstract_name(name),
                None => SocketAddr::from_pathname(&path),
            };
            let socket = UnixDatagram::unbound().ok()?;
            socket.connect_addr(&address.ok()?).ok()?;
            socket.set_nonblocking(true).ok()?;
            Some(socket)
        });
        Self { socket, every: sd_notify::watchdog_enabled() }
    }

    /// Tells the manager; a manager that does not listen is no trouble of ours.
    pub fn say(&self, line: &str) {
        if let Some(socket) = &self.socket {
            let _ = socket.send(line.as_bytes());
        }
    }

    /// The loop's own line to the watchdog, where one watches.
    #[must_use]
    pub fn watchdog(&self) -> Option<Feed> {
        let (socket, every) = (self.socket.as_ref()?, self.every?);
        Some(Feed { socket: socket.try_clone().ok()?, every_s: every.as_secs_f64() / 2.0 })
    }
}

impl Feed {
    /// One meal: one system call that does not wait.
    pub fn feed(&self) {
        let _ = self.socket.send(b"WATCHDOG=1");
    }
}
