//! Manoeuvres: the elements of a schedule, and how the search changes them.
//!
//! Each kind separates certain effects: a circle shows a dependence on δ, a ladder a dependence on amplitude and the cost
//! of a reversal, nested loops memory, quick reversals delays, a stroke at constant bend pressure, a hold creep and leak,
//! and a rest a dependence on time.

use crate::diagnosis::excite::{Machine, ScheduleRow};
use crate::named;
use rand::RngExt;
use rand::rngs::StdRng;
use std::f64::consts::TAU;

named! {
/// Kinds of manoeuvre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ManoeuvreKind {
    /// `count` poses around a full circle of δ at one bend.
    Circle = "circle",
    /// Up to the bend in `count` rungs and down again.
    Ladder = "ladder",
    /// From side to side with an amplitude that shrinks to zero in `count` swings.
    Nested = "nested loops",
    /// From side to side `count` times without a pause.
    Reversals = "reversals",
    /// All bellows longer and shorter `count` times at constant bend.
    Stroke = "stroke",
    /// Out for `hold_s`, then to rest for a third of it.
    Hold = "hold",
    /// One bellow after the other in and out, the other two at rest length.
    Single = "single bellows",
}
}

/// One manoeuvre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Manoeuvre {
    /// Kind.
    pub kind: ManoeuvreKind,
    /// Largest bend, degrees.
    pub bend_deg: f64,
    /// Direction of the first pose, degrees.
    pub dir_deg: f64,
    /// Centre-line length, mm.
    pub len_mm: f64,
    /// Poses, rungs, swings or strokes.
    pub count: usize,
    /// Hold at each pose, s.
    pub hold_s: f64,
    /// Fastest piston, mm/s.
    pub speed_mm_s: f64,
}

impl Manoeuvre {
    /// Rows of the manoeuvre; the bend of a pose out of reach is reduced until the machine reaches it.
    pub fn rows(&self, machine: &Machine) -> Vec<ScheduleRow> {
        let rest_mm = machine.rig.geometry.rest_length_mm;
        let pose = |bend_deg: f64, dir_deg: f64, len_mm: f64, hold_s: f64| {
            let turned_deg = if bend_deg < 0.0 { 180.0 } else { 0.0 };
            let dir_deg = dir_deg + turned_deg;
            ScheduleRow::new(bend_deg, dir_deg, len_mm, hold_s, self.speed_mm_s)
        };
        let here = |bend_deg: f64| pose(bend_deg, self.dir_deg, self.len_mm, self.hold_s);
        let n = self.count.max(1);
        let part = |k: usize| k as f64 / n as f64;
        let side = |k: usize| [1.0, -1.0][k % 2];
        let rows: Vec<ScheduleRow> = match self.kind {
            ManoeuvreKind::Circle => {
                let towards = |k: usize| self.dir_deg + 360.0 * part(k);
                let round = |k: usize| pose(self.bend_deg, towards(k), self.len_mm, self.hold_s);
                (0..n).map(round).collect()
            }
            ManoeuvreKind::Ladder => {
                let rungs = (1..=n).chain((1..n).rev());
                rungs.map(|k| here(self.bend_deg * part(k))).collect()
            }
            ManoeuvreKind::Nested => {
                let swing = |k: usize| here(self.bend_deg * (1.0 - part(k)) * side(k));
                (0..n).map(swing).collect()
            }
            ManoeuvreKind::Reversals => (0..2 * n).map(|k| here(self.bend_deg * side(k))).collect(),
            ManoeuvreKind::Stroke => {
                let lengths = [self.len_mm, 2.0 * rest_mm - self.len_mm];
                let end = |k: usize| pose(self.bend_deg, self.dir_deg, lengths[k % 2], self.hold_s);
                (0..2 * n).map(end).collect()
            }
            ManoeuvreKind::Hold => {
                let rest = pose(0.0, 0.0, rest_mm, self.hold_s / 3.0);
                vec![here(self.bend_deg), rest]
            }
            ManoeuvreKind::Single => {
                let poses = (0..3).flat_map(|i| single(machine, i, self.bend_deg));
                poses.map(|(b, d, l)| pose(b, d, l, self.hold_s)).collect()
            }
        };
        rows.iter().map(|row| within(machine, row)).collect()
    }

