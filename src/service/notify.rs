//! systemd's notify socket (`sd_notify(3)`): READY, STATUS, STOPPING and the watchdog heartbeat.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

/// Connection to the service manager, if there is one.
#[derive(Debug, Default)]
pub struct Notifier {
    socket: Option<UnixDatagram>,
}

/// Sends the watchdog heartbeat. The loop thread sends it itself, so a stalled loop is detected whatever the other
/// threads do.
#[derive(Debug, Default)]
pub struct Heartbeat {
    /// Where it goes, and its period, s: half of the manager's time-out. `None` without a watchdog.
    to: Option<(UnixDatagram, f64)>,
    sent_s: f64,
}

impl Notifier {
    /// Reads NOTIFY_SOCKET.
    pub fn from_env() -> Self {
        let connect = |path: std::ffi::OsString| -> std::io::Result<UnixDatagram> {
            let address = match path.as_bytes().strip_prefix(b"@") {
                Some(name) => SocketAddr::from_abstract_name(name),
                None => SocketAddr::from_pathname(&path),
            }?;
            let socket = UnixDatagram::unbound()?;
            socket.connect_addr(&address)?;
            socket.set_nonblocking(true)?;
            Ok(socket)
        };
        let socket = std::env::var_os("NOTIFY_SOCKET").and_then(|path| connect(path).ok());
        Self { socket }
    }

    /// True if there is a service manager.
    pub fn is_there(&self) -> bool {
        self.socket.is_some()
    }

    /// Sends a line. Errors are ignored: the service also runs without a manager.
    pub fn notify(&self, line: &str) {
        if let Some(socket) = &self.socket {
            let _ = socket.send(line.as_bytes());
        }
    }

    /// The heartbeat, where the manager has a watchdog for this service, by WATCHDOG_USEC.
    pub fn heartbeat(&self) -> Heartbeat {
        let socket = self.socket.as_ref().and_then(|s| s.try_clone().ok());
        let period_s = sd_notify::watchdog_enabled().map(|timeout| timeout.as_secs_f64() / 2.0);
        let (to, sent_s) = (socket.zip(period_s), 0.0);
        Heartbeat { to, sent_s }
    }
}

impl Heartbeat {
    /// Sends the heartbeat when it is due, unless a thread is `stalled`: a single non-blocking system call.
    pub fn update(&mut self, stalled: bool, now_s: f64) {
        if let Some((socket, period_s)) = &self.to
            && !stalled
            && now_s - self.sent_s >= *period_s
        {
            self.sent_s = now_s;
            let _ = socket.send(b"WATCHDOG=1");
        }
    }
}
