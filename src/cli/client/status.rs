//! `status`, `subscribe` and `stream`.

use super::args::{StatusArgs, SubscribeArgs};
use super::connection::{At, ask, connect, report};
use crate::cli::CommandOutcome::{self, Good, NotGoodEnough};
use crate::cli::output::{self, print};
use crate::service::protocol::Request;
use miette::{Result, miette};
use serde_json::Value;
use std::io::{BufRead, IsTerminal, Write};
use std::time::{Duration, Instant};

/// Clears the terminal and moves to its first place (ECMA-48).
const CLEAR: &str = "\x1b[H\x1b[2J";
/// Widest line of the status, characters.
const WIDTH: usize = 100;

/// `status`, for people or as JSON.
///
/// # Errors
/// A report with the service's message.
pub fn status(args: &StatusArgs) -> Result<CommandOutcome> {
    output::check(&[("--json", args.json.as_deref())], &[])?;
    let mut connection = connect(&args.at)?;
    let redraw = args.watch && args.json.is_none() && std::io::stdout().is_terminal();
    loop {
        let Some(s) = ask(&mut connection, &Request::Status {})? else { return Ok(NotGoodEnough) };
        match &args.json {
            Some(path) => output::write(path, format!("{s}\n"))?,
            None if redraw => print(format!("{CLEAR}{}", readable(&s))),
            None => print(readable(&s)),
        }
        if !args.watch {
            return Ok(Good);
        }
        std::thread::sleep(Duration::from_millis(500));
    }
}

fn readable(s: &Value) -> String {
    let line = |(name, value): &(&str, String)| format!("{name:<10}{}\n", wrapped(value));
    rows(s).iter().map(line).collect()
}

/// What a status says, as name and text. The recorded status of a log lacks some of it.
pub(super) fn rows(s: &Value) -> Vec<(&'static str, String)> {
    let text = |v: &Value| v.as_str().map_or_else(|| v.to_string(), str::to_owned);
    let list = |v: &Value| v.as_array().cloned().unwrap_or_default();
    let degrees = |v: &Value| v.as_f64().unwrap_or(0.0);
    let pose = |v: &Value| {
        let (bend, dir) = (degrees(&v["bend_deg"]), degrees(&v["dir_deg"]));
        if v.is_null() { "–".to_owned() } else { format!("{bend:.1}° at {dir:.0}°") }
    };
    let pistons = list(&s["piston_mm"]);
    let pistons: Vec<String> = pistons.iter().map(|p| format!("{:.2}", degrees(p))).collect();
    let words = |key: &str, text: &'static str| if s[key] == true { text } else { "" };
    let energised = words("energised", ", energised");
    let stopped = words("stopped", ", stopped until `retroflex arm`");
    let (estimate, target) = (pose(&s["estimate"]), pose(&s["target"]));
    let mut rows = vec![
        ("mode", text(&s["mode"]) + energised + stopped),
        ("estimate", format!("{estimate}   target {target}")),
        ("pistons", pistons.join("  ") + " mm"),
    ];
    if let [tip @ Value::String(_), calibration @ Value::String(_)] = ["tip", "calibration"].map(|key| &s[key]) {
        rows.push(("tip", format!("{}   calibration {}", text(tip), text(calibration))));
    }
    if let [cycles @ Value::Number(_), late, most, lost] = ["cycles", "late_cycles", "max_lateness_us", "lost_frames"].map(|key| &s[key]) {
        rows.push(("loop", format!("{cycles} cycles, {late} late, at most {most} µs, {lost} frames lost")));
    }
    let optional = [
        ("fault", &s["fault"]),
        ("lost", &s["lost"]),
        ("limit", &s["shortfall"]),
        ("base", &s["base"]),
        ("world", &s["world"]),
        ("suspected", &s["suspicion"]),
        ("alarm", &s["alarm"]),
        ("running", &s["calibrating"]),
        ("recording", &s["recording"]["path"]),
        ("recorded", &s["recording_ended"]),
        ("log", &s["flight_log"]["problem"]),
        ("memory", &s["memory"]["error"]),
    ];
    let present = optional.iter().filter(|(_, v)| !v.is_null());
    rows.extend(present.map(|(name, v)| (*name, text(v))));
    if let (Some(at_s), Some(of_s)) = (s["path"]["at_s"].as_f64(), s["path"]["duration_s"].as_f64()) {
        let slower = s["path"]["time_scale"].as_f64().filter(|scale| *scale > 1.0);
        let slower = slower.map_or_else(String::new, |x| format!(", {x:.2} times slower than given"));
        rows.push(("path", format!("{at_s:.1} s of {of_s:.1} s{slower}")));
    }
    if s["unverified"] == true {
        let stated = "stated by the operator; no measurement has confirmed it";
        rows.push(("zero", stated.to_owned()));
    }
    rows.extend(list(&s["power"]).iter().map(|trouble| ("power", text(trouble))));
    let advice = list(&s["sensor"]["advice"]);
    rows.extend(advice.iter().map(|advice| ("sensor", text(advice))));
    let granted = |g: &Value| format!("{}: {}", text(&g["what"]), text(&g["grant"]));
    rows.extend(list(&s["real_time"]).iter().map(|g| ("real time", granted(g))));
    rows
}

