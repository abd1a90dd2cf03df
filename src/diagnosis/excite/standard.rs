//! The standard bench schedule, with which a design is compared.
//!
//! Circles at three bends, ladders in twelve directions at three lengths, random poses at three speeds, and three long
//! holds: about four minutes.

use crate::diagnosis::excite::{Machine, ScheduleRow};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Directions of the ladders, degrees.
const LADDERS_DEG: [f64; 12] = [
    120.0, 30.0, 330.0, 240.0, 0.0, 90.0, 150.0, 180.0, 270.0, 210.0, 300.0, 60.0,
];

/// Bend and direction of a tour of six directions at increasing bends, degrees.
pub fn tour() -> impl Iterator<Item = (f64, f64)> {
    let around = |bend| [0.0, 120.0, 240.0, 60.0, 180.0, 300.0].map(|dir| (bend, dir));
    [20.0, 40.0, 60.0].into_iter().flat_map(around)
}

/// Rows of the standard schedule.
pub fn rows(machine: &Machine) -> Vec<ScheduleRow> {
    let rest_mm = machine.rig.geometry.rest_length_mm;
    let mut rng = StdRng::seed_from_u64(42);
    let mut rows = vec![ScheduleRow::rest(4.0, &machine.rig.geometry)];
    let mut add = |bend: f64, dir: f64, len_mm: f64, hold_s: f64, speed_mm_s: f64| {
        rows.push(ScheduleRow::new(bend, dir, len_mm, hold_s, speed_mm_s).rounded());
    };
    for (bend, dir) in tour() {
        add(bend, dir, rest_mm, 0.5, 20.0);
    }
    add(0.0, 0.0, rest_mm, 1.0, 20.0);
    for (k, dir) in LADDERS_DEG.into_iter().enumerate() {
        let length = rest_mm + 1.5 * (k % 3) as f64;
        for bend in [15.0, 30.0, 45.0, 60.0, 75.0, 60.0, 45.0, 30.0, 15.0] {
            let hold = if bend == 75.0 { 1.6 } else { 0.8 };
            add(bend, dir, length, hold, 20.0);
        }
    }
    add(0.0, 0.0, rest_mm, 2.0, 20.0);
    for _ in 0..15 {
        let speed = [6.0, 12.0, 26.0][rng.random_range(0..3)];
        let hold = [0.3, 0.8, 2.0][rng.random_range(0..3)];
        let [bend, dir] = [5.0..70.0, 0.0..360.0].map(|of| rng.random_range(of));
        add(bend, dir, rest_mm + rng.random_range(0.0..3.0), hold, speed);
    }
    for (bend, dir) in [(40.0, 300.0), (70.0, 240.0), (55.0, 160.0)] {
        add(bend, dir, rest_mm, 14.0, 20.0);
        add(0.0, 0.0, rest_mm, 5.0, 20.0);
    }
    rows
}
