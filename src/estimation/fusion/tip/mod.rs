//! From IMU readings to the orientation of the tip.
//!
//! ```text
//! reading ─ sensor monitor ─▶ usable parts ─┬─ alignment (until a still stretch is complete)
//!                                           └─ estimator ─▶ bend ─ correction smoother ─▶ loop
//!                  base IMU ─▶ turn of the base ─┘   └─ second estimator at a lower rate ─▶ disagreement
//! ```
//!
//! An estimator receives only what the sensor monitor has accepted. A gap between samples that is too long to
//! integrate widens the covariance, and the following corrections by gravity and field are applied smoothly
//! ([`super::correction_smoother`]). Nothing in this module allocates after alignment.

mod tracking;
mod types;

pub use types::{FuseConfig, FusionInput, TipEstimate};

use crate::estimation::fusion::align::{AlignState, Alignment};
use crate::estimation::fusion::base::BaseTracker;
use crate::estimation::fusion::bend::BendFilter;
use crate::estimation::fusion::estimator::Estimator;
use crate::estimation::fusion::health::{
    CauseSet, HealthCause, HealthVerdict, ImuReading, KnownErrors, Quality, SensorMonitor,
};
use crate::model::Bend;
use crate::primitives::{Base, ImuSample, Rotation, Seconds, World};
use nalgebra::{Matrix2, Vector3};
use tracking::Tracker;

#[derive(Debug, Clone)]
#[allow(
    clippy::large_enum_variant,
    reason = "lives in the state of the loop, which may not allocate"
)]
enum Stage {
    /// Waiting for a still tip.
    Aligning(AlignState),
    /// Aligned and running.
    Tracking(Tracker),
}

impl Default for Stage {
    fn default() -> Self {
        Self::Aligning(AlignState::default())
    }
}

/// Orientation estimation from power-up on.
#[derive(Debug, Clone, Default)]
pub struct Fusion {
    monitor: SensorMonitor,
    verdict: Option<HealthVerdict>,
    base: BaseTracker,
    base_monitor: SensorMonitor,
    base_raised: CauseSet,
    /// The monitor of the base IMU knows the field of its alignment.
    with_base_field: bool,
    /// The base IMU has been seen.
    with_base: bool,
    stage: Stage,
}

impl Fusion {
    /// Processes one tick.
    pub fn update(&mut self, config: &FuseConfig, input: &FusionInput) {
        let input = &FusionInput {
            tip: self.without_coils(input),
            ..*input
        };
        self.update_base(config, input);
        match &mut self.stage {
            Stage::Aligning(state) => {
                let verdict = self.monitor.assess(&config.health, input.now, &input.tip);
                self.verdict = Some(verdict);
                if let (true, ImuReading::Sample(sample, _)) = (
                    verdict.gyro && !verdict.in_force.contains(HealthCause::Frozen),
                    &input.tip,
                ) && let Some(alignment) = state.add(&config.align, sample)
                {
                    self.stage = Stage::Tracking(Tracker::new(config, &alignment));
                    self.set_known(KnownErrors::default());
                }
            }
            Stage::Tracking(tracker) => {
                let reading = tracker.expecting_noise(input.tip);
                let verdict = self.monitor.assess(&tracker.limits, input.now, &reading);
                self.verdict = Some(verdict);
                tracker.update(config, &verdict, input, &self.base);
                if let Some(known) = tracker.known_errors() {
                    self.set_known(known);
                }
            }
        }
    }

