//! `retroflex replay LOG`: runs a recorded input through the present software and compares every decision bit for bit.

pub mod settings;

use crate::cli::{CommandOutcome, output};
use crate::config::Gains;
use crate::control::LoopConfig;
use crate::log::error::why_unreadable;
use crate::model::Line;
use crate::service::flight::cycle::Cycle;
use crate::service::flight::file::{FlightFile, TOPICS, io_error};
use crate::service::flight::log::{part_path, run_and_part};
use crate::service::flight::read::{Ending, Entry, messages};
use crate::service::flight::start::{Event, Header, Logged, hash};
use crate::service::record::flight_path;
use crate::service::start::{Start, with_gains};
use crate::supervisor::{CycleOutput, Supervisor, SupervisorConfig};
use mcap::McapError;
use miette::{Result, bail, miette};
use nalgebra::Vector2;
use settings::{Settings, SettingsArgs, text};
use std::mem::take;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Arguments of `replay`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Flight log, or bend log that was recorded with one (`NAME.mcap` beside `NAME.csv.gz`).
    log: PathBuf,
    #[command(flatten)]
    changes: SettingsArgs,
    /// Write what is replayed, with the other settings if there are any, as a flight log, which `monitor` shows; it must not exist.
    #[arg(long, value_name = "FILE.mcap")]
    out: Option<PathBuf>,
}

/// What the supervisor of a log started from.
///
/// # Errors
/// What is wrong with the configuration in the log.
pub fn start_of(header: &Header) -> std::result::Result<Start, String> {
    Ok(Start::of(header, Settings::of(header)?.config(header)))
}

/// Runs the command.
///
/// # Errors
/// A report that names the defect of the log.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let path = flight_of(&args.log)?;
    output::check(&[("--out", args.out.as_deref())], &[&path])?;
    let mut replay = Replay {
        args: args.changes.any().then_some(&args.changes),
        ..Replay::default()
    };
    let done = match &args.out {
        None => replay.read(&path),
        Some(out) => replay.write(&path, out),
    };
    let ending = done.map_err(|e| miette!("{e}"))?;
    let Replay {
        cycles,
        different,
        skipped,
        ..
    } = replay;
    if cycles == 0 {
        let file = path.display();
        bail!(
            "{file}: cannot be replayed, because it does not begin with the start of a supervisor: the part before is missing"
        );
    }
    let shown = if ending == Ending::COMPLETE {
        String::new()
    } else {
        format!("; {ending}")
    };
    println!("{cycles} cycles replayed, {different} differ{shown}");
    for (before, t_s, lost) in &replay.gaps {
        println!("gap: {lost} cycles are missing before cycle {before} at {t_s:.3} s");
    }
    if skipped > 0 {
        println!(
            "{skipped} cycles after a gap are not compared, because nothing tells the state of the loop there"
        );
    }
    if replay.altered.is_some() {
        show(&replay.changes, cycles);
    }
    let Some((number, t_s, fields)) = replay.first else {
        return Ok(ending.damage.is_empty().into());
    };
    let program = replay.header.as_ref().map_or("", |header| &header.program);
    let fields = match fields.len() {
        0 => "a field without a digest".to_owned(),
        _ => fields.join(", "),
    };
    println!(
        "the first difference is in cycle {number} at {t_s:.3} s, in {fields}: the software has changed since version {program} wrote the log"
    );
    Ok(CommandOutcome::NotGoodEnough)
}

/// The flight log of a path: the file itself, or the one beside a bend log.
///
/// # Errors
/// A report about a file that does not exist.
pub fn flight_of(log: &Path) -> Result<PathBuf> {
    if log.is_dir() || !log.exists() {
        let why = why_unreadable(log, &std::io::ErrorKind::NotFound.into());
        bail!("{}: {why}", log.display());
    }
    let flight = flight_path(log);
    let is_bend_log = log.extension().is_some_and(|e| e == "csv" || e == "gz");
    let why = "there is no such file; a bend log has a flight log beside it only if it was recorded with `retroflex run --record LOG`, or with `retroflex record start` while disarmed at rest";
    match flight.exists() {
        true => Ok(flight),
        false if is_bend_log => Err(miette!("{}: {why}", flight.display())),
        false => Ok(log.to_owned()),
    }
}

/// The parts of a run up to this one that are there.
fn parts(path: &Path) -> Vec<PathBuf> {
    let mut all = Vec::new();
    if let (Some((run, part)), Some(folder)) = (run_and_part(path), path.parent()) {
        all.extend((1..part).map(|n| part_path(folder, run, n)));
        all.retain(|p| p.exists());
    }
    all.push(path.to_owned());
    all
}

