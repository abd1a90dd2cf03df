//! Recordings: a bend log that the diagnosis reads as it is, and the tape beside it.
//!
//! One row per sample of the tip's IMU; numbers as short as they come back exactly. A recording starts
//! with a rest when the pistons are at zero, and only then has it a tape: what the pilot remembers in
//! mid-flight cannot be written down.

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

/// A recording that runs.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    log: BufWriter<File>,
    tape: Option<BufWriter<File>>,
    step_mm: f64,
    /// Rows so far.
    pub rows: u64,
    begun_s: Option<f64>,
    last_s: f64,
    scratch: Vec<u8>,
    /// A tape begins with a pilot's first turn.
    waits: bool,
}

/// Name of the tape of a log.
#[must_use]
pub fn tape_of(log: &Path) -> PathBuf {
    let mut name = log.as_os_str().to_owned();
    name.push(".tape");
    PathBuf::from(name)
}

impl Recording {
    /// Begins; a file that is there already is not written over.
    ///
    /// # Errors
    /// The system's.
    pub fn begin(path: &Path, step_mm: f64, header: Option<&tape::Header>) -> io::Result<Self> {
        let mut log = BufWriter::new(File::create_new(path)?);
        log.write_all(HEADER.as_bytes())?;
        let tape = match header {
            None => None,
            Some(header) => {
                let mut tape = BufWriter::new(File::create_new(tape_of(path))?);
                serde_json::to_writer(&mut tape, header)?;
                tape.write_all(b"\n")?;
                Some(tape)
            }
        };
        Ok(Self {
            path: path.to_owned(),
            log,
            tape,
            step_mm,
            rows: 0,
            begun_s: None,
            last_s: f64::NEG_INFINITY,
            scratch: Vec::new(),
            waits: header.is_some(),
        })
    }

    /// Where it is written.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// It can be replayed.
    #[must_use]
    pub fn has_tape(&self) -> bool {
        self.tape.is_some()
    }

    /// No pilot begins with it: a log alone, from now on.
    pub fn go_without_tape(&mut self) {
        self.tape = None;
        self.waits = false;
    }

    /// The tape ends here: something happened that it cannot hold.
    pub fn cut_tape(&mut self) {
        if let Some(mut tape) = self.tape.take() {
            // the log goes on without it, and says so at the end
            let _ = tape.flush();
        }
    }

    /// One turn.
    ///
    /// # Errors
    /// The system's: the recording should be ended.
    pub fn turn(&mut self, turned: &CycleOutput) -> io::Result<()> {
        self.waits &= !turned.first;
        if self.waits {
            return Ok(());
        }
        if let Some(tape) = &mut self.tape {
            self.scratch.clear();
            let sensed = Sensed { truth: None, ..turned.sensed };
            tape::write(&mut self.scratch, &tape::Record { sensed, order: turned.order, digest: tape::digest(turned) });
            tape.write_all(&self.scratch)?;
        }
        let ImuReading::Sample(sample, _) = turned.input.imu else { return Ok(()) };
        let begun_s = *self.begun_s.get_or_insert(sample.t.0 - 1e-3);
        let t = sample.t.0 - begun_s;
        if t <= self.last_s {
            return Ok(());
        }
        self.last_s = t;
        self.rows += 1;
        let target = &turned.frame.target;
        let (bend, dir) = (target.bend.beta().to_degrees(), target.bend.delta().to_degrees());
        let piston = turned.counted.0.map(|n| f64::from(n) * self.step_mm);
        let (a, g) = (sample.acc_m_s2, sample.gyro_rad_s);
        write!(self.log, "{t:.6},{bend},{dir},{},{},{},{}", target.length.0, piston[0], piston[1], piston[2])?;
        write!(self.log, ",{},{},{},{},{},{}", a.x, a.y, a.z, g.x, g.y, g.z)?;
        match sample.mag_ut {
            Some(m) => writeln!(self.log, ",{},{},{}", m.x, m.y, m.z),
            None => writeln!(self.log, ",,,"),
        }
    }

    /// Ends it: forced to the disk. Rows written.
    ///
    /// # Errors
    /// The system's.
    pub fn end(mut self) -> io::Result<u64> {
        self.log.flush()?;
        self.log.get_ref().sync_all()?;
        if let Some(tape) = &mut self.tape {
            tape.flush()?;
            tape.get_ref().sync_all()?;
        }
        Ok(self.rows)
    }
}
