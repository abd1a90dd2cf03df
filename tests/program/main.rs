//! Tests that run the program.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod accept;
mod attacks;
mod bad_input;
mod boards;
mod clients;
mod command_line;
#[path = "../common/mod.rs"]
mod common;
mod demo;
mod emulated_pi;
mod every_field;
#[path = "../fake_imu/mod.rs"]
mod fake_imu;
mod fleet;
mod flight_log;
mod foxglove;
mod gap_cli;
mod gap_compare;
mod gap_map;
mod guided;
mod hostile_server;
mod imu_calibrate;
mod monitor;
mod outside;
mod page;
#[path = "../emulated_pi/mod.rs"]
mod pi;
mod replay_golden;
mod schemas;
mod service;
mod shown_commands;
mod systemd;
