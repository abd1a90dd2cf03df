//! Limits of a believable reading and what to do beyond them: the `[fuse.health]` table of a gains file.

use super::cause::HealthCause;
use serde::{Deserialize, Serialize};

/// What happens while a cause is in force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Policy {
    /// Leave the faulty sample out; the next good one is used at once.
    Skip,
    /// Integrate the gyroscope alone, at most this long; then hold as well.
    CoastOnGyro {
        /// How long the gyroscope may carry the attitude alone, seconds.
        for_s: f64,
    },
    /// Keep gyroscope and accelerometer, leave the magnetometer out.
    GravityOnly,
    /// Stop the pistons where they are until the sensor has recovered.
    Hold,
}

/// One policy for each cause, `cause = { do = "…" }`.
///
/// `do` is `skip`, `coast_on_gyro` (with `for_s`), `gravity_only` or `hold`. A milder policy keeps
/// the tip moving through a fault at the price of a larger attitude error; `hold` is always safe.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Policies {
    /// A transfer that was refused. Default `skip`: one lost sample costs one period of attitude.
    pub nack: Policy,
    /// A transfer that broke off. Default `skip`, as for `nack`.
    pub short_read: Policy,
    /// A bus on which nothing works. Default `hold`: there is no attitude to steer by.
    pub stuck_bus: Policy,
    /// A chip that is not the configured one. Default `hold`: its numbers mean something else.
    pub wrong_id: Policy,
    /// A chip that lost its settings. Default `hold` until it is set up again.
    pub brown_out: Policy,
    /// A chip that repeats itself. Default `hold`: a still picture of a moving tip is dangerous.
    pub frozen: Policy,
    /// A number that is none. Default `skip`; never let it reach a filter.
    pub not_finite: Policy,
    /// A single impossible sample. Default `skip`.
    pub spike: Policy,
    /// A gyroscope at its end stop. Default `hold`: rotation is lost for as long as it lasts.
    pub saturated: Policy,
    /// Samples that come late or not at all. Default `skip`; `blind_max_s` then holds.
    pub stale_timestamp: Policy,
    /// A clock that jumps. Default `skip`: the step would be integrated over a false time.
    pub jumping_timestamp: Policy,
    /// An overflowing magnetometer. Default `gravity_only`.
    pub mag_overflow: Policy,
    /// A magnetometer without news. Default `gravity_only`.
    pub mag_silent: Policy,
    /// A field that is not the earth's alone. Default `gravity_only`.
    pub field_disturbed: Policy,
    /// An accelerometer that feels more than gravity. Default `coast_on_gyro` for 5 s: a push or a
    /// knock passes, and within 5 s a corrected gyroscope drifts by well under a degree.
    pub accel_disturbed: Policy,
}

impl Default for Policies {
    fn default() -> Self {
        Self {
            nack: Policy::Skip,
            short_read: Policy::Skip,
            stuck_bus: Policy::Hold,
            wrong_id: Policy::Hold,
            brown_out: Policy::Hold,
            frozen: Policy::Hold,
            not_finite: Policy::Skip,
            spike: Policy::Skip,
            saturated: Policy::Hold,
            stale_timestamp: Policy::Skip,
            jumping_timestamp: Policy::Skip,
            mag_overflow: Policy::GravityOnly,
            mag_silent: Policy::GravityOnly,
            field_disturbed: Policy::GravityOnly,
            accel_disturbed: Policy::CoastOnGyro { for_s: 5.0 },
        }
    }
}

impl Policies {
    /// The policy for a cause.
    #[must_use]
    pub fn of(&self, cause: HealthCause) -> Policy {
        match cause {
            HealthCause::Nack => self.nack,
            HealthCause::ShortRead => self.short_read,
            HealthCause::StuckBus => self.stuck_bus,
            HealthCause::WrongId => self.wrong_id,
            HealthCause::BrownOut => self.brown_out,
            HealthCause::Frozen => self.frozen,
            HealthCause::NotFinite => self.not_finite,
            HealthCause::Spike => self.spike,
            HealthCause::Saturated => self.saturated,
            HealthCause::StaleTimestamp => self.stale_timestamp,
            HealthCause::JumpingTimestamp => self.jumping_timestamp,
            HealthCause::MagOverflow => self.mag_overflow,
            HealthCause::MagSilent => self.mag_silent,
            HealthCause::FieldDisturbed => self.field_disturbed,
            HealthCause::AccelDisturbed => self.accel_disturbed,
        }
    }
}