    /// Follows the base with its own IMU while that is healthy.
    fn update_base(&mut self, config: &FuseConfig, input: &FusionInput) {
        self.with_base |= input.base.is_some();
        if !self.with_base {
            return;
        }
        let quality = Quality {
            expect_noise: self.base.noisy(),
            ..Quality::default()
        };
        let reading = input.base.map_or(ImuReading::Nothing, |sample| {
            ImuReading::Sample(sample, quality)
        });
        let limits = match &self.stage {
            Stage::Aligning(_) => config.health,
            Stage::Tracking(t) => t.base_limits(),
        };
        let verdict = self.base_monitor.assess(&limits, input.now, &reading);
        self.base_raised = verdict.raised;
        let up = self.alignment().map(|a| a.acc_rest_m_s2);
        match &input.base {
            Some(sample) if verdict.gyro => {
                let sample = ImuSample {
                    mag_ut: sample.mag_ut.filter(|_| verdict.mag),
                    ..*sample
                };
                self.base
                    .update(&config.base, &config.align, &sample, up.as_ref());
                if let (false, Some(rest)) = (self.with_base_field, self.base.rest()) {
                    self.base_monitor.set_known(
                        KnownErrors::default(),
                        &rest.acc_rest_m_s2,
                        rest.mag_rest_ut.as_ref(),
                    );
                }
                self.with_base_field = self.base.rest().is_some();
            }
            _ if verdict.blind => self.base.lose(),
            _ => {}
        }
        if let (true, Stage::Tracking(t), Some(rate)) = (
            input.still && input.base.is_some(),
            &self.stage,
            self.rate_rad_s(),
        ) {
            self.base.compare(
                &t.estimator.r_base_tip().apply(&rate),
                t.alignment.periods_s().0,
            );
        }
    }

    fn set_known(&mut self, known: KnownErrors) {
        if let Stage::Tracking(Tracker { alignment, .. }) = &self.stage {
            self.monitor.set_known(
                known,
                &alignment.acc_rest_m_s2,
                alignment.mag_rest_ut.as_ref(),
            );
        }
    }

    /// The tip's reading with the field of the motor coils subtracted.
    fn without_coils(&self, input: &FusionInput) -> ImuReading {
        let coils_ut = match &self.stage {
            Stage::Aligning(_) => input.coils_ut,
            Stage::Tracking(t) => t.estimator.r_base_tip().inverse().apply(&input.coils_ut),
        };
        match input.tip {
            ImuReading::Sample(s, quality) => ImuReading::Sample(
                ImuSample {
                    mag_ut: s.mag_ut.map(|m| m - coils_ut),
                    ..s
                },
                quality,
            ),
            other => other,
        }
    }

    /// Saves the estimated sensor errors, for a later [`Fusion::realign`]. The caller reports that the tip has
    /// settled and that no motion of the base is suspected.
    pub fn remember(&mut self, now: Seconds) {
        if let Stage::Tracking(t) = &mut self.stage {
            t.save(now);
        }
    }

    /// Takes the next still stretch for a new alignment, with the tip at `bend`: for a base that was turned. The
    /// bend filter keeps the estimated sensor errors, a generic filter starts anew.
    pub fn realign(&mut self, bend: Bend) {
        if let Stage::Tracking(t) = &mut self.stage {
            t.realignment = Some((AlignState::default(), bend));
        }
        self.base.restart();
    }

    /// Right after alignment: corrects it for a tip that was not straight but at `bend`. The straight alignment is
    /// known from before a restart: mean specific force, m/s², and mean field, µT.
    pub fn assume(
        &mut self,
        config: &FuseConfig,
        bend: Bend,
        acc_m_s2: &Vector3<f64>,
        mag_ut: Option<Vector3<f64>>,
    ) {
        if let Stage::Tracking(t) = &mut self.stage {
            t.assume(config, bend, acc_m_s2, mag_ut);
            self.set_known(KnownErrors::default());
        }
    }

    /// True while a re-alignment waits for its still stretch.
    pub fn realigning(&self) -> bool {
        self.tracker().is_some_and(|t| t.realignment.is_some())
    }

    /// What the alignment waits for, as text.
    pub fn waiting_for(&self) -> String {
        let reason = |state: &AlignState| {
            state.refused.map_or_else(
                || "no sample has arrived".to_owned(),
                |reason| reason.to_string(),
            )
        };
        let faults = self.in_force();
        match &self.stage {
            Stage::Aligning(_) if faults.contains(HealthCause::Spike) => {
                format!(
                    "gyroscope or accelerometer readings jump further than a tip can move: {faults}"
                )
            }
            Stage::Aligning(_) if !faults.is_empty() => format!("the IMU is faulty: {faults}"),
            Stage::Aligning(state) => reason(state),
            Stage::Tracking(t) => t
                .realignment
                .as_ref()
                .map_or_else(|| "nothing".to_owned(), |(state, _)| reason(state)),
        }
    }