/// A text in lines that fit beside a column of names.
fn wrapped(text: &str) -> String {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.is_empty() => *line = word.to_owned(),
            Some(line) if line.chars().count() + word.chars().count() + 11 < WIDTH => line.extend([" ", word]),
            _ => lines.push(word.to_owned()),
        }
    }
    lines.join(&format!("\n{:10}", ""))
}

/// Time by which a set-point with a time is sent ahead of it, s.
const SENT_AHEAD_S: f64 = 0.3;

/// `stream`: set-points from standard input, `BEND DIR` or `BEND DIR T` per line. A set-point with a time waits for it; after the last
/// one the tip holds.
///
/// # Errors
/// A report with the service's message.
pub fn stream(at: &At) -> Result<CommandOutcome> {
    let mut connection = connect(at)?;
    let (mut began, mut end_s) = (None, None);
    for (k, line) in std::io::stdin().lock().lines().enumerate() {
        let line = line.map_err(|e| miette!("standard input, line {}: {e}", k + 1))?;
        let numbers: std::result::Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
        let (bend_deg, dir_deg, t_s) = match numbers.as_deref() {
            Ok(&[bend_deg, dir_deg]) => (bend_deg, dir_deg, None),
            Ok(&[bend_deg, dir_deg, t_s]) => (bend_deg, dir_deg, Some(t_s)),
            _ => {
                let expected = "expected BEND DIR or BEND DIR T, numbers in degrees and seconds";
                return Err(miette!("standard input, line {}: `{line}`: {expected}", k + 1));
            }
        };
        if let Some(t_s) = t_s {
            let (start, from_s) = *began.get_or_insert_with(|| (Instant::now(), t_s));
            sleep_until(start, t_s - from_s - SENT_AHEAD_S);
            end_s = Some((start, t_s - from_s));
        }
        if ask(&mut connection, &Request::Stream { bend_deg, dir_deg, length_mm: None, t_s })?.is_none() {
            return Ok(NotGoodEnough);
        }
    }
    if let Some((start, at_s)) = end_s {
        sleep_until(start, at_s);
        return Ok(if ask(&mut connection, &Request::Hold {})?.is_none() { NotGoodEnough } else { Good });
    }
    Ok(Good)
}

/// Sleeps until `after_s` from `start`, which may have passed.
fn sleep_until(start: Instant, after_s: f64) {
    let left_s = after_s - start.elapsed().as_secs_f64();
    std::thread::sleep(Duration::try_from_secs_f64(left_s).unwrap_or_default());
}

/// `subscribe`: frames as JSON lines, until the reader closes its end.
///
/// # Errors
/// A report with the service's message.
pub fn subscribe(args: &SubscribeArgs) -> Result<CommandOutcome> {
    let mut connection = connect(&args.at)?;
    if ask(&mut connection, &Request::Subscribe { rate_hz: args.rate })?.is_none() {
        return Ok(NotGoodEnough);
    }
    let mut out = std::io::stdout();
    loop {
        let value = connection.read().map_err(report)?;
        if writeln!(out, "{value}").is_err() {
            return Ok(Good);
        }
    }
}
