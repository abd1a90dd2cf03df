//! The built-in plant: general properties, signatures of the effects, sensors, faults, and the paper twin.

mod faults;
mod laws;
mod open_loop;
mod rig;
mod sensors;
mod signatures;
mod twin;
