//! Finds the faults of one reading, from its values and from the readings before it.

use super::cause::{CauseSet, HealthCause};
use super::config::HealthConfig;
use super::reading::{FieldShape, dip};
use super::repetition::Repetition;
use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::intake::GRAVITY_M_S2;
use crate::primitives::{ImuReading, ImuSample, Quality, ReadFault};
use nalgebra::{Rotation3, Vector3};

/// Estimated errors of the sensor, which are not disturbances.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct KnownErrors {
    /// Estimated accelerometer bias, m/s², subtracted before the norm is checked.
    pub acc_bias_m_s2: Vector3<f64>,
    /// Additional tolerance of the norm for the uncertainty of that estimate, m/s².
    pub acc_margin_m_s2: f64,
    /// Estimated field of the tip's own iron, µT, subtracted before strength and dip are checked.
    pub iron_ut: Vector3<f64>,
    /// Additional tolerance of the field for the uncertainty of that estimate, µT.
    pub iron_margin_ut: f64,
}

/// Result of the checks of one reading.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Findings {
    /// Causes found in this reading.
    pub faults: CauseSet,
    /// Causes that this reading could have shown.
    pub tested: CauseSet,
    /// The jumps rejected just before were true.
    pub confirmed: bool,
}

impl Findings {
    fn test(&mut self, cause: HealthCause, fault: bool) {
        self.tested.insert(cause);
        if fault {
            self.faults.insert(cause);
        }
    }
}

/// A sample under test.
struct Seen<'a> {
    config: &'a HealthConfig,
    /// Time of the test, s.
    now: f64,
    sample: &'a ImuSample,
    quality: &'a Quality,
}

/// What the checks remember of earlier readings.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Checks {
    reference: Option<FieldShape>,
    gravity_m_s2: Option<f64>,
    known: KnownErrors,
    /// Last finite sample.
    last: Option<ImuSample>,
    /// Last sample that was no spike.
    last_plausible: Option<ImuSample>,
    last_was_sample: bool,
    repetition: Repetition,
    /// Samples in a row that agree with each other after a jump.
    agreeing: u32,
    bus_failures: u32,
    /// Last magnetometer value, and the time of the last one that was new, s.
    last_mag_ut: Option<Vector3<f64>>,
    last_mag_s: Option<f64>,
    /// Specific force of the vertical in sensor axes, propagated by the gyroscope, m/s².
    up: Option<Vector3<f64>>,
}

impl Checks {
    /// Sets the estimated sensor errors; the references are recomputed from the raw means of the alignment.
    pub fn set_known(&mut self, known: KnownErrors, rest: &Alignment) {
        let acc = rest.acc_rest_m_s2 - known.acc_bias_m_s2;
        let mag = rest.mag_rest_ut.map(|mag| mag - known.iron_ut);
        self.reference = mag.and_then(|mag| FieldShape::from_rest(&acc, &mag));
        self.gravity_m_s2 = Some(acc.norm());
        self.known = known;
    }

    /// Checks one reading at time `now`, s; `shaken` is true while the accelerometer counts as disturbed.
    pub fn inspect(
        &mut self,
        config: &HealthConfig,
        now: f64,
        reading: &ImuReading,
        shaken: bool,
    ) -> Findings {
        let mut found = Findings::default();
        match reading {
            ImuReading::Sample(sample, quality) => {
                let seen = Seen {
                    config,
                    now,
                    sample,
                    quality,
                };
                self.inspect_sample(&seen, shaken, &mut found);
            }
            ImuReading::Failed(fault) => self.inspect_failure(config, *fault, &mut found.faults),
            ImuReading::Nothing => {
                let old = |last: &ImuSample| now - last.t.0 > config.stale_after_s;
                if self.last.as_ref().is_some_and(old) {
                    found.faults.insert(HealthCause::StaleTimestamp);
                }
            }
        }
        self.last_was_sample = reading.sample().is_some();
        found
    }

    fn inspect_failure(&mut self, config: &HealthConfig, fault: ReadFault, faults: &mut CauseSet) {
        let (cause, on_the_bus) = match fault {
            ReadFault::Nack | ReadFault::Bus => (HealthCause::Nack, true),
            ReadFault::ShortRead => (HealthCause::ShortRead, true),
            ReadFault::WrongId => (HealthCause::WrongId, false),
            ReadFault::BrownOut => (HealthCause::BrownOut, false),
        };
        faults.insert(cause);
        if on_the_bus {
            self.bus_failures = self.bus_failures.saturating_add(1);
            if self.bus_failures >= config.stuck_after {
                faults.insert(HealthCause::StuckBus);
            }
        }
    }

    fn inspect_sample(&mut self, seen: &Seen<'_>, shaken: bool, found: &mut Findings) {
        use HealthCause::{BrownOut, Nack, ShortRead, StuckBus, WrongId};
        let (config, sample, quality) = (seen.config, seen.sample, seen.quality);
        self.bus_failures = 0;
        for cause in [Nack, ShortRead, StuckBus, WrongId, BrownOut] {
            found.test(cause, false);
        }
        let finite = sample.is_finite() && sample.t.0.is_finite();
        found.test(HealthCause::NotFinite, !finite);
        if !finite {
            return; // no other check is meaningful, and the values must not be stored
        }
        self.check_clock(seen, found);
        let repeats = self.repetition.add(sample, config.frozen_after);
        let expected = quality.expect_noise && config.frozen_after > 0;
        found.test(HealthCause::Frozen, expected && repeats);
        let saturated = quality.gyro_load >= config.saturated_at;
        found.test(HealthCause::Saturated, saturated);
        self.check_spike(config, sample, found);
        let gravity = self.gravity_m_s2.unwrap_or(GRAVITY_M_S2);
        let force = (sample.acc_m_s2 - self.known.acc_bias_m_s2).norm();
        let disturbed =
            (force - gravity).abs() > config.acc_norm_tolerance_m_s2 + self.known.acc_margin_m_s2;
        let at_end = quality.acc_load >= config.saturated_at;
        found.test(HealthCause::AccelDisturbed, disturbed || at_end);
        if saturated || found.faults.contains(HealthCause::Spike) {
            self.up = None; // the gyroscope may have missed part of the rotation
        }
        self.propagate_vertical(config, sample, !disturbed && !shaken);
        self.check_magnetometer(seen, found);
        self.last = Some(*sample);
    }

