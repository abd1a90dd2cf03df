//! Why an experiment failed.

use crate::control::learning::batch::Unidentifiable;
use crate::diagnosis::tip::observed::ObserveError;
use crate::log::error::ReadError;
use crate::simulation::MachineError;
use thiserror::Error;

/// Why an experiment failed.
#[derive(Debug, Error)]
pub enum ExperimentError {
    /// The world failed.
    #[error(transparent)]
    World(#[from] MachineError),
    /// The tip did not come to rest.
    #[error(
        "the tip was not still within {0} s of the start ({1}); the alignment needs 2 s of rest with the pistons at zero"
    )]
    NotStill(f64, String),
    /// The world has no reference for the score.
    #[error(
        "the plant gives no `ref`, the true orientation of its tip, which it is judged by; it must answer with \"ref\":{{\"quat\":[w,x,y,z]}}"
    )]
    NoReference,
    /// The data do not determine the gains, or none that can be.
    #[error("identification: {0}")]
    Unidentifiable(#[from] Unidentifiable),
    /// The log for the diagnosis cannot be diagnosed.
    #[error("arm diagnosed: {0}")]
    Undiagnosed(#[from] ObserveError),
    /// The path is out of reach.
    #[error(transparent)]
    Path(#[from] ReadError),
}
