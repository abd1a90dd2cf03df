//! `play`: runs a schedule through a running service, so that its log can be diagnosed.
//!
//! The speed of a row is that of the fastest piston. The speed of the set-point follows from the gains in use: pistons
//! move by (1 + k_ε) Δq (Eq. 16), and all arrive at the same time.

use super::connection::{
    At, Connection, ask, connect, halted, is_led_elsewhere, poll, report, status, words,
};
use crate::cli::{Refused, output};
use crate::diagnosis::excite::{ScheduleRow, rows};
use crate::experiment::path::PathFile;
use crate::log::table::{Schema, Table};
use crate::model::{Bend, Geometry};
use crate::service::protocol::{Failure, PathRow, RecordAction, Request};
use crate::service::status::Status;
use crate::supervisor::Mode;
use miette::{IntoDiagnostic, Report, Result, miette};
use std::path::{Path, PathBuf};

/// Longest delay of a segment beyond its planned duration, s.
const LATE_MAX_S: f64 = 10.0;
/// Time at the beginning of a recording in which the pistons stand, s: a diagnosis takes it for the tip at rest.
const AT_REST_S: f64 = 2.0;
/// Time at the first row of a path before it begins, s.
const AT_FIRST_S: f64 = 1.0;
/// Rows of a path in one request: at most 16 KiB.
const CHUNK_ROWS: usize = 150;
/// Largest difference between two lengths that are the same, mm: rounding.
const SAME_MM: f64 = 0.05;
/// k_ε of a service that does not report one: the mean of the paper's.
const K_EPSILON: f64 = 2.2;

/// Arguments of `play`.
#[derive(Debug, clap::Args)]
pub struct PlayArgs {
    #[command(flatten)]
    at: At,
    /// Rows `bend_deg,dir_deg,len_mm,hold_s,speed_mm_s`, or a path of rows `t_s,bend_deg,dir_deg[,len_mm]`.
    #[arg(value_name = "SCHEDULE.csv")]
    schedule: PathBuf,
    /// Record the schedule under this name.
    #[arg(long)]
    record: Option<String>,
}

/// Runs the schedule on an armed tip and, with `--record`, records it. The recording ends with this command, however that ends.
///
/// # Errors
/// A schedule that cannot be read, or a report with the service's message.
pub fn play(args: &PlayArgs) -> Result<()> {
    let schedule = Schedule::read(&args.schedule)?;
    let mut connection = connect(&args.at)?;
    let now = status(&mut connection)?;
    if now.mode != Some(Mode::Holding) || now.stopped {
        let why = "the schedule moves the tip, so it must be armed and at a standstill: `retroflex arm` first";
        return Err(Refused::report(why));
    }
    schedule.check(&args.schedule, &mut connection)?;
    if args.record.is_none() {
        return schedule.run(&mut connection, now.stops);
    }
    if now.counted != Some([0; 3]) {
        let why = "the log must begin at rest: `retroflex relax`, then `retroflex arm`";
        return Err(Refused::report(why));
    }
    let request = |action| Request::Record {
        action,
        name: args.record.clone(),
        owned: true,
    };
    let started = ask(&mut connection, &request(RecordAction::Start))?;
    if let Some(remark) = started["remark"].as_str() {
        eprintln!("note: {remark}; `retroflex zero` first measures against the present attitude");
    }
    // after an earlier motion the straight tip is not quite where the first row is
    let rest = ScheduleRow::rest(AT_REST_S, &Geometry::default());
    let rested = arrive_and_hold(&mut connection, &now, 0.0, &rest, None);
    let outcome = rested.and_then(|()| schedule.run(&mut connection, now.stops));
    let recorded = ask(&mut connection, &request(RecordAction::Stop));
    if let Ok(recorded) = &recorded {
        output::print(words(recorded));
    }
    outcome.and(recorded.map(drop))
}

/// What is played.
enum Schedule {
    /// Poses with speeds and holds.
    Poses(Vec<ScheduleRow>),
    /// A path.
    Path(PathFile),
}

impl Schedule {
    /// Reads a file, which is a path if its header names `t_s`.
    fn read(file: &Path) -> Result<Self> {
        let header = Schema {
            required: &[],
            known: &|_| false,
            rows_min: 0,
        };
        let table = Table::open(file, &header).into_diagnostic()?;
        let is_path = table.header().iter().any(|name| name == "t_s");
        Ok(if is_path {
            Self::Path(PathFile::open(file, &Geometry::default()).into_diagnostic()?)
        } else {
            Self::Poses(rows::read(file).into_diagnostic()?)
        })
    }

