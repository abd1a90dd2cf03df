//! What bounds the pressure if the counted position is wrong.
//!
//! Without sensors the program knows the pressure only through the position that it believes: after a lost count or with a
//! wrong stiffness the motor is the last bound. Something else has to bound the pressure.

use crate::config::Board;

/// What bounds the gauge pressure of a line independently of the counted position.
#[derive(Debug, Clone, PartialEq)]
pub struct PressureBound {
    /// False if nothing does.
    pub is_bounded: bool,
    /// What bounds it, or that nothing does.
    pub says: String,
}

impl PressureBound {
    /// What to do where nothing bounds the pressure.
    pub const REMEDY: &str = "fit relief valves and state safety.relief_valve_kpa, or pressure sensors and state [pressure], or lower the \
        motor's current so that power.holding_torque_n_mm suffices for limits.pressure_max_kpa only; see docs/hardware.md";

    /// The bound of a board.
    pub fn of(board: &Board) -> Self {
        let makes = board.power.stall_kpa(board.drive.pinion_pitch_diameter_mm);
        let limit = board.safety.pressure_max_kpa;
        let mut is_bounded = true;
        let says = match board.safety.relief_valve_kpa {
            _ if board.pins.is_none() => "the machine is simulated".to_owned(),
            _ if makes <= limit => format!(
                "bounded by the motor, which makes {makes:.1} kPa of safety.pressure_max_kpa = {limit} kPa"
            ),
            Some(opens) => format!("bounded by relief valves that open at {opens} kPa"),
            None if board.pressure.is_some() => {
                format!("watched by pressure sensors, which trip the gate at {limit} kPa")
            }
            None => {
                is_bounded = false;
                format!(
                    "the motor makes {makes:.0} kPa, more than safety.pressure_max_kpa = {limit} kPa, and only the counted position prevents it"
                )
            }
        };
        Self { is_bounded, says }
    }
}
