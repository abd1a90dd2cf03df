//! Rows of a schedule, the pistons that drive them, and the poses a machine can reach.
//!
//! A row is a pose and how to get there: bend, direction and length (paper, Eq. 3), the speed of the fastest piston on
//! the way, and the hold after arrival. All pistons start and arrive together on straight lines. Eq. 10-11 and Eq. 16
//! turn poses into piston positions.

use crate::diagnosis::tip::Rig;
use crate::log::error::ReadError;
use crate::log::table::{Schema, Table};
use crate::model::{Bend, Geometry, Line, Shape, Side, SideState};
use nalgebra::Vector3;
use std::fmt::Write as _;
use std::path::Path;

/// Part of the travel that a schedule uses: the rest is left to units whose gains differ by up to 8 %.
const TRAVEL_SHARE: f64 = 0.92;
/// Slowest piston of a schedule, mm/s.
const SPEED_MIN_MM_S: f64 = 3.0;
/// Speed left below the largest, mm/s.
const SPEED_MARGIN_MM_S: f64 = 2.0;
/// Speed of the fastest piston to a rest, mm/s.
const REST_SPEED_MM_S: f64 = 20.0;
/// Dead band of a reversal, mm.
const BAND_MM: f64 = 0.03;

/// One pose of a schedule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScheduleRow {
    /// Bend β, degrees.
    pub bend_deg: f64,
    /// Direction δ, degrees, 0..360.
    pub dir_deg: f64,
    /// Centre-line length l, mm.
    pub len_mm: f64,
    /// Time at the pose after arrival, s.
    pub hold_s: f64,
    /// Speed of the fastest piston on the way there, mm/s.
    pub speed_mm_s: f64,
}

impl ScheduleRow {
    /// The pose with this bend, direction and length, held so long, reached at that speed.
    pub fn new(bend_deg: f64, dir_deg: f64, len_mm: f64, hold_s: f64, speed_mm_s: f64) -> Self {
        Self {
            bend_deg,
            dir_deg,
            len_mm,
            hold_s,
            speed_mm_s,
        }
    }

    /// A rest.
    pub fn rest(hold_s: f64, geometry: &Geometry) -> Self {
        Self::new(0.0, 0.0, geometry.rest_length_mm, hold_s, REST_SPEED_MM_S)
    }

    /// Change of bellow lengths, mm.
    pub fn lengths(&self, geometry: &Geometry) -> Vector3<f64> {
        let bend = Bend::from_deg(self.bend_deg, self.dir_deg);
        geometry.lengths(&Shape::new(bend.0, self.len_mm))
    }

    /// Duration of the way from another row, s, with these gains, and the speed of a set-point that takes as long, °/s; `None` if it does
    /// not bend.
    pub fn segment(
        &self,
        from: &Self,
        geometry: &Geometry,
        k_epsilon: [f64; 3],
    ) -> (f64, Option<f64>) {
        let change = self.lengths(geometry) - from.lengths(geometry);
        let piston_mm = |i: usize| (change[i] * (1.0 + k_epsilon[i])).abs();
        let seconds = (0..3).map(piston_mm).fold(0.0, f64::max) / self.speed_mm_s;
        let bend = |r: &Self| Bend::from_deg(r.bend_deg, r.dir_deg).0;
        let bend_deg = (bend(self) - bend(from)).norm().to_degrees();
        (seconds, (bend_deg > 0.1).then(|| bend_deg / seconds))
    }

    /// The row rounded to the digits that a file holds, so that the designed schedule is the written one.
    pub fn rounded(&self) -> Self {
        let to = |x: f64, digits: f64| (x * digits).round() / digits;
        let [bend, len, hold] = [self.bend_deg, self.len_mm, self.hold_s].map(|x| to(x, 100.0));
        let dir = to(self.dir_deg.rem_euclid(360.0), 10.0).rem_euclid(360.0);
        Self::new(bend, dir, len, hold, to(self.speed_mm_s, 10.0))
    }
}

/// The nominal machine that a schedule is designed for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Machine {
    /// Geometry and prior lag.
    pub rig: Rig,
    /// Gains that turn poses into piston positions.
    pub lines: [Line; 3],
    /// Largest piston displacement of a schedule, mm.
    pub travel_mm: f64,
    /// Slowest and fastest piston of a schedule, mm/s.
    pub speed_mm_s: [f64; 2],
}

