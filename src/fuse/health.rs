//! May this reading be believed? A pure judge between the sensor and the filter.
//!
//! Each call takes one [`Reading`] (a sample, a failed transfer, or nothing), finds every [`Cause`]
//! that speaks against it, and answers with a [`Verdict`]: which of the three sensors the filter may
//! use now, and whether the pistons must be held. A cause stays *in force* until
//! [`Config::recover_samples`] good readings in a row have cleared it; while it recovers, good
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
//! the norm and the dip δ, sin δ = −m·a / (|m| |a|), that every later sample must show.
//! Time comes in with the reading; nothing here fetches it, allocates or locks.

mod cause;
mod config;
#[cfg(test)]
mod tests;

pub use cause::{Cause, CauseSet};
pub use config::{Config, ConfigError, Policies, Policy};

use crate::sample::ImuSample;
use crate::units::Seconds;
use nalgebra::Vector3;

/// How a transfer failed, as the sensor edge reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// Not acknowledged.
    Nack,
    /// Broke off early.
    ShortRead,
    /// The bus itself misbehaved: arbitration, timeout, a line held down.
    Bus,
    /// Another chip answers.
    WrongId,
    /// The chip is back at its defaults.
    BrownOut,
}

/// What is known of a sample besides its values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    /// Largest gyroscope count as a share of the full scale, 0 to 1; 0 if unknown.
    pub gyro_load: f64,
    /// Largest accelerometer count as a share of the full scale, 0 to 1; 0 if unknown.
    pub acc_load: f64,
    /// The magnetometer flagged an overflow.
    pub mag_overflow: bool,
    /// The source has noise, so identical samples mean a frozen sensor. True for chips; false for a
    /// plant or a log that may be noiseless.
    pub expect_noise: bool,
}

impl Default for Quality {
    fn default() -> Self {
        Self { gyro_load: 0.0, acc_load: 0.0, mag_overflow: false, expect_noise: true }
    }
}

/// What came from the sensor at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// A sample, in the sensor frame.
    Sample(ImuSample, Quality),
    /// The transfer failed.
    Failed(Fault),
    /// Nothing was due, or nothing came.
    Nothing,
}

/// One question to the judge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Time of asking, on the clock of the sample stamps, s.
    pub now: Seconds,
    /// What came.
    pub outcome: Outcome,
}

/// The earth's field and gravity as found at rest, for later comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldReference {
    /// |m|, µT.
    pub norm_ut: f64,
    /// Angle of the field below the horizontal, rad.
    pub dip_rad: f64,
    /// |a| of the still accelerometer, m/s².
    pub gravity_m_s2: f64,
}

impl FieldReference {
    /// From the means over a rest; `None` when either is zero or not finite.
    #[must_use]
    pub fn from_rest(acc_m_s2: &Vector3<f64>, mag_ut: &Vector3<f64>) -> Option<Self> {
        let dip_rad = dip(acc_m_s2, mag_ut)?;
        Some(Self { norm_ut: mag_ut.norm(), dip_rad, gravity_m_s2: acc_m_s2.norm() })
    }
}

/// Angle of `mag` below the plane across `acc`, rad; `None` for a zero or non-finite vector.
fn dip(acc: &Vector3<f64>, mag: &Vector3<f64>) -> Option<f64> {
    let norms = acc.norm() * mag.norm();
    (norms.is_finite() && norms > 1e-9).then(|| (-acc.dot(mag) / norms).clamp(-1.0, 1.0).asin())
}

/// The past of one cause.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Track {
    since: Option<f64>,
    good: u32,
    times: u32,
}

/// What the judge remembers. Fixed size; cloned for replay.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct State {
    tracks: [Track; Cause::ALL.len()],
    reference: Option<FieldReference>,
    seen: Option<ImuSample>,
    good: Option<ImuSample>,
    last_outcome_was_sample: bool,
    same: u32,
    agree: u32,
    bus_failures: u32,
    used_s: Option<f64>,
    mag_s: Option<f64>,
}

