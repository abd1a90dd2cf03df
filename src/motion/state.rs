//! Kinematic state of one channel and its motion under constant jerk.
//!
//! Under constant jerk j (mm/s³) for a time t (s):
//! `p(t) = p + v t + a t²/2 + j t³/6`, `v(t) = v + a t + j t²/2`, `a(t) = a + j t`.
//! A motion is a chain of such pieces. Conditions that must hold at all times are checked on the
//! closed form of each piece (its ends and inner extrema), never on samples.

/// Position, velocity and acceleration of one piston.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionState {
    /// Piston displacement from rest, mm; positive elongates the bellow.
    pub position_mm: f64,
    /// Velocity, mm/s.
    pub velocity_mm_s: f64,
    /// Acceleration, mm/s².
    pub acceleration_mm_s2: f64,
}

impl MotionState {
    /// At rest at a position.
    pub fn rest(position_mm: f64) -> Self {
        Self {
            position_mm,
            ..Self::default()
        }
    }

    /// Whether velocity and acceleration are zero.
    pub fn is_rest(&self) -> bool {
        self.velocity_mm_s == 0.0 && self.acceleration_mm_s2 == 0.0
    }

    /// The state after `t_s` of constant jerk.
    pub fn after(&self, jerk_mm_s3: f64, t_s: f64) -> Self {
        let (v, a, t) = (self.velocity_mm_s, self.acceleration_mm_s2, t_s);
        Self {
            position_mm: self.position_mm + t * (v + t * (a / 2.0 + t * jerk_mm_s3 / 6.0)),
            velocity_mm_s: v + t * (a + t * jerk_mm_s3 / 2.0),
            acceleration_mm_s2: a + t * jerk_mm_s3,
        }
    }

    /// The instants inside (0, `duration_s`) at which the velocity changes sign, in order, s.
    pub fn reversals(&self, jerk_mm_s3: f64, duration_s: f64) -> impl Iterator<Item = f64> + use<> {
        let (v, a, j) = (self.velocity_mm_s, self.acceleration_mm_s2, jerk_mm_s3);
        let end = self.after(j, duration_s);
        let discriminant = a * a - 2.0 * j * v;
        // Two roots need an acceleration that changes sign; one root needs a velocity that does.
        let monotone = v * end.velocity_mm_s > 0.0 && a * end.acceleration_mm_s2 >= 0.0;
        let mut found = [None; 2];
        if !monotone && discriminant >= 0.0 {
            // The stable pair of roots of j/2 t² + a t + v: neither subtracts nearly equal numbers.
            let q = -(a + discriminant.sqrt().copysign(a));
            let (x, y) = (q / j, if q == 0.0 { f64::NAN } else { 2.0 * v / q });
            let (first, second) = if x <= y { (x, y) } else { (y, x) };
            let inside = |t: &f64| *t > 0.0 && *t < duration_s;
            found[0] = Some(first).filter(inside);
            found[1] = Some(second)
                .filter(inside)
                .filter(|t| found[0].is_none_or(|first| *t > first));
        }
        found.into_iter().flatten()
    }

    /// Least and greatest position over `duration_s` of constant jerk, ends included, mm.
    pub fn position_range(&self, jerk_mm_s3: f64, duration_s: f64) -> (f64, f64) {
        let end = self.after(jerk_mm_s3, duration_s).position_mm;
        let ends = (self.position_mm.min(end), self.position_mm.max(end));
        self.reversals(jerk_mm_s3, duration_s)
            .fold(ends, |(low, high), t| {
                let p = self.after(jerk_mm_s3, t).position_mm;
                (low.min(p), high.max(p))
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The velocity is zero at each reversal and keeps its sign between reversals.
        #[test]
        fn reversals_split_a_piece_into_monotone_parts(
            v in -30.0..30.0f64, a in -300.0..300.0f64, j in -6000.0..6000.0f64, d in 1e-4..0.2f64,
        ) {
            let s = MotionState { position_mm: 0.0, velocity_mm_s: v, acceleration_mm_s2: a };
            let mut knots = vec![0.0];
            for t in s.reversals(j, d) {
                prop_assert!(s.after(j, t).velocity_mm_s.abs() < 1e-9);
                knots.push(t);
            }
            knots.push(d);
            for k in knots.windows(2) {
                let sign = s.after(j, 0.5 * (k[0] + k[1])).velocity_mm_s.signum();
                for i in 1..20 {
                    let t = k[0] + (k[1] - k[0]) * f64::from(i) / 20.0;
                    prop_assert!(s.after(j, t).velocity_mm_s * sign > -1e-9);
                }
            }
        }

        /// No sample lies outside the position range, and samples come close to both ends of it.
        #[test]
        fn position_range_is_tight(
            v in -30.0..30.0f64, a in -300.0..300.0f64, j in -6000.0..6000.0f64, d in 1e-4..0.2f64,
        ) {
            let s = MotionState { position_mm: 1.0, velocity_mm_s: v, acceleration_mm_s2: a };
            let (low, high) = s.position_range(j, d);
            let mut sampled = (f64::MAX, f64::MIN);
            for i in 0..=2000 {
                let p = s.after(j, d * f64::from(i) / 2000.0).position_mm;
                prop_assert!(p >= low - 1e-12 && p <= high + 1e-12);
                sampled = (sampled.0.min(p), sampled.1.max(p));
            }
            prop_assert!(sampled.0 - low < 1e-4 && high - sampled.1 < 1e-4);
        }
    }

    #[test]
    fn zero_jerk_and_zero_motion_are_handled() {
        assert_eq!(MotionState::rest(3.0).reversals(0.0, 1.0).next(), None);
        let cruise = MotionState {
            velocity_mm_s: 2.0,
            ..MotionState::rest(0.0)
        };
        assert_eq!(cruise.reversals(0.0, 1.0).next(), None);
        let brake = MotionState {
            velocity_mm_s: 2.0,
            acceleration_mm_s2: -4.0,
            ..MotionState::rest(0.0)
        };
        assert!(brake.reversals(0.0, 1.0).eq([0.5]));
    }
}
