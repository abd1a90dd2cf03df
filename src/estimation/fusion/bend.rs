//! Bend-constrained orientation estimator: an error-state Kalman filter with a model of the mechanism.
//!
//! A generic attitude filter estimates three free angles and needs the magnetometer for one of them. The tip has
//! fewer degrees of freedom: relative to the base frame of the alignment it bends (Eq. 7) and twists a little as it
//! bends. Gravity alone therefore determines its orientation in almost every attitude, and the field is an
//! additional measurement. In the direction that gravity does not observe (bending about the vertical) the filter
//! depends on gyroscope and field, and its covariance shows it.
//!
//! The orientation is a quaternion `S`, sensor now to sensor during alignment. The 24 error states are
//!
//! | entry | symbol | unit |
//! |---|---|---|
//! | 0-2 | θ, error of S, `S_true = Exp(θ) S` | rad |
//! | 3-5 | b_g, gyroscope bias | rad/s |
//! | 6-8 | b_a, accelerometer bias | m/s² |
//! | 9-11 | b_m, field of the tip's own iron | µT |
//! | 12 | c, twist per bend (torsion) | rad/rad |
//! | 13-14 | μ, tilt about x and y of the axis that bending never turns about | rad |
//! | 15-17 | φ, rotation of the base beyond the known one, `S_true = Exp(φ + θ) S` | rad |
//! | 18-20 | w, error of the field in the base | µT |
//! | 21-23 | s, scale error of the gyroscope | |
//!
//! * **Gyroscope**: `Ṡ = S [ω − b_g − s ω]×`, so `θ̇ = −S (δb_g + ω δs)`. An error on the left does not turn with the tip.
//! * **Acceleration**: the sensor sits at a known place on an arc, so the gyroscope determines its acceleration,
//!   which is subtracted before the specific force counts as gravity.
//! * **Gravity and field**: a world-fixed vector reads `v₀ = v + b` during alignment and `Sᵀ (v₀ − b) + b` later. Turned
//!   into the base it is `S (v − b) = v₀ − b`, with a slope by θ that does not depend on S: readings are averaged there
//!   over a window. Each bias becomes observable after a few poses.
//! * **Mechanism**: the twist ψ of S about the axis `a = Exp(−μ) z` is c β, with an error for torsion that is not
//!   proportional. The error is correlated in time, so the gyroscope determines the twist within a motion.
//! * **Standstill**: while the pistons stand the gyroscope measures its bias and the rate that the tip still has.
//!
//! What the sensor suffers from cannot be known beforehand, and each remedy harms where it is not needed: a bias that may
//! wander takes creep of the tip for drift, and one that may not loses the tip when the part warms up. Five **hypotheses**
//! have a Kalman filter each, around the same nominal values: the gyroscope is steady; its bias drifts, fast or slowly; its rate is
//! wrong while the tip turns (samples that are late by a time that wanders, a scale that changes); the base sways. Estimate and covariance
//! are those of the mixture.
//!
//! A tilted chip turns a pure bend R into `S = Mᵀ R M`; a tip that sags by b₀ during alignment gives `R(b₀)ᵀ R(b)`.
//! As quaternions both form the plane through 1 that is orthogonal to a = Mᵀ z, with half of b₀ in place of μ, so
//! one tilt describes both. What exceeds sag and torsion is a chip that is mounted askew: the output is M S Mᵀ.

mod bank;
mod config;
mod corrections;
mod kalman;
mod laws;
mod prediction;
mod reacquisition;
mod state;
#[cfg(test)]
mod tests;
mod window;

pub use config::BendFilterConfig;
pub(crate) use laws::right_jacobian_inverse;
pub use state::BendFilter;
