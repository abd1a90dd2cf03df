//! From IMU readings to tip orientation: judge, alignment at rest, estimator, second opinion.
//!
//! ```text
//! reading ─ judge ─▶ what may be used ─┬─ alignment (until a still stretch is full)
//!                                      └─ estimator ─▶ felt bend ─ ease ─▶ the loop
//!                       base IMU ─▶ turn of the base ─┘   └─ second opinion, at a lower rate ─▶ flag
//! ```
//!
//! The judge speaks first: nothing reaches an estimator that it has not let through. A hole in the
//! readings that is longer than a sample may be integrated over widens the estimate, and what gravity
//! and field then correct is let in smoothly ([`CorrectionSmoother`]). Nothing here allocates.

use crate::estimation::fusion::align::{AlignConfig, AlignState, Alignment};
use crate::estimation::fusion::base::{BaseConfig, BaseTracker, BaseTurn};
use crate::estimation::fusion::base_watch::WatchConfig;
use crate::estimation::fusion::bend::{BendFilter, BendFilterConfig, MeasurementMask};
use crate::estimation::fusion::correction_smoother::CorrectionSmoother;
use crate::estimation::fusion::estimator::{Choice, Estimator};
use crate::estimation::fusion::health::{
    self, CauseSet, Health, HealthCause, HealthVerdict, ImuReading, KnownErrors, Quality, TimedReading,
};
use crate::estimation::fusion::second::{Second, SecondConfig};
use crate::model::bend::Bend;
use crate::primitives::frames::{Base, Rotation, Tip};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::Seconds;
use nalgebra::{Vector2, Vector3};
use serde::Deserialize;

/// Alignment, estimator and health settings.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseConfig {
    /// Estimator of the loop: `bend` (default), `madgwick`, `vqf`, `vqf-long` or `mekf`. The generic
    /// ones need the magnetometer; `bend` only uses it.
    pub filter: Choice,
    /// When the tip counts as still.
    pub align: AlignConfig,
    /// The bend-constrained estimator.
    pub bend: BendFilterConfig,
    /// The estimator beside it.
    pub second: SecondConfig,
    /// When a reading is believed, and what to do when it is not.
    pub health: health::HealthConfig,
    /// The base's own IMU, where there is one.
    pub base: BaseConfig,
    /// The watch for a base that moves, where there is none.
    pub watch: WatchConfig,
}

/// What fusion says after a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipEstimate {
    /// Tip in the base.
    pub r_base_tip: Rotation<Base, Tip>,
    /// The bend in it.
    pub bend: Bend,
    /// Largest standard deviation of the bend vector, rad; `None` where the filter gives none.
    pub sigma_rad: Option<f64>,
    /// The second opinion has differed for long.
    pub disagrees: bool,
    /// Angle between the two opinions, rad.
    pub disagreement_rad: f64,
}

/// What fusion is told at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FusionInput {
    /// Time of the tick, on the clock of the sample stamps.
    pub now: Seconds,
    /// What came from the tip.
    pub tip: ImuReading,
    /// A sample of the base's IMU, if there is one.
    pub base: Option<ImuSample>,
    /// Field of the motors' coils in the base, µT; zero where it is not known.
    pub coils_ut: Vector3<f64>,
    /// The pistons have rested for a while.
    pub still: bool,
}

#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "lives in the loop's state, which may not allocate")]
enum Stage {
    /// Waiting for a still tip.
    Aligning(AlignState),
    /// Aligned and running.
    Running(Running),
}

/// Rates that were refused for leaping: true after all if what follows bears them out.
#[derive(Debug, Clone, Copy, Default)]
struct Refused {
    /// What they turned by, rad.
    turn_rad: Vector3<f64>,
    /// Stamp of the last of them, s.
    until_s: Option<f64>,
}

#[derive(Debug, Clone)]
struct Running {
    rest: Alignment,
    /// The judge's limits for this source.
    limits: health::HealthConfig,
    noisy: bool,
    estimator: Estimator,
    second: Second,
    smoother: CorrectionSmoother,
    last: Option<ImuSample>,
    /// What was refused since for leaping.
    refused: Refused,
    /// How fast the bend went at the last sample, by the gyroscope, rad/s.
    bend_rate: Vector2<f64>,
    /// What it has gone on by since, rad.
    ahead: Vector2<f64>,
    /// The bend filter as it was when all was quiet last: what it knew of the sensor.
    saved: Option<BendFilter>,
    saved_at_s: f64,
    /// Averages a rest that is to become the new one, for a tip that is bent by this.
    again: Option<(AlignState, Bend)>,
}

