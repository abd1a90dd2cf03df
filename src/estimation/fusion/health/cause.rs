//! What can be wrong with a reading, as values: fifteen causes and a set of them in one word.
//!
//! A cause is named after what is seen, not after what broke: a loose plug, a short and a dead chip
//! all show as [`HealthCause::Nack`].

use serde::{Deserialize, Serialize};

/// Why a reading, or a part of it, is not to be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HealthCause {
    /// The chip did not acknowledge, or the transfer failed in another way.
    Nack,
    /// Fewer bytes came than were asked for.
    ShortRead,
    /// Every transfer of a long row failed: a line is held down or unplugged.
    StuckBus,
    /// Another chip than the configured one answers.
    WrongId,
    /// The chip lost its settings: its supply dipped.
    BrownOut,
    /// The very same counts came too often: the chip stopped converting.
    Frozen,
    /// A NaN or an infinity.
    NotFinite,
    /// A jump that no motion of the tip can make.
    Spike,
    /// The gyroscope is at the end of its range: the true rate is unknown.
    Saturated,
    /// The sample is old, or carries the time of the one before it, or none comes at all.
    StaleTimestamp,
    /// The sample's time runs backwards, leaps ahead, or lies in the future.
    JumpingTimestamp,
    /// The magnetometer reports an overflow.
    MagOverflow,
    /// The magnetometer has had nothing new for too long.
    MagSilent,
    /// The field's strength or dip is not the one found at rest.
    FieldDisturbed,
    /// The accelerometer measures more than gravity.
    AccelDisturbed,
}

impl HealthCause {
    /// Every cause, in the order of its number.
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

    /// Name as in files and status lines.
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

    /// What a person can do about it.
    #[must_use]
    pub fn advice(self) -> &'static str {
        match self {
            Self::Nack => "check plug, supply and pull-ups of the IMU cable; 1.2 m at 400 kHz is the limit",
            Self::ShortRead => "the chip fell silent in mid-transfer: look for a loose contact in the cable",
            Self::StuckBus => "a line is held low: power-cycle the IMU, then look for a short in the cable",
            Self::WrongId => "another part is fitted: set `imu.part` and `imu.address` to what is on the board",
            Self::BrownOut => "the IMU's supply dipped: check the 3.3 V at the tip under motor load",
            Self::Frozen => "the chip answers but no longer converts: re-initialise or power-cycle it",
            Self::NotFinite => "a number is no number: the plant or the log upstream is at fault",
            Self::Spike => "single wild samples: shield the cable and keep it off the motor wires",
            Self::Saturated => "turn more slowly or choose a wider `gyro_range_dps`",
            Self::StaleTimestamp => "samples come late: check the bus speed and the load of the machine",
            Self::JumpingTimestamp => "the sample clock jumps: use one monotonic clock for all stamps",
            Self::MagOverflow => "a strong magnet is near the tip: move it away",
            Self::MagSilent => "the magnetometer stopped: re-initialise the IMU",
            Self::FieldDisturbed => "iron or a current is near the tip: heading now rests on the gyroscope",
            Self::AccelDisturbed => "the tip is shaken or pushed: tilt now rests on the gyroscope",
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

/// A set of causes in one word: copied freely, allocates nothing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CauseSet(u16);

impl CauseSet {
    /// Nothing is wrong.
    pub const EMPTY: Self = Self(0);

    /// The set of one.
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
    /// True when nothing is wrong.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
    /// How many causes are in the set.
    #[must_use]
    pub const fn len(self) -> usize {
        self.0.count_ones() as usize
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
