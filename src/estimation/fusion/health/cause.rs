//! The fifteen faults of a reading, and sets of them.
//!
//! A cause is named after its symptom, not after the defect: a loose plug, a short and a dead chip all appear as
//! [`HealthCause::Nack`].

use serde::{Deserialize, Serialize};

/// Why a reading, or a part of it, must not be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HealthCause {
    /// The chip did not acknowledge, or the transfer failed in another way.
    Nack,
    /// Fewer bytes arrived than were requested.
    ShortRead,
    /// Many transfers in a row failed: a line is held low or unplugged.
    StuckBus,
    /// Another chip than the configured one responds.
    WrongId,
    /// The chip lost its settings because its supply dipped.
    BrownOut,
    /// Identical samples in a row: the chip no longer converts.
    Frozen,
    /// A value is NaN or infinite.
    NotFinite,
    /// A jump that no motion of the tip can cause.
    Spike,
    /// The gyroscope is at the end of its range, so the true rate is unknown.
    Saturated,
    /// The sample is old or repeats the time of the previous one, or no sample arrives.
    StaleTimestamp,
    /// The time of the sample runs backwards, jumps ahead, or lies in the future.
    JumpingTimestamp,
    /// The magnetometer reports an overflow.
    MagOverflow,
    /// The magnetometer has delivered no new value for too long.
    MagSilent,
    /// Strength or dip of the field differ from the alignment.
    FieldDisturbed,
    /// The norm of the specific force differs from gravity.
    AccelDisturbed,
}

impl HealthCause {
    /// Every cause, in numerical order.
    pub const ALL: [Self; 15] = [
        Self::Nack,
        Self::ShortRead,
        Self::StuckBus,
        Self::WrongId,
        Self::BrownOut,
        Self::Frozen,
        Self::NotFinite,
        Self::Spike,
        Self::Saturated,
        Self::StaleTimestamp,
        Self::JumpingTimestamp,
        Self::MagOverflow,
        Self::MagSilent,
        Self::FieldDisturbed,
        Self::AccelDisturbed,
    ];

    /// Name in files and status lines.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Nack => "nack",
            Self::ShortRead => "short_read",
            Self::StuckBus => "stuck_bus",
            Self::WrongId => "wrong_id",
            Self::BrownOut => "brown_out",
            Self::Frozen => "frozen",
            Self::NotFinite => "not_finite",
            Self::Spike => "spike",
            Self::Saturated => "saturated",
            Self::StaleTimestamp => "stale_timestamp",
            Self::JumpingTimestamp => "jumping_timestamp",
            Self::MagOverflow => "mag_overflow",
            Self::MagSilent => "mag_silent",
            Self::FieldDisturbed => "field_disturbed",
            Self::AccelDisturbed => "accel_disturbed",
        }
    }

    /// Advice to the operator.
    #[must_use]
    pub fn advice(self) -> &'static str {
        match self {
            Self::Nack => "check plug, supply and pull-ups of the IMU cable; its length limit is 1.2 m at 400 kHz",
            Self::ShortRead => "the chip stopped in the middle of a transfer: check the cable for a loose contact",
            Self::StuckBus => "a line is held low: cycle the power of the IMU, then check the cable for a short circuit",
            Self::WrongId => "another part is fitted: set `imu.chip.part` and `imu.chip.address` to the part on the board",
            Self::BrownOut => "the supply of the IMU dipped: check the 3.3 V at the tip under motor load",
            Self::Frozen => "the chip responds but no longer converts: initialise it again or cycle its power",
            Self::NotFinite => "a value is NaN or infinite: check the plant or the log that supplies it",
            Self::Spike => "isolated implausible samples: shield the cable and route it away from the motor wires",
            Self::Saturated => "move more slowly or set a larger `imu.chip.gyro_range_dps`",
            Self::StaleTimestamp => "samples arrive late: check the bus speed and the load of the computer",
            Self::JumpingTimestamp => "the sample clock jumps: use one monotonic clock for all timestamps",
            Self::MagOverflow => "a strong magnet is near the tip: remove it",
            Self::MagSilent => "the magnetometer stopped: initialise the IMU again",
            Self::FieldDisturbed => "iron or a current is near the tip: until it is removed the heading depends on the gyroscope",
            Self::AccelDisturbed => "the tip is shaken or pushed: until it stops the tilt depends on the gyroscope",
        }
    }

    const fn bit(self) -> u16 {
        1 << self as u16
    }
}

impl std::fmt::Display for HealthCause {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A set of causes in one machine word.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct CauseSet(u16);

impl CauseSet {
    /// The empty set.
    pub const EMPTY: Self = Self(0);

    /// The set of one cause.
    #[must_use]
    pub const fn of(cause: HealthCause) -> Self {
        Self(cause.bit())
    }
    /// Adds a cause.
    pub const fn insert(&mut self, cause: HealthCause) {
        self.0 |= cause.bit();
    }
    /// True when the cause is in the set.
    #[must_use]
    pub const fn contains(self, cause: HealthCause) -> bool {
        self.0 & cause.bit() != 0
    }
    /// True when the set is empty.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
    /// The causes, in the order of [`HealthCause::ALL`].
    pub fn iter(self) -> impl Iterator<Item = HealthCause> {
        HealthCause::ALL.into_iter().filter(move |c| self.contains(*c))
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
