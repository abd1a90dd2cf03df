//! Logs on disk, read into the types of the lower floors.

pub mod bend_log;
pub mod error;
pub mod recording;
