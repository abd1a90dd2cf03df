//! May this reading be believed? A pure judge between the sensor and the filter.
//!
//! Each call takes one [`TimedReading`] (a sample, a failed transfer, or nothing), finds every [`HealthCause`]
//! that speaks against it, and answers with a [`HealthVerdict`]: which of the three sensors the filter may
//! use now, and whether the pistons must be held. A cause stays *in force* until
//! [`HealthConfig::recover_samples`] good readings in a row have cleared it; while it recovers, good
//! samples are used again, so the filter is warm when the hold is lifted.
//!
//! ```text
//!            fault                      fault
//!   clear ───────────► in force ◄──────────────┐
//!     ▲                    │ good reading      │
//!     └────────────── recovering (1 … n) ──────┘
//!        n-th good one: Recovered { after_s }
//! ```
//!
//! Limits rest on physics: between two samples dt apart the rate can change by at most α_max·dt
//! (largest angular acceleration), and a still accelerometer reads |a| = g; the field at rest gives
//! the norm and the dip δ, sin δ = −m·u / (|m| |u|), that every later sample must show (u: up, carried
//! along by the gyroscope).
//! Time comes in with the reading; nothing here fetches it, allocates or locks.

mod cause;
mod config;
mod reading;
#[cfg(test)]
mod tests;
mod verdict;

pub use cause::{CauseSet, HealthCause};
pub use config::{ConfigError, HealthConfig, Policies, Policy};
pub use reading::{FieldReference, ImuReading, Quality, ReadFault, TimedReading};
pub use verdict::{HealthAction, HealthVerdict, Recovered};

use crate::primitives::sample::ImuSample;
use crate::primitives::units::Seconds;
use nalgebra::{Rotation3, Vector3};
use reading::dip;

/// The past of one cause.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Track {
    since: Option<f64>,
    good: u32,
    times: u32,
    /// When it was over last, s.
    over: Option<f64>,
    /// Returns in a row, each soon after it was over.
    returns: u32,
}

/// What the judge remembers. Fixed size; cloned for replay.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HealthState {
    tracks: [Track; HealthCause::ALL.len()],
    reference: Option<FieldReference>,
    gravity_m_s2: Option<f64>,
    seen: Option<ImuSample>,
    good: Option<ImuSample>,
    last_outcome_was_sample: bool,
    same: u32,
    agree: u32,
    bus_failures: u32,
    used_s: Option<f64>,
    mag_s: Option<f64>,
    up: Option<Vector3<f64>>,
    known: KnownErrors,
}

/// A disturbance that comes back within this time is the same one, s.
const RETURN_S: f64 = 60.0;
/// Returns after which the wait grows no longer: 2¹⁰ times ten values at 100 Hz are 100 s.
const RETURNS_MAX: u32 = 10;

/// What is known of the sensor's own errors, so that they are not taken for disturbances.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct KnownErrors {
    /// Estimated accelerometer bias, m/s²: taken off before the norm is judged.
    pub acc_bias_m_s2: Vector3<f64>,
    /// What the norm may be off by because that estimate is uncertain, m/s².
    pub acc_slack_m_s2: f64,
    /// Estimated field of the tip's own iron, µT: taken off before strength and dip are judged.
    pub iron_ut: Vector3<f64>,
    /// What the field may be off by because that estimate is uncertain, µT.
    pub iron_slack_ut: f64,
}

impl HealthState {
    /// Tells what the estimator has learnt of the sensor; `acc_rest` and `mag_rest` are the raw means
    /// of the rest, from which the references are taken anew.
    pub fn set_known(&mut self, known: KnownErrors, acc_rest: &Vector3<f64>, mag_rest: Option<&Vector3<f64>>) {
        let acc = acc_rest - known.acc_bias_m_s2;
        self.reference = mag_rest.and_then(|mag| FieldReference::from_rest(&acc, &(mag - known.iron_ut)));
        self.gravity_m_s2 = Some(acc.norm());
        self.known = known;
    }

