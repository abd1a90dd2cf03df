//! Gains files: how the loop behaves.

use crate::config::fuse;
use crate::control::follow::Pace;
use crate::control::learning::online::RefineConfig;
use crate::control::obstruction::ObstructionConfig;
use crate::control::standstill::StandstillConfig;
use crate::control::tick::FeedbackConfig;
use crate::estimation::fusion::tip::FuseConfig;
use crate::model::transmission::Side;
use crate::primitives::check::{Check, Checker};
use serde::Deserialize;

/// A gains file.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Gains {
    /// The outer loop.
    #[serde(rename = "loop")]
    pub outer: LoopSection,
    /// Pace of the set-point.
    pub pace: PaceSection,
    /// Backlash compensation.
    pub backlash: BacklashSection,
    /// The rest latch.
    pub rest: RestSection,
    /// The watch for a tip that is held.
    pub wall: WallSection,
    /// Online refinement of k_ε.
    pub refine: RefineConfig,
    /// Orientation estimation.
    pub fuse: FuseConfig,
}

/// The outer loop.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LoopSection {
    /// Closed-loop time constant τ_c, s. Default 0.1. Larger is calmer and slower; the dead time
    /// raises it by itself.
    pub tau_c_s: f64,
    /// Cap of the proportional gain. Default 2. Larger lets a slow line be pushed harder and the
    /// noise of the felt bend reach the pistons.
    pub kp_max: f64,
    /// Bound of the integral part, degrees. Default 60. Larger over-drives a lossy line further.
    pub integral_max_deg: f64,
    /// Share of the lag that the feedforward leads by. Default 1; 0 does not lead. More than 1
    /// overshoots.
    pub lead: f64,
    /// Learn lag and dead time while running. Default true.
    pub learn_dynamics: bool,
}

impl Default for LoopSection {
    fn default() -> Self {
        Self { tau_c_s: 0.1, kp_max: 2.0, integral_max_deg: 60.0, lead: 1.0, learn_dynamics: true }
    }
}

/// Pace of the set-point.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PaceSection {
    /// Speed of the bend, deg/s. Default 90. Larger arrives sooner until the pistons cannot follow.
    pub bend_speed_deg_s: f64,
    /// Acceleration of the bend, deg/s². Default 600. A slow line lowers it by itself.
    pub bend_acceleration_deg_s2: f64,
    /// Speed of the centre length, mm/s. Default 3.
    pub length_speed_mm_s: f64,
    /// Acceleration of the centre length, mm/s². Default 20.
    pub length_acceleration_mm_s2: f64,
}

impl Default for PaceSection {
    fn default() -> Self {
        Self { bend_speed_deg_s: 90.0, bend_acceleration_deg_s2: 600.0, length_speed_mm_s: 3.0, length_acceleration_mm_s2: 20.0 }
    }
}

impl PaceSection {
    /// For the bend set-point, rad.
    #[must_use]
    pub fn bend(&self) -> Pace {
        Pace { speed: self.bend_speed_deg_s.to_radians(), acceleration: self.bend_acceleration_deg_s2.to_radians() }
    }
    /// For the centre length, mm.
    #[must_use]
    pub fn length(&self) -> Pace {
        Pace { speed: self.length_speed_mm_s, acceleration: self.length_acceleration_mm_s2 }
    }
}

/// Backlash compensation.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BacklashSection {
    /// Reversal of the slack that is ignored, mm. Default 0.03 (one microstep). Larger moves less
    /// often and leaves a larger error; 0 follows every reversal.
    pub band_mm: f64,
    /// The paper's smooth form tanh(q̇ / rate) in place of sgn: its rate, mm/s of slack. 0, the
    /// default, uses the band.
    pub smooth_rate_mm_s: f64,
}

impl Default for BacklashSection {
    fn default() -> Self {
        Self { band_mm: 0.03, smooth_rate_mm_s: 0.0 }
    }
}

/// The rest latch.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RestSection {
    /// The latch closes inside this error, degrees. Default 0.15. Larger rests sooner and less
    /// exactly.
    pub close_deg: f64,
    /// … once it has been inside this long, s. Default 0.05.
    pub close_after_s: f64,
    /// The latch opens beyond this error, degrees. Default 0.3. Larger tolerates more creep before a
    /// correction.
    pub open_deg: f64,
    /// Smoothing of the error it looks at, s. Default 0.04. Larger ignores more noise and reacts
    /// later.
    pub smooth_s: f64,
}

impl Default for RestSection {
    fn default() -> Self {
        Self { close_deg: 0.15, close_after_s: 0.05, open_deg: 0.3, smooth_s: 0.04 }
    }
}

