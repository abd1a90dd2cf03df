//! Logs and recordings on disk.
//!
//! [`table`] reads CSV or gzip CSV; [`bend_log`] and [`recording`] give the columns their meaning.

pub mod bend_log;
pub mod error;
pub mod recording;
pub mod table;