    /// A manoeuvre of the same kind with one to three values changed.
    pub fn varied(&self, machine: &Machine, rng: &mut StdRng) -> Self {
        let mut m = *self;
        let by = |rng: &mut StdRng, x: f64, range: (f64, f64)| {
            (x * rng.random_range(0.6..1.6f64)).clamp(range.0, range.1)
        };
        for _ in 0..rng.random_range(1..=3) {
            match rng.random_range(0..7) {
                0 => m.bend_deg = by(rng, m.bend_deg, BEND_DEG),
                1 => m.dir_deg = rng.random_range(0.0..360.0),
                2 => m.len_mm = random_length_mm(machine, rng),
                3 => m.hold_s = by(rng, m.hold_s, hold_range(m.kind)),
                4 => m.speed_mm_s = by(rng, m.speed_mm_s, machine.speed_mm_s.into()),
                5 => m.count = rng.random_range(COUNT.0..=COUNT.1),
                _ => m.dir_deg += 30.0 * f64::from(rng.random_range(-2i32..=2)),
            }
        }
        m
    }

    /// A random manoeuvre.
    pub fn any(machine: &Machine, rng: &mut StdRng) -> Self {
        let kind = ManoeuvreKind::ALL[rng.random_range(0..ManoeuvreKind::ALL.len())];
        let hold = hold_range(kind);
        Self {
            kind,
            bend_deg: rng.random_range(BEND_DEG.0..BEND_DEG.1),
            dir_deg: rng.random_range(0.0..360.0),
            len_mm: random_length_mm(machine, rng),
            count: rng.random_range(COUNT.0..=COUNT.1),
            // uniform in the logarithm: most holds are short, a few are long
            hold_s: hold.0 * (hold.1 / hold.0).powf(rng.random_range(0.0..1.0)),
            speed_mm_s: rng.random_range(machine.speed_mm_s[0]..machine.speed_mm_s[1]),
        }
    }
}

/// Range of the bend, degrees.
const BEND_DEG: (f64, f64) = (10.0, 85.0);
/// Range of the change of the centre-line length, mm.
const STRETCH_MM: (f64, f64) = (-2.5, 4.0);
/// Range of the count.
const COUNT: (usize, usize) = (2, 8);

fn random_length_mm(machine: &Machine, rng: &mut StdRng) -> f64 {
    let rest_mm = machine.rig.geometry.rest_length_mm;
    rng.random_range(rest_mm + STRETCH_MM.0..rest_mm + STRETCH_MM.1)
}

/// Range of a hold, s.
fn hold_range(kind: ManoeuvreKind) -> (f64, f64) {
    match kind {
        ManoeuvreKind::Hold => (6.0, 30.0),
        _ => (0.15, 2.5),
    }
}

/// Poses (β, δ, l) that shorten and lengthen bellow `i` while the other two keep their length.
fn single(machine: &Machine, i: usize, bend_deg: f64) -> [(f64, f64, f64); 2] {
    // one bellow changed by q bends by 2 q / (3 r) towards it and lengthens the middle by q / 3
    let q_mm = 1.5 * machine.rig.geometry.r_mm * bend_deg.to_radians();
    let towards_deg = -(i as f64) * (TAU / 3.0).to_degrees();
    let l = machine.rig.geometry.rest_length_mm;
    let (short_mm, long_mm) = (l - q_mm / 3.0, l + q_mm / 3.0);
    [(towards_deg, short_mm), (towards_deg + 180.0, long_mm)].map(|(d, l)| (bend_deg, d, l))
}

/// The pose with its bend and its change of length scaled down until it is in reach.
fn within(machine: &Machine, row: &ScheduleRow) -> ScheduleRow {
    let rest_mm = machine.rig.geometry.rest_length_mm;
    let scaled = |s: f64| {
        let mut row = *row;
        (row.bend_deg, row.len_mm) = (row.bend_deg.abs() * s, rest_mm + (row.len_mm - rest_mm) * s);
        row.rounded()
    };
    let mut smaller = (0..40).map(|k| scaled(1.0 - 0.025 * f64::from(k)));
    let reached = smaller.find(|r| machine.reaches(r));
    reached.unwrap_or_else(|| scaled(0.0))
}