/// Cycles of a chunk of the log to write.
const CHUNK: u64 = 500;

#[derive(Default)]
struct Replay<'a> {
    /// Settings to speculate with.
    args: Option<&'a SettingsArgs>,
    /// The start of the present supervisor.
    header: Option<Header>,
    machine: Option<(Settings, SupervisorConfig)>,
    /// `None` after a gap.
    supervisor: Option<Supervisor>,
    /// A supervisor with the other settings, and the differences that they make.
    altered: Option<Supervisor>,
    changes: [Change; QUANTITIES.len()],
    /// The flight log to write, and what happens before its next cycle.
    out: Option<FlightFile>,
    events: Vec<Arc<Event>>,
    /// Number of the next cycle.
    next: u64,
    cycles: u64,
    different: u64,
    skipped: u64,
    /// Number and time of the cycle after each gap, and the cycles that are missing.
    gaps: Vec<(u64, f64, u64)>,
    /// Number and time of the first cycle that differs, and the fields that differ there or, if it names none, in the next that does.
    first: Option<(u64, f64, Vec<&'static str>)>,
}

impl Replay<'_> {
    /// Replays a log and the parts before it. Returns how it ends, and where any part is damaged.
    fn read(&mut self, path: &Path) -> std::result::Result<Ending, String> {
        let (mut ending, mut damage) = (Ending::default(), Vec::new());
        for part in parts(path) {
            ending = messages(&part, &mut |message| match TOPICS
                .contains(&message.channel.topic.as_str())
            {
                true => self.take(Entry::of(&message)?),
                false => Ok(()),
            })?;
            let file = if part == path {
                String::new()
            } else {
                format!("{}: ", part.display())
            };
            damage.extend(ending.damage.drain(..).map(|place| file.clone() + &place));
        }
        Ok(Ending { damage, ..ending })
    }

    /// As [`Self::read`], and writes what is replayed.
    fn write(&mut self, path: &Path, out: &Path) -> std::result::Result<Ending, String> {
        let failed = |e: McapError| format!("--out {}: {}", out.display(), io_error(e));
        self.out = Some(FlightFile::create(out, 0).map_err(failed)?);
        let written = self.read(path).and_then(|ending| {
            let Some(mut file) = self.out.take() else {
                return Ok(ending);
            };
            file.state_damage(&ending.damage)
                .and_then(|()| file.finish())
                .map_err(failed)
                .map(|()| ending)
        });
        written.inspect_err(|_| {
            // it holds nothing of use
            let _ = std::fs::remove_file(out);
        })
    }

    fn take(&mut self, entry: Entry) -> std::result::Result<(), String> {
        match entry {
            Entry::Event(event) => {
                let written = match *event {
                    Event::Start(_) => false,
                    // the other settings stay
                    Event::Reload { .. } => self.altered.is_none(),
                    Event::Path(..) => true,
                };
                if written && self.out.is_some() {
                    self.events.push(Arc::new((*event).clone()));
                }
                self.event(*event)?;
            }
            Entry::Cycles(first, cycles) => {
                (first..)
                    .zip(&cycles)
                    .try_for_each(|(number, cycle)| self.turn(number, cycle))?;
            }
            Entry::Shown(_) => {}
        }
        Ok(())
    }

    fn event(&mut self, event: Event) -> std::result::Result<(), String> {
        match event {
            // repeated at the beginning of a part
            Event::Start(header)
                if self
                    .header
                    .as_ref()
                    .is_some_and(|known| known.cycle == header.cycle) => {}
            Event::Start(header) => self.start(header)?,
            Event::Reload { gains, lines } => self.reload(&gains, lines)?,
            Event::Path(t_s, rows) => {
                let path = crate::control::path::Path::new(t_s, rows).map(Box::new);
                for supervisor in self.supervisor.iter_mut().chain(&mut self.altered) {
                    supervisor.load(&mut path.clone());
                }
            }
        }
        Ok(())
    }

    fn start(&mut self, header: Header) -> std::result::Result<(), String> {
        let settings = Settings::of(&header)?;
        let start = Start::of(&header, settings.config(&header));
        let mut used = (settings.clone(), start.config.clone());
        if let Some(args) = self.args {
            let settings = settings.clone().changed(args).map_err(|e| e.to_string())?;
            let config = settings.config(&header);
            self.altered = Some(
                Start {
                    config: config.clone(),
                    ..start.clone()
                }
                .supervisor(),
            );
            used = (settings, config);
        }
        if self.out.is_some() {
            self.events.push(Arc::new(Event::Start(
                self.header_of(&header, &used.0, &used.1)?,
            )));
        }
        self.next = header.cycle;
        self.header = Some(header);
        self.machine = Some((settings, start.config.clone()));
        self.supervisor = Some(start.supervisor());
        Ok(())
    }

    /// The header of the log to write.
    fn header_of(
        &self,
        read: &Header,
        settings: &Settings,
        config: &SupervisorConfig,
    ) -> std::result::Result<Header, String> {
        let texts = settings.texts(read, self.args).map_err(|e| e.to_string())?;
        let (program, config_hash) = (
            env!("CARGO_PKG_VERSION").to_owned(),
            hash(texts.iter().map(String::as_str)),
        );
        let LoopConfig {
            lines, dynamics, ..
        } = config.tick;
        Ok(Header {
            program,
            config_hash,
            texts,
            lines,
            dynamics,
            ..read.clone()
        })
    }

    fn reload(&mut self, gains: &str, lines: [Line; 3]) -> std::result::Result<(), String> {
        let (Some(supervisor), Some((settings, config))) =
            (&mut self.supervisor, &mut self.machine)
        else {
            return Ok(());
        };
        let gains: Gains = text(gains)?;
        config.tick.lines = lines;
        *config = with_gains(config, &settings.board, &settings.calibration, &gains);
        supervisor.reload(&mut config.clone());
        Ok(())
    }

    fn turn(&mut self, number: u64, cycle: &Cycle) -> std::result::Result<(), String> {
        let t_s = cycle.sensed.t.0;
        if number < self.next {
            // a copy
            return Ok(());
        }
        if number > self.next {
            self.gaps.push((number, t_s, number - self.next));
            self.supervisor = None;
        }
        self.next = number + 1;
        let Some(supervisor) = &mut self.supervisor else {
            self.skipped += 1;
            return Ok(());
        };
        let mut output = supervisor.turn(&cycle.sensed, cycle.order);
        self.cycles += 1;
        if let Some(fields) = cycle.differences(&output) {
            self.different += 1;
            let first = self.first.get_or_insert((number, t_s, Vec::new()));
            if first.2.is_empty() {
                first.2 = fields;
            }
        }
        if let Some(altered) = &mut self.altered {
            let other = altered.turn(&cycle.sensed, cycle.order);
            compare(&mut self.changes, t_s, &output, &other);
            output = other;
        }
        let Some(file) = &mut self.out else {
            return Ok(());
        };
        let written = file.write(&Logged {
            number,
            events: take(&mut self.events),
            output,
        });
        let flushed = written.and_then(|()| {
            if number.is_multiple_of(CHUNK) {
                file.flush(false)
            } else {
                Ok(())
            }
        });
        flushed.map_err(|e| format!("--out: {}", io_error(e)))
    }
}

