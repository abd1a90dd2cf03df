//! TOML in, validated domain types out.
//!
//! Three kinds of file: a *board* (what the machine is), a *calibration* (what this tip is) and
//! *gains* (how the loop behaves). Unknown keys are errors and every number has a range; an error
//! shows the file, the line, the key, the value and how to correct it.

pub mod board;
pub mod calib;
pub mod gains;
pub mod message;
pub mod place;
pub mod power;
pub mod pressure_bound;
mod relations;
pub mod rewired;
pub mod sections;
pub mod service;
pub mod shipped;
pub mod show;
pub mod source;
pub mod supervisor;

pub use crate::control::LoopConfig;
pub use board::{Board, PlantSection};
pub use calib::{Calibration, DynamicsSection, TransmissionSection};
pub use gains::Gains;
pub use pressure_bound::PressureBound;
pub use sections::Header;
pub use service::ServiceSection;

/// Puts the three files together into what [`crate::control::tick::tick`] runs on.
pub fn assemble(board: &Board, calibration: &Calibration, gains: &Gains) -> LoopConfig {
    LoopConfig {
        geometry: board.geometry.law(),
        drive: board.drive.law(),
        lines: calibration.lines(),
        line_sigmas: calibration
            .prior()
            .map(|p| [p.k_epsilon_sigma, p.k_lambda_sigma_mm]),
        dynamics: calibration.dynamics.law(),
        side: gains.side(),
        bend_pace: gains.pace.bend(),
        length_pace: gains.pace.length(),
        motion: board.drive_limits(),
        limits: board.limits(),
        feedback: Some(gains.feedback()),
        feedforward: None,
        refine: gains.refine,
        fuse: gains.fuse,
        imu: calibration.imu.correction(),
        motors: calibration.imu.motor_field.clone(),
        motors_idle_after_s: MOTORS_IDLE_AFTER_S,
    }
}

/// A driver that has not stepped for this long runs at its idle current, s: the shortest setting of common
/// drivers' standstill timers.
pub const MOTORS_IDLE_AFTER_S: f64 = 0.35;
