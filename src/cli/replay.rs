//! `retroflex replay LOG`: runs a recorded input through the present software and compares every decision bit for bit.

use crate::cli::{CommandOutcome, inputs, output};
use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::source;
use crate::config::supervisor::assemble;
use crate::control::pi::DynamicsPrior;
use crate::estimation::fusion::estimator::EstimatorName;
use crate::log::error::why_unreadable;
use crate::model::described::DescribedMachine;
use crate::model::transmission::Line;
use crate::primitives::parameters::Check;
use crate::service::flight::cycle::Cycle;
use crate::service::flight::log::{part_path, run_and_part};
use crate::service::flight::read::{Entry, messages};
use crate::service::flight::start::{Event, Header};
use crate::service::record::flight_path;
use crate::service::start::{Start, with_gains};
use crate::supervisor::cycle::{CycleOutput, Supervisor, SupervisorConfig};
use miette::{IntoDiagnostic, Result, bail, miette};
use nalgebra::Vector2;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Arguments of `replay`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Flight log, or bend log that was recorded with one (`NAME.mcap` beside `NAME.csv.gz`).
    log: PathBuf,
    /// Also run it with this gains file and show what would have changed; it is speculation, because the recorded machine does
    /// not answer to it.
    #[arg(long)]
    gains: Option<PathBuf>,
    /// As `--gains`, with this calibration file.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// As `--gains`, with this estimator of the orientation: `bend`, `madgwick`, `vqf`, `vqf-long` or `mekf`.
    #[arg(long, value_name = "NAME", value_parser = |name: &str| EstimatorName::try_from(name.to_owned()))]
    filter: Option<EstimatorName>,
    /// As `--gains`, fed forward through this model of `gap diagnose --save`.
    #[arg(long, value_name = "MODEL.toml")]
    feedforward: Option<PathBuf>,
}

/// The settings of a log.
#[derive(Clone)]
struct Settings {
    board: Board,
    gains: Gains,
    calibration: Calibration,
    /// Lines and dynamics that were in use instead of those of the calibration.
    learned: Option<([Line; 3], DynamicsPrior)>,
    feedforward: Option<Arc<DescribedMachine>>,
}

impl Settings {
    fn of(header: &Header) -> std::result::Result<Self, String> {
        if header.log != 2 {
            return Err(format!("log version {}; this program reads version 2", header.log));
        }
        let [board, gains, calibration, model @ ..] = header.texts.as_slice() else { return Err("has no configuration".to_owned()) };
        let board: Board = text(board)?;
        let name = "model of the log";
        let described = model.first().map(|text| {
            let model = source::parse(name, text).into_diagnostic()?;
            inputs::described_by(name, model, &board)
        });
        let feedforward = described.transpose().map_err(|e| e.to_string())?;
        let (gains, calibration) = (text(gains)?, text(calibration)?);
        let learned = Some((header.lines, header.dynamics));
        Ok(Self { board, gains, calibration, learned, feedforward })
    }

    fn config(&self, header: &Header) -> SupervisorConfig {
        let mut config = assemble(&self.board, &self.calibration, &self.gains, &header.machine);
        if let Some(machine) = &self.feedforward {
            config.tick = config.tick.fed_forward(Arc::clone(machine));
        }
        if let Some(learned) = self.learned {
            (config.tick.lines, config.tick.dynamics) = learned;
        }
        config
    }

