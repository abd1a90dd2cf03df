//! Transmission through the air line (paper, Eq. 12-17): extension and backlash, forward beside inverse.
//!
//! `q̃ = q + K_ε q + K_λ sgn(q̇)`: the piston must travel k_ε q further than the bellow (the air is a
//! spring) and k_λ to the side it moves to. The law is used in two directions:
//!
//! * forward, from piston to bellow, it is a play operator of half-width k_λ followed by 1/(1 + k_ε):
//!   the play output `w` moves only when the piston pushes against one end of the gap;
//! * inverse, from bellow to piston, it is Eq. 16 with the side as explicit state.
//!
//! The functions are pure: the side is an argument and a result. The paper allows tanh in place of sgn, which is
//! [`Side::Smooth`].

/// Gains of one channel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, Default)]
pub struct Line {
    /// Extension gain k_ε, dimensionless (Eq. 14): bellow stiffness over air stiffness.
    pub k_epsilon: f64,
    /// Backlash half-width k_λ, mm (Eq. 15).
    pub k_lambda_mm: f64,
}

/// Largest gain, and largest half-width of the play, mm.
const GAIN_MAX: f64 = 100.0;
const PLAY_MAX_MM: f64 = 100.0;

impl Line {
    /// Three lines from their gains.
    pub fn each(k_epsilon: [f64; 3], k_lambda_mm: [f64; 3]) -> [Self; 3] {
        std::array::from_fn(|i| Self {
            k_epsilon: k_epsilon[i],
            k_lambda_mm: k_lambda_mm[i],
        })
    }

    /// True if a line can have these gains, wherever they were read: far beyond those of the paper.
    pub fn is_possible(&self) -> bool {
        (0.0..=GAIN_MAX).contains(&self.k_epsilon)
            && (0.0..=PLAY_MAX_MM).contains(&self.k_lambda_mm)
    }

    /// Play operator: the output `w` after the piston moves to `piston_mm`.
    pub fn play(&self, w_mm: f64, piston_mm: f64) -> f64 {
        w_mm.max(piston_mm - self.k_lambda_mm)
            .min(piston_mm + self.k_lambda_mm)
    }
    /// Bellow length change for a play output, `q = w / (1 + k_ε)`.
    pub fn bellow_mm(&self, w_mm: f64) -> f64 {
        w_mm / (1.0 + self.k_epsilon)
    }
    /// Play output for a bellow length change: inverse of [`Line::bellow_mm`].
    pub fn play_output_mm(&self, q_mm: f64) -> f64 {
        q_mm * (1.0 + self.k_epsilon)
    }
    /// Eq. 16: piston displacement q̃ for bellow change `q_mm`, pushing to `side` (−1..=1).
    pub fn piston_mm(&self, q_mm: f64, side: f64) -> f64 {
        self.play_output_mm(q_mm) + self.k_lambda_mm * side
    }
}

/// How the side sgn(q̇) of Eq. 15 follows the commanded motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Side {
    /// The side changes only once the commanded play output has reversed by more than the band (mm of play
    /// output). Inside the band nothing moves, so the loop cannot limit-cycle in the gap.
    Band {
        /// Reversal that is ignored, mm.
        band_mm: f64,
    },
    /// The paper's smooth option: tanh(q̇ / rate).
    Smooth {
        /// Speed of the play output at which the compensation reaches 76 % of k_λ, mm/s.
        rate_mm_s: f64,
    },
}

/// State of the inverse of one channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SideState {
    /// Play output last commanded, mm.
    pub w_mm: f64,
    /// Position of the piston in its gap: −1..=1, 0 before the first motion (play starts centred).
    pub side: f64,
    /// Direction of the last motion: −1, 1, or 0 before the first.
    pub direction: f64,
}

impl Side {
    /// The inverse with state: from a commanded bellow change, mm, to piston position and new state. The time since the last command, s, is
    /// used by the smooth form only.
    pub fn invert(&self, line: &Line, state: SideState, q_mm: f64, dt_s: f64) -> (f64, SideState) {
        let want = line.play_output_mm(q_mm);
        let next = match *self {
            Self::Band { band_mm } => band(state, want, band_mm),
            Self::Smooth { rate_mm_s } => {
                let rate = (want - state.w_mm) / dt_s;
                SideState {
                    w_mm: want,
                    side: (rate / rate_mm_s).tanh(),
                    direction: rate.signum(),
                }
            }
        };
        (next.w_mm + line.k_lambda_mm * next.side, next)
    }
}

/// Follows motion in the direction of the last; ignores a reversal up to the band; otherwise reverses.
fn band(state: SideState, want: f64, band_mm: f64) -> SideState {
    let ahead = want - state.w_mm;
    if ahead * state.direction > 0.0 {
        SideState {
            w_mm: want,
            side: state.direction,
            ..state
        }
    } else if ahead.abs() > band_mm {
        let direction = ahead.signum();
        SideState {
            w_mm: want,
            side: direction,
            direction,
        }
    } else {
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Time between two commands, s.
    const DT_S: f64 = 1e-3;

    fn line() -> impl Strategy<Value = Line> {
        (0.0..5.0f64, 0.0..2.0f64).prop_map(|(k_epsilon, k_lambda_mm)| Line {
            k_epsilon,
            k_lambda_mm,
        })
    }

    proptest! {
        /// Inverse then forward reproduces every commanded motion, through any number of reversals.
        #[test]
        fn round_trips_through_reversals(l in line(), path in prop::collection::vec(-6.0..6.0f64, 1..60)) {
            let mut inv = SideState::default();
            let mut w = 0.0;
            for q in path {
                let (u, next) = Side::Band { band_mm: 0.0 }.invert(&l, inv, q, DT_S);
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
                let (u, next) = Side::Band { band_mm }.invert(&l, inv, q, DT_S);
                let (again, _) = Side::Band { band_mm }.invert(&l, next, l.bellow_mm(next.w_mm) - next.side * 0.9 * l.bellow_mm(band_mm), DT_S);
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
            // arriving from far on the other side, the play output is pushed from behind
            let w = l.play(l.play_output_mm(q) - side * 50.0, u);
            prop_assert!((l.bellow_mm(w) - q).abs() < 1e-9);
        }

        #[test]
        fn tanh_tends_to_the_sign(l in line(), q in 0.5..6.0f64) {
            let smooth = Side::Smooth { rate_mm_s: 1e-3 };
            let (u, _) = smooth.invert(&l, SideState::default(), q, DT_S);
            prop_assert!((u - l.piston_mm(q, 1.0)).abs() < 1e-9);
            let held = SideState { w_mm: l.play_output_mm(q), side: 1.0, direction: 1.0 };
            let (u, _) = smooth.invert(&l, held, q, DT_S);
            prop_assert!((u - l.play_output_mm(q)).abs() < 1e-9);
        }
    }
}