    /// The rows as those of a path. What is between poses is not checked, so their times only have to increase.
    fn path(&self) -> Vec<PathRow> {
        match self {
            Self::Poses(rows) => {
                // two rows make a path
                let again = rows.first().filter(|_| rows.len() == 1);
                let timed = (0_u32..)
                    .map(|k| f64::from(k) * 1e-3)
                    .zip(rows.iter().chain(again));
                let row =
                    |(t_s, r): (f64, &ScheduleRow)| (t_s, r.bend_deg, r.dir_deg, Some(r.len_mm));
                timed.map(row).collect()
            }
            Self::Path(file) => {
                let column = |name: &str| file.table.column(name).unwrap_or_default();
                let [t_s, bend_deg, dir_deg, len_mm] =
                    ["t_s", "bend_deg", "dir_deg", "len_mm"].map(column);
                let row = |k: usize| (t_s[k], bend_deg[k], dir_deg[k], len_mm.get(k).copied());
                (0..t_s.len()).map(row).collect()
            }
        }
    }

    /// Has the service check all rows before anything moves.
    fn check(&self, file: &Path, connection: &mut Connection) -> Result<()> {
        for chunk in self.path().chunks(CHUNK_ROWS) {
            let (rows, more) = (chunk.to_vec(), true);
            let answer = connection.request(&Request::Path { rows, more });
            answer.map_err(|failure| match failure {
                Failure { code: 2, message } => self.refusal(file, &message),
                failure => report(failure),
            })?;
        }
        Ok(())
    }

    /// What the service says of a row, with its place in the file.
    fn refusal(&self, file: &Path, message: &str) -> Report {
        let place = || {
            let (place, expected) = message.strip_prefix("row ")?.split_once(": expected ")?;
            let (row, given) = place.split_once(", ")?;
            let (column, value) = given.split_once(' ')?;
            let row = row.parse::<usize>().ok()?.checked_sub(1)?;
            Some((row, column.replace("length_mm", "len_mm"), value, expected))
        };
        match (self, place()) {
            (Self::Path(path), Some((row, column, value, expected))) if row < path.table.rows() => {
                miette!("{}", path.table.refuse(row, &column, value, expected))
            }
            _ => miette!("{}, {message}", file.display()),
        }
    }

    /// Plays it, after so many stops. One more ends it, also if the tip is armed again at once.
    fn run(&self, connection: &mut Connection, stops: u64) -> Result<()> {
        match self {
            Self::Poses(rows) => run_rows(connection, rows, stops),
            Self::Path(_) => run_path(connection, &self.path(), stops),
        }
    }
}

/// Moves to the first row of a path that the service has checked, then follows it.
fn run_path(connection: &mut Connection, rows: &[PathRow], stops: u64) -> Result<()> {
    let now = status_after(connection, stops)?;
    let (_, bend_deg, dir_deg, _) = rows[0];
    let first = ScheduleRow {
        bend_deg,
        dir_deg,
        ..ScheduleRow::rest(AT_FIRST_S, &Geometry::default())
    };
    ask(connection, &to_first(rows[0]))?;
    arrive_and_hold(connection, &now, 0.0, &first, Some(rows[0]))?;
    let began = status_after(connection, stops)?;
    let (t_s, bend_deg, dir_deg, length_mm) = rows[rows.len() - 1];
    // a path without lengths keeps the one at its first row
    let end = (t_s, bend_deg, dir_deg, length_mm.or(began.target_length_mm));
    let (rows, more) = (vec![], false);
    let answer = ask(connection, &Request::Path { rows, more })?;
    let duration_s = answer["duration_s"].as_f64().unwrap_or_default();
    if let Some(slower) = answer["time_scale"].as_f64().filter(|scale| *scale > 1.0) {
        eprintln!(
            "note: the path asks {slower:.2} times the speed that the pistons can follow; it is played that much slower"
        );
    }
    poll(connection, 20, |s| {
        let is_over = s.path.is_none();
        let early = is_over && (s.t - began.t < duration_s || is_elsewhere(s, end));
        match ended(s, &began).or_else(|| early.then(replaced)) {
            Some(why) => Some(Err(Refused(format!("the path ended early: {why}")).into())),
            None => (is_over && s.mode == Some(Mode::Holding)).then_some(Ok(())),
        }
    })?
}

