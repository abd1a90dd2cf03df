//! Commands that wait for their end: a move, an alignment, a calibration.

use super::connection::{
    At, Connection, ask, ask_and_print, connect, halted, is_led_elsewhere, poll,
};
use super::status::pose;
use crate::cli::{Refused, ResultFile, output, within};
use crate::model::Bend;
use crate::service::protocol::{CalibrateAction, DIR_DEG, Frame, POSES, Request};
use crate::service::status::Status;
use crate::supervisor::Mode;
use clap::builder::TypedValueParser;
use miette::Result;
use serde_json::json;
use std::ops::RangeInclusive;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Longest wait for an alignment.
const ALIGNED_MAX: Duration = Duration::from_secs(10);
/// Longest wait for a move.
const MOVED_MAX: Duration = Duration::from_secs(60);
/// Longest wait of `arm` for a service that has just been started.
const STARTED_MAX: Duration = Duration::from_secs(2);

/// Period of the lines that report progress where there is no terminal.
const SAID_EVERY: Duration = Duration::from_secs(5);

/// Bends that may be asked for, degrees. How far the tip reaches in a direction depends on the machine, and the service says it.
pub(super) const BEND_DEG: RangeInclusive<f64> = -135.0..=135.0;

/// Arguments of `bend`.
#[derive(Debug, clap::Args)]
pub struct BendArgs {
    #[command(flatten)]
    at: At,
    /// Bend angle, degrees.
    #[arg(value_parser = within(BEND_DEG, "degrees"))]
    bend: f64,
    /// Bend direction, degrees.
    #[arg(long, default_value_t = 0.0, value_parser = within(DIR_DEG, "degrees"))]
    toward: f64,
    /// Length of the centre line, mm. Default: the rest length.
    #[arg(long, value_parser = within(5.0..=200.0, "mm"))]
    length: Option<f64>,
    /// Speed of the set-point, °/s. Default: that of the gains file.
    #[arg(long, value_parser = within(0.1..=720.0, "°/s"))]
    speed: Option<f64>,
    /// Wait until the tip has settled.
    #[arg(long)]
    wait: bool,
    /// Keep the orientation in the world that the bend has now, while the base turns. Needs an IMU on the base.
    #[arg(long, conflicts_with = "wait")]
    world: bool,
}

/// Arguments of `calibrate transmission`.
#[derive(Debug, clap::Args)]
pub struct TransmissionArgs {
    #[command(flatten)]
    at: At,
    /// Use a few poses and the present calibration as prior, instead of Algorithm 1 from zero gains.
    #[arg(long, conflicts_with_all = ["accept", "discard"])]
    short: bool,
    /// Poses of a short calibration, 6 to 24. With the prior of a fleet (`retroflex fleet --prior`), 12 do.
    #[arg(long, requires = "short", default_value_t = *POSES.end(), value_parser = clap::value_parser!(u8).range(6..=24).map(usize::from))]
    poses: usize,
    /// Apply the proposed calibration.
    #[arg(long, conflicts_with = "discard")]
    accept: bool,
    /// Discard the proposed calibration.
    #[arg(long)]
    discard: bool,
    /// Write the proposed calibration as JSON to this file (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    json: Option<ResultFile>,
}

/// `bend`, with `--wait` until the tip has settled; false if it does not.
///
/// # Errors
/// A report with the service's message.
pub fn bend(args: &BendArgs) -> Result<bool> {
    let mut connection = connect(&args.at)?;
    let (bend_deg, dir_deg) = (args.bend, args.toward);
    let request = Request::Bend {
        bend_deg,
        dir_deg,
        length_mm: args.length,
        speed_deg_s: args.speed,
        frame: if args.world {
            Frame::World
        } else {
            Frame::Base
        },
    };
    if args.wait {
        settle(&mut connection, &request, Bend::from_deg(bend_deg, dir_deg))
    } else {
        ask_and_print(&mut connection, &request).map(|()| true)
    }
}

/// Sends the request of a bend, and waits until the tip has settled there; false if it does not.
///
/// # Errors
/// A report with the service's message.
pub fn settle(connection: &mut Connection, request: &Request, sent_to: Bend) -> Result<bool> {
    ask(connection, request)?;
    let (started, bar) = (Instant::now(), output::bar(0, "{msg}"));
    let (good, line) = poll(connection, 50, |s| {
        let mode = s.mode_name().unwrap_or_default();
        let (estimate, target) = (pose(&s.estimate), pose(&s.target));
        let line = format!("{mode}  estimate {estimate} of {target}");
        let why = match halted(s) {
            Some(why) => why,
            None if is_led_elsewhere(s, sent_to) => {
                format!("another command replaced this one: {line}")
            }
            None if s.settled => {
                let how = s.shortfall.as_deref().unwrap_or("settled");
                return Some((!s.blocked, format!("{line}: {how}\n")));
            }
            None if started.elapsed() < MOVED_MAX => {
                bar.set_message(line);
                return None;
            }
            None => line,
        };
        let suspicion = s.suspicion.as_ref();
        let suspicion = suspicion.map_or(String::new(), |text| format!("; {text}"));
        Some((false, format!("not settled: {why}{suspicion}\n")))
    })?;
    drop(bar);
    output::print(line);
    Ok(good)
}