    fn tracker(&self) -> Option<&Tracker> {
        if let Stage::Tracking(t) = &self.stage {
            Some(t)
        } else {
            None
        }
    }
    fn bend_filter(&self) -> Option<&BendFilter> {
        self.tracker().and_then(Tracker::bend_filter)
    }
    /// The estimate, once aligned.
    pub fn estimate(&self) -> Option<TipEstimate> {
        self.tracker().map(Tracker::estimate)
    }
    /// Bend of the tip if the base had stood since the alignment: what the selected estimator takes for a sway counts as bend.
    pub fn bend_on_standing_base(&self) -> Option<Bend> {
        let estimator = self.estimator()?;
        Some(
            estimator
                .as_bend()
                .map_or_else(|| estimator.bend(), BendFilter::bend_on_standing_base),
        )
    }
    /// The verdict on the last reading.
    pub fn verdict(&self) -> Option<HealthVerdict> {
        self.verdict
    }
    /// Health causes in force.
    pub fn in_force(&self) -> CauseSet {
        self.verdict.map_or(CauseSet::EMPTY, |v| v.in_force)
    }
    /// The pistons must not move.
    pub fn hold(&self) -> bool {
        self.verdict.is_some_and(|v| v.hold)
    }
    /// Causes against the IMU on the base: those in force, and those raised by the last reading. `None` without such an IMU.
    pub fn base_health(&self) -> Option<(CauseSet, CauseSet)> {
        self.with_base
            .then(|| (self.base_monitor.in_force(), self.base_raised))
    }
    /// The base has an IMU of its own, and it is aligned.
    pub fn tracks_base(&self) -> bool {
        self.base.follows()
    }
    /// Attitude of the base in the world, which is the base at the alignment; the last known one without a healthy IMU on the base.
    pub fn base_attitude(&self) -> Rotation<World, Base> {
        Rotation::assert_frames(self.base.turn().r_rest_now)
    }
    /// The tip has twisted against the mechanism for several seconds without a base IMU: the base may have turned.
    pub fn suspects_base_motion(&self, config: &FuseConfig) -> bool {
        let observable = config.watch.enabled
            && !self.base.follows()
            && !self.in_force().contains(HealthCause::FieldDisturbed);
        observable
            && self
                .bend_filter()
                .is_some_and(|f| f.twist_misfit() > config.watch.misfit)
    }
    /// Largest twist per bend that is consistent with the estimates so far, rad/rad, if the bend filter runs.
    pub fn twist_per_bend_max(&self) -> Option<f64> {
        self.bend_filter().map(BendFilter::twist_per_bend_max)
    }
    /// The selected estimator, once aligned.
    pub fn estimator(&self) -> Option<&Estimator> {
        self.tracker().map(|t| &t.estimator)
    }
    /// The alignment, once complete.
    pub fn alignment(&self) -> Option<&Alignment> {
        self.tracker().map(|t| &t.alignment)
    }
    /// Covariance of the estimated bend, rad²; zero where it is not known.
    pub fn covariance(&self) -> Matrix2<f64> {
        self.tracker()
            .and_then(|t| t.estimator.covariance())
            .unwrap_or_default()
    }

    /// Rate of the last used sample minus the gyroscope bias, sensor axes, rad/s; `None` if the last reading was not used. The bias is the
    /// present one: an older one makes a gyroscope that warms up a tip that twists.
    pub fn rate_rad_s(&self) -> Option<Vector3<f64>> {
        let (tracker, verdict) = (self.tracker()?, self.verdict?);
        let bias = tracker.bend_filter().map_or(
            tracker.alignment.gyro_bias_rad_s,
            BendFilter::gyro_bias_rad_s,
        );
        tracker
            .last
            .filter(|_| verdict.gyro)
            .map(|s| s.gyro_rad_s - bias)
    }
}
