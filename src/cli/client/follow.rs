//! Commands that wait for their end: a move, an alignment, a calibration.

use super::args::{BendArgs, TransmissionArgs};
use super::connection::{At, ask, ask_and_print, connect, status};
use super::play::halted;
use super::status::pose;
use crate::cli::CommandOutcome::{self, Good, NotGoodEnough};
use crate::cli::output;
use crate::model::Bend;
use crate::report::page::Page;
use crate::service::client::Client as Connection;
use crate::service::protocol::{CalibrateAction, Frame, Request};
use miette::Result;
use serde_json::Value;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Longest wait for an alignment.
const ALIGNED_MAX: Duration = Duration::from_secs(10);
/// Longest wait for a move.
const MOVED_MAX: Duration = Duration::from_secs(60);
/// Longest wait of `arm` for a service that has just been started.
const STARTED_MAX: Duration = Duration::from_secs(2);
/// Largest difference between two targets that are the same, degrees: rounding.
const SAME_DEG: f64 = 0.1;

/// Period of the lines that report progress where there is no terminal.
const SAID_EVERY: Duration = Duration::from_secs(5);

/// Polls the status until `done` returns a result, or until the service refuses.
fn poll(
    connection: &mut Connection,
    period_ms: u64,
    mut done: impl FnMut(&Value) -> Option<CommandOutcome>,
) -> Result<CommandOutcome> {
    loop {
        sleep(Duration::from_millis(period_ms));
        if let Some(outcome) = done(&status(connection)?) {
            return Ok(outcome);
        }
    }
}

/// `bend`, with `--wait` until the tip has settled.
///
/// # Errors
/// A report with the service's message.
pub fn bend(args: &BendArgs) -> Result<CommandOutcome> {
    let mut connection = connect(&args.at)?;
    let frame = if args.world {
        Frame::World
    } else {
        Frame::Base
    };
    let request = Request::Bend {
        bend_deg: args.bend,
        dir_deg: args.toward,
        length_mm: args.length,
        speed_deg_s: args.speed,
        frame,
    };
    match args.wait {
        true => settle(
            &mut connection,
            &request,
            Bend::from_deg(args.bend, args.toward),
        ),
        false => ask_and_print(&mut connection, &request),
    }
}

/// Sends the request of a bend, and waits until the tip has settled there.
///
/// # Errors
/// A report with the service's message.
pub fn settle(
    connection: &mut Connection,
    request: &Request,
    sent_to: Bend,
) -> Result<CommandOutcome> {
    if ask(connection, request)?.is_none() {
        return Ok(NotGoodEnough);
    }
    let (started, bar) = (Instant::now(), output::bar(0, "{msg}"));
    let outcome = poll(connection, 50, |s| {
        let (mode, target) = (s["mode"].as_str().unwrap_or(""), &s["target"]);
        let line = format!(
            "{mode}  estimate {} of {}",
            pose(&s["estimate"]),
            pose(target)
        );
        let degrees = |key: &str| target[key].as_f64().unwrap_or(0.0);
        let off = Bend::from_deg(degrees("bend_deg"), degrees("dir_deg")).0 - sent_to.0;
        let why = match halted(s) {
            Some(why) => why,
            None if off.norm().to_degrees() > SAME_DEG => {
                format!("another command replaced this one: {line}")
            }
            None if s["settled"] == true => {
                bar.finish_and_clear();
                output::print(format!(
                    "{line}: {}\n",
                    s["shortfall"].as_str().unwrap_or("settled")
                ));
                return Some(if s["blocked"] == true {
                    NotGoodEnough
                } else {
                    Good
                });
            }
            None if started.elapsed() < MOVED_MAX => {
                bar.set_message(line);
                return None;
            }
            None => format!("mode {mode}"),
        };
        bar.finish_and_clear();
        let suspicion = s["suspicion"]
            .as_str()
            .map_or_else(String::new, |x| format!("; {x}"));
        output::print(format!("not settled: {why}{suspicion}\n"));
        Some(NotGoodEnough)
    });
    bar.finish_and_clear();
    outcome
}

