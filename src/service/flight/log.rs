//! The log of a run: a series of files, written by a thread of its own and bounded on the disk.
//!
//! The hub hands over cycles in batches and never waits. A batch that finds the queue full is dropped, and the numbers of the
//! cycles show the gap. While the disk has no room, or fails, nothing is written, and the status says why.

use crate::config::ServiceSection;
use crate::service::disk::{free_bytes, mib, require_free};
use crate::service::flight::file::{FlightFile, io_error, zero_unix_ns};
use crate::service::flight::start::{Event, Logged};
use mcap::McapResult;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Cycles that are handed over together.
const BATCH: usize = 64;
/// Batches that may wait for the disk: 8 s at 1 kHz.
const BATCHES_MAX: usize = 128;
/// A chunk is closed this often: what a kill loses.
const CHUNK: Duration = Duration::from_millis(500);
/// The disk is asked this often to keep what it has: what a loss of power loses.
const SYNC: Duration = Duration::from_secs(5);

/// After the disk has failed, the log is written again no earlier than this.
const RETRY: Duration = Duration::from_secs(1);

/// The hub's end.
pub struct FlightLog {
    batch: Vec<Logged>,
    /// `None` once the log has ended.
    queue: Option<SyncSender<Vec<Logged>>>,
    thread: JoinHandle<()>,
    problem: Arc<Problem>,
    /// Cycles that the queue had no place for.
    pub lost: u64,
}

impl FlightLog {
    /// Starts the thread. It creates the folder and the first file.
    ///
    /// # Errors
    /// The operating system's, if there is no thread.
    pub fn start(folder: &Path, bounds: &ServiceSection) -> io::Result<Self> {
        let (queue, work) = sync_channel(BATCHES_MAX);
        let (folder, bounds, problem) = (folder.to_owned(), bounds.clone(), Arc::default());
        let shared = Arc::clone(&problem);
        let thread = std::thread::Builder::new()
            .name("flight log".into())
            .spawn(move || keep_writing(&folder, &bounds, &work, &shared))?;
        Ok(Self {
            batch: Vec::new(),
            queue: Some(queue),
            thread,
            problem,
            lost: 0,
        })
    }

    /// Adds one cycle.
    pub fn push(&mut self, logged: &Logged) {
        let Some(queue) = &self.queue else { return };
        self.batch.push(logged.clone());
        if self.batch.len() < BATCH {
            return;
        }
        match queue.try_send(std::mem::take(&mut self.batch)) {
            Ok(()) => {}
            Err(TrySendError::Full(batch)) => self.lost += batch.len() as u64,
            // the thread has panicked
            Err(TrySendError::Disconnected(_)) => self.queue = None,
        }
    }

    /// Why nothing is written at present.
    pub fn problem(&self) -> Option<String> {
        let told = self.problem.lock();
        let told = told.unwrap_or_else(PoisonError::into_inner).clone();
        let ended = || "its thread has ended".to_owned();
        told.or_else(|| self.queue.is_none().then(ended))
    }