impl State {
    /// Sets what the field looks like when undisturbed; without it the field is not judged.
    pub fn set_reference(&mut self, reference: Option<FieldReference>) {
        self.reference = reference;
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
        for cause in Cause::ALL {
            if self.track(cause).since.is_some() {
                set.insert(cause);
            }
        }
        set
    }
    /// When a cause came into force, s; `None` while it is clear.
    #[must_use]
    pub fn since(&self, cause: Cause) -> Option<Seconds> {
        self.track(cause).since.map(Seconds)
    }
    /// How often a cause has come into force since the start.
    #[must_use]
    pub fn times(&self, cause: Cause) -> u32 {
        self.track(cause).times
    }

    fn track(&self, cause: Cause) -> &Track {
        &self.tracks[cause as usize]
    }
}

/// The harshest thing a verdict asks for, in rising order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Action {
    /// Use everything there is.
    Use,
    /// Gyroscope and accelerometer only.
    GravityOnly,
    /// Gyroscope only.
    CoastOnGyro,
    /// Nothing of this reading.
    Skip,
    /// Nothing may move.
    Hold,
}

/// A fault that is over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recovered {
    /// The causes that were cleared by this reading.
    pub causes: CauseSet,
    /// The longest any of them was in force, s.
    pub after_s: f64,
}

/// What may be done with one reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// The filter may integrate the gyroscope.
    pub gyro: bool,
    /// The filter may correct with the accelerometer.
    pub acc: bool,
    /// The filter may correct with the magnetometer (there is a new value and it is sound).
    pub mag: bool,
    /// The pistons must be held.
    pub hold: bool,
    /// No usable gyroscope sample for longer than [`Config::blind_max_s`].
    pub blind: bool,
    /// What is wrong with this very reading.
    pub faults: CauseSet,
    /// What is still counted against the sensor, recovering causes included.
    pub in_force: CauseSet,
    /// Causes that came into force with this reading.
    pub raised: CauseSet,
    /// Causes that this reading cleared, if any.
    pub recovered: Option<Recovered>,
}

impl Verdict {
    /// The verdict in one word.
    #[must_use]
    pub fn action(&self) -> Action {
        let shut_out = |c: &Cause| matches!(c, Cause::MagOverflow | Cause::MagSilent | Cause::FieldDisturbed);
        if self.hold {
            Action::Hold
        } else if !self.gyro {
            Action::Skip
        } else if !self.acc {
            Action::CoastOnGyro
        } else if !self.mag && self.in_force.iter().any(|c| shut_out(&c)) {
            Action::GravityOnly
        } else {
            Action::Use
        }
    }
}

/// The judge; it has no state of its own.
#[derive(Debug, Clone, Copy)]
pub struct Health;

impl Health {
    /// Judges one reading.
    pub fn judge(config: &Config, state: &mut State, reading: Reading) -> Verdict {
        let now = reading.now.0;
        let found = match reading.outcome {
            Outcome::Sample(sample, quality) => inspect(config, state, now, &sample, quality),
            Outcome::Failed(fault) => refused(config, state, fault),
            Outcome::Nothing => Found { faults: silence(config, state, now), ..Found::default() },
        };
        state.last_outcome_was_sample = matches!(reading.outcome, Outcome::Sample(..));
        let (raised, recovered) = count(config, state, now, found);
        decide(config, state, reading, found.faults, raised, recovered)
    }
}

/// What one reading shows: its faults, and the causes it could have shown.
#[derive(Debug, Clone, Copy, Default)]
struct Found {
    faults: CauseSet,
    tested: CauseSet,
}

impl Found {
    fn test(&mut self, cause: Cause, fault: bool) {
        self.tested.insert(cause);
        if fault {
            self.faults.insert(cause);
        }
    }
}

