//! Detects hunting: a tip that swings about its target because the loop drives it.
//!
//! While the set-point rests, the error to the target is followed from extreme to extreme. An extreme on the other side of
//! the target ends a swing. The swing counts if it is large, if it has not decayed to half of the one before, and if the
//! pistons caused it: the modelled motion over the swing explains most of the motion of the tip. A breathing patient
//! swings the tip as well, but there the pistons move against the motion.
//!
//! Three swings that count in a row, one and a half periods, are hunting. Then the loop becomes slower by
//! a factor of two, which ends a swing that a wrong response time causes, and the error at which the pistons may stand widens to
//! the smallest extreme that was reached, which ends a swing in a mechanism that sticks and slips: it has no finer
//! position. The slowness is kept, also over restarts; the wider band is halved with every new target, so that a mechanism
//! that has freed itself becomes exact again.

use nalgebra::Vector2;

/// Factor on the time constant of the loop at each detection.
const SLOWER: f64 = 2.0;
/// Largest such factor in total.
const CAUTION_MAX: f64 = 8.0;
/// Extreme below which a swing does not count, rad (0.4°).
const SWING_RAD: f64 = 0.007;
/// Ratio of an extreme to the one before below which the swing decays by itself.
const DECAYS: f64 = 0.5;
/// Share of a swing that the model must explain for the swing to be the loop's own.
const OWN_SHARE: f64 = 0.5;
/// Swings in a row that are hunting.
const SWINGS: u32 = 3;
/// Ratio of the band in which the pistons stand to the smallest extreme.
const BAND: f64 = 1.25;

/// State of the detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HuntingDetector {
    /// Factor on the time constant of the loop, ≥ 1.
    pub caution: f64,
    /// Error at which the pistons may stand, beyond that of the configuration, rad.
    pub band_rad: f64,
    /// Hunting was detected at the present target.
    pub hunting: bool,
    extreme: Option<Extreme>,
    swings: u32,
    smallest_rad: f64,
}

/// Error, bend and modelled bend at the present extreme, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Extreme {
    error: Vector2<f64>,
    predicted: Vector2<f64>,
    /// The same at the extreme before.
    before: Option<(Vector2<f64>, Vector2<f64>)>,
}

impl Default for HuntingDetector {
    fn default() -> Self {
        Self::new(1.0)
    }
}

impl HuntingDetector {
    /// A detector whose loop is slower by the factor `caution`, as remembered.
    pub fn new(caution: f64) -> Self {
        let caution = caution.clamp(1.0, CAUTION_MAX);
        Self {
            caution,
            band_rad: 0.0,
            hunting: false,
            extreme: None,
            swings: 0,
            smallest_rad: f64::INFINITY,
        }
    }

    /// A new target.
    pub fn new_target(&mut self) {
        *self = Self {
            band_rad: if self.band_rad > SWING_RAD {
                self.band_rad / 2.0
            } else {
                0.0
            },
            ..Self::new(self.caution)
        };
    }

    /// One tick at a resting set-point: target minus estimated bend, and the bend that the model predicts, rad.
    pub fn step(&mut self, error: Vector2<f64>, predicted: Vector2<f64>) {
        let Some(extreme) = &mut self.extreme else {
            self.extreme = Some(Extreme {
                error,
                predicted,
                before: None,
            });
            return;
        };
        if error.dot(&extreme.error) >= 0.0 {
            if error.norm_squared() > extreme.error.norm_squared() {
                (extreme.error, extreme.predicted) = (error, predicted);
            }
            return;
        }
        // the error has changed sides: the extreme is complete
        let (ended, size) = (*extreme, extreme.error.norm());
        self.extreme = Some(Extreme {
            error,
            predicted,
            before: Some((ended.error, ended.predicted)),
        });
        self.smallest_rad = self.smallest_rad.min(size.max(SWING_RAD / 2.0));
        self.swings = if ended.counts(size) {
            self.swings + 1
        } else {
            0
        };
        if self.swings >= SWINGS {
            self.hunting = true;
            self.swings = 0;
            self.caution = (self.caution * SLOWER).min(CAUTION_MAX);
            self.band_rad = self.band_rad.max(BAND * self.smallest_rad);
        }
    }
}

impl Extreme {
    /// True if the swing that ends at this extreme of the given size is large, lasting and the loop's own.
    fn counts(&self, size: f64) -> bool {
        let Some((error, predicted)) = self.before else {
            return size > SWING_RAD;
        };
        let (moved, modelled) = (error - self.error, self.predicted - predicted);
        let own = modelled.dot(&moved) > OWN_SHARE * moved.norm_squared();
        size > SWING_RAD && size > DECAYS * error.norm() && own
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Swings of `size` rad with the ratio `decay` per half period; the pistons make the share `own` of the motion.
    fn after(half_periods: u32, size: f64, decay: f64, own: f64) -> HuntingDetector {
        let mut d = HuntingDetector::default();
        for k in 0..half_periods * 50 {
            let t = f64::from(k) / 100.0;
            let swing = size * decay.powf(2.0 * t) * (TAU * t).cos();
            d.step(Vector2::new(swing, 0.0), Vector2::new(-own * swing, 0.0));
        }
        d
    }

    #[test]
    fn hunting_is_detected_within_two_periods_and_slows_the_loop_down() {
        let d = after(4, 0.05, 1.0, 1.0);
        assert!(
            d.hunting && d.caution == SLOWER && d.band_rad > 0.05,
            "{d:?}"
        );
    }

    #[test]
    fn decaying_small_and_foreign_swings_are_not_hunting() {
        for d in [
            after(8, 0.05, 0.4, 1.0),
            after(8, 0.005, 1.0, 1.0),
            after(8, 0.05, 1.0, -1.0),
            after(8, 0.05, 1.0, 0.0),
        ] {
            assert!(!d.hunting && d.caution == 1.0 && d.band_rad == 0.0, "{d:?}");
        }
    }

    #[test]
    fn a_new_target_narrows_the_band_and_keeps_the_caution() {
        let mut d = after(4, 0.05, 1.0, 1.0);
        let band_rad = d.band_rad;
        d.new_target();
        assert!(!d.hunting && d.caution == SLOWER && d.band_rad == band_rad / 2.0);
        (0..8).for_each(|_| d.new_target());
        assert_eq!(d.band_rad, 0.0);
    }

    #[test]
    fn the_caution_is_bounded() {
        assert_eq!(after(200, 0.05, 1.0, 1.0).caution, CAUTION_MAX);
    }
}
