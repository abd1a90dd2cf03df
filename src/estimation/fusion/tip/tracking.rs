//! Tracking of an aligned tip: gaps, rejected rates and corrections around the estimators.

use super::types::{FuseConfig, FusionInput, TipEstimate};
use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::base::BaseTurn;
use crate::estimation::fusion::bend::BendFilter;
use crate::estimation::fusion::correction_smoother::CorrectionSmoother;
use crate::estimation::fusion::estimator::Estimator;
use crate::estimation::fusion::filter::TipSample;
use crate::estimation::fusion::health::{HealthCause, HealthConfig, HealthVerdict};
use crate::estimation::fusion::second::Second;
use crate::model::Bend;
use crate::primitives::{ImuReading, ImuSample};
use nalgebra::{Matrix2, Vector2, Vector3};

/// Uncertainty of the bend that is remembered from before a restart, rad (2°), 1 σ.
const REMEMBERED_SIGMA_RAD: f64 = 0.035;
/// Share of the longest blind time after which a base IMU that repeats itself is stuck.
const FROZEN_SHARE: f64 = 0.4;

/// Rates that were rejected as spikes since the last used sample. They are used after all if the next readings
/// confirm them.
#[derive(Debug, Clone, Copy, Default)]
struct RejectedRates {
    /// Their integral, rad.
    turn_rad: Vector3<f64>,
    /// Stamp of the last of them, s.
    until_s: Option<f64>,
}

/// State of the fusion after alignment.
#[derive(Debug, Clone)]
pub(super) struct Tracker {
    pub alignment: Alignment,
    /// Limits of the sensor monitor for the sampling periods of this source.
    pub limits: HealthConfig,
    /// The source had noise during the first alignment.
    noisy: bool,
    pub estimator: Estimator,
    second: Second,
    smoother: CorrectionSmoother,
    /// Last sample that was used.
    pub last: Option<ImuSample>,
    rejected: RejectedRates,
    /// Rate of the bend at the last sample, by the gyroscope, rad/s.
    bend_rate: Vector2<f64>,
    /// Extrapolation of the bend since the last sample, rad.
    extrapolation: Vector2<f64>,
}

impl Tracker {
    pub fn new(config: &FuseConfig, alignment: &Alignment) -> Self {
        let (imu_s, mag_s) = alignment.periods_s();
        let second = Estimator::new(
            config.filter.second(),
            &config.bend,
            alignment,
            config.second.period_s,
        );
        Self {
            alignment: *alignment,
            limits: config
                .health
                .for_periods(imu_s, alignment.mag_rest_ut.map(|_| mag_s)),
            noisy: alignment.noisy(),
            estimator: Estimator::new(config.filter, &config.bend, alignment, 0.0),
            second: Second::new(second),
            smoother: CorrectionSmoother::default(),
            last: None,
            rejected: RejectedRates::default(),
            bend_rate: Vector2::zeros(),
            extrapolation: Vector2::zeros(),
        }
    }

    /// Limits of the monitor of the base IMU: it must notice a stuck one as soon as a silent one.
    pub fn base_limits(&self) -> HealthConfig {
        let readings =
            (self.limits.blind_max_s * FROZEN_SHARE / self.alignment.periods_s().0) as u32;
        let frozen_after = readings.clamp(3, self.limits.frozen_after.max(3));
        // readings that stick after a jump count as stuck before the jump counts as true
        HealthConfig {
            frozen_after,
            spike_confirm: self.limits.spike_confirm.max(2 * frozen_after),
            ..self.limits
        }
    }

    /// Expects noise of every source that had noise during alignment.
    pub fn expecting_noise(&self, reading: ImuReading) -> ImuReading {
        reading.map(|_, quality| quality.expect_noise |= self.noisy)
    }

    pub fn update(
        &mut self,
        config: &FuseConfig,
        verdict: &HealthVerdict,
        input: &FusionInput,
        base: &BaseTurn,
    ) {
        if !verdict.recovered.is_empty() {
            self.smoother.arm();
        }
        let Some(imu) = input.tip.sample().filter(|_| verdict.gyro) else {
            // between samples, and at the start of a gap, the bend continues at its last rate
            let age_s = self.last.map_or(0.0, |last| input.now.0 - last.t.0);
            self.extrapolation = self.bend_rate * age_s.clamp(0.0, self.limits.blind_max_s);
            self.reject(verdict, &input.tip);
            return;
        };
        let period_s = self.alignment.periods_s().0;
        let gap_s = self.last.map_or(period_s, |last| imu.t.0 - last.t.0);
        if gap_s <= 0.0 {
            return;
        }
        let sample = TipSample {
            imu: *imu,
            dt_s: gap_s,
            acc: verdict.acc,
            mag: verdict.mag,
            still: input.still && !verdict.hold,
            base: *base,
        };
        if self.rejected.until_s.is_some() && !verdict.confirmed {
            self.estimator.suspect_jump();
        }
        if gap_s <= self.limits.jump_max_s {
            if gap_s - period_s > 0.5 * period_s && !verdict.confirmed {
                self.estimator
                    .widen_for_gap(self.limits.angular_acceleration_max_rad_s2, gap_s);
                self.smoother.arm();
            }
            self.step(config, sample, verdict.confirmed);
        } else {
            self.resume(&sample);
        }
        (self.last, self.extrapolation, self.rejected) =
            (Some(*imu), Vector2::zeros(), RejectedRates::default());
    }