fn refused(config: &Config, state: &mut State, fault: Fault) -> Found {
    let mut found = Found::default();
    let cause = match fault {
        Fault::Nack | Fault::Bus => Cause::Nack,
        Fault::ShortRead => Cause::ShortRead,
        Fault::WrongId => Cause::WrongId,
        Fault::BrownOut => Cause::BrownOut,
    };
    found.faults.insert(cause);
    if matches!(fault, Fault::Nack | Fault::Bus | Fault::ShortRead) {
        state.bus_failures = state.bus_failures.saturating_add(1);
        if state.bus_failures >= config.stuck_after {
            found.faults.insert(Cause::StuckBus);
        }
    }
    found
}

fn silence(config: &Config, state: &State, now: f64) -> CauseSet {
    match &state.seen {
        Some(seen) if now - seen.t.0 > config.stale_after_s => CauseSet::of(Cause::StaleTimestamp),
        _ => CauseSet::EMPTY,
    }
}

fn inspect(config: &Config, state: &mut State, now: f64, sample: &ImuSample, quality: Quality) -> Found {
    let mut found = Found::default();
    state.bus_failures = 0;
    for cause in [Cause::Nack, Cause::ShortRead, Cause::StuckBus, Cause::WrongId, Cause::BrownOut] {
        found.test(cause, false);
    }
    found.test(Cause::NotFinite, !sample.is_finite() || !sample.t.0.is_finite());
    if found.faults.contains(Cause::NotFinite) {
        return found; // nothing can be said of the rest, and nothing of it may be remembered
    }
    clock(config, state, now, sample, &mut found);
    repetition(config, state, sample, quality, &mut found);
    found.test(Cause::Saturated, quality.gyro_load >= config.saturated_at);
    spike(config, state, sample, &mut found);
    let gravity = state.reference.map_or(9.81, |r| r.gravity_m_s2);
    let shaken = (sample.acc_m_s2.norm() - gravity).abs() > config.acc_norm_tolerance_m_s2;
    found.test(Cause::AccelDisturbed, shaken || quality.acc_load >= config.saturated_at);
    magnet(config, state, now, sample, quality, &mut found);
    state.seen = Some(*sample);
    found
}

fn clock(config: &Config, state: &State, now: f64, sample: &ImuSample, found: &mut Found) {
    let t = sample.t.0;
    let step = state.seen.map_or(f64::NAN, |seen| t - seen.t.0); // NaN: no fault for the first one
    found.test(Cause::StaleTimestamp, now - t > config.stale_after_s || step == 0.0);
    let leap = step > config.jump_max_s && state.last_outcome_was_sample;
    found.test(Cause::JumpingTimestamp, step < 0.0 || leap || t - now > config.jump_max_s);
}

fn repetition(config: &Config, state: &mut State, sample: &ImuSample, quality: Quality, found: &mut Found) {
    let same = state.seen.is_some_and(|s| s.gyro_rad_s == sample.gyro_rad_s && s.acc_m_s2 == sample.acc_m_s2);
    state.same = if same { state.same.saturating_add(1) } else { 0 };
    let armed = quality.expect_noise && config.frozen_after > 0;
    found.test(Cause::Frozen, armed && state.same >= config.frozen_after);
}

/// A jump is a spike unless [`Config::spike_confirm`] samples in a row agree on where it went.
fn spike(config: &Config, state: &mut State, sample: &ImuSample, found: &mut Found) {
    let near = |other: &Option<ImuSample>| other.as_ref().is_none_or(|o| reachable(config, o, sample));
    let mut wild = !near(&state.good);
    if wild {
        state.agree = if near(&state.seen) { state.agree + 1 } else { 0 };
        wild = state.agree < config.spike_confirm;
    }
    if !wild {
        state.agree = 0;
        state.good = Some(*sample);
    }
    found.test(Cause::Spike, wild);
}

