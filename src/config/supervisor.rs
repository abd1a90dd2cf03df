//! The files together, as the supervisor needs them.

use crate::config::{Board, Calibration, Gains};
use crate::supervisor::{MachineInfo, SupervisorConfig};

/// Board, calibration and gains for a machine.
pub fn assemble(
    board: &Board,
    calibration: &Calibration,
    gains: &Gains,
    info: &MachineInfo,
) -> SupervisorConfig {
    let mut tick = super::assemble(board, calibration, gains);
    // the machine's own step and rest length take the board's place
    tick.drive.step_mm = info.step_mm;
    tick.geometry.rest_length_mm = info.rest_length_mm;
    let gate = board.safety.gate(&tick, info.period_s);
    SupervisorConfig {
        gate,
        residual: board.safety.residual,
        restart_check: board.safety.restart,
        dead_man_s: board.service.dead_man_s,
        tick,
    }
}
