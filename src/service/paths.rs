//! Where the sockets and the state are, unless the board file or an option names other paths.

use crate::config::ServiceSection;
use nix::unistd::Uid;
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
        let (socket, status) = (service.socket.clone(), service.status_socket.clone());
        let control = socket.unwrap_or_else(own_socket);
        Self {
            status: status.unwrap_or_else(|| status_socket(&control)),
            control,
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
    let all = sockets();
    let there = all.iter().find(|path| path.exists());
    there.unwrap_or(&all[0]).clone()
}

/// The command sockets where services may listen: this user's and the system's.
pub fn sockets() -> Vec<PathBuf> {
    own_and_system(own_socket(), "/run/retroflex/control.sock")
}

/// The folders where services may keep their flight logs: this user's and the system's.
pub fn flight_folders() -> Vec<PathBuf> {
    own_and_system(state_folder().join("flights"), "/var/lib/retroflex/flights")
}

fn own_socket() -> PathBuf {
    runtime_folder().join("control.sock")
}

fn own_and_system(own: PathBuf, system: &str) -> Vec<PathBuf> {
    let mut all = vec![own, PathBuf::from(system)];
    all.dedup();
    all
}

/// An absolute path from the environment; systemd separates several by colons.
fn path_from(variable: &str) -> Option<PathBuf> {
    let value = std::env::var(variable).ok()?;
    let first = PathBuf::from(value.split(':').next()?);
    first.is_absolute().then_some(first)
}

/// The folder that systemd has set, else the system's for root, else that in a folder of this user.
fn folder(variable: &str, system: &str, own: Option<PathBuf>) -> Option<PathBuf> {
    let system = Uid::effective().is_root().then(|| PathBuf::from(system));
    let own = own.map(|folder| folder.join("retroflex"));
    path_from(variable).or(system).or(own)
}

fn runtime_folder() -> PathBuf {
    let own = path_from("XDG_RUNTIME_DIR");
    // without a runtime folder, beside the state
    folder("RUNTIME_DIRECTORY", "/run/retroflex", own).unwrap_or_else(state_folder)
}

fn state_folder() -> PathBuf {
    let of_home = || Some(path_from("HOME")?.join(".local/state"));
    let own = path_from("XDG_STATE_HOME").or_else(of_home);
    folder("STATE_DIRECTORY", "/var/lib/retroflex", own)
        .unwrap_or_else(|| std::env::temp_dir().join("retroflex"))
}
