//! Tests that take long. `cargo test` leaves them out; `.ci/slow` runs `minutes`, `.ci/long` runs `hours`, and
//! `.ci/emulated-pi` runs `real_time`, which needs a machine with nothing else to do.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../common/mod.rs"]
mod common;
#[path = "../fake_imu/mod.rs"]
mod fake_imu;
#[path = "../emulated_pi/mod.rs"]
mod pi;
#[path = "../independent_plant/mod.rs"]
mod plant_in_c;

mod hours {
    #[path = "../../emulated_pi3/mod.rs"]
    mod emulated_pi3;
    mod independent_plant;
}

mod minutes {
    mod fuse_cv;
    mod gap_recovery;
    mod identification;
    mod plausibility;
    mod sway;
}

mod real_time {
    mod emulated_pi;
}
