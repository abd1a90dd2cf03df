//! Logs and recordings on disk.
//!
//! [`table`] reads CSV or gzip CSV; [`bend_log`] and [`recording`] give the columns their meaning;
//! [`columns`] writes Parquet.

pub mod bend_log;
pub mod columns;
pub mod error;
pub mod recording;
pub mod table;
