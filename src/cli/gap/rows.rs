//! `retroflex gap diagnose --rows`: diagnoses many logs, each alone, and keeps a row of each.
//!
//! A row is written to a journal as soon as it is known. When the command is given again, after a kill or with new logs, only
//! logs without a row are diagnosed.

use crate::cli::gap::input;
use crate::cli::{ResultFile, output};
use crate::config::calib::is_day;
use crate::diagnosis::diagnose;
use crate::diagnosis::fleet::row::{self, FleetRow};
use crate::diagnosis::tip::{Rig, TipProblem};
use crate::log::columns;
use crate::model::Line;
use crate::model::effects::catalogue;
use crate::primitives::file::{is_irregular, why_unreadable};
use crate::service::flight::cycle::fnv;
use miette::{IntoDiagnostic, Result, bail, miette};
use rayon::ThreadPoolBuilder;
use serde::Deserialize;
use std::collections::HashMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::thread;

/// A part of many logs: `K/N`, the K-th of N. The path of a log in its folder alone decides to which part it belongs.
#[derive(Debug, Clone, Copy)]
pub struct Shard(u64, u64);

/// A part as `--shard` names it.
fn shard(text: &str) -> std::result::Result<Shard, String> {
    let parts = text.split_once('/');
    let parts = parts.and_then(|(k, n)| Some(Shard(k.parse().ok()?, n.parse().ok()?)));
    let parts = parts.filter(|Shard(k, n)| (1..=*n).contains(k));
    parts.ok_or("expected K/N with K from 1 to N, for example 2/8".to_owned())
}

/// A log and its row, which may not be filled in yet.
struct Task {
    path: PathBuf,
    row: FleetRow,
}

/// Options of a run over many logs.
#[derive(Debug, clap::Args)]
pub struct RowsArgs {
    /// Diagnose each log alone, and every log in a LOG that is a folder, and write a row of each as a Parquet table. Rows that
    /// the table has already are kept, also after a kill.
    #[arg(long, value_name = "ROWS.parquet", conflicts_with_all = ["map", "json", "html", "save"])]
    pub rows: Option<ResultFile>,
    /// With --rows: diagnose only the K-th of N parts of the logs.
    #[arg(long, value_name = "K/N", requires = "rows", value_parser = shard)]
    shard: Option<Shard>,
    /// With --rows: table `log,unit,lot,date` of what the logs are of; by default a log is a unit and its folder the lot.
    #[arg(long, value_name = "UNITS.csv", requires = "rows")]
    units: Option<PathBuf>,
}

/// What every row depends on beside its log.
pub struct Settings {
    /// Machine.
    pub rig: Rig,
    /// Calibration that the logs were driven with.
    pub lines: [Line; 3],
    /// Seed of the bootstrap.
    pub seed: u64,
}

/// What a table `--units` says of a log.
#[derive(Deserialize)]
struct Unit {
    log: String,
    unit: String,
    #[serde(default)]
    lot: String,
    #[serde(default)]
    date: String,
}

/// Diagnoses what has no row yet and writes the table.
///
/// # Errors
/// A report that names the faulty file. A log that cannot be diagnosed has a row that says why.
pub fn run(logs: &[PathBuf], settings: &Settings, args: &RowsArgs, table: &Path) -> Result<()> {
    let Settings { rig, lines, seed } = settings;
    let version = env!("CARGO_PKG_VERSION");
    let text = format!("{version} {rig:?} {lines:?} {seed}");
    let hash = format!("{:016x}", fnv(text.into_bytes()));
    let mut tasks = tasks(logs, args)?;
    let journal = table.with_added_extension("journal");
    let known = known(table, &journal)?;
    let mut open = Vec::new();
    for task in &mut tasks {
        // a log that cannot be read has a row that says so, as one that cannot be diagnosed
        let bytes = task.path.is_file().then(|| fs::read(&task.path));
        let bytes = bytes.and_then(Result::ok);
        task.row.content = bytes.map_or_else(String::new, |bytes| format!("{:016x}", fnv(bytes)));
        task.row.settings.clone_from(&hash);
        match known.get(&task.row.log) {
            Some(old) if old.content == task.row.content && old.settings == hash => {
                task.row.take_result(old)
            }
            _ => open.push(task),
        }
    }
    let new = open.len();
    diagnose_all(settings, open, &journal)?;
    let rows: Vec<FleetRow> = tasks.into_iter().map(|task| task.row).collect();
    let content = columns::write(&row::table(&rows), &[]).into_diagnostic()?;
    output::write(table, content)?;
    // the table holds all that it holds
    let _ = fs::remove_file(&journal);
    let refused = rows.iter().filter(|row| !row.refused.is_empty()).count();
    let (file, all) = (table.display(), rows.len());
    eprintln!("{file}: {all} logs, {new} of them diagnosed now; {refused} cannot be diagnosed");
    Ok(())
}

