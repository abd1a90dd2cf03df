//! What a board file states of motion: the limits of a channel, with the tolerances of every comparison with them, and the
//! step thread, for which [`crate::motion::lines::PulseTiming`] is what the step core computes with.
//!
//! All channels share one set of limits because the drives are alike. Comparisons allow a relative
//! tolerance of [`TOLERANCE`] for rounding in a chain of cubics, a thousandth of the 1e-6 that
//! [`crate::motion`] guarantees.

use crate::motion::MotionState;
use crate::parameters;
use crate::primitives::{Checker, Invalid, Parameters};

/// Relative tolerance of every comparison with a limit.
pub const TOLERANCE: f64 = 1e-9;
/// Tolerance of a comparison of positions, mm. The planner closes its position equation to 1e-8 mm.
pub const POSITION_TOLERANCE_MM: f64 = 1e-7;

parameters! {
    /// Limits of motion of the pistons: one set for all three channels.
    pub struct MotionLimits: Copy {
        /// Largest piston speed; the default is about 1,000 microsteps a second. A larger value settles sooner, until the
        /// motor loses steps.
        speed_max_mm_s: f64 = 30.0, "mm/s", 0.01..=1000.0, "30 is the paper's motor at about 1,000 microsteps a second";
        /// Largest piston acceleration. A larger value crosses the backlash sooner, until the motor loses steps.
        acceleration_max_mm_s2: f64 = 600.0, "mm/s²", 0.1..=100_000.0, "600 is gentle on a small stepper";
        /// Largest change of the acceleration; the default reaches full acceleration after 20 ms. A larger value responds
        /// faster; a smaller one shakes rack, tube and tip less.
        jerk_max_mm_s3: f64 = 30_000.0, "mm/s³", 1.0..=10_000_000.0, "fifty times the acceleration reaches it within 20 ms";
        /// A target nearer than this to the present target counts as the same. A larger value plans less often and leaves the
        /// piston that much beside the last target; 0 follows every change.
        retarget_min_mm: f64 = 0.0, "mm", 0.0..=1.0, "leave it out to follow every change";
    }
    set in code {
        /// Travel either side of rest, mm: `limits.travel_mm`. Targets beyond it are clamped; no motion, braking included,
        /// goes beyond.
        travel_max_mm: f64 = 30.0;
    }
}

impl MotionLimits {
    /// Checks every range.
    ///
    /// # Errors
    /// The first value that is refused.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.checked("motion")?;
        let mut checker = Checker::default();
        checker
            .at("limits.travel_mm")
            .range(self.travel_max_mm, 0.1..=1000.0, "mm")
            .hint("what rack and syringe allow either side of rest");
        checker.done()
    }

    /// Whether a position is within travel.
    pub fn contains_position(&self, position_mm: f64) -> bool {
        position_mm.abs() <= self.travel_max_mm + POSITION_TOLERANCE_MM
    }

    /// Whether the speed and acceleration of a state are within their limits.
    pub fn contains_rates(&self, s: &MotionState) -> bool {
        s.velocity_mm_s.abs() <= self.speed_max_mm_s * (1.0 + TOLERANCE)
            && s.acceleration_mm_s2.abs() <= self.acceleration_max_mm_s2 * (1.0 + TOLERANCE)
    }
}