    /// Sets what the field looks like when undisturbed; without it the field is not judged.
    pub fn set_reference(&mut self, reference: Option<FieldReference>) {
        self.reference = reference;
        self.gravity_m_s2 = reference.map(|r| r.gravity_m_s2);
    }
    /// The reference in use.
    #[must_use]
    pub fn reference(&self) -> Option<FieldReference> {
        self.reference
    }
    /// Causes that are in force now.
    #[must_use]
    pub fn in_force(&self) -> CauseSet {
        let mut set = CauseSet::EMPTY;
        for cause in HealthCause::ALL {
            if self.track(cause).since.is_some() {
                set.insert(cause);
            }
        }
        set
    }
    /// When a cause came into force, s; `None` while it is clear.
    #[must_use]
    pub fn since(&self, cause: HealthCause) -> Option<Seconds> {
        self.track(cause).since.map(Seconds)
    }
    /// How often a cause has come into force since the start.
    #[must_use]
    pub fn times(&self, cause: HealthCause) -> u32 {
        self.track(cause).times
    }

    fn track(&self, cause: HealthCause) -> &Track {
        &self.tracks[cause as usize]
    }
}

/// The judge; it has no state of its own.
#[derive(Debug, Clone, Copy)]
pub struct Health;

impl Health {
    /// Judges one reading.
    pub fn judge(config: &HealthConfig, state: &mut HealthState, reading: TimedReading) -> HealthVerdict {
        let now = reading.now.0;
        let found = match reading.outcome {
            ImuReading::Sample(sample, quality) => inspect(config, state, now, &sample, quality),
            ImuReading::Failed(fault) => refused(config, state, fault),
            ImuReading::Nothing => Found { faults: silence(config, state, now), ..Found::default() },
        };
        state.last_outcome_was_sample = matches!(reading.outcome, ImuReading::Sample(..));
        let (raised, recovered) = count(config, state, now, found);
        decide(config, state, reading, found, raised, recovered)
    }
}

/// What one reading shows: its faults, and the causes it could have shown.
#[derive(Debug, Clone, Copy, Default)]
struct Found {
    faults: CauseSet,
    tested: CauseSet,
    confirmed: bool,
}

impl Found {
    fn test(&mut self, cause: HealthCause, fault: bool) {
        self.tested.insert(cause);
        if fault {
            self.faults.insert(cause);
        }
    }
}

fn refused(config: &HealthConfig, state: &mut HealthState, fault: ReadFault) -> Found {
    let mut found = Found::default();
    let cause = match fault {
        ReadFault::Nack | ReadFault::Bus => HealthCause::Nack,
        ReadFault::ShortRead => HealthCause::ShortRead,
        ReadFault::WrongId => HealthCause::WrongId,
        ReadFault::BrownOut => HealthCause::BrownOut,
    };
    found.faults.insert(cause);
    if matches!(fault, ReadFault::Nack | ReadFault::Bus | ReadFault::ShortRead) {
        state.bus_failures = state.bus_failures.saturating_add(1);
        if state.bus_failures >= config.stuck_after {
            found.faults.insert(HealthCause::StuckBus);
        }
    }
    found
}

fn silence(config: &HealthConfig, state: &HealthState, now: f64) -> CauseSet {
    match &state.seen {
        Some(seen) if now - seen.t.0 > config.stale_after_s => CauseSet::of(HealthCause::StaleTimestamp),
        _ => CauseSet::EMPTY,
    }
}

fn inspect(config: &HealthConfig, state: &mut HealthState, now: f64, sample: &ImuSample, quality: Quality) -> Found {
    let mut found = Found::default();
    state.bus_failures = 0;
    for cause in [HealthCause::Nack, HealthCause::ShortRead, HealthCause::StuckBus, HealthCause::WrongId, HealthCause::BrownOut] {
        found.test(cause, false);
    }
    found.test(HealthCause::NotFinite, !sample.is_finite() || !sample.t.0.is_finite());
    if found.faults.contains(HealthCause::NotFinite) {
        return found; // nothing can be said of the rest, and nothing of it may be remembered
    }
    clock(config, state, now, sample, &mut found);
    repetition(config, state, sample, quality, &mut found);
    found.test(HealthCause::Saturated, quality.gyro_load >= config.saturated_at);
    spike(config, state, sample, &mut found);
    let gravity = state.gravity_m_s2.unwrap_or(9.81);
    let force = (sample.acc_m_s2 - state.known.acc_bias_m_s2).norm();
    let shaken = (force - gravity).abs() > config.acc_norm_tolerance_m_s2 + state.known.acc_slack_m_s2;
    found.test(HealthCause::AccelDisturbed, shaken || quality.acc_load >= config.saturated_at);
    let calm = !shaken && state.since(HealthCause::AccelDisturbed).is_none();
    if found.faults.contains(HealthCause::Spike) || found.faults.contains(HealthCause::Saturated) {
        state.up = None; // it may have turned by more than the gyroscope says
    }
    vertical(config, state, sample, calm);
    magnet(config, state, now, sample, quality, &mut found);
    state.seen = Some(*sample);
    found
}

