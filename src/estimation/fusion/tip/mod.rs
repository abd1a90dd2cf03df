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

pub use types::{FuseConfig, FusionInput, STILL_AFTER_S, TipEstimate};

use crate::estimation::fusion::align::{AlignState, Alignment};
use crate::estimation::fusion::base::BaseTracker;
use crate::estimation::fusion::bend::BendFilter;
use crate::estimation::fusion::estimator::Estimator;
use crate::estimation::fusion::health::{
    CauseSet, HealthCause, HealthVerdict, KnownErrors, SensorMonitor,
};
use crate::model::Bend;
use crate::primitives::{Base, ImuReading, ImuSample, Rotation, World};
use nalgebra::{Matrix2, Vector3};
use tracking::Tracker;

/// Orientation estimation from power-up on.
#[derive(Debug, Clone, Default)]
pub struct Fusion {
    monitor: SensorMonitor,
    base: BaseTracker,
    base_monitor: SensorMonitor,
    /// The still stretch at the start.
    start: AlignState,
    /// What runs from the alignment on.
    tracker: Option<Tracker>,
}

impl Fusion {
    /// Processes one tick.
    pub fn update(&mut self, config: &FuseConfig, input: &FusionInput) {
        let input = &FusionInput {
            tip: self.without_coils(input),
            ..*input
        };
        self.update_base(config, input);
        let Some(tracker) = &mut self.tracker else {
            return self.align(config, input);
        };
        let reading = tracker.expecting_noise(input.tip);
        let verdict = self.monitor.assess(&tracker.limits, input.now, &reading);
        tracker.update(config, &verdict, input, &self.base.turn());
        if let Some(filter) = tracker.bend_filter() {
            let known = filter.known_errors();
            self.monitor.set_known(known, &tracker.alignment);
        }
    }

    /// Waits for a still tip.
    fn align(&mut self, config: &FuseConfig, input: &FusionInput) {
        let verdict = self.monitor.assess(&config.health, input.now, &input.tip);
        let usable = verdict.gyro && !verdict.in_force.contains(HealthCause::Frozen);
        if let Some(sample) = input.tip.sample().filter(|_| usable)
            && let Some(alignment) = self.start.add(&config.align, sample)
        {
            self.tracker = Some(Tracker::new(config, &alignment));
            self.monitor.set_known(KnownErrors::default(), &alignment);
        }
    }

    /// Follows the base with its own IMU while that is healthy.
    fn update_base(&mut self, config: &FuseConfig, input: &FusionInput) {
        if input.base.is_none() && self.base_health().is_none() {
            return;
        }
        let noisy = self.base.noisy();
        let reading = ImuReading::from_world(input.base).map(|_, q| q.expect_noise = noisy);
        let tracker = self.tracker.as_ref();
        let limits = tracker.map_or(config.health, Tracker::base_limits);
        let verdict = self.base_monitor.assess(&limits, input.now, &reading);
        if let Some(sample) = input.base.filter(|_| verdict.gyro) {
            let sample = ImuSample {
                mag_ut: sample.mag_ut.filter(|_| verdict.mag),
                ..sample
            };
            let up = tracker.map(|t| &t.alignment.acc_rest_m_s2);
            self.base.update(&config.base, &config.align, &sample, up);
            if let Some(rest) = self.base.rest() {
                self.base_monitor.set_known(KnownErrors::default(), rest);
            }
        } else if verdict.blind {
            self.base.lose();
        }
        let stands = input.still && input.base.is_some();
        if let (true, Some(t), Some(rate)) = (stands, tracker, self.rate_rad_s()) {
            let rate_in_base = t.estimator.r_base_tip().apply(&rate);
            self.base.compare(&rate_in_base, t.alignment.periods_s().0);
        }
    }

    /// The tip's reading with the field of the motor coils subtracted.
    fn without_coils(&self, input: &FusionInput) -> ImuReading {
        let coils_ut = self.estimator().map_or(input.coils_ut, |e| {
            e.r_base_tip().inverse().apply(&input.coils_ut)
        });
        let subtract = |m: Vector3<f64>| m - coils_ut;
        input.tip.map(|s, _| s.mag_ut = s.mag_ut.map(subtract))
    }