fn reachable(config: &Config, from: &ImuSample, to: &ImuSample) -> bool {
    let dt = (to.t.0 - from.t.0).clamp(0.0, config.jump_max_s);
    let gyro_max = config.gyro_jump_allowed_rad_s + config.angular_acceleration_max_rad_s2 * dt;
    (to.gyro_rad_s - from.gyro_rad_s).norm() <= gyro_max
        && (to.acc_m_s2 - from.acc_m_s2).norm() <= config.acc_jump_allowed_m_s2
}

fn magnet(config: &Config, state: &mut State, now: f64, sample: &ImuSample, quality: Quality, found: &mut Found) {
    let since = *state.mag_s.get_or_insert(now);
    if quality.mag_overflow || sample.mag_ut.is_some() {
        found.test(Cause::MagOverflow, quality.mag_overflow);
        found.test(Cause::MagSilent, false);
        state.mag_s = Some(now);
    } else if config.expect_mag && now - since > config.mag_silent_after_s {
        found.test(Cause::MagSilent, true);
    }
    if let (Some(mag), Some(reference)) = (&sample.mag_ut, &state.reference) {
        let acc_ok = !found.faults.contains(Cause::AccelDisturbed);
        found.test(Cause::FieldDisturbed, bent(config, reference, &sample.acc_m_s2, mag, acc_ok));
    }
}

/// True when the field is not the one at rest; the dip counts only while the accelerometer is calm.
fn bent(config: &Config, reference: &FieldReference, acc: &Vector3<f64>, mag: &Vector3<f64>, acc_ok: bool) -> bool {
    let norm_off = (mag.norm() / reference.norm_ut - 1.0).abs() > config.field_norm_tolerance;
    let dip_max = config.field_dip_tolerance_deg.to_radians();
    let dip_off = dip(acc, mag).is_none_or(|d| (d - reference.dip_rad).abs() > dip_max);
    norm_off || (acc_ok && dip_off)
}

/// Moves every cause's track by one reading.
fn count(config: &Config, state: &mut State, now: f64, found: Found) -> (CauseSet, Option<Recovered>) {
    let (mut raised, mut cleared, mut after_s) = (CauseSet::EMPTY, CauseSet::EMPTY, 0.0_f64);
    for cause in Cause::ALL {
        let track = &mut state.tracks[cause as usize];
        if found.faults.contains(cause) {
            track.good = 0;
            if track.since.is_none() {
                track.since = Some(now);
                track.times = track.times.saturating_add(1);
                raised.insert(cause);
            }
        } else if let Some(since) = track.since
            && found.tested.contains(cause)
        {
            track.good += 1;
            if track.good >= needed(config, cause) {
                track.since = None;
                cleared.insert(cause);
                after_s = after_s.max(now - since);
            }
        }
    }
    (raised, (!cleared.is_empty()).then_some(Recovered { causes: cleared, after_s }))
}

fn needed(config: &Config, cause: Cause) -> u32 {
    match cause {
        Cause::MagOverflow | Cause::MagSilent | Cause::FieldDisturbed => config.recover_mag_samples,
        _ => config.recover_samples,
    }
}

fn decide(
    config: &Config,
    state: &mut State,
    reading: Reading,
    faults: CauseSet,
    raised: CauseSet,
    recovered: Option<Recovered>,
) -> Verdict {
    let now = reading.now.0;
    let sample = if let Outcome::Sample(sample, _) = reading.outcome { Some(sample) } else { None };
    let (mut gyro, mut acc, mut mag) =
        (sample.is_some(), sample.is_some(), sample.is_some_and(|s| s.mag_ut.is_some()));
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
    gyro &= !faults.contains(Cause::NotFinite); // whatever the policy says: it would poison the filter
    let used = *state.used_s.get_or_insert(now);
    let blind = !gyro && now - used > config.blind_max_s;
    if gyro {
        state.used_s = Some(now);
    }
    Verdict {
        gyro,
        acc: acc && gyro,
        mag: mag && gyro,
        hold: hold || blind,
        blind,
        faults,
        in_force,
        raised,
        recovered,
    }
}
