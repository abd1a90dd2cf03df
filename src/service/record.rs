//! Recordings: a bend log in the format that the diagnosis reads, and a flight log beside it (`NAME.csv.gz` and `NAME.mcap`).
//!
//! The log has one row per sample of the tip's IMU, with the newest sample of the IMU on the base since the row before; numbers are written with the fewest digits that restore them
//! exactly. A recording has a flight log of its own only if it starts with a freshly reset supervisor, because the internal
//! state of a running one cannot be written down.
//!
//! The hub formats the rows; a thread of the recording's own creates, compresses and writes the files. A recording that
//! reaches its limits, or whose disk is too slow, ends and reports why.

use crate::config::ServiceSection;
use crate::model::Shape;
use crate::primitives::{ImuReading, ImuSample};
use crate::service::Caller;
use crate::service::disk::{create_recording, free_bytes, mib, require_free};
use crate::service::flight::file::{FlightFile, io_error};
use crate::service::flight::start::{Event, Logged};
use crate::supervisor::Sensed;
use flate2::{Compression, write::GzEncoder};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{
    Receiver, Sender, SyncSender, TryRecvError, TrySendError, channel, sync_channel,
};
use std::time::{Duration, Instant};

/// Columns, as in every bend log.
pub const HEADER: &str = "time_s,cmd_bend_deg,cmd_dir_deg,cmd_len_mm,piston1_mm,piston2_mm,piston3_mm,\
acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s,mag_x_ut,mag_y_ut,mag_z_ut,temp_c,\
pressure1_kpa,pressure2_kpa,pressure3_kpa,base_acc_x_m_s2,base_acc_y_m_s2,base_acc_z_m_s2,\
base_gyr_x_rad_s,base_gyr_y_rad_s,base_gyr_z_rad_s,base_mag_x_ut,base_mag_y_ut,base_mag_z_ut\n";

/// Time of the first row, s.
const FIRST_ROW_S: f64 = 1e-3;
/// Rows are handed to the thread this often, or when there are as many bytes of them.
const CHUNK: (Duration, usize) = (Duration::from_millis(250), 64 * 1024);
/// Chunks that may wait for the disk: at 500 rows a second, more than 20 s.
const CHUNKS_MAX: usize = 128;

/// What the thread reports.
#[derive(Debug)]
pub enum Progress {
    /// The files exist.
    Started,
    /// The recording has ended and is on the disk, or why it is not; with the reason if a limit ended it.
    Ended(io::Result<Option<&'static str>>),
}

/// Rows of the bend log and cycles of the flight log.
type Chunk = (Vec<u8>, Vec<Logged>);

/// A recording in progress.
#[derive(Debug)]
pub struct Recording {
    pub(super) path: PathBuf,
    /// Rows that wait to be handed over.
    log: Vec<u8>,
    /// Cycles for the flight log, if there is one.
    cycles: Option<Vec<Logged>>,
    handed_over: Instant,
    /// `None` once the recording is ending.
    chunks: Option<SyncSender<Chunk>>,
    progress: Receiver<Progress>,
    /// Longest duration, s.
    most_s: f64,
    step_mm: f64,
    pub(super) rows: Rows,
    /// The new supervisor has not run its first cycle yet.
    waiting: bool,
    /// Why it ends early.
    reason: Option<&'static str>,
    /// It ends when this client disconnects.
    pub(super) owner: Option<u64>,
    /// Who waits for its start, and for its end.
    pub(super) starting: Option<Caller>,
    pub(super) ending: Vec<Caller>,
}

/// Path of the flight log of a recording.
pub fn flight_path(log: &Path) -> PathBuf {
    let name = log.to_string_lossy();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    let name = name.strip_suffix(".csv").unwrap_or(name);
    PathBuf::from(format!("{name}.mcap"))
}

impl Recording {
    /// Starts the thread, which creates the bend log and, if the recording shall be replayable, its flight log: then `flight` is
    /// the time of the loop's zero, ns since 1970. Existing files are not overwritten. A name that ends in `.gz` compresses the
    /// bend log.
    ///
    /// # Errors
    /// The operating system's, if there is no thread.
    pub fn start(
        path: &Path,
        step_mm: f64,
        flight: Option<u64>,
        bounds: &ServiceSection,
    ) -> io::Result<Self> {
        let (chunks, work) = sync_channel(CHUNKS_MAX);
        let (report, progress) = channel();
        let (own, limits) = (path.to_owned(), bounds.clone());
        std::thread::Builder::new()
            .name("recording".into())
            .spawn(move || {
                let ended = write(&own, flight, &limits, &work, &report);
                // the hub is gone only when the service ends
                let _ = report.send(Progress::Ended(ended));
            })?;
        Ok(Self {
            path: path.to_owned(),
            log: HEADER.as_bytes().to_vec(),
            waiting: flight.is_some(),
            cycles: flight.map(|_| Vec::new()),
            handed_over: Instant::now(),
            chunks: Some(chunks),
            progress,
            most_s: bounds.record_max_s,
            step_mm,
            rows: Rows::default(),
            reason: None,
            owner: None,
            starting: None,
            ending: Vec::new(),
        })
    }

