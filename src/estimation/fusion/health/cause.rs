//! The fifteen faults of a reading, and sets of them.
//!
//! A cause is named after its symptom, not after the defect: a loose plug, a short and a dead chip all appear as
//! [`HealthCause::Nack`].

use crate::named;
use serde::{Deserialize, Serialize};

named! {
    /// Why a reading, or a part of it, must not be used: its name, and the advice to the operator.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum HealthCause {
        /// The chip did not acknowledge, or the transfer failed in another way.
        Nack = "nack":
            "check plug, supply and pull-ups of the IMU cable; its length limit is 1.2 m at 400 kHz",
        /// Fewer bytes arrived than were requested.
        ShortRead = "short_read":
            "the chip stopped in the middle of a transfer: check the cable for a loose contact",
        /// Many transfers in a row failed: a line is held low or unplugged.
        StuckBus = "stuck_bus":
            "a line is held low: cycle the power of the IMU, then check the cable for a short circuit",
        /// Another chip than the configured one responds.
        WrongId = "wrong_id":
            "another part is fitted: set `imu.chip.part` and `imu.chip.address` to the part on the board",
        /// The chip lost its settings because its supply dipped.
        BrownOut = "brown_out":
            "the supply of the IMU dipped: check the 3.3 V at the tip under motor load",
        /// Identical samples in a row: the chip no longer converts.
        Frozen = "frozen":
            "the chip responds but no longer converts, and is set up again: if that does not help, cycle its power",
        /// A value is NaN or infinite.
        NotFinite = "not_finite":
            "a value is NaN or infinite: check the plant or the log that supplies it",
        /// A jump that no motion of the tip can cause.
        Spike = "spike":
            "isolated implausible samples: shield the cable and route it away from the motor wires",
        /// The gyroscope is at the end of its range, so the true rate is unknown.
        Saturated = "saturated":
            "move more slowly or set a larger `imu.chip.gyro_range_dps`",
        /// The sample is old or repeats the time of the previous one, or no sample arrives.
        StaleTimestamp = "stale_timestamp":
            "samples arrive late: check the bus speed and the load of the computer",
        /// The time of the sample runs backwards, jumps ahead, or lies in the future.
        JumpingTimestamp = "jumping_timestamp":
            "the sample clock jumps: use one monotonic clock for all timestamps",
        /// The magnetometer reports an overflow.
        MagOverflow = "mag_overflow":
            "a strong magnet is near the tip: remove it",
        /// The magnetometer has delivered no new value for too long.
        MagSilent = "mag_silent":
            "the magnetometer stopped, and is set up again: if that does not help, cycle the power of the IMU",
        /// Strength or dip of the field differ from the alignment.
        FieldDisturbed = "field_disturbed":
            "iron or a current is near the tip: until it is removed the heading depends on the gyroscope",
        /// The norm of the specific force differs from gravity.
        AccelDisturbed = "accel_disturbed":
            "the tip is shaken or pushed: until it stops the tilt depends on the gyroscope",
    }
}

impl HealthCause {
    const fn bit(self) -> u16 {
        1 << self as u16
    }
}

/// A set of causes in one machine word.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct CauseSet(u16);

impl CauseSet {
    /// The empty set.
    pub const EMPTY: Self = Self(0);

    /// Adds a cause.
    pub const fn insert(&mut self, cause: HealthCause) {
        self.0 |= cause.bit();
    }
    /// True when the cause is in the set.
    pub const fn contains(self, cause: HealthCause) -> bool {
        self.0 & cause.bit() != 0
    }
    /// True when the set is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
    /// The causes, in the order of [`HealthCause::ALL`].
    pub fn iter(self) -> impl Iterator<Item = HealthCause> {
        HealthCause::ALL
            .into_iter()
            .filter(move |c| self.contains(*c))
    }
}

impl FromIterator<HealthCause> for CauseSet {
    fn from_iter<I: IntoIterator<Item = HealthCause>>(causes: I) -> Self {
        Self(causes.into_iter().fold(0, |set, cause| set | cause.bit()))
    }
}

impl std::fmt::Display for CauseSet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (i, cause) in self.iter().enumerate() {
            if i > 0 {
                f.write_str(", ")?;
            }
            f.write_str(cause.name())?;
        }
        Ok(())
    }
}