/// Rows of a whole schedule: rest, manoeuvres, rest.
pub fn schedule(machine: &Machine, manoeuvres: &[Manoeuvre]) -> Vec<ScheduleRow> {
    let mut rows = vec![ScheduleRow::rest(REST_S, &machine.rig.geometry)];
    rows.extend(manoeuvres.iter().flat_map(|m| m.rows(machine)));
    rows.push(ScheduleRow::rest(2.0, &machine.rig.geometry));
    rows
}

/// Initial rest, s: it defines zero bend, gravity, field and gyroscope bias.
const REST_S: f64 = 5.0;

/// Start of the search: one or more manoeuvres of each kind at several lengths and speeds.
pub fn first_guess(rest_mm: f64) -> Vec<Manoeuvre> {
    let m = |kind, bend_deg, dir_deg, stretch_mm: f64, count, hold_s, speed_mm_s| Manoeuvre {
        kind,
        bend_deg,
        dir_deg,
        len_mm: rest_mm + stretch_mm,
        count,
        hold_s,
        speed_mm_s,
    };
    vec![
        m(ManoeuvreKind::Circle, 35.0, 0.0, 0.0, 6, 0.4, 25.0),
        m(ManoeuvreKind::Ladder, 70.0, 90.0, 2.0, 4, 0.8, 15.0),
        m(ManoeuvreKind::Reversals, 20.0, 30.0, 0.0, 4, 0.15, 28.0),
        m(ManoeuvreKind::Single, 40.0, 0.0, 0.0, 2, 0.8, 20.0),
        m(ManoeuvreKind::Nested, 65.0, 150.0, 0.0, 6, 0.3, 6.0),
        m(ManoeuvreKind::Hold, 70.0, 240.0, 0.0, 2, 18.0, 25.0),
        m(ManoeuvreKind::Stroke, 45.0, 300.0, 3.0, 2, 1.0, 20.0),
        m(ManoeuvreKind::Circle, 70.0, 15.0, 1.5, 8, 0.6, 12.0),
        m(ManoeuvreKind::Hold, 65.0, 60.0, 3.0, 2, 18.0, 25.0),
        m(ManoeuvreKind::Ladder, 75.0, 330.0, 0.0, 4, 0.6, 25.0),
        m(ManoeuvreKind::Nested, 60.0, 270.0, 2.0, 5, 0.3, 25.0),
        m(ManoeuvreKind::Reversals, 35.0, 120.0, 0.0, 3, 0.15, 28.0),
        m(ManoeuvreKind::Hold, 60.0, 150.0, -1.5, 2, 15.0, 25.0),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::tip::Rig;
    use crate::model::transmission::Line;
    use rand::SeedableRng;

    #[test]
    fn every_manoeuvre_stays_within_the_machine() {
        let machine = Machine::new(
            Rig::default(),
            [Line {
                k_epsilon: 2.5,
                k_lambda_mm: 0.9,
            }; 3],
        );
        let mut rng = StdRng::seed_from_u64(3);
        for _ in 0..300 {
            let m = Manoeuvre::any(&machine, &mut rng).varied(&machine, &mut rng);
            for row in m.rows(&machine) {
                assert!(
                    machine.reaches(&row)
                        && row.bend_deg >= 0.0
                        && (0.0..360.0).contains(&row.dir_deg),
                    "{m:?} {row:?}"
                );
                assert!(
                    row.hold_s > 0.0
                        && (machine.speed_mm_s[0]..=machine.speed_mm_s[1])
                            .contains(&row.speed_mm_s),
                    "{row:?}"
                );
            }
        }
    }

    #[test]
    fn a_single_bellow_manoeuvre_moves_one_bellow() {
        let machine = Machine::new(
            Rig::default(),
            [Line {
                k_epsilon: 2.2,
                k_lambda_mm: 0.9,
            }; 3],
        );
        for i in 0..3 {
            for (bend_deg, dir_deg, len_mm) in single(&machine, i, 30.0) {
                let q = ScheduleRow {
                    bend_deg,
                    dir_deg,
                    len_mm,
                    hold_s: 1.0,
                    speed_mm_s: 9.0,
                }
                .lengths(&machine.rig.geometry);
                for k in 0..3 {
                    assert!((q[k].abs() > 1.0) == (k == i), "bellow {i}: {q}");
                }
            }
        }
    }
}