impl Machine {
    /// A rig with these gains.
    pub fn new(rig: Rig, lines: [Line; 3]) -> Self {
        let fastest = (rig.speed_max_mm_s - SPEED_MARGIN_MM_S).max(SPEED_MIN_MM_S + 1.0);
        Self {
            rig,
            lines,
            travel_mm: TRAVEL_SHARE * rig.travel_mm,
            speed_mm_s: [SPEED_MIN_MM_S, fastest],
        }
    }

    /// Whether the machine reaches a pose from either side of the backlash.
    pub fn reaches(&self, row: &ScheduleRow) -> bool {
        let q = row.lengths(&self.rig.geometry);
        (0..3).all(|i| {
            let bellow = self.rig.geometry.rest_length_mm + q[i];
            let piston = self.lines[i].piston_mm(q[i], q[i].signum());
            (self.rig.bellow_mm[0]..=self.rig.bellow_mm[1]).contains(&bellow)
                && piston.abs() <= self.travel_mm
        })
    }

    /// Counted pistons along a schedule, mm, every `period_s`, and the end of the last hold, s. They start at zero with the play centred.
    pub fn drive(&self, rows: &[ScheduleRow], period_s: f64) -> (Vec<Vector3<f64>>, f64) {
        let side = Side::Band { band_mm: BAND_MM };
        let mut states = [SideState::default(); 3];
        let (mut from, mut begun_s) = (Vector3::zeros(), 0.0);
        let mut piston_mm = Vec::new();
        for row in rows {
            let q = row.lengths(&self.rig.geometry);
            let to = Vector3::from_fn(|i, _| {
                let (piston, next) = side.invert(&self.lines[i], states[i], q[i], 1.0);
                states[i] = next;
                piston
            });
            let move_s = (to - from).amax() / row.speed_mm_s;
            let end_s = begun_s + move_s + row.hold_s;
            loop {
                let t = period_s * (piston_mm.len() + 1) as f64;
                if t > end_s {
                    break;
                }
                // a way of no length is done at once
                let share = if move_s > 0.0 {
                    ((t - begun_s) / move_s).min(1.0)
                } else {
                    1.0
                };
                piston_mm.push(from + (to - from) * share);
            }
            (from, begun_s) = (to, end_s);
        }
        (piston_mm, begun_s)
    }

    /// Length of a schedule, s.
    pub fn duration_s(&self, rows: &[ScheduleRow]) -> f64 {
        let (_, duration_s) = self.drive(rows, 10.0);
        duration_s
    }
}

/// The moving average of a path over the last `window` instants.
pub fn rounded(path: &[Vector3<f64>], window: usize) -> Vec<Vector3<f64>> {
    let mut sum = path.first().copied().unwrap_or_default() * window as f64;
    let mean = |k: usize| {
        sum += path[k] - path[k.saturating_sub(window)];
        sum / window as f64
    };
    (0..path.len()).map(mean).collect()
}

/// A schedule as CSV text.
pub fn csv(rows: &[ScheduleRow]) -> String {
    let mut out = String::from("bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n");
    for r in rows {
        // writing to a String cannot fail
        let _ = write!(out, "{:.2},{:.1},{:.2},", r.bend_deg, r.dir_deg, r.len_mm);
        let _ = writeln!(out, "{:.2},{:.1}", r.hold_s, r.speed_mm_s);
    }
    out
}

/// Columns of a schedule with the range of each.
const COLUMNS: [(&str, std::ops::RangeInclusive<f64>); 5] = [
    ("bend_deg", 0.0..=180.0),
    ("dir_deg", -360.0..=360.0),
    ("len_mm", 1.0..=200.0),
    ("hold_s", 0.0..=3600.0),
    ("speed_mm_s", 0.1..=1000.0),
];