/// `arm`, also right after the start of the service: waits for its socket and for the end of its alignment.
///
/// # Errors
/// A report with the service's message.
pub fn arm(at: &At) -> Result<()> {
    let started = Instant::now();
    let mut connection = loop {
        match connect(at) {
            Err(_) if started.elapsed() < STARTED_MAX => sleep(Duration::from_millis(50)),
            reached => break reached?,
        }
    };
    aligned(&mut connection)?;
    ask_and_print(&mut connection, &Request::Arm {})
}

/// Waits for the end of an alignment.
///
/// # Errors
/// A report with the service's message, or that the tip is not aligned in time.
pub fn aligned(connection: &mut Connection) -> Result<()> {
    let (started, mut said) = (Instant::now(), false);
    let aligned = poll(connection, 100, |s| {
        if !matches!(s.mode, Some(Mode::Boot | Mode::Aligning)) {
            return Some(true);
        }
        if !std::mem::replace(&mut said, true) {
            eprintln!(
                "waiting for the end of the alignment, for which the tip must be still for 2 s"
            );
        }
        (started.elapsed() > ALIGNED_MAX).then_some(false)
    })?;
    if aligned {
        Ok(())
    } else {
        Err(Refused(format!("not aligned after {} s because the tip or the base is not still; the service keeps trying", ALIGNED_MAX.as_secs())).into())
    }
}

/// `calibrate transmission`, until the gains are identified; false if they are not.
///
/// # Errors
/// A report with the service's message.
pub fn transmission(args: &TransmissionArgs) -> Result<bool> {
    let mut connection = connect(&args.at)?;
    let action = match (args.accept, args.discard, args.short) {
        (true, ..) => CalibrateAction::Accept,
        (_, true, _) => CalibrateAction::Discard,
        (.., true) => CalibrateAction::Short,
        _ => CalibrateAction::Full,
    };
    let poses = args.poses;
    ask(&mut connection, &Request::Calibrate { action, poses })?;
    if args.accept || args.discard {
        return Ok(true);
    }
    let (bar, mut said) = (output::bar(0, "{msg}"), Instant::now());
    let last = poll(&mut connection, 200, |s| {
        let Some(progress) = &s.calibrating else {
            return Some(s.clone());
        };
        bar.set_message(progress.clone());
        // a spinner is seen on a terminal only
        if bar.is_hidden() && said.elapsed() >= SAID_EVERY {
            said = Instant::now();
            eprintln!("{progress}");
        }
        None
    })?;
    drop(bar);
    if let Some(why) = &last.calibration_failed {
        output::print(format!("no gains were identified: {why}\n"));
        return Ok(false);
    }
    show_gains(&last, &args.json)?;
    let apply = match &last.feedforward {
        Some(model) => format!(
            "the gains of the feedforward model {model} stay in use: to apply these, start the service without it, then accept them"
        ),
        None => "apply them with `retroflex calibrate transmission --accept`".to_owned(),
    };
    eprintln!("{apply}, or discard them with `--discard`");
    Ok(true)
}

/// Shows the proposed gains beside those in use.
fn show_gains(s: &Status, json: &Option<ResultFile>) -> Result<()> {
    let shown = |x: Option<f64>| x.map_or("–".to_owned(), |x| format!("{x:.3}"));
    let proposed = s.proposed.as_ref();
    let row = |i: usize| {
        [
            (i + 1).to_string(),
            shown(s.k_epsilon.map(|k| k[i])),
            shown(proposed.map(|gains| gains.k_epsilon[i])),
            shown(s.k_lambda_mm.map(|k| k[i])),
            shown(proposed.map(|gains| gains.k_lambda_mm[i])),
        ]
    };
    let header = "line|k_epsilon in use|proposed|k_lambda in use, mm|proposed, mm";
    let table = output::table(header, 1..5, [0, 1, 2].map(row));
    let (lag_s, delay_s) = proposed.map_or((0.0, 0.0), |gains| (gains.lag_s, gains.delay_s));
    let text = format!("{table}\nlag {lag_s:.3} s, dead time {delay_s:.3} s\n");
    output::answer(json, &json!(proposed), text)
}