    /// Right after alignment: corrects it for a tip that was not straight but at `bend`. The straight alignment is
    /// known from before a restart: mean specific force, m/s², and mean field, µT.
    pub fn assume(&mut self, bend: Bend, acc_m_s2: &Vector3<f64>, mag_ut: Option<Vector3<f64>>) {
        if let Some(tracker) = &mut self.tracker {
            tracker.assume(bend, acc_m_s2, mag_ut);
            let known = KnownErrors::default();
            self.monitor.set_known(known, &tracker.alignment);
        }
    }

    /// What the alignment waits for, as text.
    pub fn waiting_for(&self) -> String {
        let faults = self.in_force();
        match (&self.tracker, self.start.refused) {
            (Some(_), _) => "nothing".to_owned(),
            (None, _) if faults.contains(HealthCause::Spike) => {
                format!(
                    "gyroscope or accelerometer readings jump further than a tip can move: {faults}"
                )
            }
            (None, _) if !faults.is_empty() => format!("the IMU is faulty: {faults}"),
            (None, Some(reason)) => reason.to_string(),
            (None, None) => "no sample has arrived".to_owned(),
        }
    }

    fn bend_filter(&self) -> Option<&BendFilter> {
        self.tracker.as_ref().and_then(Tracker::bend_filter)
    }
    /// The estimate, once aligned.
    pub fn estimate(&self) -> Option<TipEstimate> {
        self.tracker.as_ref().map(Tracker::estimate)
    }
    /// Bend of the tip if the base had stood since the alignment: what the selected estimator takes for a sway counts as bend.
    pub fn bend_on_standing_base(&self) -> Option<Bend> {
        Some(match self.estimator()? {
            Estimator::Bend(filter) => filter.bend_on_standing_base(),
            other => other.bend(),
        })
    }
    /// The verdict on the last reading.
    pub fn verdict(&self) -> Option<HealthVerdict> {
        self.monitor.verdict()
    }
    /// Health causes in force.
    pub fn in_force(&self) -> CauseSet {
        self.verdict().map_or(CauseSet::EMPTY, |v| v.in_force)
    }
    /// The pistons must not move.
    pub fn hold(&self) -> bool {
        self.verdict().is_some_and(|v| v.hold)
    }
    /// Causes against the IMU on the base: those in force, and those raised by the last reading. `None` without such an IMU.
    pub fn base_health(&self) -> Option<(CauseSet, CauseSet)> {
        let verdict = self.base_monitor.verdict()?;
        Some((verdict.in_force, verdict.raised))
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
        let contradicts = |f: &BendFilter| f.twist_misfit() > config.watch.misfit;
        config.watch.enabled
            && !self.base.follows()
            && !self.in_force().contains(HealthCause::FieldDisturbed)
            && self.bend_filter().is_some_and(contradicts)
    }
    /// Variance of the rate of [`Fusion::rate_rad_s`] about an axis, integrated over `time_s`, rad².
    pub fn turn_variance(&self, time_s: f64) -> f64 {
        let Some(tracker) = &self.tracker else {
            return 0.0;
        };
        let (alignment, filter) = (&tracker.alignment, tracker.bend_filter());
        let white = alignment.gyro_sigma_rad_s.powi(2) * alignment.periods_s().0 * time_s;
        white + filter.map_or(0.0, BendFilter::gyro_bias_variance) * time_s * time_s
    }
    /// The selected estimator, once aligned.
    pub fn estimator(&self) -> Option<&Estimator> {
        self.tracker.as_ref().map(|t| &t.estimator)
    }
    /// The alignment, once complete.
    pub fn alignment(&self) -> Option<&Alignment> {
        self.tracker.as_ref().map(|t| &t.alignment)
    }
    /// Covariance of the estimated bend, rad²; zero where it is not known.
    pub fn covariance(&self) -> Matrix2<f64> {
        let estimator = self.estimator();
        estimator.and_then(|e| e.covariance()).unwrap_or_default()
    }

    /// Rate of the last used sample minus the gyroscope bias, sensor axes, rad/s; `None` if the last reading was not used. The bias is the
    /// present one: an older one makes a gyroscope that warms up a tip that twists.
    pub fn rate_rad_s(&self) -> Option<Vector3<f64>> {
        let (tracker, verdict) = (self.tracker.as_ref()?, self.verdict()?);
        let at_rest = tracker.alignment.gyro_bias_rad_s;
        let bias = self.bend_filter().map_or(at_rest, |f| f.gyro_bias_rad_s());
        let sample = tracker.last.filter(|_| verdict.gyro)?;
        Some(sample.gyro_rad_s - bias)
    }
}
