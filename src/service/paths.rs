//! Where the sockets and the state are, unless the board file or an option names other paths.

use crate::config::ServiceSection;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The paths of a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Paths {
    /// The command socket.
    pub control: PathBuf,
    /// The status socket.
    pub status: PathBuf,
    /// The folder of the persistent state.
    pub state: PathBuf,
}

impl Paths {
    /// The paths that this section names, and the default ones for this user.
    pub fn of(service: &ServiceSection) -> Self {
        let control = service
            .socket
            .clone()
            .unwrap_or_else(|| runtime_folder().join("control.sock"));
        let status = service
            .status_socket
            .clone()
            .unwrap_or_else(|| status_socket(&control));
        Self {
            control,
            status,
            state: service.state.clone().unwrap_or_else(state_folder),
        }
    }
}

/// The status socket that belongs to a command socket, unless the board file names another.
pub fn status_socket(control: &Path) -> PathBuf {
    control.with_file_name("status.sock")
}

/// The socket of `stop` that belongs to a command socket.
pub fn stop_socket(control: &Path) -> PathBuf {
    control.with_extension("stop.sock")
}

/// The command socket to connect to, where none is named: that of this user's service if there is one, else the system's.
pub fn default_socket() -> PathBuf {
    let own = runtime_folder().join("control.sock");
    let system = PathBuf::from("/run/retroflex/control.sock");
    if !own.exists() && system.exists() {
        system
    } else {
        own
    }
}

/// The command sockets where services may listen: this user's and the system's.
pub fn sockets() -> Vec<PathBuf> {
    let mut all = vec![
        runtime_folder().join("control.sock"),
        PathBuf::from("/run/retroflex/control.sock"),
    ];
    all.dedup();
    all
}

/// The folders where services may keep their flight logs: this user's and the system's.
pub fn flight_folders() -> Vec<PathBuf> {
    let mut all = vec![
        state_folder().join("flights"),
        PathBuf::from("/var/lib/retroflex/flights"),
    ];
    all.dedup();
    all
}

/// An absolute path from the environment; systemd separates several by colons.
fn path_from(variable: &str) -> Option<PathBuf> {
    let value = std::env::var(variable).ok()?;
    let first = PathBuf::from(value.split(':').next()?);
    first.is_absolute().then_some(first)
}

fn is_root() -> bool {
    std::fs::metadata("/proc/self").is_ok_and(|m| m.uid() == 0)
}

fn runtime_folder() -> PathBuf {
    let system = || is_root().then(|| PathBuf::from("/run/retroflex"));
    let own = || path_from("XDG_RUNTIME_DIR").map(|folder| folder.join("retroflex"));
    // without a runtime folder, beside the state
    path_from("RUNTIME_DIRECTORY")
        .or_else(system)
        .or_else(own)
        .unwrap_or_else(state_folder)
}

fn state_folder() -> PathBuf {
    let system = || is_root().then(|| PathBuf::from("/var/lib/retroflex"));
    let own =
        || path_from("XDG_STATE_HOME").or_else(|| Some(path_from("HOME")?.join(".local/state")));
    let folder = path_from("STATE_DIRECTORY")
        .or_else(system)
        .or_else(|| own().map(|folder| folder.join("retroflex")));
    folder.unwrap_or_else(|| std::env::temp_dir().join("retroflex"))
}
