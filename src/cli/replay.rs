//! `retroflex replay LOG`: runs a recorded input through the present software and compares every decision bit for bit.

pub mod settings;

use crate::cli::{ResultFile, flight, output};
use crate::config::Gains;
use crate::model::Line;
use crate::service::flight::cycle::Cycle;
use crate::service::flight::file::{FlightFile, TOPICS};
use crate::service::flight::log::{part_path, run_and_part};
use crate::service::flight::read::{Ending, Entry};
use crate::service::flight::start::{Event, Header, Logged, hash};
use crate::service::start::{Start, with_gains};
use crate::supervisor::{CycleOutput, Supervisor, SupervisorConfig};
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
    out: Option<ResultFile>,
}

/// Runs the command.
///
/// # Errors
/// A report that names the defect of the log.
pub fn run(args: &Args) -> Result<bool> {
    let path = flight::flight_of(&args.log)?;
    let mut replay = Replay {
        args: args.changes.any().then_some(&args.changes),
        ..Replay::default()
    };
    let ending = match &args.out {
        None => replay.read(&path)?,
        Some(out) => replay.write(&path, out)?,
    };
    let (cycles, different, skipped) = (replay.cycles, replay.different, replay.skipped);
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
    output::print(format!(
        "{cycles} cycles replayed, {different} differ{shown}\n"
    ));
    for (before, t_s, lost) in &replay.gaps {
        output::print(format!(
            "gap: {lost} cycles are missing before cycle {before} at {t_s:.3} s\n"
        ));
    }
    if skipped > 0 {
        output::print(format!(
            "{skipped} cycles after a gap are not compared, because nothing tells the state of the loop there\n"
        ));
    }
    if replay.altered.is_some() {
        show(&replay.changes, cycles);
    }
    let Some((number, t_s, fields)) = replay.first else {
        return Ok(ending.damage.is_empty());
    };
    let program = replay.program;
    let fields = match fields.len() {
        0 => "a field without a digest".to_owned(),
        _ => fields.join(", "),
    };
    output::print(format!(
        "the first difference is in cycle {number} at {t_s:.3} s, in {fields}: the software has changed since version {program} wrote the log\n"
    ));
    Ok(false)
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
    /// Number of the first cycle of the present supervisor, and the version of the program that wrote the log.
    began: Option<u64>,
    program: String,
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
    fn read(&mut self, path: &Path) -> Result<Ending> {
        let (mut ending, mut damage) = (Ending::default(), Vec::new());
        for part in parts(path) {
            ending = flight::read(&part, &mut |_, message| {
                if !TOPICS.contains(&message.channel.topic.as_str()) {
                    return Ok(());
                }
                self.take(Entry::of(message)?)
            })?;
            let of_part = format!("{}: ", part.display());
            let of_part = if part == path { "" } else { &of_part };
            let places = ending.damage.drain(..);
            damage.extend(places.map(|place| format!("{of_part}{place}")));
        }
        Ok(Ending { damage, ..ending })
    }

    /// As [`Self::read`], and writes what is replayed.
    fn write(&mut self, path: &Path, out: &Path) -> Result<Ending> {
        flight::write(out, &format!("--out {}", out.display()), |file| {
            self.out = Some(file);
            let ending = self.read(path)?;
            let file = self.out.take();
            Ok((file.ok_or_else(|| miette!("no log is written"))?, ending))
        })
    }

    fn take(&mut self, entry: Entry) -> Result<(), String> {
        match entry {
            Entry::Event(event) => self.event(*event),
            Entry::Cycles(first, cycles) => {
                let mut numbered = (first..).zip(&cycles);
                numbered.try_for_each(|(number, cycle)| self.turn(number, cycle))
            }
            Entry::Shown(_) => Ok(()),
        }
    }

    fn event(&mut self, event: Event) -> Result<(), String> {
        match &event {
            // repeated at the beginning of a part
            Event::Start(header) if self.began == Some(header.cycle) => return Ok(()),
            Event::Start(header) => return self.start(header),
            Event::Reload { gains, lines } => {
                self.reload(gains, *lines)?;
                if self.altered.is_some() {
                    // the other settings stay
                    return Ok(());
                }
            }
            Event::Path(t_s, rows) => {
                let path = crate::supervisor::Path::new(t_s.clone(), rows.clone()).map(Box::new);
                for supervisor in self.supervisor.iter_mut().chain(&mut self.altered) {
                    supervisor.load(&mut path.clone());
                }
            }
        }
        if self.out.is_some() {
            self.events.push(Arc::new(event));
        }
        Ok(())
    }

    fn start(&mut self, header: &Header) -> Result<(), String> {
        let settings = Settings::of(header)?;
        let start = Start::of(header, settings.config(header));
        let (mut used, mut altered) = (settings.clone(), start.clone());
        if let Some(args) = self.args {
            used = used.changed(args).map_err(|e| e.to_string())?;
            altered.config = used.config(header);
            self.altered = Some(altered.clone().supervisor());
        }
        if self.out.is_some() {
            let texts = used.texts(header, self.args).map_err(|e| e.to_string())?;
            let written = Header {
                program: env!("CARGO_PKG_VERSION").to_owned(),
                config_hash: hash(texts.iter().map(String::as_str)),
                texts,
                lines: altered.config.tick.lines,
                dynamics: altered.config.tick.dynamics,
                ..header.clone()
            };
            self.events.push(Arc::new(Event::Start(written)));
        }
        (self.next, self.began) = (header.cycle, Some(header.cycle));
        self.program.clone_from(&header.program);
        self.machine = Some((settings, start.config.clone()));
        self.supervisor = Some(start.supervisor());
        Ok(())
    }

    fn reload(&mut self, gains: &str, lines: [Line; 3]) -> Result<(), String> {
        let machine = (&mut self.supervisor, &mut self.machine);
        if let (Some(supervisor), Some((settings, config))) = machine {
            let gains: Gains = text(gains)?;
            config.tick.lines = lines;
            *config = with_gains(config, &settings.board, &settings.calibration, &gains);
            supervisor.reload(&mut config.clone());
        }
        Ok(())
    }

    fn turn(&mut self, number: u64, cycle: &Cycle) -> Result<(), String> {
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
            let (.., named) = self.first.get_or_insert((number, t_s, Vec::new()));
            if named.is_empty() {
                *named = fields;
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
        let failed = flight::unwritable("--out");
        let logged = Logged {
            number,
            events: take(&mut self.events),
            output,
        };
        file.write(&logged).map_err(&failed)?;
        if number.is_multiple_of(CHUNK) {
            file.flush(false).map_err(&failed)?;
        }
        Ok(())
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
    let (predicted, feedback) = (a.predicted - b.predicted, a.feedback - b.feedback);
    let angles = [setpoint, estimate, predicted, feedback].map(|v| v.norm().to_degrees());
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
    output::print(
        "\nWith the other settings, on the same input. This is speculation: the recorded machine did not follow them.\n",
    );
    let row = |(name, (squares, largest, at_s)): (&&str, &Change)| {
        let rms = (squares / cycles as f64).sqrt();
        let [rms, largest] = [rms, *largest].map(|x| format!("{x:.4}"));
        [(*name).to_owned(), rms, largest, format!("{at_s:.3}")]
    };
    let rows = QUANTITIES.iter().zip(changes).map(row);
    let header = "difference|RMS|largest|at, s";
    output::print(format!("{}\n", output::table(header, 1..4, rows)));
}
