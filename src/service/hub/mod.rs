//! The hub: everything around the loop that may wait. Each round takes requests, sends orders, reads frames and answers,
//! and hands what must survive to the state writer.

mod loop_output;
mod persist;
mod recording;
mod requests;
mod run;
mod state;

pub use state::{Facts, Hub, HubIo};

#[cfg(test)]
mod tests;
