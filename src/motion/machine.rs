//! The interface to a machine: drivers, input lines, IMUs and alarms.
//!
//! ```text
//!  loop: wait until k·period ─▶ Machine::turn(now, wanted) ─▶ Sensed ─▶ supervisor ─▶ wanted ─┐
//!         ▲                                                                                   │
//!         └───────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! The loop owns the clock and passes the time as an argument. [`Machine::turn`] never sleeps, locks, allocates or waits
//! for a device: hardware reads its IMU and drives its pins in threads of its own, connected by wait-free rings. Expected
//! trouble is a value in [`Sensed`]; an error means that the machine cannot be used any more.
//!
//! The built-in plant, a foreign plant and the hardware all implement [`Machine`] and are interchangeable.

use crate::motion::{Drive, DriveState, Inputs, StepGenerator, StepperFault, StepperMode};
use crate::primitives::{Base, ImuReading, ImuSample, Rotation, Seconds, Steps, Tip};
use thiserror::Error;

/// What the machine reports in one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Sensed {
    /// Time of the cycle on the loop's clock.
    pub t: Seconds,
    /// Tip IMU: the newest sample that was not reported before, a failed transfer, or nothing.
    pub imu: ImuReading,
    /// Base IMU, if there is one.
    pub base_imu: Option<ImuSample>,
    /// Microsteps made since zero, signed.
    pub counted: Steps,
    /// Age of the counts, s: steps that have been due since then may be missing. The step thread may be late, and it reports
    /// at its own times; a report that is newer than `t` has a negative age.
    pub counted_age_s: f64,
    /// The drivers are energised.
    pub energised: bool,
    /// The input lines.
    pub inputs: Inputs,
    /// Alarm of the step generator, until [`Machine::clear`], or a limit of the gauges, while it is exceeded.
    pub alarm: Option<Alarm>,
    /// Pressure and temperature, for the status; what exceeds a limit is an alarm.
    pub gauges: Gauges,
    /// True tip orientation, if the machine is simulated. It serves scoring only; the loop never reads it.
    #[serde(skip)]
    pub truth: Option<Rotation<Base, Tip>>,
}

impl Sensed {
    /// What the drive reports at `t`, which is `t_ns` on the clock of the step generator, without any sample.
    pub fn of_drive<G: StepGenerator>(t: Seconds, t_ns: u64, drive: &Drive<G>) -> Self {
        let mut sensed = Self {
            t,
            energised: drive.generator().is_energised(),
            ..Self::default()
        };
        if let Some(report) = drive.generator().latest() {
            (sensed.counted, sensed.inputs) = (report.counted, report.inputs);
            // pistons that rest send few reports, and their counts stay true
            if matches!(report.mode, StepperMode::Following | StepperMode::Stopping) {
                sensed.counted_age_s = (t_ns as i64 - report.complete_ns as i64) as f64 * 1e-9;
            }
        }
        sensed.inputs.emergency_stop |= drive.stopped;
        sensed.alarm = match drive.state() {
            DriveState::Faulted(StepperFault::Late { late_ns, .. }) => {
                let late_s = late_ns as f64 * 1e-9;
                Some(Alarm::Late { late_s })
            }
            DriveState::Faulted(StepperFault::Discontinuity { jump_mm, .. }) => {
                Some(Alarm::Discontinuity { jump_mm })
            }
            DriveState::Faulted(StepperFault::Pins) => Some(Alarm::Pins),
            DriveState::Dead => Some(Alarm::Dead),
            DriveState::Silent => Some(Alarm::Silent),
            _ => drive.starved.then_some(Alarm::Underrun),
        };
        sensed
    }
}

/// Readings of the gauges that a machine has.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Gauges {
    /// Gauge pressure of each line, kPa; NaN while a sensor does not answer.
    pub pressure_kpa: Option<[f64; 3]>,
    /// Temperature of the tip, °C.
    pub tip_c: Option<f64>,
    /// The tip is warmer than the board file's `safety.tip_warm_c`.
    pub tip_warm: bool,
}