/// Orientation estimation from power-up on.
#[derive(Debug, Clone)]
pub struct Fusion {
    judge: health::HealthState,
    verdict: Option<HealthVerdict>,
    base: BaseTracker,
    stage: Stage,
}

impl Default for Fusion {
    fn default() -> Self {
        let stage = Stage::Aligning(AlignState::default());
        Self { judge: health::HealthState::default(), verdict: None, base: BaseTracker::Absent, stage }
    }
}

/// Uncertainties of the sensor's own errors that the judge allows for.
const SIGMAS: f64 = 3.0;
/// Uncertainty of the bend that a re-alignment is told, rad (2°).
const REALIGN_SIGMA_RAD: f64 = 0.035;
/// How often a quiet estimator is remembered, s.
const REMEMBER_S: f64 = 0.5;
/// A sample may be integrated over this many of its periods, and a hole is anything longer.
const BRIDGED_PERIODS: f64 = 6.0;

impl Fusion {
    /// One tick.
    pub fn update(&mut self, config: &FuseConfig, told: &FusionInput) {
        let told = &FusionInput { tip: self.without_coils(told), ..*told };
        let Self { judge, verdict, base, stage } = self;
        if let Some(sample) = &told.base {
            let up = if let Stage::Running(r) = stage { Some(r.rest.acc_rest_m_s2) } else { None };
            base.update(&config.base, &config.align, sample, up.as_ref());
        }
        match stage {
            Stage::Aligning(state) => {
                let said = Health::judge(&config.health, judge, TimedReading { now: told.now, outcome: told.tip });
                *verdict = Some(said);
                if let (true, ImuReading::Sample(sample, _)) = (said.gyro && !frozen(&said), &told.tip)
                    && let Some(rest) = state.add(&config.align, sample)
                {
                    *stage = Stage::Running(Running::new(config, &rest));
                    *judge = judged_from(judge, &rest);
                }
            }
            Stage::Running(running) => {
                let outcome = running.expecting_noise(told.tip);
                let said = Health::judge(&running.limits, judge, TimedReading { now: told.now, outcome });
                *verdict = Some(said);
                running.update(config, &said, told, base);
                if let Some(known) = running.known() {
                    judge.set_known(known, &running.rest.acc_rest_m_s2, running.rest.mag_rest_ut.as_ref());
                }
            }
        }
    }

    /// What came from the tip, its field without the motors' share of it.
    fn without_coils(&self, told: &FusionInput) -> ImuReading {
        let here = match &self.stage {
            Stage::Aligning(_) => told.coils_ut,
            Stage::Running(r) => r.estimator.r_base_tip().inverse().apply(&told.coils_ut),
        };
        match told.tip {
            ImuReading::Sample(s, quality) => ImuReading::Sample(ImuSample { mag_ut: s.mag_ut.map(|m| m - here), ..s }, quality),
            other => other,
        }
    }

    /// All is quiet: what the estimator knows of the sensor may be returned to.
    pub fn remember(&mut self, now: Seconds) {
        if let Stage::Running(r) = &mut self.stage
            && now.0 - r.saved_at_s > REMEMBER_S
        {
            r.saved = r.bend_filter().cloned();
            r.saved_at_s = now.0;
        }
    }

    /// Takes the next still stretch for the rest again, of a tip that is bent by `bend`: for a base
    /// that was turned. What is known of the sensor is kept; generic filters start anew.
    pub fn realign(&mut self, bend: Bend) {
        if let Stage::Running(running) = &mut self.stage {
            running.again = Some((AlignState::default(), bend));
        }
        self.base.restart();
    }

    /// Right after alignment: the tip was not straight over that stretch but bent by `bend`, and the true
    /// rest is known from before a restart: mean specific force, m/s², and field, µT.
    pub fn assume(&mut self, config: &FuseConfig, bend: Bend, acc_m_s2: &Vector3<f64>, mag_ut: Option<Vector3<f64>>) {
        if let Stage::Running(running) = &mut self.stage {
            running.assume(config, bend, acc_m_s2, mag_ut);
            self.judge.set_known(KnownErrors::default(), &running.rest.acc_rest_m_s2, running.rest.mag_rest_ut.as_ref());
        }
    }

