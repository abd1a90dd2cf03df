//! Static limits of bellows and pistons.
//!
//! The range of a bellow, 14 to 29 mm, limits the target shape, not the command: feedback must be able to overdrive a
//! lossy line. Travel and pressure limit the piston itself.

use crate::model::{Geometry, Line, Shape};
use crate::parameters;
use nalgebra::Vector3;

parameters! {
    /// How far a piston may go.
    pub struct ActuatorLimits: Copy {
        /// Piston travel either side of rest; the default is half of the 60 mm rack. A value larger than the rack runs the
        /// pinion off it.
        travel_mm: f64 = 30.0, "mm", 1.0..=100.0, "half the rack's length";
        /// Gauge pressure per mm of piston that compresses air; the default is 17.5 kPa at the paper's largest bend. A larger
        /// value stops the piston sooner.
        pressure_kpa_per_mm: f64 = 1.4, "kPa/mm", 0.01..=100.0, "read a gauge while the piston moves by 1 mm against a blocked bellow";
        /// Largest gauge pressure of either sign; the default is the paper's 6 PSI. A larger value risks the bellow and pushes
        /// harder against the motor.
        pressure_max_kpa: f64 = 41.3, "kPa", 1.0..=200.0, "the paper stays under 6 PSI = 41.4 kPa";
    }
    set in code {
        /// Shortest bellow, mm: `geometry.bellow_min_mm`.
        bellow_min_mm: f64 = 14.0;
        /// Longest bellow, mm: `geometry.bellow_max_mm`.
        bellow_max_mm: f64 = 29.0;
    }
}

/// The limit that cut a request; if several do, the last one of the command path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
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
    pub fn bellows(&self, q_mm: &Vector3<f64>, rest_length_mm: f64) -> (Vector3<f64>, Cut) {
        let shortest = self.bellow_min_mm - rest_length_mm;
        let longest = self.bellow_max_mm - rest_length_mm;
        let scale = q_mm.iter().fold(1.0f64, |s, &q| {
            let bound = if q < 0.0 { shortest } else { longest };
            if q == 0.0 {
                s
            } else {
                s.min((bound / q).max(0.0))
            }
        });
        if scale < 1.0 {
            (q_mm * scale, Cut::Bellow)
        } else {
            (*q_mm, Cut::None)
        }
    }

    /// Length to add to all bellows (mm) so that no piston exceeds its travel. Bending depends on differences only, so the
    /// other two channels can relieve one at its limit. If that is not enough, the excess is shared.
    pub fn relief(&self, q_mm: &Vector3<f64>, lines: &[Line; 3]) -> f64 {
        relief(q_mm, &Vector3::repeat(1.0), &self.room(lines))
    }

    /// Largest length change of each bellow that a piston makes within its travel, mm.
    pub fn room(&self, lines: &[Line; 3]) -> Vector3<f64> {
        Vector3::from_fn(|i, _| {
            lines[i].bellow_mm((self.travel_mm - lines[i].k_lambda_mm).max(0.0))
        })
    }

    /// Share of the bend of `shape`, at most 1, that these lines can hold at its length.
    pub fn largest_share(&self, geometry: &Geometry, lines: &[Line; 3], shape: &Shape) -> f64 {
        let holds = |share: f64| {
            let q_mm = geometry.lengths(&Shape::new(shape.bend.0 * share, shape.length.0));
            let relieved = q_mm.add_scalar(self.relief(&q_mm, lines));
            let piston_mm =
                Vector3::from_fn(|i, _| lines[i].piston_mm(relieved[i], relieved[i].signum()));
            let (inner_q_mm, inner_mm) = (q_mm * (1.0 - 1e-9), piston_mm * (1.0 - 1e-9));
            self.bellows(&inner_q_mm, geometry.rest_length_mm).1 == Cut::None
                && self.pistons(&inner_mm, &relieved).1 == Cut::None
        };
        if holds(1.0) {
            return 1.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..20 {
            let middle = (low + high) / 2.0;
            if holds(middle) {
                low = middle
            } else {
                high = middle
            }
        }
        low
    }

    /// Limits piston targets (mm) by travel and pressure. `q_mm` is the estimated bellow change, so `piston − q` is the
    /// compressed air.
    pub fn pistons(&self, piston_mm: &Vector3<f64>, q_mm: &Vector3<f64>) -> (Vector3<f64>, Cut) {
        let mut cut = Cut::None;
        let squeeze_max_mm = self.pressure_max_kpa / self.pressure_kpa_per_mm;
        let bounded = Vector3::from_fn(|i, _| {
            let (least, most) = (q_mm[i] - squeeze_max_mm, q_mm[i] + squeeze_max_mm);
            let by_pressure = piston_mm[i].clamp(least, most);
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

/// The least common change, of which each length takes its `part`, by which no length exceeds its `room` either way. If there is none,
/// the excess is shared.
pub fn relief(q_mm: &Vector3<f64>, part: &Vector3<f64>, room_mm: &Vector3<f64>) -> f64 {
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for i in 0..3 {
        low = low.max((-room_mm[i] - q_mm[i]) / part[i]);
        high = high.min((room_mm[i] - q_mm[i]) / part[i]);
    }
    if low > high {
        (low + high) / 2.0
    } else {
        0.0f64.clamp(low, high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Bend;
    use proptest::prelude::*;

    const LIMITS: ActuatorLimits = ActuatorLimits {
        travel_mm: 30.0,
        pressure_kpa_per_mm: 2.0,
        pressure_max_kpa: 41.0,
        bellow_min_mm: 14.0,
        bellow_max_mm: 29.0,
    };

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
        let lossy = |k_epsilon| Line {
            k_epsilon,
            k_lambda_mm: 1.0,
        };
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
    fn the_largest_bend_is_that_at_which_a_bellow_is_shortest() {
        let (geometry, lines) = (
            Geometry::default(),
            [Line {
                k_epsilon: 2.2,
                k_lambda_mm: 0.9,
            }; 3],
        );
        let share = |bend_deg: f64, dir_deg: f64| {
            let shape = Shape {
                bend: Bend::from_deg(bend_deg, dir_deg),
                length: crate::primitives::units::Mm(20.0),
            };
            LIMITS.largest_share(&geometry, &lines, &shape)
        };
        assert_eq!(share(75.0, 80.0), 1.0);
        // at dir 0 the first bellow is shortened by r β
        let limit_deg = (6.0 / geometry.r_mm).to_degrees();
        assert!(
            (share(120.0, 0.0) * 120.0 - limit_deg).abs() < 0.01,
            "{}",
            share(120.0, 0.0) * 120.0
        );
        assert_eq!(share(limit_deg - 0.01, 0.0), 1.0);
        // weak lines reach the pressure limit first
        let weak = [Line {
            k_epsilon: 6.0,
            k_lambda_mm: 0.9,
        }; 3];
        let shape = Shape {
            bend: Bend::from_deg(80.0, 0.0),
            length: crate::primitives::units::Mm(20.0),
        };
        assert!(LIMITS.largest_share(&geometry, &weak, &shape) < 0.7);
    }

    #[test]
    fn permitted_values_stay_unchanged() {
        let q = Vector3::new(-5.3, 2.6, 2.6);
        assert_eq!(LIMITS.bellows(&q, 20.0), (q, Cut::None));
        let u = q * 3.2;
        assert_eq!(LIMITS.pistons(&u, &q), (u, Cut::None));
    }
}
