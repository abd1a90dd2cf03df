//! Errors of the service.

use crate::service::memory::MemoryError;
use crate::supervisor::MachineError;
use std::path::Path;
use thiserror::Error;

/// Why the service could not start or ended by itself.
#[derive(Debug, Error)]
pub enum ServiceError {
    /// The memory cannot be used.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// The machine failed.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// The socket of this path cannot be created.
    #[error(
        "{0}: {1}; RuntimeDirectory= in the unit creates the folder, `--socket` names another path"
    )]
    Socket(String, #[source] std::io::Error),
    /// This thread, signal handler or recording could not be started.
    #[error("{0}: {1}")]
    System(String, #[source] std::io::Error),
    /// The loop ended by a panic.
    #[error(
        "the control loop ended unexpectedly; this is a defect of the program, please report it with the log"
    )]
    LoopPanicked,
}

impl ServiceError {
    /// Adds the path of a socket to an I/O error.
    pub fn socket(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.display().to_string();
        move |reason| Self::Socket(path, reason)
    }

    /// Adds what could not be started to an I/O error.
    pub fn system(what: impl std::fmt::Display) -> impl FnOnce(std::io::Error) -> Self {
        let what = what.to_string();
        move |reason| Self::System(what, reason)
    }
}
