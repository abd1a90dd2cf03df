//! Every cause is raised, every policy is applied, every recovery is timed, and clean noise raises no alarm.

mod disturbances;

use super::*;
use crate::estimation::fusion::align::Alignment;
use crate::primitives::{ImuReading, ImuSample, Parameters, Quality, ReadFault, Seconds};
use nalgebra::{Rotation3, Vector3};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};

const DT: f64 = 0.002;

/// A still tip with the noise of the datasheet at 500 Hz, magnetometer at 100 Hz.
struct Source {
    rng: StdRng,
    n: u32,
    rate: Vector3<f64>,
    acc: Vector3<f64>,
    mag: Vector3<f64>,
}

impl Source {
    fn new(seed: u64) -> Self {
        let (acc, mag) = (Vector3::new(0.0, 0.0, 9.81), Vector3::new(20.0, 0.0, -45.0));
        Self {
            rng: StdRng::seed_from_u64(seed),
            n: 0,
            rate: Vector3::zeros(),
            acc,
            mag,
        }
    }
    fn noise(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| {
            sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut self.rng)
        })
    }
    fn now(&self) -> f64 {
        f64::from(self.n) * DT
    }
    fn next(&mut self) -> ImuSample {
        self.n += 1;
        let mag = self.n.is_multiple_of(5).then(|| self.mag + self.noise(0.5));
        let gyro_rad_s = self.rate + self.noise(0.004);
        let acc_m_s2 = self.acc + self.noise(0.03);
        ImuSample {
            t: Seconds(self.now()),
            gyro_rad_s,
            acc_m_s2,
            mag_ut: mag,
        }
    }
}

struct Rig {
    config: HealthConfig,
    monitor: SensorMonitor,
    source: Source,
    /// Every cause that has come into force, in order.
    raised: Vec<HealthCause>,
}

/// An alignment with these means.
fn at_rest(acc_rest_m_s2: Vector3<f64>, mag_ut: Vector3<f64>) -> Alignment {
    Alignment {
        acc_rest_m_s2,
        mag_rest_ut: Some(mag_ut),
        ..Alignment::default()
    }
}

impl Rig {
    fn new() -> Self {
        let mut monitor = SensorMonitor::default();
        let source = Source::new(7);
        monitor.set_known(KnownErrors::default(), &at_rest(source.acc, source.mag));
        Self {
            config: HealthConfig::default(),
            monitor,
            source,
            raised: Vec::new(),
        }
    }
    fn put(&mut self, reading: ImuReading) -> HealthVerdict {
        let now = Seconds(self.source.now());
        let verdict = self.monitor.assess(&self.config, now, &reading);
        self.raised.extend(verdict.raised.iter());
        verdict
    }
    fn good(&mut self) -> HealthVerdict {
        let sample = self.source.next();
        self.put(ImuReading::Sample(sample, Quality::default()))
    }
    fn settle(&mut self) {
        for _ in 0..200 {
            assert_eq!(self.good().faults, CauseSet::EMPTY);
        }
    }
    fn fail(&mut self, fault: ReadFault) -> HealthVerdict {
        self.source.n += 1;
        self.put(ImuReading::Failed(fault))
    }
    fn with(&mut self, change: impl FnOnce(&mut ImuSample, &mut Quality)) -> HealthVerdict {
        let (mut sample, mut quality) = (self.source.next(), Quality::default());
        change(&mut sample, &mut quality);
        self.put(ImuReading::Sample(sample, quality))
    }
    /// Good readings until `cause` recovers; returns how many it took.
    fn until_recovered(&mut self, cause: HealthCause) -> u32 {
        let n = (1..1000).find(|_| self.good().recovered.contains(cause));
        n.unwrap_or_else(|| panic!("{cause} did not recover"))
    }
    /// How often a cause has come into force.
    fn times(&self, cause: HealthCause) -> usize {
        self.raised.iter().filter(|c| **c == cause).count()
    }
}

#[test]
fn clean_noise_raises_nothing_in_a_minute() {
    let mut b = Rig::new();
    for _ in 0..30_000 {
        let v = b.good();
        assert!(v.in_force.is_empty(), "false alarm: {}", v.in_force);
        assert_eq!(v.action(), HealthAction::Use);
    }
}

