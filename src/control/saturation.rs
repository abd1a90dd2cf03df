//! Saturation: the controller has reached a limit and the tip is still off target.
//!
//! The monitor reports saturation if the set-point rests, the error persists, and either the integral part is at its
//! bound or a limit cuts a piston. The obstruction detector ([`super::obstruction`]) checks whether the tip follows the
//! feedback; this monitor only checks whether more feedback is available, and so also detects a weak line.

use crate::control::limits::Cut;
use crate::primitives::lasting;

/// The limit that the controller has reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub enum Saturation {
    /// None, or the tip is on target.
    #[default]
    No,
    /// The integral part is at its bound.
    Feedback,
    /// A piston is at the end of its travel.
    Travel,
    /// A line is at its greatest pressure.
    Pressure,
}

impl Saturation {
    /// Message with advice; `None` without saturation.
    pub fn words(self) -> Option<&'static str> {
        match self {
            Self::No => None,
            Self::Feedback => Some(
                "the feedback is at its bound (`loop.integral_max_deg`) and the tip is still off target: look for a weak line or an \
                 obstruction; relax and calibrate again",
            ),
            Self::Travel => Some(
                "a piston is at the end of its travel and the tip is still off target: request less bend, or look for a line \
                 that leaks or contains air",
            ),
            Self::Pressure => Some(
                "a line is at its pressure limit and the tip is still off target: request less bend, or look for a kink or an \
                 obstruction",
            ),
        }
    }
}

/// Time after which saturation is reported, s.
const REPORT_AFTER_S: f64 = 1.0;

/// The monitor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SaturationMonitor {
    /// Limit reached in the last tick, and for how long, s.
    present: Saturation,
    present_s: f64,
    /// Saturation that has lasted long enough to be reported.
    pub reported: Saturation,
}

impl SaturationMonitor {
    /// One tick. `off`: the error matters; `full`: the integral part is at its bound; `cut`: the limit that cut the pistons.
    pub fn step(&mut self, moving: bool, off: bool, full: bool, cut: Cut, dt_s: f64) {
        let present = match cut {
            _ if moving || !off => Saturation::No,
            Cut::Travel => Saturation::Travel,
            Cut::Pressure => Saturation::Pressure,
            Cut::None | Cut::Bellow if full => Saturation::Feedback,
            Cut::None | Cut::Bellow => Saturation::No,
        };
        self.present_s = lasting(present == self.present, self.present_s, dt_s);
        self.present = present;
        if present == Saturation::No || self.present_s >= REPORT_AFTER_S {
            self.reported = present;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(seconds: f64, moving: bool, off: bool, full: bool, cut: Cut) -> Saturation {
        let mut s = SaturationMonitor::default();
        for _ in 0..(seconds * 1e3) as u32 {
            s.step(moving, off, full, cut, 1e-3);
        }
        s.reported
    }

    #[test]
    fn saturation_is_reported_after_a_second_if_the_tip_is_off_target() {
        assert_eq!(
            after(1.1, false, true, true, Cut::None),
            Saturation::Feedback
        );
        assert_eq!(after(0.9, false, true, true, Cut::None), Saturation::No);
        assert_eq!(
            after(1.1, false, true, true, Cut::Travel),
            Saturation::Travel
        );
        assert_eq!(
            after(1.1, false, true, false, Cut::Pressure),
            Saturation::Pressure
        );
        assert_eq!(after(3.0, true, true, true, Cut::None), Saturation::No);
        assert_eq!(after(3.0, false, false, true, Cut::Travel), Saturation::No);
        assert_eq!(after(3.0, false, true, false, Cut::None), Saturation::No);
        for saturation in [
            Saturation::Feedback,
            Saturation::Travel,
            Saturation::Pressure,
        ] {
            assert!(
                saturation
                    .words()
                    .is_some_and(|w| w.contains("still off target"))
            );
        }
    }
}
