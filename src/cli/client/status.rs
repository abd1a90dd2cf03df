//! `status` and `subscribe`.

use super::args::{StatusArgs, SubscribeArgs};
use super::connection::{self, ask, connect, report};
use crate::cli::CommandOutcome::{self, Good, NotGoodEnough};
use crate::cli::output;
use crate::service::protocol::Request;
use miette::Result;
use serde_json::Value;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::time::Duration;

/// Clears the terminal and moves to its first place (ECMA-48).
const CLEAR: &str = "\x1b[H\x1b[2J";
/// Widest line of the status, characters.
const WIDTH: usize = 80;

/// `status`, for people or as JSON.
///
/// # Errors
/// A report with the service's message.
pub fn status(args: &StatusArgs) -> Result<CommandOutcome> {
    let mut connection = connect(&args.at)?;
    let redraw = args.watch && args.json.is_none() && std::io::stdout().is_terminal();
    loop {
        let s = connection::status(&mut connection)?;
        let text = match args.json.as_deref() {
            Some(path) if path == Path::new("-") => format!("{s}\n"),
            Some(path) => output::write(path, format!("{s}\n")).map(|()| String::new())?,
            None if redraw => format!("{CLEAR}{}", readable(&s)),
            None => readable(&s),
        };
        let mut out = std::io::stdout();
        // a reader that has closed its end, such as `head`, has seen enough
        if out
            .write_all(text.as_bytes())
            .and_then(|()| out.flush())
            .is_err()
            || !args.watch
        {
            return Ok(Good);
        }
        std::thread::sleep(Duration::from_millis(500));
    }
}

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap_or(0.0)
}

/// A bend of the status in words.
pub(super) fn pose(v: &Value) -> String {
    let (bend, dir) = (number(&v["bend_deg"]), number(&v["dir_deg"]));
    // the same direction, by one name
    let dir = if dir < -179.5 { 180.0 } else { dir };
    if v.is_null() {
        "–".to_owned()
    } else {
        format!("{bend:.1}° at {dir:.0}°")
    }
}

fn readable(s: &Value) -> String {
    let line = |(name, value): &(&str, String)| format!("{name:<10}{}\n", wrapped(value));
    rows(s).iter().map(line).collect()
}

/// How far a path has come.
fn path(path: &Value) -> Option<String> {
    let (at_s, of_s) = (path["at_s"].as_f64()?, path["duration_s"].as_f64()?);
    let slower = path["time_scale"].as_f64().filter(|scale| *scale > 1.0);
    let slower = slower.map_or_else(String::new, |x| format!(", {x:.2} times slower than given"));
    Some(format!("{at_s:.1} s of {of_s:.1} s{slower}"))
}

/// What a status says, as name and text. The recorded status of a log lacks some of it.
pub(super) fn rows(s: &Value) -> Vec<(&'static str, String)> {
    let text = |v: &Value| v.as_str().map_or_else(|| v.to_string(), str::to_owned);
    let list = |v: &Value| v.as_array().cloned().unwrap_or_default();
    let pistons = list(&s["piston_mm"]);
    let pistons: Vec<String> = pistons
        .iter()
        .map(|p| format!("{:.2}", number(p)))
        .collect();
    let words = |key: &str, text: &'static str| if s[key] == true { text } else { "" };
    let energised = words("energised", ", energised");
    let stopped = words("stopped", ", stopped until `retroflex arm`");
    let (estimate, target) = (pose(&s["estimate"]), pose(&s["target"]));
    let mut rows = vec![
        ("mode", text(&s["mode"]) + energised + stopped),
        ("estimate", format!("{estimate}   target {target}")),
        ("pistons", pistons.join("  ") + " mm"),
    ];
    if let [tip @ Value::String(_), calibration @ Value::String(_)] =
        ["tip", "calibration"].map(|key| &s[key])
    {
        rows.push((
            "tip",
            format!("{}   calibration {}", text(tip), text(calibration)),
        ));
    }
    if let [cycles @ Value::Number(_), late, most, lost] =
        ["cycles", "late_cycles", "max_lateness_us", "lost_frames"].map(|key| &s[key])
    {
        rows.push((
            "loop",
            format!("{cycles} cycles, {late} late, at most {most} µs, {lost} frames lost"),
        ));
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
    rows.extend(path(&s["path"]).map(|path| ("path", path)));
    if s["unverified"] == true {
        let stated = "stated by the operator; no measurement has confirmed it";
        rows.push(("zero", stated.to_owned()));
    }
    rows.extend(
        list(&s["power"])
            .iter()
            .map(|trouble| ("power", text(trouble))),
    );
    let advice = list(&s["sensor"]["advice"]);
    rows.extend(advice.iter().map(|advice| ("sensor", text(advice))));
    let slow = list(&s["remarks"]).into_iter().map(|r| text(&r));
    rows.extend(slow.filter(|r| r.contains("slow bus")).map(|r| ("note", r)));
    let granted = |g: &Value| format!("{}: {}", text(&g["what"]), text(&g["grant"]));
    let requested = list(&s["real_time"]).into_iter();
    let requested = requested.filter(|g| g["grant"] != "not requested" && g["grant"] != "granted");
    rows.extend(requested.map(|g| ("real time", granted(&g))));
    rows
}

/// A text in lines that fit beside a column of names.
fn wrapped(text: &str) -> String {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.is_empty() => *line = word.to_owned(),
            Some(line) if line.chars().count() + word.chars().count() + 11 < WIDTH => {
                line.extend([" ", word])
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines.join(&format!("\n{:10}", ""))
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
