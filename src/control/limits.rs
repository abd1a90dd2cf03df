//! Static limits of bellows and pistons.
//!
//! The range of a bellow, 14 to 29 mm, limits the target shape, not the command: feedback must be able to overdrive a
//! lossy line. Travel and pressure limit the piston itself.

use crate::model::transmission::Line;
use nalgebra::Vector3;

/// Static limits of a board and its tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActuatorLimits {
    /// Piston travel either way from rest, mm (rack of 60 mm: 30).
    pub travel_mm: f64,
    /// Gauge pressure per mm of compressed air, kPa/mm.
    pub pressure_kpa_per_mm: f64,
    /// Largest gauge pressure of either sign, kPa (the paper stays below 6 PSI = 41.4 kPa).
    pub pressure_max_kpa: f64,
    /// Shortest bellow, mm.
    pub bellow_min_mm: f64,
    /// Longest bellow, mm.
    pub bellow_max_mm: f64,
}

/// The limit that cut a request; if several do, the last one of the command path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Cut {
    /// None.
    #[default]
    None,
    /// The target shape exceeds the range of a bellow.
    Bellow,
    /// The target exceeds the travel of a piston.
    Travel,
    /// The target exceeds the pressure limit of a line.
    Pressure,
}

impl ActuatorLimits {
    /// Scales the length changes q (mm) towards zero until every bellow is within its range.
    #[must_use]
    pub fn bellows(&self, q_mm: &Vector3<f64>, rest_length_mm: f64) -> (Vector3<f64>, Cut) {
        let (shortest, longest) = (self.bellow_min_mm - rest_length_mm, self.bellow_max_mm - rest_length_mm);
        let scale = q_mm.iter().fold(1.0f64, |s, &q| {
            let bound = if q < 0.0 { shortest } else { longest };
            if q == 0.0 { s } else { s.min((bound / q).max(0.0)) }
        });
        if scale < 1.0 { (q_mm * scale, Cut::Bellow) } else { (*q_mm, Cut::None) }
    }

    /// Length to add to all bellows (mm) so that no piston exceeds its travel. Bending depends on differences only, so the
    /// other two channels can relieve one at its limit. If that is not enough, the excess is shared.
    #[must_use]
    pub fn relief(&self, q_mm: &Vector3<f64>, lines: &[Line; 3]) -> f64 {
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        for i in 0..3 {
            let room = lines[i].bellow_mm((self.travel_mm - lines[i].k_lambda_mm).max(0.0));
            low = low.max(-room - q_mm[i]);
            high = high.min(room - q_mm[i]);
        }
        if low > high { (low + high) / 2.0 } else { 0.0f64.clamp(low, high) }
    }

    /// Limits piston targets (mm) by travel and pressure. `q_mm` is the estimated bellow change, so `piston − q` is the
    /// compressed air.
    #[must_use]
    pub fn pistons(&self, piston_mm: &Vector3<f64>, q_mm: &Vector3<f64>) -> (Vector3<f64>, Cut) {
        let mut cut = Cut::None;
        let squeeze_max_mm = self.pressure_max_kpa / self.pressure_kpa_per_mm;
        let bounded = Vector3::from_fn(|i, _| {
            let by_pressure = piston_mm[i].clamp(q_mm[i] - squeeze_max_mm, q_mm[i] + squeeze_max_mm);
            let by_travel = by_pressure.clamp(-self.travel_mm, self.travel_mm);
            if by_travel != by_pressure {
                cut = Cut::Travel;
            } else if by_pressure != piston_mm[i] {
                cut = Cut::Pressure;
            }
            by_travel
        });
        (bounded, cut)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LIMITS: ActuatorLimits =
        ActuatorLimits { travel_mm: 30.0, pressure_kpa_per_mm: 2.0, pressure_max_kpa: 41.0, bellow_min_mm: 14.0, bellow_max_mm: 29.0 };

    proptest! {
        #[test]
        fn limited_values_are_within_their_ranges(
            q in prop::array::uniform3(-40.0..40.0f64),
            u in prop::array::uniform3(-80.0..80.0f64),
        ) {
            let (q, cut) = LIMITS.bellows(&Vector3::from(q), 20.0);
            prop_assert!(q.iter().all(|&x| (14.0 - 1e-9..=29.0 + 1e-9).contains(&(20.0 + x))));
            prop_assert!(cut == Cut::None || q.amax() > 5.9);
            let (u, _) = LIMITS.pistons(&Vector3::from(u), &q);
            for i in 0..3 {
                prop_assert!(u[i].abs() <= 30.0);
                prop_assert!((u[i] - q[i]).abs() <= 20.5 + 1e-9);
            }
        }
    }

    #[test]
    fn the_other_channels_relieve_one_at_its_limit() {
        let lossy = |k_epsilon| Line { k_epsilon, k_lambda_mm: 1.0 };
        let lines = [lossy(2.2), lossy(5.0), lossy(2.2)];
        let q = Vector3::new(-2.65, 5.29, -2.65);
        let s = LIMITS.relief(&q, &lines);
        assert!(s < 0.0);
        for i in 0..3 {
            assert!(lines[i].play_output_mm(q[i] + s).abs() + 1.0 <= 30.0 + 1e-9);
        }
        assert_eq!(LIMITS.relief(&(q * 0.5), &lines), 0.0);
    }

    #[test]
    fn permitted_values_stay_unchanged() {
        let q = Vector3::new(-5.3, 2.6, 2.6);
        assert_eq!(LIMITS.bellows(&q, 20.0), (q, Cut::None));
        let u = q * 3.2;
        assert_eq!(LIMITS.pistons(&u, &q), (u, Cut::None));
    }
}
