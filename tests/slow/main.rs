//! Tests that take a minute or more. `cargo test` leaves them out; `cargo test --test slow minutes` takes about five minutes,
//! `hours` more than an hour, each on two processors.
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
    mod emulated_pi;
    mod fuse_cv;
    mod gap_recovery;
    mod identification;
}
