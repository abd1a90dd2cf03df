//! Edges: the only rooms that touch hardware.

pub mod imu;