    /// The settings with those of the command line.
    fn changed(mut self, args: &Args) -> Result<Self> {
        self.gains = args.gains.as_deref().map_or(Ok(self.gains), source::read)?;
        self.gains.fuse.filter = args.filter.unwrap_or(self.gains.fuse.filter);
        if let Some(path) = &args.calib {
            (self.calibration, self.learned) = (source::read(path)?, None);
        }
        if let Some(path) = &args.feedforward {
            self.feedforward = Some(inputs::described(path, &self.board)?);
            self.learned = None;
        }
        Ok(self)
    }
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
    let changes = args.gains.is_some() || args.calib.is_some() || args.filter.is_some() || args.feedforward.is_some();
    let mut replay = Replay { args: changes.then_some(args), ..Replay::default() };
    let mut ending = None;
    for part in parts(&path) {
        let read = messages(&part, &mut |message| replay.take(Entry::of(&message)?));
        ending = read.map_err(|e| miette!("{e}"))?;
    }
    let Replay { cycles, different, skipped, .. } = replay;
    if cycles == 0 {
        let file = path.display();
        bail!("{file}: cannot be replayed, because it does not begin with the start of a supervisor: the part before is missing");
    }
    let ending = ending.map_or_else(String::new, |ending| format!("; {ending}"));
    println!("{cycles} cycles replayed, {different} differ{ending}");
    for (before, t_s, lost) in &replay.gaps {
        println!("gap: {lost} cycles are missing before cycle {before} at {t_s:.3} s");
    }
    if skipped > 0 {
        println!("{skipped} cycles after a gap are not compared, because nothing tells the state of the loop there");
    }
    if replay.altered.is_some() {
        show(&replay.changes, cycles);
    }
    let Some((number, t_s, fields)) = replay.first else { return Ok(CommandOutcome::Good) };
    let program = replay.header.as_ref().map_or("", |header| &header.program);
    let fields = match fields.len() {
        0 => "a field without a digest".to_owned(),
        _ => fields.join(", "),
    };
    eprintln!(
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

/// A configuration text of the log.
fn text<T: DeserializeOwned + Check>(text: &str) -> std::result::Result<T, String> {
    source::parse("configuration in the log", text).map_err(|e| e.to_string())
}

#[derive(Default)]
struct Replay<'a> {
    /// Settings to speculate with.
    args: Option<&'a Args>,
    /// The start of the present supervisor.
    header: Option<Header>,
    machine: Option<(Settings, SupervisorConfig)>,
    /// `None` after a gap.
    supervisor: Option<Supervisor>,
    /// A supervisor with the other settings, and the differences that they make.
    altered: Option<Supervisor>,
    changes: [Change; QUANTITIES.len()],
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
    fn take(&mut self, entry: Entry) -> std::result::Result<(), String> {
        match entry {
            Entry::Event(event) => match *event {
                // repeated at the beginning of a part
                Event::Start(header) if self.header.as_ref().is_some_and(|known| known.cycle == header.cycle) => {}
                Event::Start(header) => self.start(header)?,
                Event::Reload { gains, lines } => self.reload(&gains, lines)?,
                Event::Path(t_s, rows) => {
                    let path = crate::control::path::Path::new(t_s, rows).map(Box::new);
                    for supervisor in self.supervisor.iter_mut().chain(&mut self.altered) {
                        supervisor.load(&mut path.clone());
                    }
                }
            },
            Entry::Cycles(first, cycles) => {
                (first..).zip(&cycles).for_each(|(number, cycle)| self.turn(number, cycle));
            }
            Entry::Shown(_) => {}
        }
        Ok(())
    }

    fn start(&mut self, header: Header) -> std::result::Result<(), String> {
        let settings = Settings::of(&header)?;
        let start = Start::of(&header, settings.config(&header));
        if let Some(args) = self.args {
            let config = settings.clone().changed(args).map_err(|e| e.to_string())?.config(&header);
            self.altered = Some(Start { config, ..start.clone() }.supervisor());
        }
        self.next = header.cycle;
        self.header = Some(header);
        self.machine = Some((settings, start.config.clone()));
        self.supervisor = Some(start.supervisor());
        Ok(())
    }

    fn reload(&mut self, gains: &str, lines: [Line; 3]) -> std::result::Result<(), String> {
        let (Some(supervisor), Some((settings, config))) = (&mut self.supervisor, &mut self.machine) else { return Ok(()) };
        let gains: Gains = text(gains)?;
        config.tick.lines = lines;
        *config = with_gains(config, &settings.board, &settings.calibration, &gains);
        supervisor.reload(&mut config.clone());
        Ok(())
    }

    fn turn(&mut self, number: u64, cycle: &Cycle) {
        let t_s = cycle.sensed.t.0;
        if number != self.next {
            let lost = number.saturating_sub(self.next);
            self.gaps.push((number, t_s, lost));
            self.supervisor = None;
        }
        self.next = number + 1;
        let Some(supervisor) = &mut self.supervisor else {
            self.skipped += 1;
            return;
        };
        let output = supervisor.turn(&cycle.sensed, cycle.order);
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
        }
    }
}

/// How much a quantity differs between two runs: sum of squares, largest difference, and its time in s.
type Change = (f64, f64, f64);

const QUANTITIES: [&str; 5] = ["set-point, °", "estimated bend, °", "predicted bend, °", "feedback, °", "piston targets, mm"];

fn compare(changes: &mut [Change], t_s: f64, run: &CycleOutput, other: &CycleOutput) {
    let (a, b) = (&run.frame, &other.frame);
    let setpoint = a.setpoint.bend.0 - b.setpoint.bend.0;
    let estimates = a.estimate.zip(b.estimate);
    let estimate = estimates.map_or(Vector2::zeros(), |(a, b)| a.bend.0 - b.bend.0);
    let angles = [setpoint, estimate, a.predicted - b.predicted, a.feedback - b.feedback];
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
    println!("\nWith the other settings, on the same input. This is speculation: the recorded machine did not follow them.");
    let row = |(name, (squares, largest, at_s)): (&&str, &Change)| {
        let rms = (squares / cycles as f64).sqrt();
        let [rms, largest] = [rms, *largest].map(|x| format!("{x:.4}"));
        vec![(*name).to_owned(), rms, largest, format!("{at_s:.3}")]
    };
    let header = ["difference", "RMS", "largest", "at, s"];
    println!("{}", output::table(&header, 1..4, QUANTITIES.iter().zip(changes).map(row)));
}
