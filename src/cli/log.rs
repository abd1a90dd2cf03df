//! `retroflex log`: what a flight log holds, as a bend log, and a part of it.

mod export;

use crate::cli::{ResultFile, flight, output, within};
use crate::report::{Axis, Chart, Ink, Page, Series, Stroke};
use crate::service::flight::channels::Changes;
use crate::service::flight::file::{FlightFile, TOPICS};
use crate::service::flight::read::{Ending, Entry};
use crate::service::flight::start::Event;
use export::{ExportArgs, export};
use mcap::{McapError, Message};
use miette::{Result, bail};
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::ops::Range;
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

commands! {
    /// Flight logs.
    pub enum Log;

    /// Show when and with what a log was written, its modes, faults and gaps.
    Info(InfoArgs) => info,
    /// Write the samples, with set-point, estimate, belief, gains and mode, as a bend log, which `gap diagnose` reads, or as a table
    /// for programs that read Parquet.
    Export(ExportArgs) => export,
    /// Write a part of a log as a log, to the cycle. It can be replayed if it begins with the start of the log.
    Cut(CutArgs) => cut,
}

/// Arguments of `log info`.
#[derive(Debug, clap::Args)]
pub struct InfoArgs {
    /// Flight log.
    file: PathBuf,
    /// Write it as JSON; `-` is standard output.
    #[arg(long)]
    json: Option<ResultFile>,
    /// Write it as a page, with a chart of the bend.
    #[arg(long, value_name = "FILE")]
    html: Option<ResultFile>,
}

/// Arguments of `log cut`.
#[derive(Debug, clap::Args)]
pub struct CutArgs {
    /// Flight log.
    file: PathBuf,
    /// Start of the part, s of the log.
    #[arg(long, default_value_t = 0.0, value_parser = within(0.0..=1e9, "s"))]
    from: f64,
    /// End of the part, s of the log.
    #[arg(long, default_value_t = 1e9, value_parser = within(0.0..=1e9, "s"))]
    to: f64,
    /// Flight log to write; it must not exist.
    #[arg(long)]
    out: ResultFile,
}

/// Least time between two points of the chart of the bend, s.
const BEND_EVERY_S: f64 = 0.1;
/// Most points of a line of that chart.
const BENDS_MAX: usize = 2000;

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
        let at_s = self.duration_s;
        self.events.push(format!("{at_s:.3} s: {text}"));
    }

    fn take(&mut self, t_s: f64, message: &Message<'_>) -> Result<(), String> {
        self.begin_ns.get_or_insert(message.log_time);
        self.duration_s = t_s;
        match Entry::of(message)? {
            Entry::Event(event) => match *event {
                Event::Start(header) => {
                    for (name, hash) in header.hashes() {
                        self.fact(&name, hash);
                    }
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
                    let gap = format!("{} cycles are missing", first - next);
                    self.note(&format!("gap: {gap} before cycle {first}"));
                }
                self.next = Some(first + cycles.len() as u64);
                self.cycles += cycles.len() as u64;
            }
            Entry::Shown(value) => {
                for (bends, key) in self.bends.iter_mut().zip(["target", "estimate"]) {
                    let Some(pose) = value.get(key) else { continue };
                    // a line ends where there is no pose
                    let bend_deg = pose["bend_deg"].as_f64().unwrap_or(f64::NAN);
                    let is_due = |last: &(f64, f64)| {
                        t_s - last.0 >= BEND_EVERY_S || last.1.is_nan() != bend_deg.is_nan()
                    };
                    if bends.last().is_none_or(is_due) {
                        bends.push((t_s, bend_deg));
                    }
                }
                for change in self.changes.of(&value) {
                    self.note(&change);
                }
            }
        }
        Ok(())
    }

    fn page(&self, path: &Path, facts: &[[String; 2]]) -> Page {
        let mut page = Page::new(&format!("Flight log {}", path.display()));
        let thinned = |all: &Vec<(f64, f64)>| {
            let every = all.len().div_ceil(BENDS_MAX).max(1);
            all.iter().copied().step_by(every).collect()
        };
        let [target, estimate] = self.bends.each_ref().map(thinned);
        let series = vec![
            Series::line("target", Ink::GREY, Stroke::Dashed, target),
            Series::line("estimate", Ink::GREEN, Stroke::Solid, estimate),
        ];
        let x = Axis::new("time / s", 0.0, self.duration_s, 8);
        let chart = Chart::new("Bend", x, Axis::new("bend / °", 0.0, 90.0, 6), series);
        page.charts([(chart.svg(), "Target and estimate of the bend.")]);
        page.table("|", facts);
        page.heading("Events");
        self.events.iter().for_each(|event| page.text(event));
        page
    }
}

