//! Gains files: how the loop behaves.

use crate::control::observer::{ObserverConfig, PeriodicConfig};
use crate::control::obstruction::ObstructionConfig;
use crate::control::refine::RefineConfig;
use crate::control::{CalmConfig, FeedbackConfig, Pace, Side};
use crate::estimation::fusion::health::{HealthCause, Policy};
use crate::estimation::fusion::tip::FuseConfig;
use crate::parameters;
use crate::primitives::{Check, Checker, Parameters, Table};

parameters! {
    /// Gains: how the loop behaves. Every key may be left out; its default then applies.
    pub struct Gains: Copy {
        /// The outer loop.
        feedback as "loop": FeedbackConfig;
        /// Speed and acceleration of the set-point.
        pace: PaceSection;
        /// Backlash compensation.
        backlash: BacklashSection;
        /// Slow corrections of a set-point that rests.
        calm: CalmConfig;
        /// The observer: what is believed about the tip.
        observer: ObserverConfig;
        /// A periodic disturbance.
        periodic: PeriodicConfig;
        /// Obstruction detection.
        obstruction: ObstructionConfig;
        /// Online refinement of the extension gains.
        refine: RefineConfig;
        /// Orientation estimation.
        fuse: FuseConfig;
    }
}

parameters! {
    /// Speed and acceleration of the set-point.
    pub struct PaceSection: Copy {
        /// Speed of the bend set-point. A larger value arrives sooner, until the pistons cannot follow.
        bend_speed_deg_s: f64 = 90.0, "deg/s", 0.1..=720.0, "pistons at 30 mm/s can follow 90";
        /// Acceleration of the bend set-point. A larger value starts and stops more sharply. A slow line lowers it
        /// automatically.
        bend_acceleration_deg_s2: f64 = 600.0, "deg/s²", 1.0..=50_000.0, "600 reaches full speed after 0.15 s";
        /// Speed of the centre length. A larger value lengthens the tip sooner.
        length_speed_mm_s: f64 = 3.0, "mm/s", 0.01..=100.0, "3 is slow against bending";
        /// Acceleration of the centre length. A larger value starts and stops more sharply.
        length_acceleration_mm_s2: f64 = 20.0, "mm/s²", 0.1..=10_000.0, "20 reaches full speed after 0.15 s";
    }
}

impl PaceSection {
    /// For the bend set-point, rad.
    pub fn bend(&self) -> Pace {
        Pace {
            speed: self.bend_speed_deg_s.to_radians(),
            acceleration: self.bend_acceleration_deg_s2.to_radians(),
        }
    }
    /// For the centre length, mm.
    pub fn length(&self) -> Pace {
        Pace {
            speed: self.length_speed_mm_s,
            acceleration: self.length_acceleration_mm_s2,
        }
    }
}

parameters! {
    /// Backlash compensation.
    pub struct BacklashSection: Copy {
        /// Reversal of the play output that is ignored; the default is one microstep. A larger value moves less often and
        /// leaves a larger error; 0 follows every reversal.
        band_mm: f64 = 0.03, "mm", 0.0..=2.0, "one microstep is 0.03";
        /// Rate of the paper's smooth form tanh(q̇ / rate), which replaces sgn(q̇). A larger value blends the two sides over
        /// a wider range of speeds; 0 uses the band.
        smooth_rate_mm_s: f64 = 0.0, "mm/s", 0.0..=100.0, "0 uses the band";
    }
}

impl Gains {
    /// How the backlash compensation changes sides.
    pub fn side(&self) -> Side {
        let band_mm = self.backlash.band_mm;
        match self.backlash.smooth_rate_mm_s {
            rate_mm_s if rate_mm_s > 0.0 => Side::Smooth { rate_mm_s },
            _ => Side::Band { band_mm },
        }
    }

    /// The outer loop with its detectors.
    pub fn feedback(&self) -> FeedbackConfig {
        FeedbackConfig {
            calm: self.calm,
            observer: self.observer,
            periodic: self.periodic,
            obstruction: self.obstruction,
            ..self.feedback
        }
    }
}

impl Check for Gains {
    const TABLE: Option<&'static Table> = Some(<Self as Parameters>::TABLE);
    const REMEDY: &'static str =
        "`retroflex board show --gains` prints every key with its meaning, unit and range";

    fn check(&self, to: &mut Checker) {
        let watch = &self.fuse.watch;
        to.at("fuse.watch.onset_deg")
            .range(watch.onset_deg, 0.01..=watch.bend_deg.max(0.01), "deg")
            .hint("it must not exceed fuse.watch.bend_deg");
        for cause in HealthCause::ALL {
            if let Policy::CoastOnGyro { for_s } = self.fuse.health.policy.of(cause) {
                let key = format!("fuse.health.policy.{}.for_s", cause.name());
                to.at(&key)
                    .range(for_s, 1e-3..=60.0, "s")
                    .hint("5 lets a knock pass");
            }
        }
    }
}
