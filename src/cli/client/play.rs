//! `play`: runs a schedule through a running service, so that its log can be diagnosed.
//!
//! The speed of a row is that of the fastest piston. The speed of the set-point follows from the gains in use: pistons
//! move by (1 + k_ε) Δq (Eq. 16), and all arrive at the same time.

use super::args::PlayArgs;
use super::connection::{ask, connect, words};
use crate::cli::CommandOutcome::{self, Good, NotGoodEnough};
use crate::cli::output;
use crate::diagnosis::excite::rows::{self, Row};
use crate::model::arc::Geometry;
use crate::model::bend::Bend;
use crate::service::client::Client as Connection;
use crate::service::protocol::{RecordAction, Request};
use miette::{IntoDiagnostic, Result};
use serde_json::{Value, json};
use std::time::Duration;

/// Longest delay of a segment beyond its planned duration, s.
const LATE_MAX_S: f64 = 10.0;
/// k_ε of a service that does not report one: the mean of the paper's.
const K_EPSILON: f64 = 2.2;

/// Runs the schedule on an armed tip and, with `--record`, records it. The recording ends with this command, however that ends.
///
/// # Errors
/// A schedule that cannot be read, or a report with the service's message.
pub fn play(args: &PlayArgs) -> Result<CommandOutcome> {
    let rows = rows::read(&args.schedule).into_diagnostic()?;
    let mut connection = connect(&args.at)?;
    let Some(status) = ask(&mut connection, &Request::Status {})? else { return Ok(NotGoodEnough) };
    if status["mode"] != "holding" || status["stopped"] == true {
        eprintln!("refused: the schedule moves the tip, so it must be armed and at a standstill: `retroflex arm` first");
        return Ok(NotGoodEnough);
    }
    if args.record.is_none() {
        return run_rows(&mut connection, &rows);
    }
    if status["counted"] != json!([0, 0, 0]) {
        eprintln!("refused: the log must begin at rest: `retroflex relax`, then `retroflex arm`");
        return Ok(NotGoodEnough);
    }
    let request = |action| Request::Record { action, name: args.record.clone(), owned: true };
    let Some(started) = ask(&mut connection, &request(RecordAction::Start))? else { return Ok(NotGoodEnough) };
    if let Some(remark) = started["remark"].as_str() {
        eprintln!("note: {remark}; `retroflex zero` first measures against the present attitude");
    }
    let outcome = run_rows(&mut connection, &rows);
    if let Some(recorded) = ask(&mut connection, &request(RecordAction::Stop))? {
        output::print(&words(&recorded));
    }
    outcome
}

fn run_rows(connection: &mut Connection, rows: &[Row]) -> Result<CommandOutcome> {
    let bar = output::bar(rows.len() as u64, "row {pos} of {len}");
    let mut before = Row::rest(0.0, &Geometry::default());
    for row in rows {
        let Some(status) = ask(connection, &Request::Status {})? else { return Ok(NotGoodEnough) };
        let (seconds, speed_deg_s) = segment(&before, row, &status);
        let request = Request::Bend { bend_deg: row.bend_deg, dir_deg: row.dir_deg, length_mm: Some(row.len_mm), speed_deg_s };
        if ask(connection, &request)?.is_none() || !arrive_and_hold(connection, clock_s(&status), seconds, row)? {
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
    let fastest_mm = (0..3).map(|i| (change[i] * (1.0 + k_epsilon(i))).abs()).fold(0.0, f64::max);
    let seconds = fastest_mm / to.speed_mm_s;
    let bend = |r: &Row| Bend::from_deg(r.bend_deg, r.dir_deg).0;
    let bend_deg = (bend(to) - bend(from)).norm().to_degrees();
    // the service accepts 0.1 to 720 °/s
    (seconds, (bend_deg > 0.1).then(|| (bend_deg / seconds).clamp(0.1, 720.0)))
}

/// Waits for the end of the segment and of the hold, on the clock of the machine, which a simulation may run faster; false if
/// the service stops moving.
fn arrive_and_hold(connection: &mut Connection, started_s: f64, seconds: f64, row: &Row) -> Result<bool> {
    let mut arrived_s: Option<f64> = None;
    loop {
        std::thread::sleep(Duration::from_millis(5));
        let Some(s) = ask(connection, &Request::Status {})? else { return Ok(false) };
        let mode = s["mode"].as_str().unwrap_or("");
        if mode != "tracking" && mode != "holding" {
            let why = s["fault"].as_str().map_or(format!("mode {mode}"), str::to_owned);
            eprintln!("the schedule ended at bend {}° toward {}°: {why}", row.bend_deg, row.dir_deg);
            return Ok(false);
        }
        let now_s = clock_s(&s);
        let on_its_way = now_s - started_s < seconds || (mode == "tracking" && now_s - started_s < seconds + LATE_MAX_S);
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
