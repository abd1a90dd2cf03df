//! Tests of the library. Each module tests one subject.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod architecture;
mod commission;
#[path = "../common/mod.rs"]
mod common;
mod diagnosed;
mod documents;
mod drill;
mod estimation;
#[path = "../fake_imu/mod.rs"]
mod fake_imu;
mod fuse_filters;
mod fuzz;
mod gap_engine;
mod gap_report;
#[path = "../../examples/gap_train/main.rs"]
#[allow(dead_code, reason = "its tests run here, and nothing calls its `main`")]
mod gap_train;
mod gate;
mod identification;
mod imu_drivers;
mod imu_score;
mod independent_plant;
mod invariants;
mod log_plausibility;
mod modes;
mod motion;
mod paper_twin;
#[path = "../parsers/mod.rs"]
mod parsers;
mod plant;
#[path = "../independent_plant/mod.rs"]
mod plant_in_c;
mod recording_pins;
mod sensor_faults;
mod stepper;
mod stop;
mod supervisor;
mod tip;
mod track;