    /// True while a re-alignment waits for its still stretch.
    #[must_use]
    pub fn realigning(&self) -> bool {
        matches!(&self.stage, Stage::Running(r) if r.again.is_some())
    }

    /// What alignment still waits for, in words.
    #[must_use]
    pub fn waiting_for(&self) -> String {
        let why = |state: &AlignState| state.refused.map_or_else(|| "no sample came".to_owned(), |why| why.to_string());
        let faults = self.in_force();
        match &self.stage {
            Stage::Aligning(_) if faults.contains(HealthCause::Spike) => {
                format!("the gyroscope or the accelerometer leaps further than a tip can: {faults}")
            }
            Stage::Aligning(_) if !faults.is_empty() => format!("the IMU is not well: {faults}"),
            Stage::Aligning(state) => why(state),
            Stage::Running(r) => r.again.as_ref().map_or_else(|| "nothing".to_owned(), |(state, _)| why(state)),
        }
    }

    /// The felt orientation, once aligned.
    #[must_use]
    pub fn estimate(&self) -> Option<TipEstimate> {
        if let Stage::Running(running) = &self.stage { Some(running.estimate()) } else { None }
    }

    /// The judge's last word.
    #[must_use]
    pub fn verdict(&self) -> Option<HealthVerdict> {
        self.verdict
    }
    /// Everything that is counted against the sensor now.
    #[must_use]
    pub fn in_force(&self) -> CauseSet {
        self.verdict.map_or(CauseSet::EMPTY, |v| v.in_force)
    }
    /// The pistons must not move.
    #[must_use]
    pub fn hold(&self) -> bool {
        self.verdict.is_some_and(|v| v.hold)
    }
    /// The base's own IMU is there and followed.
    #[must_use]
    pub fn follows_base(&self) -> bool {
        self.base.follows()
    }
    /// The tip twists against its mechanism for long, and no base IMU speaks: the base may have turned.
    #[must_use]
    pub fn doubts_base(&self, config: &FuseConfig) -> bool {
        let Stage::Running(r) = &self.stage else { return false };
        let alone = config.watch.enabled && !self.base.follows() && !self.in_force().contains(HealthCause::FieldDisturbed);
        alone && r.bend_filter().is_some_and(|f| f.twist_misfit() > config.watch.misfit)
    }
    /// Twist per bend that the tip may make by what it has shown, rad/rad, where the bend filter says it.
    #[must_use]
    pub fn twists(&self) -> Option<f64> {
        if let Stage::Running(r) = &self.stage { r.bend_filter().map(BendFilter::twists) } else { None }
    }
    /// The selected estimator, once aligned.
    #[must_use]
    pub fn estimator(&self) -> Option<&Estimator> {
        if let Stage::Running(r) = &self.stage { Some(&r.estimator) } else { None }
    }
    /// The rest, once found.
    #[must_use]
    pub fn rest(&self) -> Option<&Alignment> {
        if let Stage::Running(r) = &self.stage { Some(&r.rest) } else { None }
    }
    /// Rate of the sample that was used last, without the bias that stood when all was quiet last, sensor
    /// axes, rad/s; `None` when the last reading was not used.
    #[must_use]
    pub fn rate_rad_s(&self) -> Option<Vector3<f64>> {
        let (Stage::Running(r), Some(verdict)) = (&self.stage, self.verdict) else { return None };
        // the present estimate may have begun to take a turn of the base for drift
        let bias = r.saved.as_ref().map_or(r.rest.gyro_bias_rad_s, BendFilter::gyro_bias_rad_s);
        r.last.filter(|_| verdict.gyro).map(|s| s.gyro_rad_s - bias)
    }
}

/// A fresh judge's memory that knows the rest.
fn judged_from(before: &health::HealthState, rest: &Alignment) -> health::HealthState {
    let mut judge = before.clone();
    judge.set_known(KnownErrors::default(), &rest.acc_rest_m_s2, rest.mag_rest_ut.as_ref());
    judge
}

fn frozen(verdict: &HealthVerdict) -> bool {
    verdict.in_force.contains(HealthCause::Frozen)
}

