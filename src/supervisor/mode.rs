//! The modes of the service and every way between them, as one table.
//!
//! ARCHITECTURE.md draws [`TABLE`] as a state diagram, and a test holds the drawing against it. The
//! mode changes through [`Modes::take`] alone, so what the table does not say does not happen.

use serde::{Deserialize, Serialize};

/// What the service is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Devices are being opened.
    Boot,
    /// Waiting for a still tip; the pistons stand.
    Aligning,
    /// Aligned, drivers off or about to be; nothing moves.
    Disarmed,
    /// Energised, the set-point rests.
    Holding,
    /// Energised, the set-point moves.
    Tracking,
    /// On the way back to rest, open loop and slowly.
    Relaxing,
    /// A calibration leads the set-point, open loop.
    Calibrating,
    /// The gate has tripped; it holds, relaxes or has released, as the board file says for the cause.
    Faulted,
    /// Restarted, and what is felt is not what was remembered: nothing moves before `zero` or `relax`.
    Lost,
}

impl Mode {
    /// Every mode.
    pub const ALL: [Self; 9] = [
        Self::Boot,
        Self::Aligning,
        Self::Disarmed,
        Self::Holding,
        Self::Tracking,
        Self::Relaxing,
        Self::Calibrating,
        Self::Faulted,
        Self::Lost,
    ];

    /// Name as in status lines and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Boot => "boot",
            Self::Aligning => "aligning",
            Self::Disarmed => "disarmed",
            Self::Holding => "holding",
            Self::Tracking => "tracking",
            Self::Relaxing => "relaxing",
            Self::Calibrating => "calibrating",
            Self::Faulted => "faulted",
            Self::Lost => "lost",
        }
    }

    /// The controller may move the pistons.
    #[must_use]
    pub fn moves(self) -> bool {
        matches!(self, Self::Holding | Self::Tracking | Self::Calibrating)
    }
}

impl std::fmt::Display for Mode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// What can change the mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Event {
    /// All devices answer.
    Opened,
    /// A still stretch was found; where the tip stood was proved, if there was anything to prove.
    Aligned,
    /// Where the pistons stand is not known: what is felt contradicts what was remembered, the drivers
    /// were released under pressure, or a way back without a known rest was stopped.
    Doubted,
    /// Command `arm`.
    Arm,
    /// Command `disarm`.
    Disarm,
    /// Command `bend`, or a streamed set-point.
    Bend,
    /// The set-point has arrived, or a calibration is over.
    Settled,
    /// Command `stop` or `hold`, or the dead-man of a stream.
    Stop,
    /// Command `relax`, or the end of the service.
    Relax,
    /// The pistons are back at zero.
    Rested,
    /// The pistons are back at zero, and the rest is not known any more.
    RestedUnaligned,
    /// Command `calibrate transmission`.
    Calibrate,
    /// Command `zero`.
    Zero,
    /// The gate has tripped.
    Trip,
    /// Command `reset-fault`, with the rest still known.
    Reset,
    /// Command `reset-fault`, with the rest not known.
    ResetUnaligned,
}

impl Event {
    /// Every event.
    pub const ALL: [Self; 16] = [
        Self::Opened,
        Self::Aligned,
        Self::Doubted,
        Self::Arm,
        Self::Disarm,
        Self::Bend,
        Self::Settled,
        Self::Stop,
        Self::Relax,
        Self::Rested,
        Self::RestedUnaligned,
        Self::Calibrate,
        Self::Zero,
        Self::Trip,
        Self::Reset,
        Self::ResetUnaligned,
    ];

    /// Name as in the drawing.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Opened => "opened",
            Self::Aligned => "aligned",
            Self::Doubted => "doubted",
            Self::Arm => "arm",
            Self::Disarm => "disarm",
            Self::Bend => "bend",
            Self::Settled => "settled",
            Self::Stop => "stop",
            Self::Relax => "relax",
            Self::Rested => "rested",
            Self::RestedUnaligned => "rested unaligned",
            Self::Calibrate => "calibrate",
            Self::Zero => "zero",
            Self::Trip => "trip",
            Self::Reset => "reset",
            Self::ResetUnaligned => "reset unaligned",
        }
    }
}

/// Every transition there is.
pub const TABLE: &[(Mode, Event, Mode)] = &[
    (Mode::Boot, Event::Opened, Mode::Aligning),
    (Mode::Aligning, Event::Aligned, Mode::Disarmed),
    (Mode::Aligning, Event::Doubted, Mode::Lost),
    (Mode::Aligning, Event::Trip, Mode::Faulted),
    (Mode::Disarmed, Event::Arm, Mode::Holding),
    (Mode::Disarmed, Event::Zero, Mode::Aligning),
    (Mode::Disarmed, Event::Relax, Mode::Relaxing),
    (Mode::Disarmed, Event::Trip, Mode::Faulted),
    (Mode::Holding, Event::Bend, Mode::Tracking),
    (Mode::Holding, Event::Disarm, Mode::Disarmed),
    (Mode::Holding, Event::Relax, Mode::Relaxing),
    (Mode::Holding, Event::Calibrate, Mode::Calibrating),
    (Mode::Holding, Event::Trip, Mode::Faulted),
    (Mode::Tracking, Event::Settled, Mode::Holding),
    (Mode::Tracking, Event::Stop, Mode::Holding),
    (Mode::Tracking, Event::Relax, Mode::Relaxing),
    (Mode::Tracking, Event::Trip, Mode::Faulted),
    (Mode::Calibrating, Event::Settled, Mode::Holding),
    (Mode::Calibrating, Event::Stop, Mode::Holding),
    (Mode::Calibrating, Event::Relax, Mode::Relaxing),
    (Mode::Calibrating, Event::Trip, Mode::Faulted),
    (Mode::Relaxing, Event::Rested, Mode::Disarmed),
    (Mode::Relaxing, Event::RestedUnaligned, Mode::Aligning),
    (Mode::Relaxing, Event::Stop, Mode::Holding),
    (Mode::Relaxing, Event::Doubted, Mode::Lost),
    (Mode::Relaxing, Event::Trip, Mode::Faulted),
    (Mode::Faulted, Event::Relax, Mode::Relaxing),
    (Mode::Faulted, Event::Reset, Mode::Disarmed),
    (Mode::Faulted, Event::ResetUnaligned, Mode::Aligning),
    (Mode::Faulted, Event::Doubted, Mode::Lost),
    (Mode::Lost, Event::Zero, Mode::Aligning),
    (Mode::Lost, Event::Relax, Mode::Relaxing),
    (Mode::Lost, Event::Trip, Mode::Faulted),
];

/// The mode, changed by the table alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Modes {
    now: Mode,
}

impl Default for Modes {
    fn default() -> Self {
        Self { now: Mode::Boot }
    }
}

impl Modes {
    /// The mode.
    #[must_use]
    pub fn now(&self) -> Mode {
        self.now
    }

    /// Where an event leads from here, if anywhere.
    #[must_use]
    pub fn leads(&self, event: Event) -> Option<Mode> {
        TABLE.iter().find(|(from, on, _)| *from == self.now && *on == event).map(|(_, _, to)| *to)
    }

    /// Takes an event; false when it means nothing in this mode.
    pub fn take(&mut self, event: Event) -> bool {
        match self.leads(event) {
            Some(to) => {
                self.now = to;
                true
            }
            None => false,
        }
    }
}
