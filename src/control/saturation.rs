//! Spent: the controller has done what it may, and the tip is still off.
//!
//! A set-point that rests, an error that stays, and either the integrator at its bound or a piston cut at
//! its limit: nothing will come of waiting. The wall's watch ([`super::wall`]) asks whether the tip
//! follows a push; this one only whether there is any push left, so a line that follows too weakly is
//! said as well.

use crate::control::limits::Cut;

/// What there is no more of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Saturation {
    /// There is more, or no need of it.
    #[default]
    No,
    /// The integrator is at its bound.
    Feedback,
    /// A piston is at the end of its travel.
    Travel,
    /// A line is at its greatest pressure.
    Pressure,
}

impl Saturation {
    /// In words, with the mend; `None` where nothing is amiss.
    #[must_use]
    pub fn words(self) -> Option<&'static str> {
        match self {
            Self::No => None,
            Self::Feedback => Some(
                "feedback is at its bound (`loop.integral_max_deg`) and the tip is still not there: look for a line that has \
                 weakened or something that holds the tip; relax and calibrate again",
            ),
            Self::Travel => Some(
                "a piston is at the end of its travel and the tip is still not there: ask for less bend, or look for a line \
                 that leaks or holds air",
            ),
            Self::Pressure => Some(
                "a line is at its greatest pressure and the tip is still not there: ask for less bend, or look for a kink or \
                 something that holds the tip",
            ),
        }
    }
}

/// How long it must have been so, s.
const FOR_S: f64 = 1.0;

/// The watch's memory.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SaturationMonitor {
    spent: Saturation,
    for_s: f64,
    now: Saturation,
}

impl SaturationMonitor {
    /// One tick: whether the set-point moves, whether the error is worth a word, whether the integrator is
    /// at its bound, and what cut the pistons.
    pub fn step(&mut self, moving: bool, off: bool, full: bool, cut: Cut, dt_s: f64) {
        let spent = match cut {
            _ if moving || !off => Saturation::No,
            Cut::Travel => Saturation::Travel,
            Cut::Pressure => Saturation::Pressure,
            Cut::None | Cut::Bellow if full => Saturation::Feedback,
            Cut::None | Cut::Bellow => Saturation::No,
        };
        self.for_s = if spent == self.spent { self.for_s + dt_s } else { 0.0 };
        self.spent = spent;
        if spent == Saturation::No {
            self.now = Saturation::No;
        } else if self.for_s >= FOR_S {
            self.now = spent;
        }
    }

    /// What there is no more of, for long.
    #[must_use]
    pub fn now(&self) -> Saturation {
        self.now
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
        s.now()
    }

    #[test]
    fn it_is_said_once_it_lasts_and_only_when_the_tip_is_off() {
        assert_eq!(after(1.1, false, true, true, Cut::None), Saturation::Feedback);
        assert_eq!(after(0.9, false, true, true, Cut::None), Saturation::No);
        assert_eq!(after(1.1, false, true, true, Cut::Travel), Saturation::Travel);
        assert_eq!(after(1.1, false, true, false, Cut::Pressure), Saturation::Pressure);
        assert_eq!(after(3.0, true, true, true, Cut::None), Saturation::No);
        assert_eq!(after(3.0, false, false, true, Cut::Travel), Saturation::No);
        assert_eq!(after(3.0, false, true, false, Cut::None), Saturation::No);
        for spent in [Saturation::Feedback, Saturation::Travel, Saturation::Pressure] {
            assert!(spent.words().is_some_and(|w| w.contains("still not there")));
        }
    }
}