/// How much a quantity differs between two runs: sum of squares, largest difference, and its time in s.
type Change = (f64, f64, f64);

const QUANTITIES: [&str; 5] = [
    "set-point, °",
    "estimated bend, °",
    "predicted bend, °",
    "feedback, °",
    "piston targets, mm",
];

fn compare(changes: &mut [Change], t_s: f64, run: &CycleOutput, other: &CycleOutput) {
    let (a, b) = (&run.frame, &other.frame);
    let setpoint = a.setpoint.bend.0 - b.setpoint.bend.0;
    let estimates = a.estimate.zip(b.estimate);
    let estimate = estimates.map_or(Vector2::zeros(), |(a, b)| a.bend.0 - b.bend.0);
    let angles = [
        setpoint,
        estimate,
        a.predicted - b.predicted,
        a.feedback - b.feedback,
    ];
    let angles = angles.map(|v| v.norm().to_degrees());
    let pistons = (a.piston_target_mm - b.piston_target_mm).amax();
    let all = angles.into_iter().chain([pistons]);
    for ((squares, largest, at_s), x) in changes.iter_mut().zip(all) {
        *squares += x * x;
        if x > *largest {
            (*largest, *at_s) = (x, t_s);
        }
    }
}

fn show(changes: &[Change], cycles: u64) {
    println!(
        "\nWith the other settings, on the same input. This is speculation: the recorded machine did not follow them."
    );
    let row = |(name, (squares, largest, at_s)): (&&str, &Change)| {
        let rms = (squares / cycles as f64).sqrt();
        let [rms, largest] = [rms, *largest].map(|x| format!("{x:.4}"));
        vec![(*name).to_owned(), rms, largest, format!("{at_s:.3}")]
    };
    let header = ["difference", "RMS", "largest", "at, s"];
    println!(
        "{}",
        output::table(&header, 1..4, QUANTITIES.iter().zip(changes).map(row))
    );
}