/// When a reading is believed. The limits are on SI values in the sensor frame, after calibration:
/// an uncorrected hard iron of up to 300 µT would drown every test of the field.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HealthConfig {
    /// Failed transfers in a row that make a stuck bus. Default 20 (40 ms at 500 Hz). A bigger value
    /// waits longer before the bus is declared dead and a recovery is tried.
    pub stuck_after: u32,

    /// Identical samples in a row that make a frozen sensor; 0 switches the test off. Default 25. Real
    /// converters are never this quiet; a plant without noise is (see [`super::Quality::expect_noise`]).
    /// A bigger value detects later.
    pub frozen_after: u32,

    /// Largest angular acceleration the tip can have, rad/s². Default 300: the pistons reach
    /// 120 °/s in about 10 ms at most. A faster change of rate is a spike. A bigger value lets
    /// smaller spikes through.
    pub angular_acceleration_max_rad_s2: f64,

    /// Jump of the rate that is always allowed, rad/s, above `angular_acceleration_max_rad_s2` times
    /// the sample period: noise and quantisation. Default 0.3.
    pub gyro_jump_allowed_rad_s: f64,

    /// Jump of the specific force between two samples that is always allowed, m/s². Default 15: a
    /// knock on the tip is not a spike but a disturbed accelerometer. A bigger value lets wild
    /// samples through to the norm test.
    pub acc_jump_allowed_m_s2: f64,

    /// Samples that agree with each other, though not with what came before, after which a jump is
    /// believed. Default 5. A bigger value skips longer after a true, violent motion.
    pub spike_confirm: u32,

    /// Share of the full scale, 0 to 1, from which a channel counts as saturated. Default 0.98.
    pub saturated_at: f64,

    /// Age from which a sample is stale, s; also the longest silence. Default 0.02, ten periods at
    /// 500 Hz. A bigger value tolerates a slower source.
    pub stale_after_s: f64,

    /// Longest time between two consecutive samples, s. Default 0.1. A bigger step is a jump of the
    /// clock, or a loop that stood still; either way one sample cannot bridge it.
    pub jump_max_s: f64,

    /// Longest time without a single usable gyroscope sample before the pistons are held, whatever
    /// the policies say, s. Default 0.05: at 120 °/s the tip turns 6° unseen. A bigger value rides
    /// through longer dropouts blindly.
    pub blind_max_s: f64,

    /// Whether a magnetometer is fitted and needed. Default true; false silences `mag_silent`.
    pub expect_mag: bool,

    /// Time without a new magnetometer value that counts as silence, s. Default 0.2, twenty periods
    /// at 100 Hz.
    pub mag_silent_after_s: f64,

    /// Allowed difference of the field's strength from the one at rest, as a share of it. Default
    /// 0.15. A bigger value trusts a bent field more: heading errors follow it.
    pub field_norm_tolerance: f64,

    /// Allowed difference of the field's dip from the one at rest, degrees. Default 10.
    pub field_dip_tolerance_deg: f64,

    /// Allowed difference of the specific force's norm from gravity, m/s². Default 1.0, which is a
    /// tilt error of 6° at worst. A bigger value trusts a shaken accelerometer more.
    pub acc_norm_tolerance_m_s2: f64,

    /// Time constant with which the remembered vertical follows the accelerometer, s. Default 5. It
    /// turns with the gyroscope and serves the dip test alone. A bigger value resists shaking better
    /// and a gyroscope bias worse.
    pub vertical_memory_s: f64,

    /// Good samples in a row after which a fault is over. Default 25 (50 ms at 500 Hz). A bigger
    /// value returns later but does not flap.
    pub recover_samples: u32,

    /// Good magnetometer values in a row after which a magnetic fault is over. Default 10 (0.1 s at
    /// 100 Hz). A field that is disturbed again within a minute takes twice as long each time. A bigger
    /// value leaves the field out for longer after a passing disturbance.
    pub recover_mag_samples: u32,

    /// Good accelerometer samples in a row after which a disturbance is over. Default 5. While the
    /// tip is shaken the norm passes through g time and again; a bigger value trusts fewer of these.
    pub recover_acc_samples: u32,

    /// What to do about each cause.
    pub policy: Policies,
}

