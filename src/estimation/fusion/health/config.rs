//! Limits of a plausible reading and the reaction to an implausible one: the `[fuse.health]` table of a gains file.

use super::cause::HealthCause;
use crate::parameters;
use crate::primitives::{Setting, Shape};
use serde::{Deserialize, Serialize};

/// Reaction while a cause is present.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Policy {
    /// Omit the faulty sample; the next good one is used at once.
    Skip,
    /// Integrate the gyroscope alone for a limited time, then hold.
    CoastOnGyro {
        /// Longest time without other sensors, s.
        for_s: f64,
    },
    /// Use gyroscope and accelerometer, omit the magnetometer.
    GravityOnly,
    /// Stop the pistons where they are until the sensor has recovered.
    Hold,
}

/// An inline table: `{ do = "coast_on_gyro", for_s = 5.0 }`.
impl Setting for Policy {
    const SHAPE: Shape = Shape::Scalar;
}

parameters! {
    /// Reaction to each cause while it is present: `skip` omits the sample, `gravity_only` omits the magnetometer,
    /// `coast_on_gyro` integrates the gyroscope alone for `for_s` seconds and then holds, `hold` stops the pistons. A milder
    /// policy keeps the tip moving at the price of a larger error; `hold` is always safe.
    pub struct Policies: Copy by HealthCause -> Policy {
        /// A transfer that was not acknowledged: one lost sample costs one period.
        nack of Nack: Policy = Policy::Skip;
        /// A transfer that ended early.
        short_read of ShortRead: Policy = Policy::Skip;
        /// A bus on which every transfer fails: there is no attitude to control with.
        stuck_bus of StuckBus: Policy = Policy::Hold;
        /// A chip that is not the configured one: its numbers have another meaning.
        wrong_id of WrongId: Policy = Policy::Hold;
        /// A chip that lost its settings; the pistons hold until it is set up again.
        brown_out of BrownOut: Policy = Policy::Hold;
        /// A chip that repeats its reading while the tip may move.
        frozen of Frozen: Policy = Policy::Hold;
        /// A value that is not a number. Whatever the policy, it never reaches a filter.
        not_finite of NotFinite: Policy = Policy::Skip;
        /// A single implausible sample.
        spike of Spike: Policy = Policy::Skip;
        /// A gyroscope at the end of its range: the rotation is unknown while it lasts.
        saturated of Saturated: Policy = Policy::Hold;
        /// Samples that come late or not at all; `blind_max_s` limits how long.
        stale_timestamp of StaleTimestamp: Policy = Policy::Skip;
        /// A clock that jumps: the sample would be integrated over a wrong time.
        jumping_timestamp of JumpingTimestamp: Policy = Policy::Skip;
        /// A magnetometer that overflows.
        mag_overflow of MagOverflow: Policy = Policy::GravityOnly;
        /// A magnetometer without new values.
        mag_silent of MagSilent: Policy = Policy::GravityOnly;
        /// A field that differs from the one at rest.
        field_disturbed of FieldDisturbed: Policy = Policy::GravityOnly;
        /// An accelerometer that measures more than gravity: a knock passes within 5 s, in which a corrected gyroscope drifts
        /// by less than a degree.
        accel_disturbed of AccelDisturbed: Policy = Policy::CoastOnGyro { for_s: 5.0 };
    }
}

