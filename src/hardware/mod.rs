//! Edges to the machine: everything that touches a device, a clock or a thread.

pub mod bench_rt;
pub mod cyclictest;
pub mod imu;
pub mod machine;
pub mod pins;
pub mod rt;
pub mod stepper;
