//! Commands that are followed to their end: a move, an alignment, a calibration.

use super::args::{BendArgs, TransmissionArgs};
use super::{ask, connect, outcome, say, settle};
use crate::cli::CommandOutcome;
use crate::cli::output;
use crate::service::client::Client as Connection;
use crate::service::protocol::{CalibrateAction, Request};
use miette::Result;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// How long an alignment is waited for: a tip that is not still by then is said to be so.
const ALIGNED_MAX: Duration = Duration::from_secs(10);
/// How long a move is waited for.
const MOVED_MAX: Duration = Duration::from_secs(60);

/// `bend`, with `--wait` until it has settled or says why not.
///
/// # Errors
/// A report with the service's words.
pub fn bend(args: &BendArgs) -> Result<CommandOutcome> {
    let mut connection = connect(&args.at)?;
    let request = Request::Bend { bend_deg: args.bend, dir_deg: args.toward, length_mm: args.length, speed_deg_s: args.speed };
    let value = settle(ask(&mut connection, &request))?;
    if value.is_none() || !args.wait {
        return Ok(outcome(value.as_ref()));
    }
    let (begun, live) = (Instant::now(), std::io::stderr().is_terminal());
    loop {
        std::thread::sleep(Duration::from_millis(50));
        let Some(s) = settle(ask(&mut connection, &Request::Status {}))? else { return Ok(CommandOutcome::NotGoodEnough) };
        let estimate = s["felt"]["bend_deg"].as_f64().unwrap_or(0.0);
        let line = format!(
            "{:>5.1} s  {}  felt {estimate:.1}° of {:.1}°",
            begun.elapsed().as_secs_f64(),
            s["mode"].as_str().unwrap_or(""),
            args.bend
        );
        if live {
            eprint!("\r{line}   ");
        }
        let why = match s["mode"].as_str().unwrap_or("") {
            "holding" if s["settled"] == true => {
                eprintln!(
                    "{}{line}{}",
                    if live { "\r" } else { "" },
                    s["short"].as_str().map_or_else(|| ": settled".to_owned(), |why| format!(": {why}"))
                );
                return Ok(if s["blocked"] == true { CommandOutcome::NotGoodEnough } else { CommandOutcome::Good });
            }
            "tracking" | "holding" if begun.elapsed() < MOVED_MAX => continue,
            "faulted" => s["fault"].as_str().unwrap_or("a fault").to_owned(),
            other => format!("mode {other}"),
        };
        eprintln!(
            "{}not settled: {why}{}",
            if live { "\n" } else { "" },
            s["suspicion"].as_str().map_or_else(String::new, |x| format!("; {x}"))
        );
        return Ok(CommandOutcome::NotGoodEnough);
    }
}

/// Waits until a rest that is being looked for is found.
///
/// # Errors
/// A report with the service's words.
pub fn aligned(connection: &mut Connection) -> Result<CommandOutcome> {
    let begun = Instant::now();
    loop {
        // the loop takes the order up in one of its next turns
        std::thread::sleep(Duration::from_millis(100));
        let Some(s) = settle(ask(connection, &Request::Status {}))? else { return Ok(CommandOutcome::NotGoodEnough) };
        if s["mode"] != "aligning" {
            return Ok(CommandOutcome::Good);
        }
        if begun.elapsed() > ALIGNED_MAX {
            eprintln!("the tip is not still, or the base is not: no rest was found in {} s, and it goes on looking", ALIGNED_MAX.as_secs());
            return Ok(CommandOutcome::NotGoodEnough);
        }
    }
}

/// `calibrate transmission`: begins it and follows it to its end.
///
/// # Errors
/// A report with the service's words.
pub fn transmission(args: &TransmissionArgs) -> Result<CommandOutcome> {
    let mut connection = connect(&args.at)?;
    let action = match (args.accept, args.discard, args.short) {
        (true, ..) => CalibrateAction::Accept,
        (_, true, _) => CalibrateAction::Discard,
        (.., true) => CalibrateAction::Short,
        _ => CalibrateAction::Full,
    };
    let begun = settle(ask(&mut connection, &Request::Calibrate { action }))?;
    if begun.is_none() || args.accept || args.discard {
        return Ok(outcome(begun.as_ref()));
    }
    let line = output::bar(0, "{msg}");
    loop {
        std::thread::sleep(Duration::from_millis(200));
        let Some(s) = settle(ask(&mut connection, &Request::Status {}))? else { return Ok(CommandOutcome::NotGoodEnough) };
        if let Some(progress) = s["calibrating"].as_str() {
            line.set_message(progress.to_owned());
            continue;
        }
        line.finish_and_clear();
        if let Some(why) = s["calibration_failed"].as_str() {
            eprintln!("nothing was found: {why}");
            return Ok(CommandOutcome::NotGoodEnough);
        }
        say(&format!("{}\n", s["proposed"]));
        eprintln!("`retroflex calibrate transmission --accept` puts it in use, `--discard` forgets it");
        return Ok(CommandOutcome::Good);
    }
}
