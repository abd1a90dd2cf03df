//! Recordings: bend logs.

pub mod bend_log;
