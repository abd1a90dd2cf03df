//! `play`: runs a schedule through a running service, so that its log can be diagnosed.
//!
//! The speed of a row is that of the fastest piston. The speed of the set-point follows from the gains in use: pistons
//! move by (1 + k_ε) Δq (Eq. 16), and all arrive at the same time.

use super::args::PlayArgs;
use super::connection::{answered, ask, connect, status, words};
use crate::cli::CommandOutcome::{self, Good, NotGoodEnough};
use crate::cli::output;
use crate::diagnosis::excite::Row;
use crate::diagnosis::excite::rows;
use crate::experiment::path::PathFile;
use crate::log::table::{Schema, Table};
use crate::model::{Bend, Geometry};
use crate::service::client::Client as Connection;
use crate::service::protocol::{Failure, Frame, PathRow, RecordAction, Request};
use miette::{IntoDiagnostic, Result, miette};
use serde_json::{Value, json};
use std::path::Path;
use std::time::Duration;

/// Longest delay of a segment beyond its planned duration, s.
const LATE_MAX_S: f64 = 10.0;
/// Time at the beginning of a recording in which the pistons stand, s: a diagnosis takes it for the tip at rest.
const AT_REST_S: f64 = 2.0;
/// Time at the first row of a path before it begins, s.
const AT_FIRST_S: f64 = 1.0;
/// Rows of a path in one request: at most 16 KiB.
const CHUNK_ROWS: usize = 150;
/// k_ε of a service that does not report one: the mean of the paper's.
const K_EPSILON: f64 = 2.2;

/// Runs the schedule on an armed tip and, with `--record`, records it. The recording ends with this command, however that ends.
///
/// # Errors
/// A schedule that cannot be read, or a report with the service's message.
pub fn play(args: &PlayArgs) -> Result<CommandOutcome> {
    let schedule = Schedule::read(&args.schedule)?;
    let mut connection = connect(&args.at)?;
    let now = status(&mut connection)?;
    if now["mode"] != "holding" || now["stopped"] == true {
        eprintln!(
            "refused: the schedule moves the tip, so it must be armed and at a standstill: `retroflex arm` first"
        );
        return Ok(NotGoodEnough);
    }
    if args.record.is_none() {
        return schedule.run(&mut connection);
    }
    if now["counted"] != json!([0, 0, 0]) {
        eprintln!("refused: the log must begin at rest: `retroflex relax`, then `retroflex arm`");
        return Ok(NotGoodEnough);
    }
    let request = |action| Request::Record {
        action,
        name: args.record.clone(),
        owned: true,
    };
    let Some(started) = ask(&mut connection, &request(RecordAction::Start))? else {
        return Ok(NotGoodEnough);
    };
    if let Some(remark) = started["remark"].as_str() {
        eprintln!("note: {remark}; `retroflex zero` first measures against the present attitude");
    }
    // after an earlier motion the straight tip is not quite where the first row is
    let rest = Row::rest(AT_REST_S, &Geometry::default());
    let rested = arrive_and_hold(&mut connection, clock_s(&now), 0.0, &rest)?;
    let outcome = if rested {
        schedule.run(&mut connection)
    } else {
        Ok(NotGoodEnough)
    };
    if let Some(recorded) = ask(&mut connection, &request(RecordAction::Stop))? {
        output::print(words(&recorded));
    }
    outcome
}

/// What is played.
enum Schedule {
    /// Poses with speeds and holds.
    Poses(Vec<Row>),
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
        let is_path = Table::open(file, &header)
            .into_diagnostic()?
            .header()
            .iter()
            .any(|name| name == "t_s");
        Ok(match is_path {
            true => Self::Path(PathFile::open(file, &Geometry::default()).into_diagnostic()?),
            false => Self::Poses(rows::read(file).into_diagnostic()?),
        })
    }

    fn run(&self, connection: &mut Connection) -> Result<CommandOutcome> {
        match self {
            Self::Poses(rows) => run_rows(connection, rows),
            Self::Path(file) => run_path(connection, file),
        }
    }
}

/// Has the rows of a path checked, moves to the first one, then follows it.
fn run_path(connection: &mut Connection, file: &PathFile) -> Result<CommandOutcome> {
    let column = |name: &str| file.table.column(name).unwrap_or_default();
    let (t_s, bend_deg, dir_deg, len_mm) = (
        column("t_s"),
        column("bend_deg"),
        column("dir_deg"),
        column("len_mm"),
    );
    let rows: Vec<PathRow> = (0..t_s.len())
        .map(|k| (t_s[k], bend_deg[k], dir_deg[k], len_mm.get(k).copied()))
        .collect();
    for chunk in rows.chunks(CHUNK_ROWS) {
        let request = Request::Path {
            rows: chunk.to_vec(),
            more: true,
        };
        if checked(file, connection.request(&request))?.is_none() {
            return Ok(NotGoodEnough);
        }
    }
    let now = status(connection)?;
    let (_, bend_deg, dir_deg, length_mm) = rows[0];
    let first = Row {
        bend_deg,
        dir_deg,
        hold_s: AT_FIRST_S,
        ..Row::rest(0.0, &Geometry::default())
    };
    let request = Request::Bend {
        bend_deg,
        dir_deg,
        length_mm,
        speed_deg_s: None,
        frame: Frame::Base,
    };
    if ask(connection, &request)?.is_none()
        || !arrive_and_hold(connection, clock_s(&now), 0.0, &first)?
    {
        return Ok(NotGoodEnough);
    }
    let played = connection.request(&Request::Path {
        rows: vec![],
        more: false,
    });
    let Some(answer) = checked(file, played)? else {
        return Ok(NotGoodEnough);
    };
    if let Some(slower) = answer["time_scale"].as_f64().filter(|scale| *scale > 1.0) {
        eprintln!(
            "note: the path asks {slower:.2} times the speed that the pistons can follow; it is played that much slower"
        );
    }
    loop {
        std::thread::sleep(Duration::from_millis(20));
        let s = status(connection)?;
        if let Some(why) = halted(&s) {
            eprintln!("the path ended early: {why}");
            return Ok(NotGoodEnough);
        }
        if s["path"].is_null() && s["mode"] == "holding" {
            return Ok(Good);
        }
    }
}

