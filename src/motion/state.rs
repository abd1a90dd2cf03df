//! One channel's kinematic state and its motion under constant jerk.
//!
//! Under constant jerk j (mm/s³) for a time t (s):
//! `p(t) = p + v t + a t²/2 + j t³/6`, `v(t) = v + a t + j t²/2`, `a(t) = a + j t`.
//! A motion is a chain of such pieces; everything that must hold "at all times" is checked on the
//! pieces' closed form (ends and inner extrema), never on samples.

/// Position, velocity and acceleration of one piston.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionState {
    /// Piston displacement from rest, mm, + elongates the bellow.
    pub position_mm: f64,
    /// Velocity, mm/s.
    pub velocity_mm_s: f64,
    /// Acceleration, mm/s².
    pub acceleration_mm_s2: f64,
}

impl MotionState {
    /// Standing still at a position.
    #[must_use]
    pub fn rest(position_mm: f64) -> Self {
        Self { position_mm, ..Self::default() }
    }

    /// True when nothing moves and nothing is about to.
    #[must_use]
    pub fn is_rest(&self) -> bool {
        self.velocity_mm_s == 0.0 && self.acceleration_mm_s2 == 0.0
    }

    /// The state after `t_s` of constant jerk.
    #[inline]
    #[must_use]
    pub fn after(&self, jerk_mm_s3: f64, t_s: f64) -> Self {
        let (v, a, t) = (self.velocity_mm_s, self.acceleration_mm_s2, t_s);
        Self {
            position_mm: self.position_mm + t * (v + t * (a / 2.0 + t * jerk_mm_s3 / 6.0)),
            velocity_mm_s: v + t * (a + t * jerk_mm_s3 / 2.0),
            acceleration_mm_s2: a + t * jerk_mm_s3,
        }
    }

    /// The instants inside (0, `duration_s`) at which the piston turns round, in order.
    #[inline]
    #[must_use]
    pub fn turns(&self, jerk_mm_s3: f64, duration_s: f64) -> Turns {
        let (v, a, j) = (self.velocity_mm_s, self.acceleration_mm_s2, jerk_mm_s3);
        let end = self.after(j, duration_s);
        // Two roots need an acceleration that changes sign; one needs a velocity that does.
        if v * end.velocity_mm_s > 0.0 && a * end.acceleration_mm_s2 >= 0.0 {
            return Turns::default();
        }
        let disc = a * a - 2.0 * j * v;
        if disc < 0.0 {
            return Turns::default();
        }
        // The stable pair of roots of j/2 t² + a t + v: neither subtracts nearly equal numbers.
        let q = -(a + disc.sqrt().copysign(a));
        let mut turns = Turns::default();
        let (x, y) = (q / j, if q == 0.0 { f64::NAN } else { 2.0 * v / q });
        let (first, second) = if x <= y { (x, y) } else { (y, x) };
        turns.add(first, duration_s);
        turns.add(second, duration_s);
        turns
    }

    /// Least and greatest position over `duration_s` of constant jerk, ends included.
    #[must_use]
    pub fn reach(&self, jerk_mm_s3: f64, duration_s: f64) -> (f64, f64) {
        let end = self.after(jerk_mm_s3, duration_s).position_mm;
        let ends = (self.position_mm.min(end), self.position_mm.max(end));
        self.turns(jerk_mm_s3, duration_s).as_slice().iter().fold(ends, |(low, high), &t| {
            let p = self.after(jerk_mm_s3, t).position_mm;
            (low.min(p), high.max(p))
        })
    }
}

/// Up to two turning instants of one piece, in order.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Turns {
    t_s: [f64; 2],
    len: usize,
}

impl Turns {
    /// The instants, s from the start of the piece.
    #[must_use]
    pub fn as_slice(&self) -> &[f64] {
        &self.t_s[..self.len]
    }

    fn add(&mut self, t_s: f64, duration_s: f64) {
        let fresh = self.len == 0 || t_s > self.t_s[0];
        if t_s > 0.0 && t_s < duration_s && fresh {
            self.t_s[self.len] = t_s;
            self.len += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Turning points are where the velocity is zero, and between them it keeps its sign.
        #[test]
        fn turns_split_into_monotone_parts(
            v in -30.0..30.0f64, a in -300.0..300.0f64, j in -6000.0..6000.0f64, d in 1e-4..0.2f64,
        ) {
            let s = MotionState { position_mm: 0.0, velocity_mm_s: v, acceleration_mm_s2: a };
            let turns = s.turns(j, d);
            let mut knots = vec![0.0];
            knots.extend_from_slice(turns.as_slice());
            knots.push(d);
            for &t in turns.as_slice() {
                prop_assert!(s.after(j, t).velocity_mm_s.abs() < 1e-9);
            }
            for k in knots.windows(2) {
                let sign = s.after(j, 0.5 * (k[0] + k[1])).velocity_mm_s.signum();
                for i in 1..20 {
                    let t = k[0] + (k[1] - k[0]) * f64::from(i) / 20.0;
                    prop_assert!(s.after(j, t).velocity_mm_s * sign > -1e-9);
                }
            }
        }

        /// No sample lies outside the reach, and the reach is attained.
        #[test]
        fn reach_holds_every_sample(
            v in -30.0..30.0f64, a in -300.0..300.0f64, j in -6000.0..6000.0f64, d in 1e-4..0.2f64,
        ) {
            let s = MotionState { position_mm: 1.0, velocity_mm_s: v, acceleration_mm_s2: a };
            let (low, high) = s.reach(j, d);
            let mut seen = (f64::MAX, f64::MIN);
            for i in 0..=2000 {
                let p = s.after(j, d * f64::from(i) / 2000.0).position_mm;
                prop_assert!(p >= low - 1e-12 && p <= high + 1e-12);
                seen = (seen.0.min(p), seen.1.max(p));
            }
            prop_assert!(seen.0 - low < 1e-4 && high - seen.1 < 1e-4);
        }
    }

    #[test]
    fn no_jerk_and_no_motion_turn_nowhere() {
        assert!(MotionState::rest(3.0).turns(0.0, 1.0).as_slice().is_empty());
        let cruise = MotionState { velocity_mm_s: 2.0, ..MotionState::rest(0.0) };
        assert!(cruise.turns(0.0, 1.0).as_slice().is_empty());
        let brake = MotionState { velocity_mm_s: 2.0, acceleration_mm_s2: -4.0, ..MotionState::rest(0.0) };
        assert_eq!(brake.turns(0.0, 1.0).as_slice(), &[0.5]);
    }
}
