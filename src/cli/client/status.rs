//! What the service is doing, once or again and again, and set-points that stream into it.

use super::args::{StatusArgs, SubscribeArgs};
use super::{At, ask, connect, report, say, settle};
use crate::cli::CommandOutcome;
use crate::service::protocol::Request;
use miette::{Result, miette};
use serde_json::Value;
use std::io::{BufRead, Write};
use std::time::Duration;

/// `status`, in words or as JSON.
///
/// # Errors
/// A report with the service's words.
pub fn status(args: &StatusArgs) -> Result<CommandOutcome> {
    let mut connection = connect(&args.at)?;
    loop {
        let Some(s) = settle(ask(&mut connection, &Request::Status {}))? else { return Ok(CommandOutcome::NotGoodEnough) };
        if args.json {
            say(&format!("{s}\n"));
        } else {
            say(&readable(&s));
        }
        if !args.watch {
            return Ok(CommandOutcome::Good);
        }
        std::thread::sleep(Duration::from_millis(500));
    }
}

fn readable(s: &Value) -> String {
    let text = |v: &Value| v.as_str().map_or_else(|| v.to_string(), str::to_owned);
    let pose = |v: &Value| {
        v["bend_deg"].as_f64().map_or_else(|| "–".to_owned(), |b| format!("{b:.1}° at {:.0}°", v["dir_deg"].as_f64().unwrap_or(0.0)))
    };
    let pistons: Vec<String> =
        s["piston_mm"].as_array().into_iter().flatten().map(|p| format!("{:.2}", p.as_f64().unwrap_or(0.0))).collect();
    let mut lines = vec![
        format!("mode      {}{}", text(&s["mode"]), if s["energised"] == true { ", energised" } else { "" }),
        format!("felt      {}   target {}", pose(&s["felt"]), pose(&s["target"])),
        format!("pistons   {} mm", pistons.join("  ")),
        format!("tip       {}   calibration {}", text(&s["tip"]), text(&s["calibration"])),
        format!(
            "loop      {} turns, {} late, the latest {} µs, {} frames lost",
            s["turns"], s["late_turns"], s["latest_us"], s["lost_frames"]
        ),
    ];
    for (name, key) in [
        ("fault", "fault"),
        ("short", "short"),
        ("base", "base"),
        ("suspected", "suspicion"),
        ("alarm", "alarm"),
        ("running", "calibrating"),
    ] {
        if !s[key].is_null() {
            lines.push(format!("{name:<9} {}", text(&s[key])));
        }
    }
    for advice in s["senses"]["advice"].as_array().into_iter().flatten() {
        lines.push(format!("sensor    {}", text(advice)));
    }
    for grant in s["real_time"].as_array().into_iter().flatten() {
        lines.push(format!("real time {}: {}", text(&grant["what"]), text(&grant["grant"])));
    }
    if !s["memory"]["error"].is_null() {
        lines.push(format!("memory    {}", text(&s["memory"]["error"])));
    }
    lines.join("\n") + "\n"
}

/// `stream`: `BEND DIR` a line from stdin.
///
/// # Errors
/// A report with the service's words.
pub fn stream(at: &At) -> Result<CommandOutcome> {
    let mut connection = connect(at)?;
    for line in std::io::stdin().lock().lines() {
        let line = line.map_err(|e| miette!("stdin: {e}"))?;
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|w| w.parse().ok()).collect();
        let [bend_deg, dir_deg] = numbers[..] else { return Err(miette!("stdin: `{line}`: expected BEND DIR, two numbers in degrees")) };
        if settle(ask(&mut connection, &Request::Stream { bend_deg, dir_deg, length_mm: None }))?.is_none() {
            return Ok(CommandOutcome::NotGoodEnough);
        }
    }
    Ok(CommandOutcome::Good)
}

/// `subscribe`: frames as JSON lines.
///
/// # Errors
/// A report with the service's words.
pub fn subscribe(args: &SubscribeArgs) -> Result<CommandOutcome> {
    let mut connection = connect(&args.at)?;
    if settle(ask(&mut connection, &Request::Subscribe { rate_hz: args.rate }))?.is_none() {
        return Ok(CommandOutcome::NotGoodEnough);
    }
    let mut out = std::io::stdout();
    loop {
        let value = connection.line().map_err(report)?;
        if writeln!(out, "{value}").is_err() {
            return Ok(CommandOutcome::Good);
        }
    }
}
