//! Logs and recordings on disk.
//!
//! [`table`] reads CSV or gzip CSV; [`bend_log`] and [`recording`] give the columns their meaning;
//! [`columns`] writes Parquet; [`plausibility`] refuses a log whose units or wiring cannot be right.

pub mod bend_log;
pub mod columns;
pub mod error;
pub mod plausibility;
pub mod recording;
pub mod table;
