//! Recordings: a bend log in the format that the diagnosis reads, and the tape beside it.
//!
//! The log has one row per sample of the tip's IMU; numbers are written with the fewest digits that restore them
//! exactly. A recording has a tape only if it starts with a freshly reset supervisor, because the internal state of a
//! running one cannot be written down.

use crate::estimation::fusion::health::ImuReading;
use crate::service::tape;
use crate::supervisor::cycle::CycleOutput;
use crate::supervisor::machine::Sensed;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Columns, as in every bend log.
const HEADER: &str = "time_s,cmd_bend_deg,cmd_dir_deg,cmd_len_mm,piston1_mm,piston2_mm,piston3_mm,\
acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s,mag_x_ut,mag_y_ut,mag_z_ut\n";

/// Time of the first row, s.
const FIRST_ROW_S: f64 = 1e-3;

/// A recording in progress.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    log: BufWriter<File>,
    tape: Option<BufWriter<File>>,
    step_mm: f64,
    /// Rows written so far.
    pub rows: u64,
    start_s: Option<f64>,
    last_s: f64,
    scratch: Vec<u8>,
    /// The new supervisor has not run its first cycle yet.
    waiting: bool,
}

/// Path of the tape of a log.
#[must_use]
pub fn tape_path(log: &Path) -> PathBuf {
    let mut name = log.as_os_str().to_owned();
    name.push(".tape");
    PathBuf::from(name)
}

impl Recording {
    /// Creates the log, and with a header the tape. Existing files are not overwritten.
    ///
    /// # Errors
    /// The operating system's.
    pub fn start(path: &Path, step_mm: f64, header: Option<&tape::Header>) -> io::Result<Self> {
        let mut log = BufWriter::new(File::create_new(path)?);
        log.write_all(HEADER.as_bytes())?;
        let create_tape = |header: &tape::Header| -> io::Result<BufWriter<File>> {
            let mut tape = BufWriter::new(File::create_new(tape_path(path))?);
            serde_json::to_writer(&mut tape, header)?;
            tape.write_all(b"\n")?;
            Ok(tape)
        };
        Ok(Self {
            path: path.to_owned(),
            log,
            tape: header.map(create_tape).transpose()?,
            step_mm,
            rows: 0,
            start_s: None,
            last_s: f64::NEG_INFINITY,
            scratch: Vec::new(),
            waiting: header.is_some(),
        })
    }

    /// Path of the log.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// True while the recording can be replayed.
    #[must_use]
    pub fn has_tape(&self) -> bool {
        self.tape.is_some()
    }

    /// Ends the tape before an event that it cannot hold. The log continues.
    pub fn end_tape(&mut self) {
        self.waiting = false;
        if let Some(mut tape) = self.tape.take() {
            // a tape that is cut short replays up to its last whole record
            let _ = tape.flush();
        }
    }

    /// Writes one cycle.
    ///
    /// # Errors
    /// The operating system's; the recording should then be ended.
    pub fn write(&mut self, output: &CycleOutput) -> io::Result<()> {
        self.waiting &= !output.first;
        if self.waiting {
            return Ok(());
        }
        if let Some(tape) = &mut self.tape {
            self.scratch.clear();
            let sensed = Sensed { truth: None, ..output.sensed };
            tape::write(&mut self.scratch, &tape::Record { sensed, order: output.order, digest: tape::digest(output) });
            tape.write_all(&self.scratch)?;
        }
        let ImuReading::Sample(sample, _) = output.input.imu else { return Ok(()) };
        let start_s = *self.start_s.get_or_insert(sample.t.0 - FIRST_ROW_S);
        let t = sample.t.0 - start_s;
        if t <= self.last_s {
            return Ok(());
        }
        self.last_s = t;
        self.rows += 1;
        let target = &output.frame.target;
        let (bend, dir) = (target.bend.beta().to_degrees(), target.bend.delta().to_degrees());
        let piston = output.counted.0.map(|n| f64::from(n) * self.step_mm);
        let (a, g) = (sample.acc_m_s2, sample.gyro_rad_s);
        write!(self.log, "{t:.6},{bend},{dir},{},{},{},{}", target.length.0, piston[0], piston[1], piston[2])?;
        write!(self.log, ",{},{},{},{},{},{}", a.x, a.y, a.z, g.x, g.y, g.z)?;
        match sample.mag_ut {
            Some(m) => writeln!(self.log, ",{},{},{}", m.x, m.y, m.z),
            None => writeln!(self.log, ",,,"),
        }
    }

    /// Ends the recording and waits for the disk. Returns the number of rows.
    ///
    /// # Errors
    /// The operating system's.
    pub fn finish(mut self) -> io::Result<u64> {
        for file in std::iter::once(&mut self.log).chain(&mut self.tape) {
            file.flush()?;
            file.get_ref().sync_all()?;
        }
        Ok(self.rows)
    }
}
