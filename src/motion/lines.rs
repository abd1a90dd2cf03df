//! The lines of one driver and when they may move (Allegro A4988 data sheet, Fig. 1 and table
//! "Logic interface timing": STEP high and low at least 1 µs, DIR set-up and hold at least 0.2 µs).
//!
//! A written edge happens at some instant between the clock reading before the write and the one
//! after it. Every gap is therefore counted from the reading *after* the earlier write to the reading
//! *before* the later one: the true gap is never shorter, however long the writes take.

use crate::motion::config::{ConfigError, EmergencyStop, StepperConfig};

/// Logic levels of all output lines: what is meant, not what the pin carries (polarity is the
/// backend's affair).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Levels {
    /// STEP of channels 1 to 3; a step is made as it becomes true.
    pub step: [bool; 3],
    /// DIR of channels 1 to 3; true elongates the bellow.
    pub dir: [bool; 3],
    /// Drivers energised.
    pub enable: bool,
}

/// Logic levels of all input lines, polarity applied: true means pressed or closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Inputs {
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The home switches of channels 1 to 3 are closed.
    pub home: [bool; 3],
}

/// [`StepperConfig`] in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PulseTiming {
    /// STEP high, least.
    pub high_ns: u64,
    /// STEP low, least.
    pub low_ns: u64,
    /// DIR set-up, and hold after a pulse.
    pub dir_ns: u64,
    /// Between two steps of a channel, least.
    pub interval_ns: u64,
    /// Lateness that is a fault.
    pub late_ns: u64,
    /// From energising to the first step.
    pub wake_ns: u64,
    /// Rest after which the drivers are released.
    pub idle_ns: Option<u64>,
    /// Longest wait without looking at inputs and orders.
    pub poll_ns: u64,
    /// What the emergency stop does.
    pub emergency_stop: EmergencyStop,
}

impl TryFrom<&StepperConfig> for PulseTiming {
    type Error = ConfigError;

    fn try_from(c: &StepperConfig) -> Result<Self, ConfigError> {
        c.validate()?;
        let ns = |value: f64, unit_ns: f64| (value * unit_ns).ceil() as u64;
        Ok(Self {
            high_ns: ns(c.pulse_high_us, 1e3),
            low_ns: ns(c.pulse_low_us, 1e3),
            dir_ns: ns(c.dir_setup_us, 1e3),
            interval_ns: ns(c.step_interval_min_us, 1e3),
            late_ns: ns(c.late_max_us, 1e3),
            wake_ns: ns(c.wake_delay_ms, 1e6),
            idle_ns: c.idle_release_s.map(|s| ns(s, 1e9)),
            poll_ns: ns(c.poll_period_us, 1e3),
            emergency_stop: c.emergency_stop,
        })
    }
}

/// STEP and DIR of one channel: their levels, and from when they may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OutputLine {
    /// STEP is high.
    pub high: bool,
    /// DIR is high.
    pub up: bool,
    /// STEP may fall from then on.
    pub fall_ns: u64,
    /// STEP may rise from then on.
    pub rise_ns: u64,
    /// DIR may change from then on.
    pub turn_ns: u64,
}

impl OutputLine {
    /// STEP rose in a write that was over at `done_ns`.
    pub fn rose(&mut self, done_ns: u64, t: &PulseTiming) {
        self.high = true;
        self.fall_ns = done_ns + t.high_ns;
        self.rise_ns = done_ns + t.interval_ns;
    }

    /// STEP fell in a write that was over at `done_ns`.
    pub fn fell(&mut self, done_ns: u64, t: &PulseTiming) {
        self.high = false;
        self.rise_ns = self.rise_ns.max(done_ns + t.low_ns);
        self.turn_ns = done_ns + t.dir_ns;
    }

    /// DIR changed in a write that was over at `done_ns`.
    pub fn turned(&mut self, up: bool, done_ns: u64, t: &PulseTiming) {
        self.up = up;
        self.rise_ns = self.rise_ns.max(done_ns + t.dir_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_count_from_the_end_of_the_earlier_write() {
        let t = PulseTiming::try_from(&StepperConfig::default()).unwrap();
        let mut line = OutputLine::default();
        line.turned(true, 1_000, &t);
        assert_eq!(line.rise_ns, 2_000);
        line.rose(5_000, &t);
        assert_eq!((line.fall_ns, line.rise_ns), (7_000, 205_000));
        line.fell(300_000, &t);
        assert_eq!((line.rise_ns, line.turn_ns), (302_000, 301_000));
    }
}