#[test]
fn fast_motion_is_not_a_spike() {
    let mut b = Rig::new();
    b.settle();
    for k in 0..2000 {
        // 120 deg/s at 8 Hz: 105 rad/s² at the steepest
        b.source.rate.x = 2.1 * (f64::from(k) * DT * 50.0).sin();
        assert!(!b.good().faults.contains(HealthCause::Spike));
    }
}

#[test]
fn nacks_are_skipped_then_blind_then_a_stuck_bus() {
    let mut b = Rig::new();
    b.settle();
    let first = b.fail(ReadFault::Nack);
    assert!(first.raised.contains(HealthCause::Nack) && first.action() == HealthAction::Skip);
    let mut blind_after = None;
    for n in 2..=40_u32 {
        let v = b.fail(ReadFault::Nack);
        if v.blind && blind_after.is_none() {
            blind_after = Some(f64::from(n) * DT);
        }
        assert_eq!(
            v.faults.contains(HealthCause::StuckBus),
            n >= b.config.stuck_after,
            "{n}"
        );
        assert_eq!(v.hold, n >= b.config.stuck_after || v.blind);
    }
    let blind_after = blind_after.expect("40 periods without a sample must be blind");
    assert!(blind_after > 0.05 && blind_after < 0.056, "{blind_after}");
    let n = b.until_recovered(HealthCause::StuckBus);
    assert_eq!(n, b.config.recover_samples);
    assert!(b.good().in_force.is_empty());
    assert_eq!(b.times(HealthCause::StuckBus), 1);
}

#[test]
fn samples_are_used_while_a_hold_recovers() {
    let mut b = Rig::new();
    b.settle();
    assert!(b.fail(ReadFault::BrownOut).hold);
    let v = b.good();
    assert!(
        v.hold
            && v.gyro
            && v.acc
            && v.faults.is_empty()
            && v.in_force.contains(HealthCause::BrownOut)
    );
    assert_eq!(
        b.until_recovered(HealthCause::BrownOut),
        b.config.recover_samples - 1
    );
    assert!(!b.good().hold);
}

#[test]
fn a_fault_during_recovery_restarts_the_count() {
    let mut b = Rig::new();
    b.settle();
    b.fail(ReadFault::WrongId);
    for _ in 0..b.config.recover_samples - 1 {
        assert!(b.good().recovered.is_empty());
    }
    b.fail(ReadFault::WrongId);
    assert_eq!(
        b.until_recovered(HealthCause::WrongId),
        b.config.recover_samples
    );
    assert_eq!(
        b.times(HealthCause::WrongId),
        1,
        "the cause stayed in force"
    );
}

#[test]
fn a_frozen_sensor_is_found_only_if_noise_is_expected() {
    for expect_noise in [true, false] {
        let mut b = Rig::new();
        b.settle();
        let still = b.source.next();
        let mut found_at = None;
        for n in 0..60 {
            let v = b.with(|s, q| {
                (s.gyro_rad_s, s.acc_m_s2) = (still.gyro_rad_s, still.acc_m_s2);
                q.expect_noise = expect_noise;
            });
            if v.faults.contains(HealthCause::Frozen) && found_at.is_none() {
                assert!(v.hold && !v.gyro);
                found_at = Some(n);
            }
        }
        assert_eq!(found_at, expect_noise.then_some(b.config.frozen_after));
    }
}

