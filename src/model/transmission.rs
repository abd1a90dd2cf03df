//! Transmission through the air line (paper, Eq. 12-17): extension and backlash, forward beside inverse.
//!
//! `q̃ = q + K_ε q + K_λ sgn(q̇)`: the piston must travel k_ε q further than the bellow (the air is a
//! spring) and k_λ to the side it moves to. The law has two readings:
//!
//! * forward, from piston to bellow, it is a play operator of half-width k_λ followed by 1/(1 + k_ε):
//!   the hidden slack `w` is dragged along only when the piston pushes against one end of the gap;
//! * inverse, from bellow to piston, it is Eq. 16 with the side as explicit state.
//!
//! The side is passed in and returned, never kept: these are laws, not behaviour. The paper allows
//! tanh in place of sgn; [`Side::Smooth`] is that.

/// Gains of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Extension gain k_ε, dimensionless (Eq. 14): bellow stiffness over air stiffness.
    pub k_epsilon: f64,
    /// Backlash half-width k_λ, mm (Eq. 15).
    pub k_lambda_mm: f64,
}

impl Line {
    /// Play operator: where the slack's far end `w` goes when the piston moves to `piston_mm`.
    #[must_use]
    pub fn play(&self, w_mm: f64, piston_mm: f64) -> f64 {
        w_mm.max(piston_mm - self.k_lambda_mm).min(piston_mm + self.k_lambda_mm)
    }
    /// Bellow length change of the slack's far end, `q = w / (1 + k_ε)`.
    #[must_use]
    pub fn bellow_mm(&self, w_mm: f64) -> f64 {
        w_mm / (1.0 + self.k_epsilon)
    }
    /// Slack position that gives a bellow length change: inverse of [`Line::bellow_mm`].
    #[must_use]
    pub fn slack_mm(&self, q_mm: f64) -> f64 {
        q_mm * (1.0 + self.k_epsilon)
    }
    /// Eq. 16: piston displacement q̃ for bellow change `q_mm`, pushing to `side` (−1..=1).
    #[must_use]
    pub fn piston_mm(&self, q_mm: f64, side: f64) -> f64 {
        self.slack_mm(q_mm) + self.k_lambda_mm * side
    }
}

/// How the side sgn(q̇) of Eq. 15 follows the wanted motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Side {
    /// The side flips only once the wanted slack position has turned back by more than the band
    /// (mm of slack): inside it nothing moves, so the loop cannot hunt in the gap.
    Band {
        /// Reversal that is ignored, mm.
        band_mm: f64,
    },
    /// The paper's smooth option: tanh(q̇ / rate).
    Smooth {
        /// Slack speed at which the compensation reaches 76 % of k_λ, mm/s.
        rate_mm_s: f64,
    },
}

/// What the inverse remembers of one channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SideState {
    /// Slack position last commanded, mm.
    pub w_mm: f64,
    /// Side pushed to: −1..=1, 0 before the first motion (play starts centred).
    pub side: f64,
}

impl Side {
    /// The inverse with memory: wanted bellow change in, piston position and new state out.
    ///
    /// `dt_s` is used by the smooth form only.
    #[must_use]
    pub fn invert(&self, line: &Line, state: SideState, q_mm: f64, dt_s: f64) -> (f64, SideState) {
        let want = line.slack_mm(q_mm);
        let next = match *self {
            Side::Band { band_mm } => band(state, want, band_mm),
            Side::Smooth { rate_mm_s } => {
                let rate = (want - state.w_mm) / dt_s;
                SideState { w_mm: want, side: (rate / rate_mm_s).tanh() }
            }
        };
        (next.w_mm + line.k_lambda_mm * next.side, next)
    }
}

/// Follow on in the direction of the side; ignore a reversal up to the band; else change sides.
fn band(state: SideState, want: f64, band_mm: f64) -> SideState {
    let ahead = want - state.w_mm;
    if ahead * state.side > 0.0 {
        SideState { w_mm: want, ..state }
    } else if ahead.abs() > band_mm {
        SideState { w_mm: want, side: ahead.signum() }
    } else {
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn line() -> impl Strategy<Value = Line> {
        (0.0..5.0f64, 0.0..2.0f64).prop_map(|(k_epsilon, k_lambda_mm)| Line { k_epsilon, k_lambda_mm })
    }

    proptest! {
        /// Inverse then forward gives back every wanted motion, through any number of reversals.
        #[test]
        fn round_trips_through_reversals(l in line(), path in prop::collection::vec(-6.0..6.0f64, 1..60)) {
            let mut inv = SideState::default();
            let mut w = 0.0;
            for q in path {
                let (u, next) = Side::Band { band_mm: 0.0 }.invert(&l, inv, q, 1e-3);
                inv = next;
                w = l.play(w, u);
                prop_assert!((l.bellow_mm(w) - q).abs() < 1e-9);
            }
        }

        /// With a band the error is at most the band, and a motion inside it moves no piston.
        #[test]
        fn a_band_bounds_the_error(l in line(), path in prop::collection::vec(-6.0..6.0f64, 1..60)) {
            let band_mm = 0.05;
            let mut inv = SideState::default();
            let mut w = 0.0;
            for q in path {
                let (u, next) = Side::Band { band_mm }.invert(&l, inv, q, 1e-3);
                let (again, _) = Side::Band { band_mm }.invert(&l, next, l.bellow_mm(next.w_mm) - next.side * 0.9 * l.bellow_mm(band_mm), 1e-3);
                prop_assert!((again - u).abs() < 1e-12);
                inv = next;
                w = l.play(w, u);
                prop_assert!((l.bellow_mm(w) - q).abs() <= l.bellow_mm(band_mm) + 1e-9);
            }
        }

        #[test]
        fn equation_16_round_trips(l in line(), q in -6.0..6.0f64, up in any::<bool>()) {
            let side = if up { 1.0 } else { -1.0 };
            let u = l.piston_mm(q, side);
            // arriving from far on the other side, the slack is pushed from behind
            let w = l.play(l.slack_mm(q) - side * 50.0, u);
            prop_assert!((l.bellow_mm(w) - q).abs() < 1e-9);
        }

        #[test]
        fn tanh_tends_to_the_sign(l in line(), q in 0.5..6.0f64) {
            let smooth = Side::Smooth { rate_mm_s: 1e-3 };
            let (u, _) = smooth.invert(&l, SideState::default(), q, 1e-3);
            prop_assert!((u - l.piston_mm(q, 1.0)).abs() < 1e-9);
            let held = SideState { w_mm: l.slack_mm(q), side: 1.0 };
            let (u, _) = smooth.invert(&l, held, q, 1e-3);
            prop_assert!((u - l.slack_mm(q)).abs() < 1e-9);
        }
    }
}