/// The answer to rows of a path. The refusal of one is an error that names file, line and column.
fn checked(file: &PathFile, answer: Result<Value, Failure>) -> Result<Option<Value>> {
    let message = match answer {
        Err(Failure { code: 2, message }) => message,
        other => return answered(other),
    };
    let row = message
        .strip_prefix("row ")
        .and_then(|rest| rest.split(',').next()?.parse::<usize>().ok());
    Err(match (row, message.split_once("expected ")) {
        (Some(row @ 1..), Some((_, expected))) if row <= file.table.rows() => {
            miette!("{}", file.refuse(row - 1, expected))
        }
        _ => miette!("{message}"),
    })
}

/// Why the tip does not move as it is told.
pub(super) fn halted(s: &Value) -> Option<String> {
    let mode = s["mode"].as_str().unwrap_or("");
    if s["stopped"] == true {
        return Some("stopped".to_owned());
    }
    (mode != "tracking" && mode != "holding").then(|| {
        s["fault"]
            .as_str()
            .map_or(format!("mode {mode}"), str::to_owned)
    })
}

fn run_rows(connection: &mut Connection, rows: &[Row]) -> Result<CommandOutcome> {
    let bar = output::bar(rows.len() as u64, "row {pos} of {len}");
    let mut before = Row::rest(0.0, &Geometry::default());
    for row in rows {
        let now = status(connection)?;
        let (seconds, speed_deg_s) = segment(&before, row, &now);
        let request = Request::Bend {
            bend_deg: row.bend_deg,
            dir_deg: row.dir_deg,
            length_mm: Some(row.len_mm),
            speed_deg_s,
            frame: Frame::Base,
        };
        if ask(connection, &request)?.is_none()
            || !arrive_and_hold(connection, clock_s(&now), seconds, row)?
        {
            return Ok(NotGoodEnough);
        }
        before = *row;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Good)
}

/// Duration of the segment between two rows, s, and the speed of its set-point, °/s (`None` if it does not bend).
fn segment(from: &Row, to: &Row, status: &Value) -> (f64, Option<f64>) {
    let geometry = Geometry::default();
    let k_epsilon = |i: usize| status["k_epsilon"][i].as_f64().unwrap_or(K_EPSILON);
    let change = to.lengths(&geometry) - from.lengths(&geometry);
    let fastest_mm = (0..3)
        .map(|i| (change[i] * (1.0 + k_epsilon(i))).abs())
        .fold(0.0, f64::max);
    let seconds = fastest_mm / to.speed_mm_s;
    let bend = |r: &Row| Bend::from_deg(r.bend_deg, r.dir_deg).0;
    let bend_deg = (bend(to) - bend(from)).norm().to_degrees();
    // the service accepts 0.1 to 720 °/s
    (
        seconds,
        (bend_deg > 0.1).then(|| (bend_deg / seconds).clamp(0.1, 720.0)),
    )
}

/// Waits for the end of the segment and of the hold, on the clock of the machine, which a simulation may run faster; false if
/// the service stops moving.
fn arrive_and_hold(
    connection: &mut Connection,
    started_s: f64,
    seconds: f64,
    row: &Row,
) -> Result<bool> {
    let mut arrived_s: Option<f64> = None;
    loop {
        std::thread::sleep(Duration::from_millis(5));
        let s = status(connection)?;
        if let Some(why) = halted(&s) {
            eprintln!(
                "the schedule ended at bend {}° toward {}°: {why}",
                row.bend_deg, row.dir_deg
            );
            return Ok(false);
        }
        let now_s = clock_s(&s);
        let on_its_way = now_s - started_s < seconds
            || (s["mode"] == "tracking" && now_s - started_s < seconds + LATE_MAX_S);
        if arrived_s.is_none() && !on_its_way {
            arrived_s = Some(now_s);
        }
        if arrived_s.is_some_and(|at_s| now_s - at_s >= row.hold_s) {
            return Ok(true);
        }
    }
}

/// Time of the machine, s.
fn clock_s(status: &Value) -> f64 {
    status["t"].as_f64().unwrap_or(0.0)
}