parameters! {
    /// Plausibility of readings, and the reaction to implausible ones. The limits apply to SI values in the sensor frame
    /// after calibration: an uncorrected hard iron of up to 300 µT would hide every test of the field.
    pub struct HealthConfig: Copy {
        /// Consecutive failed transfers that count as a stuck bus; the default is 40 ms at 500 Hz. A larger value waits longer
        /// before a recovery is tried.
        stuck_after: u32 = 20, "", 1..=100_000, "20 is 40 ms at 500 Hz";
        /// Consecutive identical samples that count as a frozen sensor; 0 disables the test. Real converters are never this
        /// quiet. A larger value detects later.
        frozen_after: u32 = 25, "", 0..=100_000, "25 is 50 ms at 500 Hz; 0 disables the test";
        /// Largest angular acceleration of the tip; the pistons reach 120 °/s in about 10 ms. A faster change of rate is a
        /// spike. A larger value accepts smaller spikes.
        angular_acceleration_max_rad_s2: f64 = 300.0, "rad/s²", 0.001..=100_000.0, "300 is far above what the pistons reach";
        /// Change of rate between two samples that is always accepted: noise and quantisation. A larger value accepts small
        /// spikes at high sampling rates.
        gyro_jump_allowed_rad_s: f64 = 0.3, "rad/s", 0.001..=100_000.0, "0.3 is above noise and quantisation";
        /// Change of specific force between two samples that is always accepted: a knock on the tip is not a spike. A larger
        /// value leaves wild samples to the test of the norm.
        acc_jump_allowed_m_s2: f64 = 15.0, "m/s²", 0.001..=100_000.0, "15 is above a knock on the tip";
        /// Consecutive samples that agree with each other, though not with those before, after which a jump is accepted. A
        /// larger value omits more of a real, violent motion.
        spike_confirm: u32 = 5, "", 1..=100_000, "5 is 10 ms at 500 Hz";
        /// Fraction of full scale above which a channel counts as saturated. A larger value detects an end stop later.
        saturated_at: f64 = 0.98, "", 0.5..=1.0, "0.98 is just below the end stop";
        /// Age above which a sample is stale, and longest silence; at least six periods of the source. A larger value
        /// tolerates a slower source.
        stale_after_s: f64 = 0.02, "s", 0.001..=100_000.0, "0.02 is ten periods at 500 Hz";
        /// Longest time between two samples; at least six periods of the source. Beyond it the clock jumped or the loop
        /// stalled. A larger value integrates over longer gaps.
        jump_max_s: f64 = 0.1, "s", 0.001..=100_000.0, "0.1 is the longest gap that one sample can bridge";
        /// Longest time without a gyroscope sample before the pistons hold, whatever the policies are: at 120 °/s the tip
        /// turns by 6° in 0.05 s. A larger value continues through longer gaps without measurement.
        blind_max_s: f64 = 0.05, "s", 0.001..=100_000.0, "0.05 is 6° at 120 °/s";
        /// A magnetometer is fitted and needed. `false` disables `mag_silent`.
        expect_mag: bool = true;
        /// Time without a new magnetometer value that counts as silence. A larger value detects later.
        mag_silent_after_s: f64 = 0.2, "s", 0.001..=100_000.0, "0.2 is twenty periods at 100 Hz";
        /// Accepted difference of the field's strength from that at rest, as a fraction of it. A larger value accepts a
        /// distorted field, and heading errors follow it.
        field_norm_tolerance: f64 = 0.15, "", 0.001..=100_000.0, "0.15 is 7 µT of 48";
        /// Accepted difference of the field's dip from that at rest. A larger value accepts a distorted field, and heading
        /// errors follow it.
        field_dip_tolerance_deg: f64 = 10.0, "deg", 0.001..=100_000.0, "10 is as strict as field_norm_tolerance = 0.15";
        /// Accepted difference of the specific force's norm from gravity; 1 m/s² is a tilt of 6° at worst. A larger value
        /// accepts a shaken accelerometer.
        acc_norm_tolerance_m_s2: f64 = 1.0, "m/s²", 0.001..=100_000.0, "1 is a tilt of 6° at worst";
        /// Time constant with which the remembered vertical follows the accelerometer, for the test of the dip. A larger value
        /// resists shaking better and a gyroscope bias worse.
        vertical_memory_s: f64 = 5.0, "s", 0.001..=100_000.0, "5 outlasts a knock";
        /// Consecutive good samples after which a fault is over. A larger value recovers later and does not flap.
        recover_samples: u32 = 25, "", 1..=100_000, "25 is 50 ms at 500 Hz";
        /// Consecutive good magnetometer values after which a magnetic fault is over; twice as many each time it recurs within
        /// a minute. A larger value omits the field for longer.
        recover_mag_samples: u32 = 10, "", 1..=100_000, "10 is 0.1 s at 100 Hz";
        /// Consecutive good accelerometer samples after which a disturbance is over. While the tip is shaken the norm passes
        /// through g repeatedly; a larger value accepts fewer of these passes.
        recover_acc_samples: u32 = 5, "", 1..=100_000, "5 is 10 ms at 500 Hz";
        /// Reaction to each cause.
        policy: Policies;
    }
}

/// Periods of the source that a time limit covers at least: a shorter gap is ordinary jitter.
const PERIODS: f64 = 6.0;

impl HealthConfig {
    /// The limits for a source that samples every `imu_s` and its magnetometer every `mag_s` (s): times that are short
    /// against its periods are stretched.
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
}