    /// True if the recording can be replayed.
    pub fn is_replayable(&self) -> bool {
        self.cycles.is_some()
    }

    /// Records without a flight log, because no fresh supervisor begins.
    pub fn give_up_replay(&mut self) {
        (self.waiting, self.cycles) = (false, None);
    }

    /// Adds one cycle.
    pub fn write(&mut self, logged: &Logged) {
        let begins = |event: &Arc<Event>| matches!(**event, Event::Start(_));
        self.waiting &= !logged.events.iter().any(begins);
        if self.waiting || self.chunks.is_none() {
            return;
        }
        if let Some(cycles) = &mut self.cycles {
            cycles.push(logged.clone());
        }
        let (sensed, target) = (&logged.output.sensed, &logged.output.frame.target);
        if let Some(row) = self.rows.add(sensed, target, self.step_mm) {
            write_values(&mut self.log, &row);
            self.log.push(b'\n');
        }
        if self.rows.last_s > self.most_s {
            self.reason = Some("it reached service.record_max_s");
            self.finish();
        } else if self.log.len() > CHUNK.1 || self.handed_over.elapsed() > CHUNK.0 {
            self.hand_over();
        }
    }

    fn hand_over(&mut self) {
        let Some(chunks) = &self.chunks else { return };
        self.handed_over = Instant::now();
        let cycles = self.cycles.as_mut().map(std::mem::take);
        let chunk = (std::mem::take(&mut self.log), cycles.unwrap_or_default());
        match chunks.try_send(chunk) {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => {
                self.reason = Some("the disk is too slow");
                self.chunks = None;
            }
            // the thread has ended and reports why
            Err(TrySendError::Disconnected(_)) => self.chunks = None,
        }
    }

    /// Hands over what is left; the thread reports when it is on the disk.
    pub fn finish(&mut self) {
        self.hand_over();
        self.chunks = None;
    }

