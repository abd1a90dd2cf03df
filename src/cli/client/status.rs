//! `status` and `subscribe`.

use super::connection::{At, ask, connect, read_status, report};
use crate::cli::{ResultFile, output, within};
use crate::service::protocol::Request;
use crate::service::status::{GrantState, PathState, Pose, Status};
use miette::Result;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::time::Duration;

/// Clears the terminal and moves to its first place (ECMA-48).
const CLEAR: &str = "\x1b[H\x1b[2J";
/// Widest line of the status, characters.
const WIDTH: usize = 80;

/// Arguments of `status`.
#[derive(Debug, clap::Args)]
pub struct StatusArgs {
    #[command(flatten)]
    at: At,
    /// Write the state as JSON to this file; without a name, or with `-`, to standard output.
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    json: Option<ResultFile>,
    /// Repeat twice a second.
    #[arg(long)]
    watch: bool,
}

/// Arguments of `subscribe`.
#[derive(Debug, clap::Args)]
pub struct SubscribeArgs {
    #[command(flatten)]
    at: At,
    /// Frames per second.
    #[arg(long, default_value_t = 20.0, value_parser = within(0.1..=1000.0, "Hz"))]
    rate: f64,
}

/// `status`, for people or as JSON.
///
/// # Errors
/// A report with the service's message.
pub fn status(args: &StatusArgs) -> Result<()> {
    let mut connection = connect(&args.at)?;
    let redraw = args.watch && args.json.is_none() && std::io::stdout().is_terminal();
    loop {
        let value = connection.request(&Request::Status {}).map_err(report)?;
        let text = match args.json.as_deref() {
            Some(path) if path == Path::new("-") => format!("{value}\n"),
            Some(path) => output::write(path, format!("{value}\n")).map(|()| String::new())?,
            None => readable(&read_status(&value)?),
        };
        let clear = if redraw { CLEAR } else { "" };
        let text = [clear.as_bytes(), &output::printable(text.as_bytes())].concat();
        if !output::print_with(|out| out.write_all(&text)) || !args.watch {
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(500));
    }
}

/// A bend of the status in words.
pub(super) fn pose(pose: &Option<Pose>) -> String {
    let Some(Pose { bend_deg, dir_deg }) = *pose else {
        return "–".to_owned();
    };
    // the same direction, by one name
    let dir_deg = if dir_deg < -179.5 { 180.0 } else { dir_deg };
    format!("{bend_deg:.1}° at {dir_deg:.0}°")
}

fn readable(s: &Status) -> String {
    let line = |(name, value): &(&str, String)| format!("{name:<10}{}\n", wrapped(value));
    rows(s).iter().map(line).collect()
}

/// How far a path has come.
fn path(path: &PathState) -> String {
    let mut text = format!("{:.1} s of {:.1} s", path.at_s, path.duration_s);
    if path.time_scale > 1.0 {
        text += &format!(", {:.2} times slower than given", path.time_scale);
    }
    text
}