/// `arm`, also right after the start of the service: waits for its socket and for the end of its alignment.
///
/// # Errors
/// A report with the service's message.
pub fn arm(at: &At) -> Result<CommandOutcome> {
    let started = Instant::now();
    let mut connection = loop {
        match connect(at) {
            Err(_) if started.elapsed() < STARTED_MAX => sleep(Duration::from_millis(50)),
            reached => break reached?,
        }
    };
    match aligned(&mut connection)? {
        Good => ask_and_print(&mut connection, &Request::Arm {}),
        refused => Ok(refused),
    }
}

/// Waits for the end of an alignment.
///
/// # Errors
/// A report with the service's message.
pub fn aligned(connection: &mut Connection) -> Result<CommandOutcome> {
    let (started, mut said) = (Instant::now(), false);
    poll(connection, 100, |s| {
        if !matches!(s["mode"].as_str(), Some("boot" | "aligning")) {
            return Some(Good);
        }
        if !std::mem::replace(&mut said, true) {
            eprintln!(
                "waiting for the end of the alignment, for which the tip must be still for 2 s"
            );
        }
        (started.elapsed() > ALIGNED_MAX).then(|| {
            eprintln!("not aligned after {} s because the tip or the base is not still; the service keeps trying", ALIGNED_MAX.as_secs());
            NotGoodEnough
        })
    })
}

/// `calibrate transmission`, until the gains are identified.
///
/// # Errors
/// A report with the service's message.
pub fn transmission(args: &TransmissionArgs) -> Result<CommandOutcome> {
    let mut connection = connect(&args.at)?;
    let action = match (args.accept, args.discard, args.short) {
        (true, ..) => CalibrateAction::Accept,
        (_, true, _) => CalibrateAction::Discard,
        (.., true) => CalibrateAction::Short,
        _ => CalibrateAction::Full,
    };
    let poses = args.poses;
    if ask(&mut connection, &Request::Calibrate { action, poses })?.is_none() {
        return Ok(NotGoodEnough);
    }
    if args.accept || args.discard {
        return Ok(Good);
    }
    let (bar, mut said, mut last) = (output::bar(0, "{msg}"), Instant::now(), Value::Null);
    let outcome = poll(&mut connection, 200, |s| {
        if let Some(progress) = s["calibrating"].as_str() {
            bar.set_message(progress.to_owned());
            // a spinner is seen on a terminal only
            if bar.is_hidden() && said.elapsed() >= SAID_EVERY {
                said = Instant::now();
                eprintln!("{progress}");
            }
            return None;
        }
        bar.finish_and_clear();
        if let Some(why) = s["calibration_failed"].as_str() {
            output::print(format!("no gains were identified: {why}\n"));
            return Some(NotGoodEnough);
        }
        last = s.clone();
        Some(Good)
    });
    bar.finish_and_clear();
    let outcome = outcome?;
    if outcome == Good {
        show_gains(&last, args)?;
        eprintln!(
            "apply them with `retroflex calibrate transmission --accept`, or discard them with `--discard`"
        );
    }
    Ok(outcome)
}

/// Shows the proposed gains beside those in use.
fn show_gains(s: &Value, args: &TransmissionArgs) -> Result<()> {
    let pair = |key: &str, i: usize| {
        [&s[key][i], &s["proposed"][key][i]]
            .map(|v| v.as_f64().map_or("–".to_owned(), |x| format!("{x:.3}")))
    };
    let row = |i: usize| {
        let ([k_now, k], [l_now, l]) = (pair("k_epsilon", i), pair("k_lambda_mm", i));
        [(i + 1).to_string(), k_now, k, l_now, l]
    };
    let header = "line|k_epsilon in use|proposed|k_lambda in use, mm|proposed, mm";
    let rows = [0, 1, 2].map(row);
    let [lag_s, delay_s] =
        ["lag_s", "delay_s"].map(|key| s["proposed"][key].as_f64().unwrap_or(0.0));
    let dynamics = format!("lag {lag_s:.3} s, dead time {delay_s:.3} s");
    output::write_some(&args.html, || {
        let mut page = Page::new("Proposed gains of the transmission");
        page.table(&output::columns(header), &rows);
        page.text(&dynamics);
        Ok(page.html())
    })?;
    let text = format!(
        "{}\n{dynamics}\n",
        output::table(header, 1..5, rows.clone())
    );
    output::answer(&args.json, &s["proposed"], text)
}