    /// What the thread has reported since the last call.
    pub fn progress(&mut self) -> Option<Progress> {
        Some(match self.progress.try_recv() {
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => {
                Progress::Ended(Err(io::Error::other("its thread ended unexpectedly")))
            }
            Ok(Progress::Ended(Ok(by_thread))) => Progress::Ended(Ok(by_thread.or(self.reason))),
            Ok(progress) => progress,
        })
    }
}

/// The rows that cycles add to a bend log.
#[derive(Debug, Default)]
pub struct Rows {
    /// Number of rows so far.
    pub count: u64,
    /// Time of the last row, s.
    pub last_s: f64,
    start_s: Option<f64>,
    base: Option<ImuSample>,
}

impl Rows {
    /// The row of a cycle in which a sample of the tip's IMU arrived, in the order of [`HEADER`]. What is missing is not a number.
    pub fn add(&mut self, sensed: &Sensed, target: &Shape, step_mm: f64) -> Option<Vec<f64>> {
        self.base = sensed.base_imu.or(self.base);
        let ImuReading::Sample(sample, _) = sensed.imu else {
            return None;
        };
        let t = sample.t.0 - *self.start_s.get_or_insert(sample.t.0 - FIRST_ROW_S);
        if t <= self.last_s {
            return None;
        }
        (self.last_s, self.count) = (t, self.count + 1);
        let (none, gauges, bend) = ([f64::NAN; 3], &sensed.gauges, target.bend);
        let imu = |s: ImuSample| {
            [
                s.acc_m_s2.into(),
                s.gyro_rad_s.into(),
                s.mag_ut.map_or(none, Into::into),
            ]
        };
        let mut row = vec![t, bend.beta().to_degrees(), bend.delta().to_degrees()];
        row.push(target.length.0);
        row.extend(sensed.counted.0.map(|n| f64::from(n) * step_mm));
        row.extend(imu(sample).as_flattened());
        row.push(gauges.tip_c.unwrap_or(f64::NAN));
        row.extend(gauges.pressure_kpa.unwrap_or(none));
        row.extend(self.base.take().map_or([none; 3], imu).as_flattened());
        Some(row)
    }
}

/// Appends the values of a row to a bend log: a field without a number is empty, every other one has a decimal point.
pub fn write_values(log: &mut Vec<u8>, row: &[f64]) {
    for (k, value) in row.iter().enumerate() {
        // writing to memory does not fail
        let _ = match k {
            0 => write!(log, "{value:.6}"),
            _ if !value.is_finite() => write!(log, ","),
            _ if value.fract() == 0.0 => write!(log, ",{value:.1}"),
            _ => write!(log, ",{value}"),
        };
    }
}

/// Creates the folder of a recording, and refuses a disk without room for it.
///
/// # Errors
/// The operating system's, or what is free.
pub fn make_room(path: &Path, limits: &ServiceSection) -> io::Result<()> {
    let named = |folder: &&Path| !folder.as_os_str().is_empty();
    let folder = path.parent().filter(named).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)?;
    require_free(folder, limits)
}

/// The thread: returns the reason if a limit ended the recording.
fn write(
    path: &Path,
    flight: Option<u64>,
    limits: &ServiceSection,
    chunks: &Receiver<Chunk>,
    report: &Sender<Progress>,
) -> io::Result<Option<&'static str>> {
    make_room(path, limits)?;
    let file = create_recording(path)?;
    let buffered = BufWriter::new(file.try_clone()?);
    let mut log: Box<dyn Write> = match path.extension() {
        Some(e) if e == "gz" => Box::new(GzEncoder::new(buffered, Compression::fast())),
        _ => Box::new(buffered),
    };
    let flight = flight.map(|zero| FlightFile::create(&flight_path(path), zero));
    let mut flight = flight.transpose().map_err(io_error)?;
    // the hub is gone only when the service ends
    let _ = report.send(Progress::Started);
    let mut reason = None;
    for (rows, cycles) in chunks {
        log.write_all(&rows)?;
        // a killed service leaves what it has handed over
        log.flush()?;
        if let Some(flight) = &mut flight {
            let written = cycles.iter().try_for_each(|logged| flight.write(logged));
            written
                .and_then(|()| flight.flush(false))
                .map_err(io_error)?;
        }
        // a recording whose file was removed ends with an error
        let size =
            std::fs::metadata(path)?.len() + flight.as_ref().map_or(Ok(0), FlightFile::size)?;
        if size > mib(limits.record_max_mib) {
            reason = Some("it reached service.record_max_mib");
        } else if free_bytes(path)? < mib(limits.record_free_mib) {
            reason = Some("less than service.record_free_mib of the disk is free");
        }
        if reason.is_some() {
            break;
        }
    }
    // everything is flushed; this writes the end of a compressed file
    drop(log);
    file.sync_all()?;
    let flight = flight.map_or(Ok(()), FlightFile::finish);
    flight.map_err(io_error)?;
    Ok(reason)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_whose_file_was_removed_ends_with_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bend.csv.gz");
        let limits = ServiceSection {
            record_free_mib: 1.0,
            ..ServiceSection::default()
        };
        let end = |removes: bool| {
            let mut recording = Recording::start(&path, 0.03, None, &limits).unwrap();
            let started = recording.progress.recv().unwrap();
            assert!(matches!(started, Progress::Started));
            if removes {
                std::fs::remove_file(&path).unwrap();
            }
            recording.finish();
            match recording.progress.recv().unwrap() {
                Progress::Ended(result) => result,
                Progress::Started => panic!("it has started before"),
            }
        };
        assert_eq!(end(true).unwrap_err().kind(), io::ErrorKind::NotFound);
        assert_eq!(end(false).unwrap(), None);
    }
}