parameters! {
    /// Pulses, deadlines and the thread that makes them.
    pub struct StepperConfig: Copy {
        /// Time for which STEP stays high; the A4988 needs 1 µs (data sheet, Fig. 1, t_A). A larger value suits long wires and
        /// opto-couplers and limits the step rate.
        pulse_high_us: f64 = 2.0, "µs", 1.0..=1000.0, "the driver chip needs at least the lower bound";
        /// Time for which STEP stays low before it rises again; the A4988 needs 1 µs (t_B). A larger value suits long wires
        /// and limits the step rate.
        pulse_low_us: f64 = 2.0, "µs", 1.0..=1000.0, "the driver chip needs at least the lower bound";
        /// Time between a change of DIR and the step that uses it; DIR is also kept that long after a step. The A4988 needs
        /// 0.2 µs (t_C). A larger value suits slow wiring.
        dir_setup_us: f64 = 1.0, "µs", 0.2..=1000.0, "the driver chip needs at least the lower bound";
        /// Shortest time between two steps of a channel; steps that are due closer after a late wake-up are spread to it. At
        /// most 90 % of the interval at full speed. A smaller value lets a late thread catch up faster and can stall the motor.
        step_interval_min_us: f64 = 200.0, "µs", 2.0..=100_000.0, "well below the interval at full speed";
        /// Delay above which a step is a latched fault: no further pulses, and the motors hold. A larger value tolerates a
        /// worse scheduler at the price of uneven motion.
        late_max_us: f64 = 1000.0, "µs", 10.0..=100_000.0, "`retroflex bench rt` measures what this machine keeps";
        /// Time by which motion is queued ahead of the clock. A larger value survives longer stalls of the loop and adds as
        /// much delay between command and motion.
        lead_ms: f64 = 4.0, "ms", 0.5..=100.0, "two periods of the loop";
        /// Time from energising a driver to its first step; the default covers the charge pump of the A4988. A larger value
        /// suits slower drivers.
        wake_delay_ms: f64 = 1.0, "ms", 0.0..=1000.0, "see the driver's data sheet";
        /// Time at rest after which the drivers are released; left out, they always hold. A motor released under pressure lets
        /// the piston creep back; one that holds warms the board and disturbs the magnetometer.
        idle_release_s: Option<f64> = None, "s", 0.1..=1_000_000.0, "leave it out to hold for ever";
        /// Longest time between two readings of inputs and orders. A smaller value reacts sooner and wakes the processor more
        /// often.
        poll_period_us: f64 = 500.0, "µs", 50.0..=10_000.0, "`retroflex bench rt` measures what this machine keeps";
        /// Last part of a wait, which is spent polling the clock. A larger value meets the instant better on a sluggish kernel
        /// and uses more processor time; 0 sleeps all the way.
        spin_us: f64 = 20.0, "µs", 0.0..=200.0, "`retroflex bench rt` measures what this machine keeps";
        /// SCHED_FIFO priority of the step thread, above those of the loop and the IMU; 0 requests none. A larger value
        /// displaces more of the kernel's own threads.
        priority: i32 = 80, "", 0..=99, "0 requests no real-time scheduling";
        /// Processor that the step thread stays on, from 0; left out, any. Best one that `isolcpus` names.
        cpu: Option<usize> = None;
    }
}

/// Key of the shortest time between two steps.
const INTERVAL: &str = "stepper.step_interval_min_us";

impl StepperConfig {
    /// Checks every range, and that a step fits into the shortest interval.
    ///
    /// # Errors
    /// The first value that is refused.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.checked("stepper")?;
        let least_us = self.pulse_high_us + self.pulse_low_us;
        let mut checker = Checker::default();
        checker
            .at(INTERVAL)
            .range(self.step_interval_min_us, least_us..=100_000.0, "µs")
            .hint("a step takes at least stepper.pulse_high_us + stepper.pulse_low_us");
        checker.done()
    }

    /// Checks the step interval for drives of `step_mm` a microstep at full speed.
    ///
    /// # Errors
    /// Steps at `speed_max_mm_s` come closer than `step_interval_min_us` allows.
    pub fn validate_rate(&self, motion: &MotionLimits, step_mm: f64) -> Result<(), Invalid> {
        let (interval, speed) = (self.step_interval_min_us, motion.speed_max_mm_s);
        let most_us = 0.9e6 * step_mm / speed;
        if interval <= most_us {
            return Ok(());
        }
        Err(Invalid {
            key: INTERVAL.to_owned(),
            problem: format!(
                "{interval} must be at most {most_us:.1} µs, 90 % of the interval at motion.speed_max_mm_s = {speed}"
            ),
            hint: "lower it, or lower motion.speed_max_mm_s".to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_accepted_together() {
        MotionLimits::default().checked("motion").unwrap();
        StepperConfig::default().validate().unwrap();
        StepperConfig::default()
            .validate_rate(&MotionLimits::default(), 0.029_452)
            .unwrap();
    }

    #[test]
    fn an_error_names_key_value_range_and_hint() {
        let c = MotionLimits {
            speed_max_mm_s: -3.0,
            ..MotionLimits::default()
        };
        let message = c.checked("motion").unwrap_err().to_string();
        for part in ["motion.speed_max_mm_s", "-3", "0.01 to 1000 mm/s", "30 is"] {
            assert!(message.contains(part), "{message}");
        }
        let nan = MotionLimits {
            jerk_max_mm_s3: f64::NAN,
            ..MotionLimits::default()
        };
        assert_eq!(
            nan.checked("motion").unwrap_err().key,
            "motion.jerk_max_mm_s3"
        );
    }

    #[test]
    fn the_minima_of_the_driver_chip_are_enforced() {
        let c = StepperConfig {
            pulse_high_us: 0.5,
            ..StepperConfig::default()
        };
        assert_eq!(c.validate().unwrap_err().key, "stepper.pulse_high_us");
        let c = StepperConfig {
            step_interval_min_us: 3.0,
            ..StepperConfig::default()
        };
        assert_eq!(
            c.validate().unwrap_err().key,
            "stepper.step_interval_min_us"
        );
    }

    #[test]
    fn a_speed_that_the_step_interval_forbids_is_refused() {
        let fast = MotionLimits {
            speed_max_mm_s: 200.0,
            ..MotionLimits::default()
        };
        let e = StepperConfig::default()
            .validate_rate(&fast, 0.029_452)
            .unwrap_err();
        assert_eq!(e.key, "stepper.step_interval_min_us");
    }
}