/// What a status says, as name and text.
pub(super) fn rows(s: &Status) -> Vec<(&'static str, String)> {
    let when = |holds: bool, words: &'static str| if holds { words } else { "" };
    let energised = when(s.energised, ", energised");
    let stopped = match (s.stopped, s.ending) {
        (true, true) => ", stopped; the service is ending",
        (true, false) => ", stopped until `retroflex arm`",
        (false, ending) => when(ending, "; the service is ending"),
    };
    let pistons = s.piston_mm.iter().flatten().map(|mm| format!("{mm:.2}"));
    let (estimate, target) = (pose(&s.estimate), pose(&s.target));
    let mode = [s.mode_name().unwrap_or("null"), energised, stopped].concat();
    let gains = match s.feedforward {
        Some(_) => "feedforward and calibration",
        None => "calibration",
    };
    let of_tip = |(tip, calibration)| format!("{tip}   {gains} {calibration}");
    let waits =
        "a calibration waits for `retroflex calibrate transmission --accept` or `--discard`";
    let (late, most, lost) = (s.late_cycles, s.max_lateness_us, s.lost_frames);
    let of_loop =
        |cycles| format!("{cycles} cycles, {late} late, at most {most} µs, {lost} frames lost");
    let stated = "stated by the operator; no measurement has confirmed it";
    let once = [
        ("mode", Some(mode)),
        ("estimate", Some(format!("{estimate}   target {target}"))),
        (
            "pistons",
            Some(pistons.collect::<Vec<_>>().join("  ") + " mm"),
        ),
        (
            "tip",
            s.tip.as_ref().zip(s.calibration.as_ref()).map(of_tip),
        ),
        ("proposed", s.proposed.as_ref().map(|_| waits.to_owned())),
        ("loop", s.cycles.map(of_loop)),
        ("fault", s.fault.clone()),
        ("lost", s.lost.clone()),
        ("limit", s.shortfall.clone()),
        ("base", s.base.clone()),
        ("world", s.world.clone()),
        ("suspected", s.suspicion.clone()),
        ("alarm", s.alarm.clone()),
        ("running", s.calibrating.clone()),
        ("recording", s.recording.path.clone()),
        ("recorded", s.recording_ended.clone()),
        ("log", s.flight_log.problem.clone()),
        ("memory", s.memory.error.clone()),
        ("path", s.path.as_ref().map(path)),
        ("zero", s.unverified.then(|| stated.to_owned())),
    ];
    let there = |(name, text)| Some((name, text?));
    let mut rows: Vec<(&str, String)> = once.into_iter().filter_map(there).collect();
    rows.extend(s.power.iter().map(|trouble| ("power", trouble.clone())));
    rows.extend(s.advice().map(|advice| ("sensor", advice.to_owned())));
    let is_slow = |remark: &&String| remark.contains("slow bus");
    let slow = s.remarks.iter().filter(is_slow);
    rows.extend(slow.map(|remark| ("note", remark.clone())));
    let denied = |g: &&GrantState| g.grant != "not requested" && g.grant != "granted";
    let denied = s.real_time.iter().filter(denied);
    rows.extend(denied.map(|g| ("real time", format!("{}: {}", g.what, g.grant))));
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
pub fn subscribe(args: &SubscribeArgs) -> Result<()> {
    let mut connection = connect(&args.at)?;
    ask(&mut connection, &Request::Subscribe { rate_hz: args.rate })?;
    loop {
        let value = connection.read().map_err(report)?;
        if !output::print_with(|out| writeln!(out, "{value}")) {
            return Ok(());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_drives_the_tip_and_what_waits_is_shown() {
        let said = |status: &Status| {
            let rows = rows(status).into_iter();
            let lines: Vec<String> = rows.map(|(name, text)| format!("{name}: {text}")).collect();
            lines.join("\n")
        };
        for (stopped, ending, part) in [
            (true, false, "null, stopped until `retroflex arm`"),
            (true, true, "null, stopped; the service is ending"),
            (false, true, "null; the service is ending"),
        ] {
            let status = Status {
                stopped,
                ending,
                ..Status::default()
            };
            let text = said(&status);
            assert!(text.contains(part), "{text}");
            assert!(!(ending && text.contains("arm")), "{text}");
        }
        let mut status = Status {
            tip: Some("A".to_owned()),
            calibration: Some("x.toml".to_owned()),
            ..Status::default()
        };
        assert!(said(&status).contains("tip: A   calibration x.toml"));
        assert!(!said(&status).contains("proposed"));
        status.feedforward = status.calibration.clone();
        status.proposed = Some(crate::service::LearnedGains {
            k_epsilon: [2.0; 3],
            k_lambda_mm: [0.9; 3],
            lag_s: 0.0,
            delay_s: 0.0,
            tip: String::new(),
            unix_s: 0.0,
            source: String::new(),
        });
        let text = said(&status);
        assert!(
            text.contains("tip: A   feedforward and calibration x.toml"),
            "{text}"
        );
        assert!(text.contains("--accept"), "{text}");
    }
}
