//! What a board file says of motion and of the step thread, and which values are accepted.
//!
//! These are the serde forms; [`crate::motion::MotionLimits`] and [`crate::motion::lines::PulseTiming`]
//! are what the rest computes with.

use serde::{Deserialize, Serialize};

/// A value of a configuration that is not accepted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} = {value}: must be {allowed}. {mend}")]
pub struct ConfigError {
    /// The key as it stands in the file.
    pub key: &'static str,
    /// The value found.
    pub value: String,
    /// What is accepted, in words.
    pub allowed: String,
    /// What to do about it.
    pub mend: &'static str,
}

/// Refuses `value` unless it is finite and `low <= value <= high`.
pub(crate) fn in_range(key: &'static str, value: f64, low: f64, high: f64, unit: &str, mend: &'static str) -> Result<(), ConfigError> {
    if value.is_finite() && value >= low && value <= high {
        return Ok(());
    }
    Err(ConfigError { key, value: value.to_string(), allowed: format!("{low} to {high} {unit}"), mend })
}

/// `[motion]`: how fast and how far a piston may go. One set for all three channels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionConfig {
    /// Greatest speed of a piston, mm/s. Default 30 (about a thousand microsteps a second with the
    /// 30 mm pinion). A bigger value moves faster and asks more torque of the motor, which loses
    /// steps silently when it has none left; the air line cannot follow arbitrarily fast either.
    pub speed_max_mm_s: f64,
    /// Greatest acceleration of a piston, mm/s². Default 300: full speed after 0.1 s. A bigger value
    /// answers quicker and asks more torque.
    pub acceleration_max_mm_s2: f64,
    /// Greatest change of acceleration, mm/s³. Default 6000: full acceleration after 50 ms. A bigger
    /// value answers quicker; a smaller one excites the rack, the tube and the tip less.
    pub jerk_max_mm_s3: f64,
    /// Travel of a piston either side of rest, mm. Default 25. Targets beyond it are clamped and
    /// said to be; no motion, braking included, goes beyond. A value greater than the syringe or the
    /// rack allows runs the drive against its end.
    pub travel_max_mm: f64,
    /// A target nearer than this to the one being driven to is taken as the same, mm. Default 0:
    /// every change is followed. A bigger value saves the work of planning and ignores noise of the
    /// control loop; the piston may then rest that much beside the last target asked for.
    pub retarget_min_mm: f64,
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self { speed_max_mm_s: 30.0, acceleration_max_mm_s2: 300.0, jerk_max_mm_s3: 6000.0, travel_max_mm: 25.0, retarget_min_mm: 0.0 }
    }
}

impl MotionConfig {
    /// Accepts the section or names the first key that is wrong.
    ///
    /// # Errors
    /// [`ConfigError`] with key, value and accepted range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        const SLOW: &str = "Set what the motor and the syringe can follow.";
        const REACH: &str = "Set what rack and syringe allow either side of rest.";
        in_range("motion.speed_max_mm_s", self.speed_max_mm_s, 0.01, 1000.0, "mm/s", SLOW)?;
        in_range("motion.acceleration_max_mm_s2", self.acceleration_max_mm_s2, 0.1, 1e5, "mm/s²", SLOW)?;
        in_range("motion.jerk_max_mm_s3", self.jerk_max_mm_s3, 1.0, 1e7, "mm/s³", SLOW)?;
        in_range("motion.travel_max_mm", self.travel_max_mm, 0.1, 1000.0, "mm", REACH)?;
        in_range("motion.retarget_min_mm", self.retarget_min_mm, 0.0, 1.0, "mm", "Leave it out to follow every change.")
    }
}

/// `[stepper]`: pulses, deadlines and the thread that makes them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StepperConfig {
    /// Time STEP stays high, µs. Default 2; the A4988 needs 1 (data sheet, Fig. 1, t_A). A bigger
    /// value suits long wires and opto-couplers and bounds the step rate.
    pub pulse_high_us: f64,
    /// Time STEP stays low before it may rise again, µs. Default 2; the A4988 needs 1 (t_B).
    pub pulse_low_us: f64,
    /// Time between a change of DIR and the STEP edge that uses it, µs. Default 1; the A4988 needs
    /// 0.2 (t_C). DIR is also kept that long after a pulse.
    pub dir_setup_us: f64,
    /// Least time between two steps of one channel, µs. Default 200. Steps that are due closer, after
    /// a late wake-up or at a turn, are spread to it; a smaller value lets a late thread catch up
    /// faster and can stall the motor. Must be at most 90 % of the interval at full speed.
    pub step_interval_min_us: f64,
    /// A step later than this is a fault: nothing more is pulsed and the motors hold, µs. Default
    /// 1000. A bigger value tolerates a worse scheduler at the price of uneven motion.
    pub late_max_us: f64,
    /// How far ahead of the clock segments are queued, ms. Default 4. A bigger value survives longer
    /// stalls of the loop and adds as much delay between command and motion.
    pub lead_ms: f64,
    /// Time from energising a driver to its first step, ms. Default 1 (A4988, charge pump).
    pub wake_delay_ms: f64,
    /// Release the coil current after this long at rest, s. Left out (default): always hold. A motor
    /// released under pressure lets the piston creep back; one held warms the board and disturbs the
    /// magnetometer.
    pub idle_release_s: Option<f64>,
    /// How often inputs and commands are looked at between steps, µs. Default 500. A smaller value
    /// reacts sooner and wakes the processor more often.
    pub poll_period_us: f64,
    /// The last part of a wait is spent looking at the clock, µs. Default 20. A bigger value hits the
    /// instant better on a sluggish kernel and burns processor time; 0 sleeps all the way.
    pub spin_us: f64,
    /// SCHED_FIFO priority of the thread, 1 to 99. Default 80: above the loop, below the kernel's
    /// own interrupt threads of importance. 0 asks for no real-time scheduling.
    pub priority: i32,
    /// Processor to stay on. Left out (default): any. Best one named in `isolcpus`.
    pub cpu: Option<usize>,
}