/// A drawn axis repeats its value from a drawn moment on, in parts whose resolution is fine or coarse.
#[test]
fn one_frozen_axis_is_found_and_quiet_parts_are_not() {
    let coarse = |v: &Vector3<f64>, step: f64| v.map(|x| (x / step).round() * step);
    for axis in 0..6 {
        let mut b = Rig::new();
        // a resolution of 1.5 standard deviations repeats a value every other time
        let step = if axis % 2 == 0 { 1e-4 } else { 1.5 };
        let (mut held, mut found_after) = (None, None);
        for n in 0..30_000 {
            let v = b.with(|s, q| {
                s.gyro_rad_s = coarse(&s.gyro_rad_s, 0.004 * step);
                s.acc_m_s2 = coarse(&s.acc_m_s2, 0.03 * step);
                // as of a simulated plant
                (s.gyro_rad_s[2], q.expect_noise) =
                    (if axis == 2 { s.gyro_rad_s[2] } else { 0.0 }, true);
                if n >= 20_000 + 77 * axis {
                    let value = match axis {
                        0..3 => &mut s.gyro_rad_s[axis],
                        _ => &mut s.acc_m_s2[axis - 3],
                    };
                    *value = *held.get_or_insert(*value);
                }
            });
            if v.faults.contains(HealthCause::Frozen) {
                assert!(v.hold && !v.gyro);
                found_after.get_or_insert(n - (20_000 + 77 * axis));
            }
        }
        let most = 2 * b.config.frozen_after as usize + 20;
        assert!(
            found_after.is_some_and(|n| n <= most),
            "axis {axis}: {found_after:?}"
        );
    }
}

#[test]
fn a_frozen_magnetometer_is_silent() {
    let mut b = Rig::new();
    b.settle();
    let held = Vector3::new(20.1, -0.3, -45.2);
    let mut found = false;
    for _ in 0..2000 {
        let v = b.with(|s, _| s.mag_ut = s.mag_ut.map(|_| held));
        found |= v.faults.contains(HealthCause::MagSilent);
    }
    assert!(found);
}

#[test]
fn nan_reaches_neither_the_filter_nor_the_monitor() {
    let mut b = Rig::new();
    b.config.policy.not_finite = Policy::GravityOnly; // a policy that would pass the sample
    b.settle();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let v = b.with(|s, _| s.acc_m_s2.y = bad);
        assert!(v.faults.contains(HealthCause::NotFinite) && !v.gyro && !v.acc && !v.mag);
        let v = b.with(|s, _| s.mag_ut = Some(Vector3::repeat(bad)));
        assert!(!v.gyro);
    }
    assert!(b.good().gyro);
    assert_eq!(b.monitor, b.monitor.clone(), "the monitor stored a NaN");
}

#[test]
fn a_spike_is_skipped_and_a_true_step_is_accepted() {
    let mut b = Rig::new();
    b.settle();
    let v = b.with(|s, _| s.gyro_rad_s.z += 6.0);
    assert!(v.faults.contains(HealthCause::Spike) && v.action() == HealthAction::Skip);
    assert!(b.good().gyro, "the next good sample is used at once");
    let v = b.with(|s, _| s.acc_m_s2.x -= 30.0);
    assert!(v.faults.contains(HealthCause::Spike));
    b.settle_again();
    let skipped = (0..20)
        .filter(|_| {
            b.with(|s, _| s.gyro_rad_s.z += 6.0)
                .faults
                .contains(HealthCause::Spike)
        })
        .count();
    // the allowed change grows with the time since the last plausible sample: at most `spike_confirm` are skipped
    assert!(
        (1..=b.config.spike_confirm as usize).contains(&skipped),
        "{skipped}"
    );
}

#[test]
fn a_snap_that_decays_confirms_what_was_rejected_and_a_spike_does_not() {
    let mut b = Rig::new();
    b.settle();
    let decaying = |k: i32| 1.4 * (-f64::from(k) * DT / 0.025).exp();
    let seen: Vec<_> = (0..40)
        .map(|k| b.with(|s, _| s.gyro_rad_s.z += decaying(k)))
        .collect();
    let skipped = seen
        .iter()
        .take_while(|v| v.faults.contains(HealthCause::Spike))
        .count();
    assert!(
        (1..5).contains(&skipped) && seen[skipped].confirmed,
        "{skipped}"
    );
    assert_eq!(seen.iter().filter(|v| v.confirmed).count(), 1);
    b.settle_again();
    assert!(
        b.with(|s, _| s.gyro_rad_s.z += 1.4)
            .faults
            .contains(HealthCause::Spike)
    );
    assert!(!b.good().confirmed, "the rate is back at once");
}

impl Rig {
    fn settle_again(&mut self) {
        for _ in 0..100 {
            self.good();
        }
    }
}

