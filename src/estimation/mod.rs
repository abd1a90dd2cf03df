//! Tip orientation from IMU samples, the calibration of the IMU, and scores of orientation filters.

pub mod fusion;
pub mod imu_calibration;
pub mod score;