impl Running {
    fn new(config: &FuseConfig, rest: &Alignment) -> Self {
        let (imu_s, mag_s) = rest.periods_s();
        let second = Estimator::new(config.filter.second(), &config.bend, rest, config.second.period_s);
        Self {
            rest: *rest,
            limits: config.health.for_periods(imu_s, rest.mag_rest_ut.map(|_| mag_s)),
            noisy: rest.noisy(),
            estimator: Estimator::new(config.filter, &config.bend, rest, 0.0),
            second: Second::new(second),
            smoother: CorrectionSmoother::default(),
            last: None,
            refused: Refused::default(),
            bend_rate: Vector2::zeros(),
            ahead: Vector2::zeros(),
            saved: None,
            saved_at_s: f64::NEG_INFINITY,
            again: None,
        }
    }

    /// A source that had noise at rest has it for ever; one that had none may say so.
    fn expecting_noise(&self, outcome: ImuReading) -> ImuReading {
        match outcome {
            ImuReading::Sample(sample, quality) => {
                let expect_noise = quality.expect_noise || self.noisy;
                ImuReading::Sample(sample, Quality { expect_noise, ..quality })
            }
            other => other,
        }
    }

    fn update(&mut self, config: &FuseConfig, said: &HealthVerdict, told: &FusionInput, base: &BaseTracker) {
        if said.recovered.is_some() {
            self.smoother.arm();
        }
        let (true, ImuReading::Sample(sample, _)) = (said.gyro, &told.tip) else {
            // between samples, and over the first moments of a hole, the tip goes on as it went
            let age_s = self.last.map_or(0.0, |last| told.now.0 - last.t.0);
            self.ahead = self.bend_rate * age_s.clamp(0.0, self.limits.blind_max_s);
            self.refuse(said, &told.tip);
            return;
        };
        let mask = MeasurementMask { acc: said.acc, mag: said.mag, still: told.still && !said.hold };
        let turn = base.turn();
        let gap_s = self.last.map_or(self.rest.periods_s().0, |last| sample.t.0 - last.t.0);
        if gap_s <= 0.0 {
            return;
        }
        if gap_s <= (BRIDGED_PERIODS * self.rest.periods_s().0).max(self.limits.jump_max_s) {
            let hole_s = gap_s - self.rest.periods_s().0;
            if hole_s > 0.5 * self.rest.periods_s().0 && !said.confirmed {
                self.estimator.unseen(self.limits.angular_acceleration_max_rad_s2, gap_s);
                self.smoother.arm();
            }
            self.step(config, &self.bridging(sample, gap_s, said.confirmed), gap_s, mask, &turn);
        } else {
            let before = self.estimator.bend().0 + self.ahead;
            self.estimator.recover(sample, gap_s, mask, &turn);
            self.second.recover(sample, gap_s, mask, &turn);
            self.smoother.arm();
            self.smoother.step(&(self.estimator.bend().0 - before), 0.0);
        }
        (self.last, self.ahead, self.refused) = (Some(*sample), Vector2::zeros(), Refused::default());
        self.align_again(config, sample, said);
    }

    /// A rate that was refused for leaping, or for being beyond the range, may have been true.
    fn refuse(&mut self, said: &HealthVerdict, tip: &ImuReading) {
        let (leaps, beyond) = (said.faults.contains(HealthCause::Spike), said.faults.contains(HealthCause::Saturated));
        if leaps || beyond {
            self.estimator.may_have_leapt();
        }
        if let (true, false, ImuReading::Sample(sample, _)) = (leaps, beyond, tip) {
            let since_s = self.refused.until_s.or(self.last.map(|last| last.t.0)).map_or(0.0, |before| sample.t.0 - before);
            self.refused.turn_rad += sample.gyro_rad_s * since_s;
            self.refused.until_s = Some(sample.t.0);
        }
    }

    /// Over a lost sample or two the rate is the mean of its ends; over refused ones that were true it is
    /// what they said.
    fn bridging(&self, sample: &ImuSample, gap_s: f64, confirmed: bool) -> ImuSample {
        let gyro_rad_s = match (&self.last, self.refused.until_s) {
            (Some(_), Some(until_s)) if confirmed => (self.refused.turn_rad + sample.gyro_rad_s * (sample.t.0 - until_s)) / gap_s,
            (Some(last), _) if gap_s > 1.5 * self.rest.periods_s().0 => (sample.gyro_rad_s + last.gyro_rad_s) / 2.0,
            _ => sample.gyro_rad_s,
        };
        ImuSample { gyro_rad_s, ..*sample }
    }

