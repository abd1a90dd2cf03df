//! An exam on a simulator that is a program of its own.
//!
//! Beside the plant link the program knows
//!
//! ```text
//! PROGRAM ARG… --list                                     one effect a line, its name first
//! PROGRAM ARG… --seed N --calib                           the gains of the unit as a calibration file
//! PROGRAM ARG… --seed N --effect NAME,NAME… --size X      the unit with these effects, X times as large as drawn
//! ```

use crate::config::calib::Calibration;
use crate::config::source;
use crate::experiment::exam::{Logs, Question, Recorded, record};
use crate::log::bend_log::BendLog;
use crate::model::Line;
use crate::model::effects::by_catalogue;
use crate::simulation::link::Link;
use crate::supervisor::MachineError;
use rand::rngs::StdRng;
use rand::{Rng, RngExt, SeedableRng};
use std::process::{Command, Stdio};

/// Factor by which an effect grows while it is too small to be claimed, and the largest size.
const GROWTH: f64 = 1.4;
const SIZE_MAX: f64 = 3.0;

/// The program and what it has been started with.
#[derive(Debug, Clone)]
pub struct Simulator {
    program: String,
    args: Vec<String>,
}

impl Simulator {
    /// A simulator that starts with these arguments.
    pub fn new((program, args): (String, Vec<String>)) -> Self {
        Self { program, args }
    }

    /// What the program prints with `more` arguments.
    fn print(&self, more: &[String]) -> Result<String, MachineError> {
        let fail = |source| MachineError::Start {
            program: self.program.clone(),
            source,
        };
        let mut command = Command::new(&self.program);
        command.args(self.args.iter().chain(more));
        command.stdin(Stdio::null()).stderr(Stdio::inherit());
        let out = command.output().map_err(fail)?;
        if !out.status.success() {
            let why = format!("with {} it ended with {}", more.join(" "), out.status);
            return Err(fail(std::io::Error::other(why)));
        }
        Ok(String::from_utf8_lossy(&out.stdout).into_owned())
    }

    /// The effects that the program lists, those of the catalogue and others.
    ///
    /// # Errors
    /// [`MachineError`] if it lists none.
    pub fn effects(&self) -> Result<[Vec<&'static str>; 2], MachineError> {
        let text = self.print(&["--list".to_owned()])?;
        let names = text.lines().filter_map(|l| l.split_whitespace().next());
        // as long-lived as the names of the built-in plant
        let names = names.map(|name| &*name.to_owned().leak());
        let known = by_catalogue(names.filter(|name| *name != "none"));
        let why = "the program lists no effect of the catalogue; with --list it prints one effect a line, its name first";
        if known[0].is_empty() {
            Err(malformed(&text, why))
        } else {
            Ok(known)
        }
    }

    /// Records the logs of a question. The gains of the calibration are off by a few percent; an effect that is too small to be claimed
    /// is made larger.
    ///
    /// # Errors
    /// [`MachineError`] of the program.
    pub fn draw(&self, q: &Question) -> Result<Logs, MachineError> {
        let mut rng = StdRng::seed_from_u64(q.seed);
        let seed = rng.random_range(1..1_000_000u32).to_string();
        let seed = ["--seed".to_owned(), seed];
        let printed = self.print(&[seed.as_slice(), &["--calib".to_owned()]].concat())?;
        let calib: Calibration = source::parse("PROGRAM --calib", &printed)
            .map_err(|e| malformed(&printed, &e.to_string()))?;
        let lines = calib.lines().map(|l| Line {
            k_epsilon: l.k_epsilon * rng.random_range(0.94..1.06),
            k_lambda_mm: l.k_lambda_mm * rng.random_range(0.9..1.1),
        });
        let log = |names: &[&str], size: f64, schedule, lab| -> Result<BendLog, MachineError> {
            let mut args = [self.args.as_slice(), &seed].concat();
            if !names.is_empty() {
                let with = ["--effect", &names.join(","), "--size", &size.to_string()];
                args.extend(with.map(str::to_owned));
            }
            record(|_| Link::start(&self.program, &args), &lines, schedule, lab)
        };
        let (first, second) = (rng.next_u64(), rng.next_u64());
        let recorded = |names: &[&str], size| {
            log(names, size, first, true).map(|log| Recorded::new(log, &lines))
        };
        let mut size = 1.0;
        let (with, hidden) = loop {
            let with = recorded(&q.names, size)?;
            let mut hidden = false;
            for name in &q.names {
                let rest: Vec<&str> = q.names.iter().filter(|n| *n != name).copied().collect();
                hidden = hidden || recorded(&rest, size)?.hides(&with, q.lab);
            }
            if !hidden || size * GROWTH > SIZE_MAX {
                break (with, hidden);
            }
            size *= GROWTH;
        };
        let mut asked = with.log;
        asked.reference = asked.reference.filter(|_| q.lab);
        let fresh = log(&q.names, size, second, q.lab)?;
        Ok(Logs {
            log: asked,
            fresh,
            lines,
            hidden,
        })
    }
}

/// The error about what a program has printed.
fn malformed(printed: &str, problem: &str) -> MachineError {
    MachineError::Malformed {
        line: printed.lines().next().unwrap_or_default().to_owned(),
        problem: problem.to_owned(),
    }
}