fn clock(config: &HealthConfig, state: &HealthState, now: f64, sample: &ImuSample, found: &mut Found) {
    let t = sample.t.0;
    let step = state.seen.map_or(f64::NAN, |seen| t - seen.t.0); // NaN: no fault for the first one
    found.test(HealthCause::StaleTimestamp, now - t > config.stale_after_s || step == 0.0);
    let leap = step > config.jump_max_s && state.last_outcome_was_sample;
    found.test(HealthCause::JumpingTimestamp, step < 0.0 || leap || t - now > config.jump_max_s);
}

fn repetition(config: &HealthConfig, state: &mut HealthState, sample: &ImuSample, quality: Quality, found: &mut Found) {
    let same = state.seen.is_some_and(|s| s.gyro_rad_s == sample.gyro_rad_s && s.acc_m_s2 == sample.acc_m_s2);
    state.same = if same { state.same.saturating_add(1) } else { 0 };
    let armed = quality.expect_noise && config.frozen_after > 0;
    found.test(HealthCause::Frozen, armed && state.same >= config.frozen_after);
}

/// A jump is a spike unless [`HealthConfig::spike_confirm`] samples in a row agree on where it went.
fn spike(config: &HealthConfig, state: &mut HealthState, sample: &ImuSample, found: &mut Found) {
    let near = |other: &Option<ImuSample>| other.as_ref().is_none_or(|o| reachable(config, o, sample));
    let mut wild = !near(&state.good);
    if wild {
        state.agree = if near(&state.seen) { state.agree + 1 } else { 0 };
        wild = state.agree < config.spike_confirm;
        found.confirmed = !wild;
    }
    if !wild {
        state.agree = 0;
        state.good = Some(*sample);
    }
    found.test(HealthCause::Spike, wild);
}

fn reachable(config: &HealthConfig, from: &ImuSample, to: &ImuSample) -> bool {
    let dt = (to.t.0 - from.t.0).clamp(0.0, config.jump_max_s);
    let gyro_max = config.gyro_jump_allowed_rad_s + config.angular_acceleration_max_rad_s2 * dt;
    (to.gyro_rad_s - from.gyro_rad_s).norm() <= gyro_max && (to.acc_m_s2 - from.acc_m_s2).norm() <= config.acc_jump_allowed_m_s2
}

fn magnet(config: &HealthConfig, state: &mut HealthState, now: f64, sample: &ImuSample, quality: Quality, found: &mut Found) {
    let since = *state.mag_s.get_or_insert(now);
    if quality.mag_overflow || sample.mag_ut.is_some() {
        found.test(HealthCause::MagOverflow, quality.mag_overflow);
        found.test(HealthCause::MagSilent, false);
        state.mag_s = Some(now);
    } else if config.expect_mag && now - since > config.mag_silent_after_s {
        found.test(HealthCause::MagSilent, true);
    }
    if let (Some(mag), Some(reference)) = (&sample.mag_ut, &state.reference) {
        let field = mag - state.known.iron_ut;
        found.test(HealthCause::FieldDisturbed, bent(config, reference, state.up.as_ref(), &field, state.known.iron_slack_ut));
    }
}

/// Carries the vertical along with the gyroscope and draws it slowly to a calm accelerometer, so
/// that the dip can be judged while the tip is shaken.
fn vertical(config: &HealthConfig, state: &mut HealthState, sample: &ImuSample, calm: bool) {
    let dt = state.seen.map_or(0.0, |seen| sample.t.0 - seen.t.0);
    let bridged = (0.0..=config.jump_max_s).contains(&dt);
    state.up = match state.up.filter(|_| bridged) {
        Some(up) => {
            let turned = Rotation3::new(-sample.gyro_rad_s * dt) * up;
            let pull = if calm { (dt / config.vertical_memory_s).min(1.0) } else { 0.0 };
            Some(turned * (1.0 - pull) + sample.acc_m_s2 * pull)
        }
        None => calm.then_some(sample.acc_m_s2),
    };
}

