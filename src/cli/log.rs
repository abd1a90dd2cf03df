//! `retroflex log`: what a flight log holds, as a bend log, and a part of it.

mod export;

use crate::cli::replay::flight_of;
use crate::cli::{CommandOutcome, inputs, output};
use crate::report::chart::{Axis, Chart, Series, Stroke};
use crate::report::page::Page;
use crate::report::svg::Ink;
use crate::service::flight::channels::Changes;
use crate::service::flight::file::{FlightFile, TOPICS, io_error};
use crate::service::flight::read::{Entry, messages};
use crate::service::flight::start::Event;
use export::export;
use mcap::{McapError, Message};
use miette::{Result, bail, miette};
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

/// Flight logs.
#[derive(Debug, clap::Subcommand)]
pub enum Log {
    /// Show when and with what a log was written, its modes, faults and gaps.
    Info {
        /// Flight log.
        file: PathBuf,
        /// Write it as JSON; `-` is standard output.
        #[arg(long)]
        json: Option<PathBuf>,
        /// Write it as a page, with a chart of the bend.
        #[arg(long, value_name = "FILE")]
        html: Option<PathBuf>,
    },
    /// Write the samples, with set-point, estimate, belief, gains and mode, as a bend log, which `gap diagnose` reads, or as a table
    /// for programs that read Parquet.
    Export {
        /// Flight log.
        file: PathBuf,
        /// Bend log to write; `-` is standard output.
        #[arg(long, required_unless_present = "parquet")]
        csv: Option<PathBuf>,
        /// Parquet file to write, with the same columns; a missing value is null. Its metadata hold the units and the start time.
        #[arg(long)]
        parquet: Option<PathBuf>,
    },
    /// Write a part of a log as a log, to the cycle. It can be replayed if it begins with the start of the log.
    Cut {
        /// Flight log.
        file: PathBuf,
        /// Start of the part, s of the log.
        #[arg(long, default_value_t = 0.0, value_parser = inputs::within(0.0..=1e9, "s"))]
        from: f64,
        /// End of the part, s of the log.
        #[arg(long, default_value_t = 1e9, value_parser = inputs::within(0.0..=1e9, "s"))]
        to: f64,
        /// Flight log to write; it must not exist.
        #[arg(long)]
        out: PathBuf,
    },
}

/// Runs the command.
///
/// # Errors
/// A report that names the file.
pub fn run(command: &Log) -> Result<CommandOutcome> {
    match command {
        Log::Info { file, json, html } => info(&flight_of(file)?, json.as_deref(), html.as_deref()),
        Log::Export { file, csv, parquet } => {
            export(&flight_of(file)?, csv.as_deref(), parquet.as_deref())
        }
        Log::Cut {
            file,
            from,
            to,
            out,
        } => cut(&flight_of(file)?, *from, *to, out),
    }
}

/// What `log info` collects.
#[derive(Default)]
struct Info {
    facts: Map<String, Value>,
    begin_ns: Option<u64>,
    duration_s: f64,
    cycles: u64,
    next: Option<u64>,
    changes: Changes,
    events: Vec<String>,
    /// Targets and estimates of the bend, °, with their times, s.
    bends: [Vec<(f64, f64)>; 2],
}

impl Info {
    fn fact(&mut self, name: &str, value: impl Serialize) {
        self.facts.insert(name.to_owned(), json!(value));
    }

    fn note(&mut self, text: &str) {
        self.events
            .push(format!("{:.3} s: {text}", self.duration_s));
    }

    fn take(&mut self, message: &Message<'_>) -> std::result::Result<(), String> {
        self.duration_s = since(&mut self.begin_ns, message);
        match Entry::of(message)? {
            Entry::Event(event) => match *event {
                Event::Start(header) => {
                    let hashes = header.hashes().into_iter();
                    self.facts
                        .extend(hashes.map(|(name, hash)| (name, json!(hash))));
                    self.fact("program", &header.program);
                    self.fact("machine", &header.machine.name);
                    self.fact("tip", &header.tip);
                    self.fact("config_hash", &header.config_hash);
                }
                Event::Reload { .. } => self.note("new gains"),
                Event::Path(..) => self.note("a path"),
            },
            Entry::Cycles(first, cycles) => {
                if let Some(next) = self.next.filter(|next| *next < first) {
                    let missing = first - next;
                    self.note(&format!(
                        "gap: {missing} cycles are missing before cycle {first}"
                    ));
                }
                self.next = Some(first + cycles.len() as u64);
                self.cycles += cycles.len() as u64;
            }
            Entry::Shown(value) => {
                for (bends, key) in self.bends.iter_mut().zip(["target", "estimate"]) {
                    let bend_deg = value[key]["bend_deg"].as_f64();
                    let new = bends
                        .last()
                        .is_none_or(|last| self.duration_s - last.0 >= BEND_EVERY_S);
                    bends.extend(
                        bend_deg
                            .filter(|_| new)
                            .map(|bend_deg| (self.duration_s, bend_deg)),
                    );
                }
                for change in self.changes.of(&value) {
                    self.note(&change);
                }
            }
        }
        Ok(())
    }
}

/// Least time between two points of the chart of the bend, s.
const BEND_EVERY_S: f64 = 0.1;
/// Most points of a line of that chart.
const BENDS_MAX: usize = 2000;

