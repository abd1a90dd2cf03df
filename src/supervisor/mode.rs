//! The modes of the service, and one table of all transitions.
//!
//! ARCHITECTURE.md shows [`TABLE`] as a state diagram; `tests/library/modes.rs` compares the two. The supervisor changes its mode
//! only through [`Mode::after`].

use crate::named;
use serde::{Deserialize, Serialize};

named! {
    /// What the service is doing.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Mode {
        /// The devices are being opened.
        Boot = "boot",
        /// Waits for a still tip to find the rest pose; the pistons stand.
        Aligning = "aligning",
        /// Aligned; the drivers accept no motion.
        Disarmed = "disarmed",
        /// Energised; the set-point rests.
        Holding = "holding",
        /// Energised; the set-point moves.
        Tracking = "tracking",
        /// Returns to rest, slowly and in open loop.
        Relaxing = "relaxing",
        /// A calibration moves the set-point in open loop.
        Calibrating = "calibrating",
        /// The gate has tripped. It holds, relaxes or has released the drivers, as the board file states for the cause.
        Faulted = "faulted",
        /// The position of the pistons is unknown; only `zero` ends it. `relax` returns by the remembered counts.
        Lost = "lost",
    }
}

impl Mode {
    /// True if the controller may move the pistons.
    pub fn moves(self) -> bool {
        matches!(self, Self::Holding | Self::Tracking | Self::Calibrating)
    }

    /// The mode that follows on `event`; `None` if the event has no effect in this mode.
    pub fn after(self, event: Event) -> Option<Self> {
        let row = TABLE.iter().find(|(on, ..)| *on == event);
        row.filter(|(_, from, _)| from.contains(&self))
            .map(|(.., to)| *to)
    }
}

named! {
    /// What can change the mode.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    pub enum Event {
        /// All devices respond.
        Opened = "opened",
        /// The rest pose was found, and the remembered pose, if any, agrees with it.
        Aligned = "aligned",
        /// The position of the pistons is unknown: the measured pose contradicts the remembered one, the drivers were released
        /// under pressure, or a return without a known rest pose was stopped.
        Doubted = "doubted",
        /// Command `arm`.
        Arm = "arm",
        /// Command `disarm`.
        Disarm = "disarm",
        /// Command `bend`, or a set-point of a stream.
        Bend = "bend",
        /// The set-point has arrived, or a calibration has ended.
        Settled = "settled",
        /// Command `stop`, or a stream that has fallen silent.
        Stop = "stop",
        /// Command `relax`, or the end of the service.
        Relax = "relax",
        /// The pistons are back at zero.
        Rested = "rested",
        /// The pistons are back at zero, and the rest pose is no longer known.
        RestedUnaligned = "rested unaligned",
        /// Command `calibrate transmission`.
        Calibrate = "calibrate",
        /// Command `zero`.
        Zero = "zero",
        /// The gate has tripped.
        Trip = "trip",
        /// Command `reset-fault` with a known rest pose.
        Reset = "reset",
        /// Command `reset-fault` without a known rest pose.
        ResetUnaligned = "reset unaligned",
    }
}

/// All transitions: each event with the modes in which it has an effect, and the mode that follows.
pub const TABLE: &[(Event, &[Mode], Mode)] = {
    use Mode::{Aligning, Boot, Calibrating, Disarmed, Faulted, Holding, Lost, Relaxing, Tracking};
    &[
        (Event::Opened, &[Boot], Aligning),
        (Event::Aligned, &[Aligning], Disarmed),
        (Event::Doubted, &[Aligning, Relaxing, Faulted], Lost),
        (Event::Arm, &[Disarmed], Holding),
        (Event::Disarm, &[Holding, Tracking, Calibrating], Disarmed),
        (Event::Bend, &[Holding], Tracking),
        (Event::Settled, &[Tracking, Calibrating], Holding),
        (Event::Stop, &[Tracking, Calibrating, Relaxing], Holding),
        (
            Event::Relax,
            &[Disarmed, Holding, Tracking, Calibrating, Faulted, Lost],
            Relaxing,
        ),
        (Event::Rested, &[Relaxing], Disarmed),
        (Event::RestedUnaligned, &[Relaxing], Aligning),
        (Event::Calibrate, &[Holding], Calibrating),
        (Event::Zero, &[Disarmed, Lost], Aligning),
        (
            Event::Trip,
            &[
                Aligning,
                Disarmed,
                Holding,
                Tracking,
                Calibrating,
                Relaxing,
                Lost,
            ],
            Faulted,
        ),
        (Event::Reset, &[Faulted], Disarmed),
        (Event::ResetUnaligned, &[Faulted], Aligning),
    ]
};
