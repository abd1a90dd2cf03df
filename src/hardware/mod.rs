//! Devices: everything that touches a pin, a bus, the clock or the scheduler.

pub mod bench_rt;
pub mod imu;
pub mod lock;
pub mod machine;
pub mod pins;
pub mod pressure;
pub mod rt;
pub mod stepper;
pub mod supply;

pub use crate::motion::{
    DriveLimits, EmergencyStop, Levels, MotionLimits, StepperConfig, StepperMode,
};