    fn step(&mut self, config: &FuseConfig, sample: &ImuSample, dt_s: f64, mask: MeasurementMask, turn: &BaseTurn) {
        let before = self.estimator.bend().0;
        self.estimator.update(sample, dt_s, mask, turn);
        if self.estimator.leapt() {
            self.smoother.arm();
            self.second.recover(sample, dt_s, mask, turn);
        }
        let corrected = self.estimator.corrected();
        self.bend_rate = (self.estimator.bend().0 - before - corrected) / dt_s;
        self.smoother.step(&corrected, dt_s);
        if self.second.gather(&config.second, sample, dt_s, mask, turn) {
            let up = self.rest.acc_rest_m_s2;
            let field = mask.mag && self.estimator.believes_field() && self.second.estimator.believes_field();
            let turning = (sample.gyro_rad_s - self.rest.gyro_bias_rad_s).norm();
            self.second.compare(&config.second, &self.estimator, &up, field, turning, config.second.period_s);
        }
    }

    fn align_again(&mut self, config: &FuseConfig, sample: &ImuSample, said: &HealthVerdict) {
        let Some((state, bend)) = &mut self.again else { return };
        let sound = said.acc && !said.hold;
        let Some(now) = state.add(&config.align, sample).filter(|_| sound) else { return };
        let bend = *bend;
        self.again = None;
        let estimate = self.estimate().bend.0;
        let straight = bend.rotation();
        self.rest = Alignment {
            acc_rest_m_s2: straight.apply(&now.acc_rest_m_s2),
            mag_rest_ut: now.mag_rest_ut.map(|m| straight.apply(&m)),
            ..now
        };
        if let (Estimator::Bend(f), Some(saved)) = (&mut self.estimator, self.saved.take()) {
            // what it has learnt since is the base's turn, not the sensor
            *f = saved;
        }
        self.estimator.rebase(config.filter, &config.bend, &now, bend, REALIGN_SIGMA_RAD);
        self.second.estimator.rebase(config.filter.second(), &config.bend, &now, bend, REALIGN_SIGMA_RAD);
        if let Some(f) = self.bend_filter() {
            self.rest = f.rest();
        }
        self.smoother.arm();
        self.smoother.offset = estimate - self.estimator.bend().0;
    }

    fn assume(&mut self, config: &FuseConfig, bend: Bend, acc_m_s2: &Vector3<f64>, mag_ut: Option<Vector3<f64>>) {
        let bent = bend.rotation().inverse();
        let mag_rest_ut = self.rest.mag_rest_ut.and(mag_ut);
        let now = Alignment { acc_rest_m_s2: bent.apply(acc_m_s2), mag_rest_ut: mag_rest_ut.map(|m| bent.apply(&m)), ..self.rest };
        self.rest = Alignment { acc_rest_m_s2: *acc_m_s2, mag_rest_ut, ..self.rest };
        self.estimator.rebase(config.filter, &config.bend, &now, bend, REALIGN_SIGMA_RAD);
        self.second.estimator.rebase(config.filter.second(), &config.bend, &now, bend, REALIGN_SIGMA_RAD);
    }

    fn bend_filter(&self) -> Option<&BendFilter> {
        self.estimator.as_bend().or_else(|| self.second.estimator.as_bend())
    }

    /// What the bend filter, first or second, has learnt of the sensor.
    fn known(&self) -> Option<KnownErrors> {
        let f = self.bend_filter()?;
        let (acc_bias_m_s2, acc_sigma) = f.acc_bias_m_s2();
        Some(KnownErrors {
            acc_bias_m_s2,
            acc_slack_m_s2: SIGMAS * acc_sigma,
            iron_ut: f.mag_bias_ut(),
            iron_slack_ut: SIGMAS * f.mag_bias_sigma_ut(),
        })
    }

    fn estimate(&self) -> TipEstimate {
        let said = self.estimator.bend();
        let mut estimate = TipEstimate {
            r_base_tip: self.estimator.r_base_tip(),
            bend: said,
            sigma_rad: self.estimator.sigma_rad(),
            disagrees: self.second.disagrees(),
            disagreement_rad: self.second.angle_rad(),
        };
        let offset = self.smoother.offset + self.ahead;
        if offset.norm_squared() > 0.0 {
            // the bend eased and led on, the twist as it is
            estimate.bend = Bend(said.0 + offset);
            let twist = said.rotation().inverse() * estimate.r_base_tip;
            estimate.r_base_tip = estimate.bend.rotation() * twist;
        }
        estimate
    }
}
