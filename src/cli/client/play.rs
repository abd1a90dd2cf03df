//! `play`: a schedule through a running service, so that its log can be diagnosed.
//!
//! A row's speed is that of the fastest piston. The set-point's speed follows from it by the gains in
//! use: pistons move by (1 + k_ε) Δq (Eq. 16), and all arrive together.

use super::args::PlayArgs;
use super::{ask, connect, follow, report, settle};
use crate::cli::CommandOutcome;
use crate::cli::output;
use crate::diagnosis::excite::rows::{self, Row};
use crate::model::arc::Geometry;
use crate::model::bend::Bend;
use crate::service::client::Client as Connection;
use crate::service::protocol::{RecordAction, Request};
use miette::{IntoDiagnostic, Result};
use serde_json::Value;
use std::time::{Duration, Instant};

/// How much longer than planned a way may take.
const LATE_MAX: Duration = Duration::from_secs(10);

/// Runs the schedule, recorded if it is told to.
///
/// # Errors
/// A schedule that cannot be read, or a report with the service's words.
pub fn play(args: &PlayArgs) -> Result<CommandOutcome> {
    let rows = rows::read(&args.schedule).into_diagnostic()?;
    let mut connection = connect(&args.at)?;
    if args.record.is_some() {
        let start = Request::Record { action: RecordAction::Start, name: args.record.clone() };
        if settle(ask(&mut connection, &start))?.is_none() || follow::aligned(&mut connection)? != CommandOutcome::Good {
            return Ok(CommandOutcome::NotGoodEnough);
        }
        // a schedule begins at rest, and so does its log
        std::thread::sleep(Duration::from_secs_f64(rows[0].hold_s));
        if settle(ask(&mut connection, &Request::Arm {}))?.is_none() {
            return Ok(CommandOutcome::NotGoodEnough);
        }
    }
    let ended = walk(&mut connection, &rows);
    if args.record.is_some()
        && let Some(recorded) = settle(ask(&mut connection, &Request::Record { action: RecordAction::Stop, name: None }))?
    {
        super::say(&format!("{recorded}\n"));
    }
    ended
}

fn walk(connection: &mut Connection, rows: &[Row]) -> Result<CommandOutcome> {
    let bar = output::bar(rows.len() as u64, "row {pos} of {len}");
    let mut before = Row::rest(0.0, &Geometry::default());
    for row in rows {
        let Some(status) = settle(ask(connection, &Request::Status {}))? else { return Ok(CommandOutcome::NotGoodEnough) };
        let way = Way::new(&before, row, &status);
        let request =
            Request::Bend { bend_deg: row.bend_deg, dir_deg: row.dir_deg, length_mm: Some(row.len_mm), speed_deg_s: way.bend_speed_deg_s };
        if settle(ask(connection, &request))?.is_none() || stay(connection, &way, row)? != CommandOutcome::Good {
            return Ok(CommandOutcome::NotGoodEnough);
        }
        before = *row;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(CommandOutcome::Good)
}

/// From one row to the next.
struct Way {
    seconds: f64,
    bend_speed_deg_s: Option<f64>,
}

impl Way {
    fn new(from: &Row, to: &Row, status: &Value) -> Self {
        let geometry = Geometry::default();
        let k_epsilon = |i: usize| status["k_epsilon"][i].as_f64().unwrap_or(2.2);
        let change = to.lengths(&geometry) - from.lengths(&geometry);
        let fastest_mm = (0..3).map(|i| (change[i] * (1.0 + k_epsilon(i))).abs()).fold(0.0, f64::max);
        let seconds = fastest_mm / to.speed_mm_s;
        let bend = |r: &Row| Bend::from_deg(r.bend_deg, r.dir_deg).0;
        let bend_deg = (bend(to) - bend(from)).norm().to_degrees();
        Self { seconds, bend_speed_deg_s: (bend_deg > 0.1).then(|| (bend_deg / seconds).clamp(0.1, 720.0)) }
    }
}

/// Waits until the way and the hold are over; anything but motion and rest ends the schedule.
fn stay(connection: &mut Connection, way: &Way, row: &Row) -> Result<CommandOutcome> {
    let begun = Instant::now();
    let mut arrived = None;
    loop {
        std::thread::sleep(Duration::from_millis(20));
        let s = connection.ask(&Request::Status {}).map_err(report)?;
        let mode = s["mode"].as_str().unwrap_or("").to_owned();
        if mode != "tracking" && mode != "holding" {
            let why = s["fault"].as_str().map_or(format!("mode {mode}"), str::to_owned);
            eprintln!("the schedule ended at bend {}° toward {}°: {why}", row.bend_deg, row.dir_deg);
            return Ok(CommandOutcome::NotGoodEnough);
        }
        let on_its_way = begun.elapsed().as_secs_f64() < way.seconds
            || (mode == "tracking" && begun.elapsed().as_secs_f64() < way.seconds + LATE_MAX.as_secs_f64());
        if arrived.is_none() && !on_its_way {
            arrived = Some(Instant::now());
        }
        if arrived.is_some_and(|at| at.elapsed().as_secs_f64() >= row.hold_s) {
            return Ok(CommandOutcome::Good);
        }
    }
}
