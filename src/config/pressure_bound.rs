//! What bounds the pressure if the counted position is wrong.
//!
//! Without sensors the program knows the pressure only through the position that it believes: after a lost count or with a
//! wrong stiffness the motor is the last bound. Something else has to bound the pressure.

use crate::config::Board;

/// What bounds the gauge pressure of a line independently of the counted position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PressureBound {
    /// The board has no pins, so no pressure is made.
    Simulated,
    /// The motor is too weak to exceed the limit.
    Motor {
        /// Largest pressure that the motor makes, kPa.
        stall_kpa: f64,
        /// `safety.pressure_max_kpa`.
        limit_kpa: f64,
    },
    /// Relief valves open.
    ReliefValve {
        /// Opening pressure, kPa.
        opens_kpa: f64,
    },
    /// Pressure sensors trip the gate.
    Sensors {
        /// `safety.pressure_max_kpa`.
        limit_kpa: f64,
    },
    /// Nothing does.
    Nothing {
        /// Largest pressure that the motor makes, kPa.
        stall_kpa: f64,
        /// `safety.pressure_max_kpa`.
        limit_kpa: f64,
    },
}

impl PressureBound {
    /// What to do about [`PressureBound::Nothing`].
    pub const REMEDY: &str = "fit relief valves and state safety.relief_valve_kpa, or pressure sensors and state [pressure], or lower the \
        motor's current so that power.holding_torque_n_mm suffices for limits.pressure_max_kpa only; see docs/hardware.md";

    /// The bound of a board.
    pub fn of(board: &Board) -> Self {
        let stall_kpa = board.power.stall_kpa(board.drive.pinion_pitch_diameter_mm);
        let limit_kpa = board.safety.pressure_max_kpa;
        match board.safety.relief_valve_kpa {
            _ if board.pins.is_none() => Self::Simulated,
            _ if stall_kpa <= limit_kpa => Self::Motor {
                stall_kpa,
                limit_kpa,
            },
            Some(opens_kpa) => Self::ReliefValve { opens_kpa },
            None if board.pressure.is_some() => Self::Sensors { limit_kpa },
            None => Self::Nothing {
                stall_kpa,
                limit_kpa,
            },
        }
    }

    /// False for [`PressureBound::Nothing`].
    pub fn is_bounded(&self) -> bool {
        !matches!(self, Self::Nothing { .. })
    }
}

impl std::fmt::Display for PressureBound {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Simulated => f.write_str("the machine is simulated"),
            Self::Motor {
                stall_kpa,
                limit_kpa,
            } => {
                write!(
                    f,
                    "bounded by the motor, which makes {stall_kpa:.1} kPa of safety.pressure_max_kpa = {limit_kpa} kPa"
                )
            }
            Self::ReliefValve { opens_kpa } => {
                write!(f, "bounded by relief valves that open at {opens_kpa} kPa")
            }
            Self::Sensors { limit_kpa } => write!(
                f,
                "watched by pressure sensors, which trip the gate at {limit_kpa} kPa"
            ),
            Self::Nothing {
                stall_kpa,
                limit_kpa,
            } => write!(
                f,
                "the motor makes {stall_kpa:.0} kPa, more than safety.pressure_max_kpa = {limit_kpa} kPa, and only the counted position prevents it"
            ),
        }
    }
}
