//! Closed-loop bend control and sim-to-real gap diagnosis for a disposable pneumatic endoscope tip.
//!
//! The house has floors; a file imports only from floors below its own, or from earlier rooms of its
//! own floor. `tests/floors.rs` reads this table and enforces it.
//!
//! | floor | rooms, lowest first |
//! |---|---|
//! | F0 words | [`units`], [`frames`], [`sample`], [`check`] |
//! | F1 laws: pure, stateless | [`model`] |
//! | F2 behaviour: config + state → output | [`effects`], [`calib_imu`], [`fuse`], [`control`], [`motion`], [`refine`], [`tick`], [`supervise`] |
//! | F3 twins and judges, no hardware | [`log`], [`plant`], [`world`], [`machine`], [`commission`], [`pilot`], [`imu_score`], [`experiment`], [`gap`], [`report`] |
//! | F4 edges | [`io`], [`config`], [`memory`], [`sim`], [`link`], [`service`], [`drill`], [`cli`] |

pub mod calib_imu;
pub mod check;
pub mod cli;
pub mod commission;
pub mod config;
pub mod control;
pub mod drill;
pub mod effects;
pub mod experiment;
pub mod frames;
pub mod fuse;
pub mod gap;
pub mod imu_score;
pub mod io;
pub mod link;
pub mod log;
pub mod machine;
pub mod memory;
pub mod model;
pub mod motion;
pub mod pilot;
pub mod plant;
pub mod refine;
pub mod report;
pub mod sample;
pub mod service;
pub mod sim;
pub mod supervise;
pub mod tick;
pub mod units;
pub mod world;