impl Default for StepperConfig {
    fn default() -> Self {
        Self {
            pulse_high_us: 2.0,
            pulse_low_us: 2.0,
            dir_setup_us: 1.0,
            step_interval_min_us: 200.0,
            late_max_us: 1000.0,
            lead_ms: 4.0,
            wake_delay_ms: 1.0,
            idle_release_s: None,
            poll_period_us: 500.0,
            spin_us: 20.0,
            priority: 80,
            cpu: None,
        }
    }
}

impl StepperConfig {
    /// Accepts the section or names the first key that is wrong.
    ///
    /// # Errors
    /// [`ConfigError`] with key, value and accepted range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        const CHIP: &str = "The driver chip needs at least the lower bound.";
        const LATE: &str = "See `retroflex bench rt` for what this machine keeps.";
        in_range("stepper.pulse_high_us", self.pulse_high_us, 1.0, 1000.0, "µs", CHIP)?;
        in_range("stepper.pulse_low_us", self.pulse_low_us, 1.0, 1000.0, "µs", CHIP)?;
        in_range("stepper.dir_setup_us", self.dir_setup_us, 0.2, 1000.0, "µs", CHIP)?;
        let least = self.pulse_high_us + self.pulse_low_us;
        in_range(
            "stepper.step_interval_min_us",
            self.step_interval_min_us,
            least,
            100_000.0,
            "µs",
            "A step takes pulse_high_us + pulse_low_us at least.",
        )?;
        in_range("stepper.late_max_us", self.late_max_us, 10.0, 100_000.0, "µs", LATE)?;
        in_range("stepper.lead_ms", self.lead_ms, 0.5, 100.0, "ms", "Two control ticks are a good lead.")?;
        in_range("stepper.wake_delay_ms", self.wake_delay_ms, 0.0, 1000.0, "ms", CHIP)?;
        if let Some(s) = self.idle_release_s {
            in_range("stepper.idle_release_s", s, 0.1, 1e6, "s", "Leave it out to hold for ever.")?;
        }
        in_range("stepper.poll_period_us", self.poll_period_us, 50.0, 10_000.0, "µs", LATE)?;
        in_range("stepper.spin_us", self.spin_us, 0.0, 200.0, "µs", LATE)?;
        in_range("stepper.priority", f64::from(self.priority), 0.0, 99.0, "", "0 asks for no real-time scheduling.")
    }

    /// Accepts the step interval for drives of `step_mm` a microstep at full speed.
    ///
    /// # Errors
    /// [`ConfigError`] when steps at `speed_max_mm_s` come closer than `step_interval_min_us` allows.
    pub fn validate_rate(&self, motion: &MotionConfig, step_mm: f64) -> Result<(), ConfigError> {
        let most_us = 0.9e6 * step_mm / motion.speed_max_mm_s;
        let allowed = format!("at most {most_us:.1} µs, 90 % of the interval at speed_max_mm_s = {}", motion.speed_max_mm_s);
        if self.step_interval_min_us <= most_us {
            return Ok(());
        }
        Err(ConfigError {
            key: "stepper.step_interval_min_us",
            value: self.step_interval_min_us.to_string(),
            allowed,
            mend: "Lower it, or lower motion.speed_max_mm_s.",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_accepted_together() {
        MotionConfig::default().validate().unwrap();
        StepperConfig::default().validate().unwrap();
        StepperConfig::default().validate_rate(&MotionConfig::default(), 0.029_452).unwrap();
    }

    #[test]
    fn a_refusal_names_key_value_range_and_cure() {
        let c = MotionConfig { speed_max_mm_s: -3.0, ..MotionConfig::default() };
        let words = c.validate().unwrap_err().to_string();
        for part in ["motion.speed_max_mm_s", "-3", "0.01 to 1000 mm/s", "Set what"] {
            assert!(words.contains(part), "{words}");
        }
        let nan = MotionConfig { jerk_max_mm_s3: f64::NAN, ..MotionConfig::default() };
        assert_eq!(nan.validate().unwrap_err().key, "motion.jerk_max_mm_s3");
    }

    #[test]
    fn the_chip_s_own_minima_are_kept() {
        let c = StepperConfig { pulse_high_us: 0.5, ..StepperConfig::default() };
        assert_eq!(c.validate().unwrap_err().key, "stepper.pulse_high_us");
        let c = StepperConfig { step_interval_min_us: 3.0, ..StepperConfig::default() };
        assert_eq!(c.validate().unwrap_err().key, "stepper.step_interval_min_us");
    }

    #[test]
    fn a_rate_the_interval_forbids_is_refused() {
        let fast = MotionConfig { speed_max_mm_s: 200.0, ..MotionConfig::default() };
        let e = StepperConfig::default().validate_rate(&fast, 0.029_452).unwrap_err();
        assert_eq!(e.key, "stepper.step_interval_min_us");
    }

    #[test]
    fn toml_knows_its_keys() {
        let c: StepperConfig = toml::from_str("idle_release_s = 30.0\npriority = 70").unwrap();
        assert_eq!((c.idle_release_s, c.priority), (Some(30.0), 70));
        assert!(toml::from_str::<MotionConfig>("speed_max = 3.0").is_err());
    }
}