/// True when the field is not the one at rest: its strength, or its dip where the vertical is known.
fn bent(config: &HealthConfig, reference: &FieldReference, up: Option<&Vector3<f64>>, field: &Vector3<f64>, slack_ut: f64) -> bool {
    let share = slack_ut / reference.norm_ut;
    let norm_off = (field.norm() / reference.norm_ut - 1.0).abs() > config.field_norm_tolerance + share;
    let dip_max = config.field_dip_tolerance_deg.to_radians() + share.min(1.0).asin();
    let off = |up| dip(up, field).is_none_or(|d| (d - reference.dip_rad).abs() > dip_max);
    norm_off || up.is_some_and(off)
}

/// Moves every cause's track by one reading.
fn count(config: &HealthConfig, state: &mut HealthState, now: f64, found: Found) -> (CauseSet, Option<Recovered>) {
    let (mut raised, mut cleared, mut after_s) = (CauseSet::EMPTY, CauseSet::EMPTY, 0.0_f64);
    for cause in HealthCause::ALL {
        let track = &mut state.tracks[cause as usize];
        if found.faults.contains(cause) {
            track.good = 0;
            if track.since.is_none() {
                track.since = Some(now);
                track.times = track.times.saturating_add(1);
                let soon = track.over.is_some_and(|over| now - over < RETURN_S);
                track.returns = if soon { track.returns.saturating_add(1) } else { 0 };
                raised.insert(cause);
            }
        } else if let Some(since) = track.since
            && found.tested.contains(cause)
        {
            track.good += 1;
            if track.good >= needed(config, cause, track.returns) {
                (track.since, track.over) = (None, Some(now));
                cleared.insert(cause);
                after_s = after_s.max(now - since);
            }
        }
    }
    (raised, (!cleared.is_empty()).then_some(Recovered { causes: cleared, after_s }))
}

/// Good readings that end a cause. A field that is disturbed time and again, as by motors that switch, looks
/// right now and then by chance: every return doubles what it takes to be believed.
fn needed(config: &HealthConfig, cause: HealthCause, returns: u32) -> u32 {
    match cause {
        HealthCause::FieldDisturbed => config.recover_mag_samples.saturating_mul(1 << returns.min(RETURNS_MAX)),
        HealthCause::MagOverflow | HealthCause::MagSilent => config.recover_mag_samples,
        HealthCause::AccelDisturbed => config.recover_acc_samples,
        _ => config.recover_samples,
    }
}

fn decide(
    config: &HealthConfig,
    state: &mut HealthState,
    reading: TimedReading,
    found: Found,
    raised: CauseSet,
    recovered: Option<Recovered>,
) -> HealthVerdict {
    let Found { faults, confirmed, .. } = found;
    let now = reading.now.0;
    let sample = if let ImuReading::Sample(sample, _) = reading.outcome { Some(sample) } else { None };
    let (mut gyro, mut acc, mut mag) = (sample.is_some(), sample.is_some(), sample.is_some_and(|s| s.mag_ut.is_some()));
    let mut hold = false;
    let in_force = state.in_force();
    for cause in in_force.iter() {
        let since = state.track(cause).since.unwrap_or(now);
        match config.policy.of(cause) {
            Policy::Skip => gyro &= !faults.contains(cause),
            Policy::GravityOnly => mag = false,
            Policy::CoastOnGyro { for_s } => {
                (acc, mag) = (false, false);
                hold |= now - since > for_s;
            }
            Policy::Hold => {
                hold = true;
                gyro &= !faults.contains(cause);
            }
        }
    }
    gyro &= !faults.contains(HealthCause::NotFinite); // whatever the policy says: it would poison the filter
    let used = *state.used_s.get_or_insert(now);
    let blind = !gyro && now - used > config.blind_max_s;
    if gyro {
        state.used_s = Some(now);
    }
    HealthVerdict { gyro, acc: acc && gyro, mag: mag && gyro, hold: hold || blind, blind, faults, in_force, raised, confirmed, recovered }
}
