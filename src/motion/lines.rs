//! The lines of the drivers and the times at which they may change (Allegro A4988 data sheet, Fig. 1
//! and table "Logic interface timing": STEP high and low at least 1 µs, DIR set-up and hold at least
//! 0.2 µs).
//!
//! An edge occurs at some instant between the clock reading before its write and the one after it.
//! Every interval is therefore counted from the reading *after* the earlier write to the reading
//! *before* the later one. The true interval is never shorter, however long the writes take.

use crate::motion::StepperConfig;
use crate::primitives::Invalid;

/// Logical levels of all output lines. The pin backend applies polarity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Levels {
    /// STEP of channels 1 to 3; the driver steps on the change to true.
    pub step: [bool; 3],
    /// DIR of channels 1 to 3; true elongates the bellow.
    pub dir: [bool; 3],
    /// The drivers are energised.
    pub enable: bool,
}

impl Levels {
    /// No step, with the drivers energised or not.
    pub fn without_step(enable: bool) -> Self {
        Self {
            enable,
            ..Self::default()
        }
    }
}

/// Logical levels of all input lines; true means pressed or closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub struct Inputs {
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The home switches of channels 1 to 3 are closed.
    pub home: [bool; 3],
}

/// Reaction of the step thread to the emergency stop (stop categories of IEC 60204-1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EmergencyStop {
    /// Category 0: no further step, and the motors are de-energised at once; the air pushes the pistons
    /// back.
    #[default]
    Release,
    /// Category 2: the pistons brake within the limits and stay energised; the tip keeps its pressure.
    Hold,
}

/// [`StepperConfig`] in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PulseTiming {
    /// Least time for which STEP is high.
    pub high_ns: u64,
    /// Least time for which STEP is low.
    pub low_ns: u64,
    /// Least set-up time of DIR, and hold time after a pulse.
    pub dir_ns: u64,
    /// Least time between two steps of a channel.
    pub interval_ns: u64,
    /// Lateness beyond which a step is a fault.
    pub late_ns: u64,
    /// Time from energising a driver to its first step.
    pub wake_ns: u64,
    /// Time at rest after which the drivers are released; `None` holds indefinitely.
    pub idle_ns: Option<u64>,
    /// Longest wait between two looks at inputs and orders.
    pub poll_ns: u64,
    /// What the emergency stop does.
    pub emergency_stop: EmergencyStop,
}

impl StepperConfig {
    /// The valid configuration in nanoseconds, with the reaction to the emergency stop.
    ///
    /// # Errors
    /// As [`StepperConfig::validate`].
    pub fn timing(&self, emergency_stop: EmergencyStop) -> Result<PulseTiming, Invalid> {
        self.validate()?;
        let ns = |value: f64, unit_ns: f64| (value * unit_ns).ceil() as u64;
        Ok(PulseTiming {
            high_ns: ns(self.pulse_high_us, 1e3),
            low_ns: ns(self.pulse_low_us, 1e3),
            dir_ns: ns(self.dir_setup_us, 1e3),
            interval_ns: ns(self.step_interval_min_us, 1e3),
            late_ns: ns(self.late_max_us, 1e3),
            wake_ns: ns(self.wake_delay_ms, 1e6),
            idle_ns: self.idle_release_s.map(|s| ns(s, 1e9)),
            poll_ns: ns(self.poll_period_us, 1e3),
            emergency_stop,
        })
    }
}

/// STEP and DIR of one channel: their levels and the times from which they may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OutputLine {
    /// STEP is high.
    pub step_high: bool,
    /// DIR is high.
    pub dir_high: bool,
    /// Earliest fall of STEP.
    pub fall_ns: u64,
    /// Earliest rise of STEP.
    pub rise_ns: u64,
    /// Earliest change of DIR.
    pub dir_ns: u64,
}

impl OutputLine {
    /// Records a rise of STEP in a write that ended at `done_ns`.
    pub fn step_rose(&mut self, done_ns: u64, t: &PulseTiming) {
        self.step_high = true;
        self.fall_ns = done_ns + t.high_ns;
        self.rise_ns = done_ns + t.interval_ns;
    }

    /// Records a fall of STEP in a write that ended at `done_ns`.
    pub fn step_fell(&mut self, done_ns: u64, t: &PulseTiming) {
        self.step_high = false;
        self.rise_ns = self.rise_ns.max(done_ns + t.low_ns);
        self.dir_ns = done_ns + t.dir_ns;
    }

    /// Records a change of DIR in a write that ended at `done_ns`.
    pub fn dir_changed(&mut self, high: bool, done_ns: u64, t: &PulseTiming) {
        self.dir_high = high;
        self.rise_ns = self.rise_ns.max(done_ns + t.dir_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_count_from_the_end_of_the_earlier_write() {
        let t = StepperConfig::default()
            .timing(EmergencyStop::Release)
            .unwrap();
        let mut line = OutputLine::default();
        line.dir_changed(true, 1_000, &t);
        assert_eq!(line.rise_ns, 1_000 + t.dir_ns);
        line.step_rose(5_000, &t);
        assert_eq!(
            (line.fall_ns, line.rise_ns),
            (5_000 + t.high_ns, 5_000 + t.interval_ns)
        );
        line.step_fell(300_000, &t);
        assert_eq!(
            (line.rise_ns, line.dir_ns),
            (300_000 + t.low_ns, 300_000 + t.dir_ns)
        );
    }
}