/// The watch for a tip that is held.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WallSection {
    /// Feedback added at a resting set-point before a tip that does not follow is called held,
    /// degrees. Default 15. Larger pushes harder against a wall.
    pub push_deg: f64,
    /// Fraction of the push that a free tip follows at the least. Default 0.08. Larger calls a soft
    /// line a wall.
    pub follow_min: f64,
    /// Error that is not worth a word, degrees. Default 1.
    pub error_deg: f64,
}

impl Default for WallSection {
    fn default() -> Self {
        Self { push_deg: 15.0, follow_min: 0.08, error_deg: 1.0 }
    }
}

impl Gains {
    /// How the backlash compensation changes sides.
    #[must_use]
    pub fn side(&self) -> Side {
        if self.backlash.smooth_rate_mm_s > 0.0 {
            Side::Smooth { rate_mm_s: self.backlash.smooth_rate_mm_s }
        } else {
            Side::Band { band_mm: self.backlash.band_mm }
        }
    }

    /// The outer loop, in radians.
    #[must_use]
    pub fn feedback(&self) -> FeedbackConfig {
        let (o, r, w) = (&self.outer, &self.rest, &self.wall);
        FeedbackConfig {
            tau_c_s: o.tau_c_s,
            kp_max: o.kp_max,
            integral_max_rad: o.integral_max_deg.to_radians(),
            lead: o.lead,
            learn_dynamics: o.learn_dynamics,
            standstill: StandstillConfig {
                close_rad: r.close_deg.to_radians(),
                close_after_s: r.close_after_s,
                open_rad: r.open_deg.to_radians(),
                smooth_s: r.smooth_s,
            },
            obstruction: ObstructionConfig {
                push_rad: w.push_deg.to_radians(),
                follow_min: w.follow_min,
                error_rad: w.error_deg.to_radians(),
            },
        }
    }
}

impl Check for Gains {
    fn check(&self, to: &mut Checker) {
        let o = &self.outer;
        to.range("loop.tau_c_s", o.tau_c_s, 0.01..=10.0, "s", "0.1 is brisk, 0.5 is calm");
        to.range("loop.kp_max", o.kp_max, 0.0..=10.0, "", "2 suits a felt bend with 0.05° of noise");
        to.range("loop.integral_max_deg", o.integral_max_deg, 0.0..=180.0, "deg", "60 lets a line with half its gain be made good");
        to.range("loop.lead", o.lead, 0.0..=1.5, "", "1 leads by the whole lag");
        let p = &self.pace;
        to.range("pace.bend_speed_deg_s", p.bend_speed_deg_s, 0.1..=720.0, "deg/s", "90 is what 30 mm/s pistons can follow");
        to.range("pace.bend_acceleration_deg_s2", p.bend_acceleration_deg_s2, 1.0..=50_000.0, "deg/s²", "600");
        to.range("pace.length_speed_mm_s", p.length_speed_mm_s, 0.01..=100.0, "mm/s", "3");
        to.range("pace.length_acceleration_mm_s2", p.length_acceleration_mm_s2, 0.1..=10_000.0, "mm/s²", "20");
        to.range("backlash.band_mm", self.backlash.band_mm, 0.0..=2.0, "mm", "one microstep, 0.03");
        to.range("backlash.smooth_rate_mm_s", self.backlash.smooth_rate_mm_s, 0.0..=100.0, "mm/s", "0 for the band");
        let r = &self.rest;
        to.range("rest.close_deg", r.close_deg, 0.0..=10.0, "deg", "0.15");
        to.range("rest.close_after_s", r.close_after_s, 0.0..=5.0, "s", "0.05");
        to.range("rest.open_deg", r.open_deg, r.close_deg..=20.0, "deg", "it opens further out than it closes");
        to.range("rest.smooth_s", r.smooth_s, 1e-3..=5.0, "s", "0.04");
        let w = &self.wall;
        to.range("wall.push_deg", w.push_deg, 0.5..=90.0, "deg", "15");
        to.range("wall.follow_min", w.follow_min, 0.0..=0.9, "", "0.08");
        to.range("wall.error_deg", w.error_deg, 0.05..=45.0, "deg", "1");
        self.check_refine(to);
        fuse::check(&self.fuse, to);
    }
}

impl Gains {
    fn check_refine(&self, to: &mut Checker) {
        let f = &self.refine;
        to.range("refine.forgetting", f.forgetting, 0.5..=1.0, "", "0.99 remembers about 100 poses");
        to.range("refine.prior_poses", f.prior_poses, 0.01..=1000.0, "", "2");
        to.range("refine.pose_step_deg", f.pose_step_deg, 0.5..=90.0, "deg", "5");
        to.range("refine.strain_min_mm", f.strain_min_mm, 0.1..=10.0, "mm", "1");
        to.range("refine.range", f.range, 0.01..=2.0, "", "0.5 allows half again of 1 + k_ε");
        to.range("refine.step_max", f.step_max, 0.001..=1.0, "", "0.04");
        to.range("refine.outlier", f.outlier, 1.0..=100.0, "", "4");
    }
}