/// The logs, in the order of their names, with what is known of their units.
fn tasks(logs: &[PathBuf], args: &RowsArgs) -> Result<Vec<Task>> {
    let mut tasks = Vec::new();
    for path in logs {
        let there = path.symlink_metadata();
        there.map_err(|e| miette!("{}: {}", path.display(), why_unreadable(path, &e)))?;
        let parent = path.parent().filter(|_| !path.is_dir());
        collect(path, parent.unwrap_or(path), &mut tasks)?;
    }
    tasks.sort_by(|a, b| a.row.log.cmp(&b.row.log));
    let mut pairs = tasks.windows(2);
    if let Some([a, b]) = pairs.find(|two| two[0].row.log == two[1].row.log) {
        let (a, b) = (&a.path, &b.path);
        bail!("{a:?} and {b:?} have the same name; give the folder that holds both");
    }
    if let Some(units) = &args.units {
        tell_units(&mut tasks, units)?;
    }
    if let Some(Shard(k, n)) = args.shard {
        tasks.retain(|task| fnv(task.row.log.bytes()) % n == k - 1);
    }
    if tasks.is_empty() {
        bail!(
            "there is no log to diagnose: logs are *.csv and *.csv.gz files, also in folders of folders"
        );
    }
    Ok(tasks)
}

/// Fills in what a table `--units` says.
fn tell_units(tasks: &mut [Task], units: &Path) -> Result<()> {
    let file = units.display();
    let failed = |e| miette!("{file}: {e}");
    let mut reader = csv::Reader::from_path(units).map_err(failed)?;
    let header = reader.headers().map_err(failed)?.clone();
    let mut told = HashMap::new();
    for record in reader.records() {
        let record = record.map_err(failed)?;
        let line = record.position().map_or(0, csv::Position::line);
        let of: Unit = record.deserialize(Some(&header)).map_err(failed)?;
        let (log, date) = (of.log, of.date);
        let Some(task) = tasks.iter_mut().find(|task| task.row.log == log) else {
            bail!("{file}, line {line}, column log: `{log}`: there is no such log");
        };
        if let Some(first) = told.insert(log.clone(), line) {
            bail!(
                "{file}, line {line}, column log: line {first} names `{log}`, too; remove one of them"
            );
        }
        if !(date.is_empty() || is_day(&date)) {
            bail!(
                "{file}, line {line}, column date: `{date}` is no day; write it as YYYY-MM-DD, such as 2026-03-31, or leave it empty"
            );
        }
        (task.row.unit, task.row.lot, task.row.date) = (of.unit, of.lot, date);
    }
    Ok(())
}

/// Every log at or below a path. Unless a table says otherwise, the file is the unit and its folder the lot.
fn collect(path: &Path, folder: &Path, into: &mut Vec<Task>) -> Result<()> {
    let failed = |e| miette!("{}: {e}", path.display());
    if path.is_dir() {
        for entry in fs::read_dir(path).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            // a link to a folder may lead in a circle
            if !(path.is_symlink() && path.is_dir()) {
                collect(&path, folder, into)?;
            }
        }
        return Ok(());
    }
    let log = path.strip_prefix(folder).unwrap_or(path).to_string_lossy();
    let plain = log.strip_suffix(".gz").unwrap_or(&log);
    if let Some(unit) = plain.strip_suffix(".csv") {
        let (lot, unit) = unit.rsplit_once('/').unwrap_or(("", unit));
        let [unit, lot, log] = [unit, lot, &log].map(str::to_owned);
        let mut row = FleetRow::default();
        (row.unit, row.lot, row.log) = (unit, lot, log);
        let path = path.to_owned();
        into.push(Task { path, row });
    }
    Ok(())
}

