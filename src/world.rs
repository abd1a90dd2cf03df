//! The worlds the loop can live in: one trait, lockstep.
//!
//! A world takes microstep counts, lets its time go on by one period, and answers with what the
//! sensors said. What a world knows of the *true* orientation travels beside the reading and never
//! into [`crate::tick::Input`]: it is for the judge alone.

use crate::frames::{Base, Rotation, Tip};
use crate::plant::PlantError;
use crate::sample::ImuSample;
use crate::units::{Seconds, Steps};
use thiserror::Error;

/// What a world says of itself before time starts.
#[derive(Debug, Clone, PartialEq)]
pub struct Nature {
    /// Name, for reports.
    pub name: String,
    /// Length of one step of its time, s.
    pub period_s: f64,
    /// Piston travel per microstep, mm.
    pub step_mm: f64,
    /// Bellow length at rest, mm.
    pub rest_length_mm: f64,
}

/// Answer to one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reply {
    /// Time reached.
    pub t: Seconds,
    /// A sample, if the sensor had one.
    pub imu: Option<ImuSample>,
    /// True tip orientation relative to rest, for the judge.
    pub truth: Option<Rotation<Base, Tip>>,
}

/// Something that moves when microsteps are counted.
pub trait World {
    /// What it is.
    fn nature(&self) -> &Nature;
    /// Holds the counts for one period and answers.
    ///
    /// # Errors
    /// [`WorldError`] when the other side is gone, silent or talks nonsense.
    fn step(&mut self, steps: &Steps) -> Result<Reply, WorldError>;
}

/// Why a world ended.
#[derive(Debug, Error)]
pub enum WorldError {
    /// The built-in plant cannot run with its parameters.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The program could not be started.
    #[error("plant `{program}` cannot be started: {source}; give --plant 'exec:PROGRAM ARG…' with a program on this machine")]
    Start {
        /// What was to be run.
        program: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A line that is not what the protocol says.
    #[error("plant said `{line}`: {problem}")]
    Malformed {
        /// The line, cut to a readable length.
        line: String,
        /// What is wrong with it and what was expected.
        problem: String,
    },
    /// End of file before its time.
    #[error("plant ended after `{last}`{status}; its own error output is above")]
    Died {
        /// The last good line.
        last: String,
        /// Exit status, if known.
        status: String,
    },
    /// Nothing came for too long.
    #[error("plant was silent for {seconds} s after `{last}`; it must answer every line of steps with one line")]
    Silent {
        /// How long was waited, s.
        seconds: f64,
        /// The last good line.
        last: String,
    },
}