/// An alarm of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Error, serde::Serialize, serde::Deserialize)]
pub enum Alarm {
    /// A step was later than permitted.
    #[error("a step was {:.1} ms late", .late_s * 1e3)]
    Late {
        /// Delay, s.
        late_s: f64,
    },
    /// The motion queue ran empty during a motion, and the step generator braked.
    #[error("the step thread ran out of motion and braked")]
    Underrun,
    /// The queued motion is discontinuous.
    #[error("the motion handed to the step thread jumps by {jump_mm:.3} mm")]
    Discontinuity {
        /// Size of the jump, mm.
        jump_mm: f64,
    },
    /// The pins cannot be written or read.
    #[error("the pins cannot be written or read")]
    Pins,
    /// The step thread has ended.
    #[error("the step thread has ended")]
    Dead,
    /// The step thread does not report.
    #[error("the step thread does not report: a pin or the processor that it waits for hangs")]
    Silent,
    /// A pressure sensor measures too much.
    #[error("{}", pressure(*.kpa))]
    Pressure {
        /// Gauge pressure, kPa; NaN if the sensor does not answer.
        kpa: f64,
    },
    /// The tip is too hot.
    #[error("the tip is at {temp_c:.1} °C")]
    Hot {
        /// Temperature, °C.
        temp_c: f64,
    },
}

fn pressure(kpa: f64) -> String {
    if kpa.is_nan() {
        "a pressure sensor does not answer".to_owned()
    } else {
        format!("a line is at {kpa:.1} kPa")
    }
}

impl Alarm {
    /// True for an alarm of the step generator, false for a limit of the gauges.
    pub fn is_of_steps(&self) -> bool {
        !matches!(self, Self::Pressure { .. } | Self::Hot { .. })
    }
}

/// Properties of a machine.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct MachineInfo {
    /// Name, for reports.
    pub name: String,
    /// Period of a cycle, s.
    pub period_s: f64,
    /// Piston travel per microstep, mm.
    pub step_mm: f64,
    /// Bellow length at rest, mm.
    pub rest_length_mm: f64,
}

/// Why a machine cannot be used any more.
#[derive(Debug, Error)]
pub enum MachineError {
    /// The built-in plant cannot run with its parameters.
    #[error("{0}")]
    Plant(String),
    /// The program could not be started.
    #[error(
        "plant `{program}` cannot be started: {source}; give --plant 'exec:PROGRAM ARG…' with a program on this machine"
    )]
    Start {
        /// The program.
        program: String,
        /// Reason given by the operating system.
        source: std::io::Error,
    },
    /// A line violates the protocol.
    #[error("plant sent `{line}`: {problem}")]
    Malformed {
        /// The line, cut to a readable length.
        line: String,
        /// What is wrong, and what was expected.
        problem: String,
    },
    /// The plant ended unexpectedly.
    #[error("plant ended after `{last}`{status}; its own error output is above")]
    Died {
        /// The last valid line.
        last: String,
        /// Exit status, if known.
        status: String,
    },
    /// The plant did not respond in time.
    #[error(
        "plant was silent for {seconds} s after `{last}`; it must answer every line of steps with one line"
    )]
    Silent {
        /// Time waited, s.
        seconds: f64,
        /// The last valid line.
        last: String,
    },
}

/// A machine that moves the pistons and measures the tip.
pub trait Machine: Send {
    /// Properties of the machine.
    fn info(&self) -> &MachineInfo;

    /// One cycle at `now`, which is later than in the last cycle. Accepts the counts to be reached by the end of the
    /// coming period and returns what has arrived since the last cycle. Never blocks.
    ///
    /// # Errors
    /// [`MachineError`] if the machine cannot be used any more.
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError>;

    /// Switches the drivers on or off. It takes some cycles until [`Sensed::energised`] follows. The air may push the
    /// pistons of released drivers back.
    fn energise(&mut self, on: bool);

    /// The resting pistons stand at these counts, as remembered or as found at the home switches.
    fn recount(&mut self, counted: &Steps);

    /// Clears the latched [`Alarm`] if its cause has ended.
    fn clear(&mut self);

    /// True if time is simulated, so that the loop need not wait for the clock.
    fn is_simulated(&self) -> bool;

    /// Remarks for the status, one line each: devices, real-time privileges.
    fn remarks(&self) -> Vec<String>;
}