/// The present status, but for the number of stops, which is that before the schedule.
fn status_after(connection: &mut Connection, stops: u64) -> Result<Status> {
    let now = status(connection)?;
    Ok(Status { stops, ..now })
}

/// Why the tip does not move as it is told, or that it was stopped since it `began`.
fn ended(s: &Status, began: &Status) -> Option<String> {
    let stopped = s.stops != began.stops;
    halted(s).or_else(|| stopped.then(|| "stopped".to_owned()))
}

/// True if another command has given the tip another bend than that of this row, or another length if the row has one.
fn is_elsewhere(s: &Status, (_, bend_deg, dir_deg, length_mm): PathRow) -> bool {
    let lengths = s.target_length_mm.zip(length_mm);
    is_led_elsewhere(s, Bend::from_deg(bend_deg, dir_deg))
        || lengths.is_some_and(|(now, asked)| (now - asked).abs() > SAME_MM)
}

/// What is said where the tip follows another command than this one.
fn replaced() -> String {
    "another command ended it".to_owned()
}

/// The move to the first row of a path, at the usual speed.
fn to_first((_, bend_deg, dir_deg, length_mm): PathRow) -> Request {
    Request::bend(bend_deg, dir_deg, length_mm, None)
}

fn run_rows(connection: &mut Connection, rows: &[ScheduleRow], stops: u64) -> Result<()> {
    let bar = output::bar(rows.len() as u64, "row {pos} of {len}");
    let mut before = ScheduleRow::rest(0.0, &Geometry::default());
    for row in rows {
        let now = status_after(connection, stops)?;
        let k_epsilon = now.k_epsilon.unwrap_or([K_EPSILON; 3]);
        let (seconds, speed_deg_s) = row.segment(&before, &Geometry::default(), k_epsilon);
        // the service accepts 0.1 to 720 °/s
        let speed_deg_s = speed_deg_s.map(|s| s.clamp(0.1, 720.0));
        let request = Request::bend(row.bend_deg, row.dir_deg, Some(row.len_mm), speed_deg_s);
        ask(connection, &request)?;
        let asked = (0.0, row.bend_deg, row.dir_deg, Some(row.len_mm));
        arrive_and_hold(connection, &now, seconds, row, Some(asked))?;
        before = *row;
        bar.inc(1);
    }
    Ok(())
}

/// Waits for the end of the segment and of the hold, on the clock of the machine, which a simulation may run faster. It is an error if
/// the tip was stopped, or if another command leads it away from the pose that was asked for, or moves a tip that was not asked to move.
fn arrive_and_hold(
    connection: &mut Connection,
    began: &Status,
    seconds: f64,
    row: &ScheduleRow,
    asked: Option<PathRow>,
) -> Result<()> {
    let mut arrived_s: Option<f64> = None;
    poll(connection, 5, |s| {
        let is_on_its_way = s.mode == Some(Mode::Tracking);
        let elsewhere = asked.map_or(is_on_its_way, |pose| is_elsewhere(s, pose));
        if let Some(why) = ended(s, began).or_else(|| elsewhere.then(replaced)) {
            let (bend_deg, dir_deg) = (row.bend_deg, row.dir_deg);
            let text = format!("the schedule ended at bend {bend_deg}° toward {dir_deg}°: {why}");
            return Some(Err(Refused(text).into()));
        }
        let late_max_s = if is_on_its_way { LATE_MAX_S } else { 0.0 };
        if s.t - began.t >= seconds + late_max_s {
            arrived_s.get_or_insert(s.t);
        }
        let is_over = arrived_s.is_some_and(|at_s| s.t - at_s >= row.hold_s);
        is_over.then_some(Ok(()))
    })?
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_path_begins_at_its_first_pose_and_length_at_the_usual_speed() {
        let asked = json!(to_first((0.0, 30.0, 90.0, Some(21.0))));
        assert_eq!(
            (&asked["bend_deg"], &asked["dir_deg"], &asked["length_mm"]),
            (&json!(30.0), &json!(90.0), &json!(21.0))
        );
        assert!(asked["speed_deg_s"].is_null(), "{asked}");
    }
}