    /// Restarts both estimators after a gap that is too long to integrate.
    fn resume(&mut self, sample: &TipSample) {
        let before = self.estimator.bend().0 + self.extrapolation;
        self.estimator.recover(sample);
        self.second.recover(sample);
        self.smoother.arm();
        self.smoother.step(&(self.estimator.bend().0 - before), 0.0);
    }

    /// Records a rate that was rejected as a spike or as saturated, since it may have been true.
    fn reject(&mut self, verdict: &HealthVerdict, tip: &ImuReading) {
        let spike = verdict.faults.contains(HealthCause::Spike);
        if verdict.faults.contains(HealthCause::Saturated) {
            self.estimator.suspect_jump();
        } else if let Some(imu) = tip.sample().filter(|_| spike) {
            let last_s = self.last.map(|last| last.t.0);
            let before_s = self.rejected.until_s.or(last_s);
            let since_s = before_s.map_or(0.0, |before_s| imu.t.0 - before_s);
            self.rejected.turn_rad += imu.gyro_rad_s * since_s;
            self.rejected.until_s = Some(imu.t.0);
        }
    }

    /// Mean rate over the gap before a sample: the mean of both ends over lost samples, the integral of the rejected rates
    /// if they were confirmed.
    fn mean_rate(&self, sample: &TipSample, confirmed: bool) -> Vector3<f64> {
        let (rate, gap_s) = (sample.imu.gyro_rad_s, sample.dt_s);
        match (&self.last, self.rejected.until_s) {
            (Some(_), Some(until_s)) if confirmed => {
                (self.rejected.turn_rad + rate * (sample.imu.t.0 - until_s)) / gap_s
            }
            (Some(last), _) if gap_s > 1.5 * self.alignment.periods_s().0 => {
                (rate + last.gyro_rad_s) / 2.0
            }
            _ => rate,
        }
    }

    fn step(&mut self, config: &FuseConfig, mut sample: TipSample, confirmed: bool) {
        sample.imu.gyro_rad_s = self.mean_rate(&sample, confirmed);
        let before = self.estimator.bend().0;
        self.estimator.update(&sample);
        if self.estimator.take_reacquired() {
            self.smoother.arm();
            self.second.recover(&sample);
        }
        let correction = self.estimator.correction();
        self.bend_rate = (self.estimator.bend().0 - before - correction) / sample.dt_s;
        self.smoother.step(&correction, sample.dt_s);
        if self.second.add(&config.second, &sample) {
            let up = self.alignment.acc_rest_m_s2;
            let field =
                sample.mag && self.estimator.trusts_field() && self.second.estimator.trusts_field();
            let rate_rad_s = (sample.imu.gyro_rad_s - self.alignment.gyro_bias_rad_s).norm();
            self.second
                .compare(&config.second, &*self.estimator, &up, field, rate_rad_s);
        }
    }

    pub fn assume(&mut self, bend: Bend, acc_m_s2: &Vector3<f64>, mag_ut: Option<Vector3<f64>>) {
        let bent = bend.rotation().inverse();
        let mag_rest_ut = self.alignment.mag_rest_ut.and(mag_ut);
        let now = Alignment {
            acc_rest_m_s2: bent.apply(acc_m_s2),
            mag_rest_ut: mag_rest_ut.map(|m| bent.apply(&m)),
            ..self.alignment
        };
        self.alignment = Alignment {
            acc_rest_m_s2: *acc_m_s2,
            mag_rest_ut,
            ..self.alignment
        };
        for estimator in [&mut self.estimator, &mut self.second.estimator] {
            estimator.rebase(&now, bend, REMEMBERED_SIGMA_RAD);
        }
    }

    /// The bend filter, whether it is the selected or the second estimator.
    pub fn bend_filter(&self) -> Option<&BendFilter> {
        let second = || self.second.estimator.as_bend();
        self.estimator.as_bend().or_else(second)
    }

    pub fn estimate(&self) -> TipEstimate {
        let bend = self.estimator.bend();
        let sigma = |c: Matrix2<f64>| c.symmetric_eigenvalues().max().max(0.0).sqrt();
        let mut estimate = TipEstimate {
            r_base_tip: self.estimator.r_base_tip(),
            bend,
            sigma_rad: self.estimator.covariance().map(sigma),
            disagrees: self.second.disagrees,
            disagreement_rad: self.second.angle_rad,
        };
        let offset = self.smoother.offset + self.extrapolation;
        if offset.norm_squared() > 0.0 {
            // smoothing and extrapolation apply to the bend; the twist stays
            estimate.bend = Bend(bend.0 + offset);
            let twist = bend.rotation().inverse() * estimate.r_base_tip;
            estimate.r_base_tip = estimate.bend.rotation() * twist;
        }
        estimate
    }
}