impl Default for HealthConfig {
    fn default() -> Self {
        Self {
            stuck_after: 20,
            frozen_after: 25,
            angular_acceleration_max_rad_s2: 300.0,
            gyro_jump_allowed_rad_s: 0.3,
            acc_jump_allowed_m_s2: 15.0,
            spike_confirm: 5,
            saturated_at: 0.98,
            stale_after_s: 0.02,
            jump_max_s: 0.1,
            blind_max_s: 0.05,
            expect_mag: true,
            mag_silent_after_s: 0.2,
            field_norm_tolerance: 0.15,
            field_dip_tolerance_deg: 10.0,
            acc_norm_tolerance_m_s2: 1.0,
            vertical_memory_s: 5.0,
            recover_samples: 25,
            recover_mag_samples: 10,
            recover_acc_samples: 5,
            policy: Policies::default(),
        }
    }
}

/// A limit of the `[fuse.health]` table that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`fuse.health.{field}` = {value} is out of range: allowed is {allowed}; leave it out for the default")]
pub struct ConfigError {
    /// Name of the field.
    pub field: &'static str,
    /// What was written.
    pub value: f64,
    /// What may be written.
    pub allowed: &'static str,
}

/// A silence of fewer periods than this is no silence.
const PERIODS: f64 = 6.0;

impl HealthConfig {
    /// The limits for a source that samples every `imu_s`, its magnetometer every `mag_s` (s): times
    /// that are short against its periods are stretched.
    #[must_use]
    pub fn for_periods(&self, imu_s: f64, mag_s: Option<f64>) -> Self {
        let at_least = |value: f64, period: f64| value.max(PERIODS * period);
        Self {
            stale_after_s: at_least(self.stale_after_s, imu_s),
            jump_max_s: at_least(self.jump_max_s, imu_s),
            blind_max_s: at_least(self.blind_max_s, imu_s),
            mag_silent_after_s: at_least(self.mag_silent_after_s, mag_s.unwrap_or(0.0)),
            expect_mag: self.expect_mag && mag_s.is_some(),
            ..*self
        }
    }

    /// Checks every limit.
    ///
    /// # Errors
    /// The first field outside its range, with the range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let positive = [
            ("angular_acceleration_max_rad_s2", self.angular_acceleration_max_rad_s2),
            ("gyro_jump_allowed_rad_s", self.gyro_jump_allowed_rad_s),
            ("acc_jump_allowed_m_s2", self.acc_jump_allowed_m_s2),
            ("stale_after_s", self.stale_after_s),
            ("jump_max_s", self.jump_max_s),
            ("blind_max_s", self.blind_max_s),
            ("mag_silent_after_s", self.mag_silent_after_s),
            ("field_norm_tolerance", self.field_norm_tolerance),
            ("field_dip_tolerance_deg", self.field_dip_tolerance_deg),
            ("acc_norm_tolerance_m_s2", self.acc_norm_tolerance_m_s2),
            ("vertical_memory_s", self.vertical_memory_s),
        ];
        for (field, value) in positive {
            within(field, value, value > 0.0 && value.is_finite(), "a number above 0")?;
        }
        let counts = [
            ("stuck_after", self.stuck_after),
            ("spike_confirm", self.spike_confirm),
            ("recover_samples", self.recover_samples),
            ("recover_mag_samples", self.recover_mag_samples),
            ("recover_acc_samples", self.recover_acc_samples),
        ];
        for (field, value) in counts {
            within(field, f64::from(value), value > 0, "1 or more")?;
        }
        within("saturated_at", self.saturated_at, self.saturated_at > 0.5 && self.saturated_at <= 1.0, "0.5 to 1")?;
        for cause in HealthCause::ALL {
            if let Policy::CoastOnGyro { for_s } = self.policy.of(cause) {
                within("policy.….for_s", for_s, for_s > 0.0 && for_s <= 60.0, "above 0, at most 60 s")?;
            }
        }
        Ok(())
    }
}

fn within(field: &'static str, value: f64, ok: bool, allowed: &'static str) -> Result<(), ConfigError> {
    if ok { Ok(()) } else { Err(ConfigError { field, value, allowed }) }
}