#[test]
fn saturation_holds_the_pistons() {
    let mut b = Rig::new();
    b.settle();
    assert!(b.with(|_, q| q.gyro_load = 0.979).faults.is_empty());
    let v = b.with(|_, q| q.gyro_load = 0.98);
    assert!(v.faults.contains(HealthCause::Saturated) && v.hold && !v.gyro);
    assert!(
        b.with(|_, q| q.acc_load = 1.0)
            .faults
            .contains(HealthCause::AccelDisturbed)
    );
}

#[test]
fn invalid_timestamps_are_detected() {
    let mut b = Rig::new();
    b.settle();
    let t = b.source.now();
    assert!(
        b.with(|s, _| s.t = Seconds(t))
            .faults
            .contains(HealthCause::StaleTimestamp),
        "repeated timestamp"
    );
    b.good();
    assert!(
        b.with(|s, _| s.t.0 -= 0.03)
            .faults
            .contains(HealthCause::StaleTimestamp),
        "old timestamp"
    );
    assert!(b.good().faults.is_empty());
    let back = b.with(|s, _| s.t.0 -= 0.01);
    assert!(back.faults.contains(HealthCause::JumpingTimestamp) && !back.gyro);
    b.good();
    assert!(
        b.with(|s, _| s.t.0 += 0.5)
            .faults
            .contains(HealthCause::JumpingTimestamp),
        "timestamp in the future"
    );
    b.settle_again();
    b.source.n += 100; // the loop paused for 0.2 s
    assert!(
        b.good().faults.contains(HealthCause::JumpingTimestamp),
        "jump ahead"
    );
    b.settle_again();
    for _ in 0..30 {
        b.fail(ReadFault::Nack);
    }
    b.source.n += 100;
    assert!(
        !b.good().faults.contains(HealthCause::JumpingTimestamp),
        "a gap after failed transfers is no jump"
    );
}

#[test]
fn silence_becomes_stale_then_blind() {
    let mut b = Rig::new();
    b.settle();
    for n in 1..=40 {
        b.source.n += 1;
        let v = b.put(ImuReading::Nothing);
        let silent_s = f64::from(n) * DT;
        if (silent_s - 0.02).abs() > 1e-6 && (silent_s - 0.05).abs() > 1e-6 {
            assert_eq!(
                v.faults.contains(HealthCause::StaleTimestamp),
                silent_s > 0.02
            );
            assert_eq!(v.blind, silent_s > 0.05, "{silent_s}");
        }
    }
    assert!(b.good().gyro);
    assert_eq!(
        b.until_recovered(HealthCause::StaleTimestamp),
        b.config.recover_samples - 1
    );
}

#[test]
fn policies_are_parsed_and_invalid_limits_are_named() {
    let text = "frozen_after = 0\n[policy]\nspike = { do = \"hold\" }\nnack = { do = \"coast_on_gyro\", for_s = 0.5 }\n";
    let c: HealthConfig = toml::from_str(text).expect("valid");
    assert_eq!(
        (c.policy.spike, c.policy.nack),
        (Policy::Hold, Policy::CoastOnGyro { for_s: 0.5 })
    );
    c.checked("fuse.health").expect("sound");
    assert!(
        toml::from_str::<HealthConfig>("blind_maxs = 1").is_err(),
        "a typo is an error"
    );
    let bad = HealthConfig {
        saturated_at: 98.0,
        ..HealthConfig::default()
    };
    assert_eq!(
        bad.checked("fuse.health").unwrap_err().key,
        "fuse.health.saturated_at"
    );
    let back: HealthConfig =
        toml::from_str(&toml::to_string(&HealthConfig::default()).expect("serialises"))
            .expect("reads back");
    assert_eq!(back, HealthConfig::default());
}

#[test]
fn names_match_serde() {
    for (i, c) in HealthCause::ALL.into_iter().enumerate() {
        assert_eq!(c as usize, i);
        assert_eq!(
            serde_json::to_string(&c).expect("plain"),
            format!("\"{}\"", c.name())
        );
        assert!(!c.advice().is_empty());
    }
}