    fn check_clock(&self, seen: &Seen<'_>, found: &mut Findings) {
        let (t, now, config) = (seen.sample.t.0, seen.now, seen.config);
        let step = self.last.map_or(f64::NAN, |last| t - last.t.0); // NaN: the first sample passes every comparison
        let old = now - t > config.stale_after_s;
        found.test(HealthCause::StaleTimestamp, old || step == 0.0);
        let ahead = step > config.jump_max_s && self.last_was_sample;
        let jumps = step < 0.0 || ahead || t - now > config.jump_max_s;
        found.test(HealthCause::JumpingTimestamp, jumps);
    }

    /// A jump is a spike unless [`HealthConfig::spike_confirm`] samples in a row agree on the new value. What was rejected is
    /// confirmed if the rate goes on from there: a tip that snaps slows down before that many samples.
    fn check_spike(&mut self, config: &HealthConfig, sample: &ImuSample, found: &mut Findings) {
        let near =
            |other: &Option<ImuSample>| other.as_ref().is_none_or(|o| reachable(config, o, sample));
        let mut spike = !near(&self.last_plausible);
        if spike {
            let one_more = self.agreeing + 1;
            self.agreeing = if near(&self.last) { one_more } else { 0 };
            spike = self.agreeing < config.spike_confirm;
        }
        if !spike {
            let off = |from: &Option<ImuSample>| {
                from.map_or(f64::INFINITY, |s| (sample.gyro_rad_s - s.gyro_rad_s).norm())
            };
            found.confirmed = off(&self.last) < off(&self.last_plausible);
            self.agreeing = 0;
            self.last_plausible = Some(*sample);
        }
        found.test(HealthCause::Spike, spike);
    }

    fn check_magnetometer(&mut self, seen: &Seen<'_>, found: &mut Findings) {
        let (config, now, sample, quality) = (seen.config, seen.now, seen.sample, seen.quality);
        let since = *self.last_mag_s.get_or_insert(now);
        // a field that repeats itself bit for bit was not measured again
        let repeats = quality.expect_noise && sample.mag_ut == self.last_mag_ut;
        self.last_mag_ut = sample.mag_ut.or(self.last_mag_ut);
        if quality.mag_overflow || sample.mag_ut.is_some() && !repeats {
            found.test(HealthCause::MagOverflow, quality.mag_overflow);
            found.test(HealthCause::MagSilent, false);
            self.last_mag_s = Some(now);
        } else if config.expect_mag && now - since > config.mag_silent_after_s {
            found.test(HealthCause::MagSilent, true);
        }
        if let (Some(mag), Some(reference)) = (&sample.mag_ut, &self.reference) {
            let (field, margin) = (mag - self.known.iron_ut, self.known.iron_margin_ut);
            let up = self.up.as_ref();
            let disturbed = field_disturbed(config, reference, up, &field, margin);
            found.test(HealthCause::FieldDisturbed, disturbed);
        }
    }

    /// Propagates the vertical with the gyroscope and corrects it slowly with a calm accelerometer, so that the dip
    /// can be checked while the tip is shaken.
    fn propagate_vertical(&mut self, config: &HealthConfig, sample: &ImuSample, calm: bool) {
        let dt = self.last.map_or(0.0, |last| sample.t.0 - last.t.0);
        let bridged = (0.0..=config.jump_max_s).contains(&dt);
        let share = (dt / config.vertical_memory_s).min(1.0);
        let gain = if calm { share } else { 0.0 };
        self.up = match self.up.filter(|_| bridged) {
            Some(up) => {
                let turned = Rotation3::new(-sample.gyro_rad_s * dt) * up;
                Some(turned * (1.0 - gain) + sample.acc_m_s2 * gain)
            }
            None => calm.then_some(sample.acc_m_s2),
        };
    }
}

fn reachable(config: &HealthConfig, from: &ImuSample, to: &ImuSample) -> bool {
    let dt = (to.t.0 - from.t.0).clamp(0.0, config.jump_max_s);
    let gyro_max = config.gyro_jump_allowed_rad_s + config.angular_acceleration_max_rad_s2 * dt;
    (to.gyro_rad_s - from.gyro_rad_s).norm() <= gyro_max
        && (to.acc_m_s2 - from.acc_m_s2).norm() <= config.acc_jump_allowed_m_s2
}

/// True if strength or dip of the field differ from the reference; without a vertical only the strength is checked.
pub(super) fn field_disturbed(
    config: &HealthConfig,
    reference: &FieldShape,
    up: Option<&Vector3<f64>>,
    field: &Vector3<f64>,
    margin_ut: f64,
) -> bool {
    let margin = margin_ut / reference.norm_ut;
    let strength_off =
        (field.norm() / reference.norm_ut - 1.0).abs() > config.field_norm_tolerance + margin;
    let dip_max = config.field_dip_tolerance_deg.to_radians() + margin.min(1.0).asin();
    let dip_off = |up| dip(up, field).is_none_or(|d| (d - reference.dip_rad).abs() > dip_max);
    strength_off || up.is_some_and(dip_off)
}