    /// Hands over what is left and waits for the disk, but not for longer than `most`.
    pub fn finish(&mut self, most: Duration) {
        if let Some(queue) = self.queue.take() {
            // a queue that is full loses the last batch
            let _ = queue.try_send(std::mem::take(&mut self.batch));
        }
        let since = Instant::now();
        while !self.thread.is_finished() && since.elapsed() < most {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Folder, run and part of a log that [`FlightLog`] wrote.
pub fn run_and_part(path: &Path) -> Option<(u64, u32)> {
    let (run, part) = path
        .file_name()?
        .to_str()?
        .strip_suffix(".mcap")?
        .strip_prefix("flight-")?
        .split_once('-')?;
    // another file may have any number in its name
    let run = run.parse().ok().filter(|run| *run < RUN_MAX)?;
    Some((run, part.parse().ok()?))
}

/// Largest number of a run.
const RUN_MAX: u64 = 1_000_000_000;

/// Path of a part of a run.
pub fn part_path(folder: &Path, run: u64, part: u32) -> PathBuf {
    folder.join(format!("flight-{run:06}-{part:03}.mcap"))
}

/// The flight logs in a folder, oldest first.
///
/// # Errors
/// The operating system's.
pub fn flights(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let all = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path()));
    let mut logs = all.collect::<io::Result<Vec<PathBuf>>>()?;
    logs.retain(|path| run_and_part(path).is_some());
    logs.sort_by_key(|path| run_and_part(path));
    Ok(logs)
}

/// What is the matter with the disk, for the status.
type Problem = Mutex<Option<String>>;

fn set(problem: &Problem, now: Option<String>) -> Option<String> {
    let mut told = problem.lock().unwrap_or_else(PoisonError::into_inner);
    std::mem::replace(&mut told, now)
}

/// The thread: writes, and tries again, as another run, after the disk has failed.
fn keep_writing(
    folder: &Path,
    bounds: &ServiceSection,
    work: &Receiver<Vec<Logged>>,
    problem: &Problem,
) {
    let mut start = None;
    while let Err(e) = run(folder, bounds, work, &mut start, problem) {
        let why = io_error(e).to_string();
        if set(problem, Some(why.clone())).is_none() {
            let shown = folder.display();
            tracing::error!(
                event = "flight_log",
                "{shown}: the flight log is not written: {why}"
            );
        }
        std::thread::sleep(RETRY);
        work.try_iter().for_each(drop);
    }
}

/// Writes `flight-RUN-PART.mcap`; `start` is the start of the present supervisor.
fn run(
    folder: &Path,
    bounds: &ServiceSection,
    work: &Receiver<Vec<Logged>>,
    start: &mut Option<Event>,
    problem: &Problem,
) -> McapResult<()> {
    std::fs::create_dir_all(folder)?;
    let last = flights(folder)?.pop();
    let last = last.and_then(|path| run_and_part(&path));
    let run = last.map_or(1, |(run, _)| run + 1);
    let (mut part, mut zero_ns) = (0, None);
    let mut open: Option<(FlightFile, f64)> = None;
    let (mut flushed, mut synced) = (Instant::now(), Instant::now());
    loop {
        let batch = match work.recv_timeout(CHUNK) {
            Ok(batch) => batch,
            Err(RecvTimeoutError::Timeout) => Vec::new(),
            Err(RecvTimeoutError::Disconnected) => {
                return open.map_or(Ok(()), |(file, _)| file.finish());
            }
        };
        for logged in &batch {
            let t_s = logged.output.sensed.t.0;
            let mut events = logged.events.iter();
            let began = events.rfind(|event| matches!(***event, Event::Start(_)));
            *start = began.map(|event| event.at(logged.number)).or(start.take());
            let (file, _) = match &mut open {
                Some(open) => open,
                none => {
                    prune(folder, bounds, &[])?;
                    part += 1;
                    let zero_ns = *zero_ns.get_or_insert_with(|| zero_unix_ns(t_s));
                    let mut file = FlightFile::create(&part_path(folder, run, part), zero_ns)?;
                    if let Some(start) = start.as_ref().filter(|_| began.is_none()) {
                        // every file says with what it was written
                        file.event(start, zero_ns + (t_s * 1e9) as u64)?;
                    }
                    set(problem, None);
                    none.insert((file, t_s))
                }
            };
            file.write(logged)?;
        }
        let (Some((file, since_s)), true) = (&mut open, flushed.elapsed() > CHUNK) else {
            continue;
        };
        flushed = Instant::now();
        let syncs = synced.elapsed() > SYNC;
        file.flush(syncs)?;
        if syncs {
            synced = flushed;
            prune(folder, bounds, &[part_path(folder, run, part)])?;
        }
        let last = batch.last();
        let age_s = last.map_or(0.0, |logged| logged.output.sensed.t.0 - *since_s);
        if file.size()? > mib(bounds.flight_file_mib) || age_s > bounds.flight_file_s {
            open.take().map_or(Ok(()), |(file, _)| file.finish())?;
        }
    }
}

/// Deletes the oldest logs until there is room for one more, but neither `keep` nor the newest one beside it. If that cannot make room,
/// because other files fill the disk, no log is deleted for it.
fn prune(folder: &Path, bounds: &ServiceSection, keep: &[PathBuf]) -> io::Result<()> {
    // somebody else may delete logs too
    let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |m| m.len());
    let most = mib(bounds.flight_max_mib - bounds.flight_file_mib);
    let old = flights(folder)?.into_iter();
    let mut old: Vec<PathBuf> = old.filter(|path| !keep.contains(path)).rev().collect();
    loop {
        let room = require_free(folder, bounds);
        let sizes: Vec<u64> = old.iter().map(size).collect();
        let helps =
            free_bytes(folder)? + sizes.iter().skip(1).sum::<u64>() >= mib(bounds.record_free_mib);
        let much = sizes.iter().sum::<u64>() > most;
        if old.len() < 2 || !(much || helps && room.is_err()) {
            return room;
        }
        match old.pop().map(std::fs::remove_file) {
            Some(Err(e)) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logs_are_deleted_oldest_first_and_not_where_that_makes_no_room() {
        let left = |record_free_mib: f64, flight_max_mib: f64| {
            let folder = tempfile::tempdir().unwrap();
            let paths: Vec<PathBuf> = (1..=5).map(|n| part_path(folder.path(), n, 1)).collect();
            for path in &paths {
                let file = std::fs::File::create(path).unwrap();
                file.set_len(1 << 20).unwrap();
            }
            let bounds = ServiceSection {
                record_free_mib,
                flight_max_mib,
                flight_file_mib: 1.0,
                ..ServiceSection::default()
            };
            let room = prune(folder.path(), &bounds, &paths[4..]);
            let left = flights(folder.path()).unwrap();
            assert_eq!(left, paths[5 - left.len()..]);
            (room.is_ok(), left.len())
        };
        // of four beside the present one, as many as are allowed, and at least the newest
        for (max_mib, expected) in [(5.0, 5), (4.0, 4), (3.0, 3), (2.0, 2), (1.0, 2)] {
            assert_eq!(left(0.0, max_mib), (true, expected), "{max_mib} MiB");
        }
        // other files fill the disk
        assert_eq!(left(1e9, 64.0), (false, 5));
    }
}
