//! Orientation of the tip from IMU samples, and calibration of the IMU.

pub mod fusion;
pub mod imu_calibration;