impl Info {
    fn page(&self, path: &Path, facts: &[[String; 2]]) -> Page {
        let mut page = Page::new(&format!("Flight log {}", path.display()));
        let thinned = |all: &Vec<(f64, f64)>| {
            all.iter()
                .copied()
                .step_by(all.len().div_ceil(BENDS_MAX).max(1))
                .collect()
        };
        let [target, estimate] = self.bends.each_ref().map(thinned);
        let series = [
            ("target", Ink::GREY, Stroke::Dashed, target),
            ("estimate", Ink::GREEN, Stroke::Solid, estimate),
        ];
        let series =
            series.map(|(name, ink, stroke, points)| Series::line(name, ink, stroke, points));
        let (x, y) = (
            Axis::new("time / s", 0.0, self.duration_s, 8),
            Axis::new("bend / °", 0.0, 90.0, 6),
        );
        page.charts(&[(
            Chart::new("Bend", x, y, series.into()).svg(),
            "Target and estimate of the bend.".to_owned(),
        )]);
        page.table(&["", ""], facts);
        page.heading("Events");
        self.events.iter().for_each(|event| page.text(event));
        page
    }
}

/// Time of a message since the first one, s.
pub fn since(begin_ns: &mut Option<u64>, message: &Message<'_>) -> f64 {
    let now_ns = message.log_time;
    now_ns.saturating_sub(*begin_ns.get_or_insert(now_ns)) as f64 * 1e-9
}

fn info(path: &Path, json: Option<&Path>, html: Option<&Path>) -> Result<CommandOutcome> {
    output::check(&[("--json", json), ("--html", html)], &[path])?;
    let mut info = Info::default();
    let ending = messages(path, &mut |message| info.take(&message)).map_err(|e| miette!("{e}"))?;
    let begin_s = info.begin_ns.unwrap_or(0) / 1_000_000_000;
    let begins = OffsetDateTime::from_unix_timestamp(begin_s as i64);
    info.fact(
        "begins",
        begins.map_or_else(|_| String::new(), |t| t.to_string()),
    );
    info.fact("duration_s", (info.duration_s * 1e3).round() / 1e3);
    info.fact("cycles", info.cycles);
    info.fact("ending", ending.to_string());
    let mut text = format!("{}\n", path.display());
    let shown = |value: &Value| {
        value
            .as_str()
            .map_or_else(|| value.to_string(), str::to_owned)
    };
    let facts: Vec<[String; 2]> = info
        .facts
        .iter()
        .map(|(name, value)| [name.clone(), shown(value)])
        .collect();
    for [name, value] in &facts {
        text += &format!("  {name}: {value}\n");
    }
    for event in &info.events {
        text += &format!("  at {event}\n");
    }
    info.fact("events", info.events.clone());
    output::json(json, &info.facts)?;
    if let Some(html) = html {
        output::write(html, info.page(path, &facts).html())?;
    }
    output::show(&text, json);
    Ok(ending.damage.is_empty().into())
}

/// Rounding of the times of a log, s.
const ROUNDING_S: f64 = 1e-6;

fn cut(path: &Path, from_s: f64, to_s: f64, out: &Path) -> Result<CommandOutcome> {
    if from_s >= to_s {
        bail!("--from {from_s} --to {to_s}: the part is empty; --to must be later");
    }
    output::check(&[("--out", Some(out))], &[path])?;
    let (name, shown) = (path.display(), out.display());
    let failed = |e: McapError| format!("{shown}: {}", io_error(e));
    let mut file = FlightFile::create(out, 0).map_err(|e| miette!("{}", failed(e)))?;
    let (mut begin_ns, mut flushed_s, mut cycles) = (None, 0.0, 0);
    let copied = messages(path, &mut |message| {
        let t_s = since(&mut begin_ns, &message);
        match message.channel.topic.as_str() {
            topic if topic == TOPICS[1] => {
                if let (true, Entry::Event(event)) = (t_s <= to_s, Entry::of(&message)?) {
                    // every part says with what it was written
                    file.event(
                        &event,
                        message.log_time + ((from_s - t_s).max(0.0) * 1e9) as u64,
                    )
                    .map_err(failed)?;
                }
            }
            topic if topic == TOPICS[0] => {
                let Entry::Cycles(first, all) = Entry::of(&message)? else {
                    return Ok(());
                };
                let last_s = all.last().map_or(0.0, |cycle| cycle.sensed.t.0);
                let before = |at_s: f64| {
                    all.partition_point(|cycle| t_s + cycle.sensed.t.0 - last_s < at_s - ROUNDING_S)
                };
                let part = before(from_s)..before(to_s);
                if let Some(cycle) = all[part.clone()].last() {
                    let early_ns = ((last_s - cycle.sensed.t.0) * 1e9) as u64;
                    file.write_cycles(
                        first + part.start as u64,
                        &all[part.clone()],
                        message.log_time - early_ns,
                    )
                    .map_err(failed)?;
                }
                cycles += part.len();
            }
            _ if (from_s..to_s).contains(&t_s) => file.copy(&message).map_err(failed)?,
            _ => {}
        }
        if t_s - flushed_s > 0.4 {
            flushed_s = t_s;
            file.flush(false).map_err(failed)?;
        }
        Ok(())
    });
    let done = copied.and_then(|ending| match cycles {
        0 => Err(format!(
            "{name}: there is nothing from {from_s} s to {to_s} s"
        )),
        _ => file
            .state_damage(&ending.damage)
            .and_then(|()| file.finish())
            .map_err(failed)
            .map(|()| ending),
    });
    if done.is_err() {
        // it holds nothing of use
        let _ = std::fs::remove_file(out);
    }
    let ending = done.map_err(|e| miette!("{e}"))?;
    eprintln!("{ending}");
    Ok(ending.damage.is_empty().into())
}