/// Rows of an earlier run, by log: those of its table, and those of its journal if it did not end.
fn known(table: &Path, journal: &Path) -> Result<HashMap<String, FleetRow>> {
    let mut rows = Vec::new();
    if table.is_file() {
        rows = read(table)?;
    }
    let text = fs::read(journal).unwrap_or_default();
    let lines = text.split(|b| *b == b'\n');
    // a row that was being written as the run ended is no row
    rows.extend(lines.filter_map(|line| serde_json::from_slice::<FleetRow>(line).ok()));
    Ok(rows.into_iter().map(|row| (row.log.clone(), row)).collect())
}

/// Rows of a table.
///
/// # Errors
/// A report that names the file.
pub fn read(table: &Path) -> Result<Vec<FleetRow>> {
    let file = table.display();
    let other = |why: &str| miette!("{file}: this is no table of `gap diagnose --rows`: {why}");
    let open = File::open(table).map_err(|e| miette!("{file}: {}", why_unreadable(table, &e)))?;
    let columns = columns::read(open).map_err(|e| other(&e.to_string()))?;
    let rows = row::rows(&columns).map_err(|e| other(&e.to_string()))?;
    if rows.iter().any(|row| row.log.is_empty()) {
        Err(other("it has no column `log`"))
    } else {
        Ok(rows)
    }
}

/// Fills in the rows, one log a core at a time.
fn diagnose_all(settings: &Settings, open: Vec<&mut Task>, journal: &Path) -> Result<()> {
    let failed = |e: io::Error| miette!("{}: {e}", journal.display());
    let mut options = OpenOptions::new();
    let file = options.create(true).append(true).open(journal);
    let mut file = file.map_err(failed)?;
    // ends a row that was being written as an earlier run ended
    file.write_all(b"\n").map_err(failed)?;
    let bar = output::bar(open.len() as u64, "{pos} of {len} logs, {eta} left,");
    let open = Mutex::new(open.into_iter());
    let next = || open.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = || -> io::Result<()> {
        // cores share logs out, not the parts of one log: that scales better and holds few logs in memory
        let pool = ThreadPoolBuilder::new().num_threads(1).build();
        let pool = pool.map_err(io::Error::other)?;
        while let Some(task) = next() {
            pool.install(|| diagnose_one(settings, task));
            let line = serde_json::to_string(&task.row)? + "\n";
            // one call appends one row
            (&file).write_all(line.as_bytes())?;
            file.sync_data()?;
            bar.inc(1);
        }
        Ok(())
    };
    let done = thread::scope(|scope| {
        let cores = 0..rayon::current_num_threads();
        let workers: Vec<_> = cores.map(|_| scope.spawn(work)).collect();
        let defect = |_| Err(io::Error::other("a diagnosis failed"));
        let ends = workers.into_iter().map(|w| w.join().unwrap_or_else(defect));
        // all end before the first error counts
        ends.fold(Ok(()), io::Result::and)
    });
    done.map_err(failed)
}

fn diagnose_one(settings: &Settings, task: &mut Task) {
    let Settings { rig, lines, seed } = settings;
    // a pipe would keep all the others waiting
    if is_irregular(&task.path) {
        task.row.refused = format!("{}: this is no regular file", task.row.log);
        return;
    }
    match input::observe(&task.path, rig) {
        Ok(log) => {
            let done = diagnose(&TipProblem::new(&log, catalogue(), lines, *seed));
            task.row.tell(&done);
        }
        // where the folder lies does not matter
        Err(e) => {
            let path = task.path.display().to_string();
            task.row.refused = e.to_string().replace(&path, &task.row.log);
        }
    }
}