/// Reads a schedule in the format of [`csv()`]. Whether the machine can reach the poses is not checked.
///
/// # Errors
/// [`ReadError`] with file, line and column.
pub fn read(path: &Path) -> Result<Vec<ScheduleRow>, ReadError> {
    let names = COLUMNS.map(|c| c.0);
    let schema = Schema {
        required: &names,
        known: &|n| names.contains(&n),
        rows_min: 1,
    };
    let table = Table::open(path, &schema)?;
    for (name, allowed) in COLUMNS {
        let mut values = table.complete(name)?.iter().enumerate();
        if let Some((k, value)) = values.find(|(_, v)| !allowed.contains(v)) {
            let expected = format!("a number from {} to {}", allowed.start(), allowed.end());
            return Err(table.refuse(k, name, &value.to_string(), &expected));
        }
    }
    let [bend, dir, len, hold, speed] = table.group(names)?.unwrap_or_default();
    let row = |k: usize| ScheduleRow::new(bend[k], dir[k], len[k], hold[k], speed[k]);
    Ok((0..table.rows()).map(row).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: Line = Line {
        k_epsilon: 2.2,
        k_lambda_mm: 0.87,
    };

    #[test]
    fn the_fastest_piston_has_the_speed_of_the_row_and_all_arrive_together() {
        let machine = Machine::new(Rig::default(), [PAPER; 3]);
        let rows = [
            ScheduleRow::rest(4.0, &machine.rig.geometry),
            ScheduleRow {
                bend_deg: 60.0,
                dir_deg: 30.0,
                len_mm: 21.0,
                hold_s: 2.0,
                speed_mm_s: 10.0,
            },
        ];
        let (piston_mm, duration_s) = machine.drive(&rows, 0.01);
        let speed = piston_mm
            .windows(2)
            .map(|w| (w[1] - w[0]).amax() / 0.01)
            .fold(0.0, f64::max);
        assert!((speed - 10.0).abs() < 0.01, "{speed}");
        assert!(
            piston_mm[398].amax() == 0.0,
            "the pistons stand during the rest"
        );
        let q = rows[1].lengths(&machine.rig.geometry);
        let end = piston_mm[piston_mm.len() - 1];
        for i in 0..3 {
            assert!((end[i] - PAPER.piston_mm(q[i], q[i].signum())).abs() < 1e-9);
        }
        assert!((duration_s - (4.0 + end.amax() / 10.0 + 2.0)).abs() < 1e-9);
        assert!((machine.duration_s(&rows) - duration_s).abs() < 1e-12);
    }

    #[test]
    fn a_pose_beyond_bellow_or_travel_is_out_of_reach() {
        let machine = Machine::new(Rig::default(), [PAPER; 3]);
        let row = |bend_deg, len_mm| ScheduleRow {
            bend_deg,
            dir_deg: 0.0,
            len_mm,
            hold_s: 1.0,
            speed_mm_s: 10.0,
        };
        assert!(machine.reaches(&row(75.0, 20.0)));
        assert!(
            !machine.reaches(&row(75.0, 17.0)),
            "a bellow is shorter than 14 mm"
        );
        assert!(
            !machine.reaches(&row(0.0, 29.0)),
            "a piston is beyond its travel"
        );
    }

    #[test]
    fn a_file_holds_the_rounded_row() {
        let row = ScheduleRow {
            bend_deg: 33.333_3,
            dir_deg: -0.04,
            len_mm: 20.0,
            hold_s: 0.5,
            speed_mm_s: 12.34,
        }
        .rounded();
        assert_eq!(
            csv(&[row]),
            "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n33.33,0.0,20.00,0.50,12.3\n"
        );
        assert_eq!(row.rounded(), row);
    }

    #[test]
    fn a_written_schedule_reads_back_and_errors_name_line_and_column() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.csv");
        let rows = [
            ScheduleRow::rest(4.0, &Geometry::default()),
            ScheduleRow {
                bend_deg: 60.0,
                dir_deg: 30.0,
                len_mm: 21.0,
                hold_s: 2.0,
                speed_mm_s: 10.0,
            },
        ];
        std::fs::write(&path, csv(&rows)).unwrap();
        assert_eq!(read(&path).unwrap(), rows);
        let head = "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n";
        let cases = [
            (
                format!("{head}0,0,20,4,20\n10,0,20,-1,20\n"),
                "line 3, column hold_s: `-1` is not a number from 0 to 3600",
            ),
            (format!("{head}0,0,20,4,x\n"), "line 2"),
            (format!("{head}0,0,20,4,NaN\n"), "line 2, column speed_mm_s"),
            (head.to_owned(), "no rows"),
            ("bend_deg,dir_deg\n1,2\n".to_owned(), "len_mm"),
        ];
        for (text, expected) in cases {
            std::fs::write(&path, &text).unwrap();
            let message = read(&path).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
