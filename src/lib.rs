//! Closed-loop bend control and sim-to-real gap diagnosis for a disposable pneumatic endoscope tip.
//!
//! The library has sixteen rooms. A file imports only from rooms above its own in this table; `tests/library/architecture.rs`
//! reads the table and enforces it.
//!
//! | room | contents | may use |
//! |---|---|---|
//! | [`primitives`] | units, frames, samples, parameters, text files | files |
//! | [`model`] | paper, Eq. 1-17, forward beside inverse; the effects, one physical cause a file | nothing |
//! | [`log`] | bend logs and IMU recordings | files |
//! | [`motion`] | from wanted piston positions to the instants of microsteps; the `Machine` trait | nothing |
//! | [`estimation`] | fusion, alignment, sensor health, IMU calibration | nothing |
//! | [`control`] | feedback, limits, backlash, learning, and the whole loop in [`control::tick`] | nothing |
//! | [`supervisor`] | modes, safety gate, orders, residual monitor, commissioning | nothing |
//! | [`simulation`] | the built-in plant and the plant link | child processes |
//! | [`diagnosis`] | sim-to-real gap: observe, fit, search, score, decide | threads |
//! | [`experiment`] | the paper's protocol, identification, evaluation, sweep and ablation; filter scores and the exam of the diagnosis | threads |
//! | [`report`] | words, tables, SVG and HTML | nothing |
//! | [`hardware`] | IMU drivers, pins, step thread, clock, real-time set-up | devices |
//! | [`config`] | TOML in, validated domain types out | files |
//! | [`service`] | loop thread, hub, sockets, memory, recordings, heartbeat | threads, files, sockets |
//! | [`drill`] | every fault that the project claims to survive | processes |
//! | [`cli`] | one file a command | everything |

/// The name under which the integration tests know this crate, for the test support that both compile.
#[cfg(test)]
extern crate self as retroflex;

pub mod cli;
pub mod config;
pub mod control;
pub mod diagnosis;
pub mod drill;
pub mod estimation;
pub mod experiment;
pub mod hardware;
pub mod log;
pub mod model;
pub mod motion;
pub mod primitives;
pub mod report;
pub mod service;
pub mod simulation;
pub mod supervisor;