fn info(args: &InfoArgs) -> Result<bool> {
    let (path, mut info) = (flight::flight_of(&args.file)?, Info::default());
    let ending = flight::read(&path, &mut |t_s, message| info.take(t_s, message))?;
    let begin_s = info.begin_ns.unwrap_or(0) / 1_000_000_000;
    let begins = OffsetDateTime::from_unix_timestamp(begin_s as i64);
    info.fact("begins", begins.map_or(String::new(), |t| t.to_string()));
    info.fact("duration_s", (info.duration_s * 1e3).round() / 1e3);
    info.fact("cycles", info.cycles);
    info.fact("ending", ending.to_string());
    let mut text = format!("{}\n", path.display());
    let words = |value: &Value| value.as_str().map_or(value.to_string(), str::to_owned);
    let fact = |(name, value): (&String, &Value)| [name.clone(), words(value)];
    let facts: Vec<[String; 2]> = info.facts.iter().map(fact).collect();
    for [name, value] in &facts {
        text += &format!("  {name}: {value}\n");
    }
    for event in &info.events {
        text += &format!("  at {event}\n");
    }
    info.fact("events", info.events.clone());
    output::write_some(&args.html, || Ok(info.page(&path, &facts).html()))?;
    output::answer(&args.json, &info.facts, text)?;
    Ok(ending.damage.is_empty())
}

/// Rounding of the times of a log, s.
const ROUNDING_S: f64 = 1e-6;

fn cut(args: &CutArgs) -> Result<bool> {
    let (path, from_s, to_s) = (flight::flight_of(&args.file)?, args.from, args.to);
    if from_s >= to_s {
        bail!("--from {from_s} --to {to_s}: the part is empty; --to must be later");
    }
    let shown = args.out.display().to_string();
    let ending = flight::write(&args.out, &shown, |mut file| {
        let (ending, cycles) = copy(&path, from_s..to_s, &mut file, flight::unwritable(&shown))?;
        if cycles == 0 {
            let name = path.display();
            bail!("{name}: there is nothing from {from_s} s to {to_s} s");
        }
        Ok((file, ending))
    })?;
    eprintln!("{ending}");
    Ok(ending.damage.is_empty())
}

/// Copies a part of a log. Returns how the log ends, and the number of cycles in the part.
fn copy(
    path: &Path,
    part_s: Range<f64>,
    file: &mut FlightFile,
    failed: impl Fn(McapError) -> String,
) -> Result<(Ending, usize)> {
    let (mut flushed_s, mut cycles) = (0.0, 0);
    let ending = flight::read(path, &mut |t_s, message| {
        match message.channel.topic.as_str() {
            topic if topic == TOPICS[1] => {
                if let (true, Entry::Event(event)) = (t_s <= part_s.end, Entry::of(message)?) {
                    // every part says with what it was written
                    let later_ns = ((part_s.start - t_s).max(0.0) * 1e9) as u64;
                    let at_ns = message.log_time + later_ns;
                    file.event(&event, at_ns).map_err(&failed)?;
                }
            }
            topic if topic == TOPICS[0] => {
                let Entry::Cycles(first, all) = Entry::of(message)? else {
                    return Ok(());
                };
                let last_s = all.last().map_or(0.0, |cycle| cycle.sensed.t.0);
                let before = |at_s: f64| {
                    all.partition_point(|cycle| t_s + cycle.sensed.t.0 - last_s < at_s - ROUNDING_S)
                };
                let part = before(part_s.start)..before(part_s.end);
                let (number, part) = (first + part.start as u64, &all[part]);
                if let Some(cycle) = part.last() {
                    let early_ns = ((last_s - cycle.sensed.t.0) * 1e9) as u64;
                    let at_ns = message.log_time - early_ns;
                    file.write_cycles(number, part, at_ns).map_err(&failed)?;
                }
                cycles += part.len();
            }
            _ if part_s.contains(&t_s) => file.copy(message).map_err(&failed)?,
            _ => {}
        }
        if t_s - flushed_s > 0.4 {
            flushed_s = t_s;
            file.flush(false).map_err(&failed)?;
        }
        Ok(())
    })?;
    Ok((ending, cycles))
}
