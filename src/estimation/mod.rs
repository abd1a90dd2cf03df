//! Orientation of the tip from IMU samples, calibration of the IMU, and scores of orientation filters.

pub mod fusion;
pub mod imu_calibration;
pub mod score;
