//! Base motion without a base IMU: rotation that no piston explains.
//!
//! The measured rate ω is taken apart by the constraint: `φ̇ = J_r⁻¹(φ) ω` has a z part that no
//! constant-curvature section can make, and x, y parts that the pistons should have caused. Two
//! watches follow from that.
//!
//! * **Twist**: `∫ φ̇_z`, forgotten over a second. Torsion and a tilted mount make some of it, in
//!   proportion to the set-point's motion, and as much is allowed: at first what any tip may make, later
//!   what this one has been seen to.
//! * **Bend**: `∫ (φ̇_xy − model)`, from the moment on at which the loop had settled on a resting
//!   set-point. Only then: during a motion the model is not exact enough to accuse the base. And only
//!   when the turn began while the pistons stood: a tip that is held differs by *not* turning while
//!   it is pushed, and a gap believed too wide by turning more than it was pushed.
//!
//! A turn that looks like bending and comes while the tip moves is seen by neither: a cable that pulls taut, or
//! a wall, makes a tip lag its pistons by as much, and all three read the same on one IMU. It is said, as
//! something outside, once it is more than such a cable does.
//!
//! What looks like bending and comes slowly (a leak, creep, a base that is tilted over a minute) stays
//! below both, and is corrected by the loop as bending. In one pose only a base IMU can tell that apart. Over
//! several poses a turned base shows as twist that gravity and field say and the mechanism cannot make:
//! the estimator's misfit ([`super::bend::BendFilter::twist_misfit`]) earns it a word, but no freeze, since a field
//! that lies does the same.

use crate::estimation::fusion::intake::share;
use crate::parameters;
use nalgebra::{Vector2, Vector3};

parameters! {
    /// Detection of base motion without a base IMU.
    pub struct WatchConfig: Copy {
        /// Detects base motion.
        enabled: bool = true;
        /// Unexplained twist that flags base motion. A larger value misses larger turns.
        twist_deg: f64 = 5.0, "deg", 0.1..=90.0, "5 is above the noise of the estimate";
        /// Twist that is allowed per degree of set-point motion: torsion and a tilted mount. Less is allowed once the tip has
        /// shown that it twists less. A larger value attributes more of a turn to the tip.
        twist_share: f64 = 0.45, "", 0.0..=2.0, "0.45 covers torsion and a tilted mount";
        /// Unexplained bend that flags base motion. A larger value misses larger turns.
        bend_deg: f64 = 5.5, "deg", 0.1..=90.0, "5.5 is above what creep makes";
        /// Unexplained bend at which the pistons are required to stand. A larger value tests it when the loop has already
        /// reacted to the turn.
        onset_deg: f64 = 0.4, "deg", 0.01..=90.0, "below bend_deg";
        /// Error below which the loop counts as settled. A larger value starts to watch sooner after a motion, with a less
        /// exact model.
        settled_deg: f64 = 1.5, "deg", 0.01..=45.0, "1.5 is reached soon after a motion";
        /// Twist against the mechanism, in standard deviations over 3 s, above which the status reports that the base may
        /// have turned slowly. A larger value misses larger turns.
        misfit: f64 = 0.8, "sigma", 0.05..=100.0, "0.8 is reached by a slow turn of the base";
        /// Time constant with which both quantities are forgotten. A larger value detects slower turns, and more creep.
        memory_s: f64 = 1.5, "s", 0.1..=600.0, "1.5 is longer than a motion of the base";
    }
}

/// What the watch is told at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WatchInput {
    /// Rate of the tip, bias taken off, tip axes, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Felt bend vector, rad.
    pub estimate: Vector2<f64>,
    /// Bend that the pistons should give by now, rad.
    pub model: Vector2<f64>,
    /// Set-point on its way, rad.
    pub setpoint: Vector2<f64>,
    /// Target less felt, rad.
    pub remaining: Vector2<f64>,
    /// For how long the pistons have stood, s.
    pub still_s: f64,
    /// Lag and dead time of the line together, s.
    pub response_s: f64,
    /// Twist per bend that this tip may make, by what it has shown, rad/rad; `None` where nobody knows.
    pub twist_per_bend_max: Option<f64>,
    /// Time since the last tick, s.
    pub dt_s: f64,
}

/// What the watch remembers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Watch {
    last: Option<(Vector2<f64>, Vector2<f64>)>,
    path_fast: f64,
    path_slow: f64,
    twist: f64,
    twisted_s: f64,
    settled: bool,
    bend: Vector2<f64>,
    onset: Onset,
}

/// How the present unexplained bend began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Onset {
    /// There is none.
    #[default]
    None,
    /// While the pistons stood.
    ByItself,
    /// While they moved, or not to be told.
    Pushed,
}

/// A flag needs this long, s.
const CONFIRM_S: f64 = 0.03;
/// Path of the set-point that counts as none, rad.
const RESTING_RAD: f64 = 0.017;
/// Unexplained motion that is nothing out of the ordinary, rad.
const QUIET_RAD: f64 = 0.017;

impl Watch {
    /// One tick; true when the base must have moved.
    pub fn step(&mut self, config: &WatchConfig, input: &WatchInput) -> bool {
        let (model, setpoint) = self.last.replace((input.model, input.setpoint)).unwrap_or((input.model, input.setpoint));
        let path = (input.setpoint - setpoint).norm();
        let keep = |tau_s: f64| (-input.dt_s / tau_s).exp();
        self.path_fast = self.path_fast * keep(0.25 + 2.0 * input.response_s) + path;
        self.path_slow = self.path_slow * keep(0.6 + 2.0 * input.response_s) + path;
        let phi_rate = constrained(&input.estimate, &input.rate_rad_s);
        let fade = 1.0 - share(input.dt_s, config.memory_s);
        self.twist = self.twist * fade + phi_rate.z * input.dt_s;
        // b = (φ_y, φ_x)
        let turned = Vector2::new(phi_rate.y, phi_rate.x) * input.dt_s;
        self.follow_bend(config, input, turned, input.model - model, fade);
        self.exceeds(config, input)
    }

    fn follow_bend(&mut self, config: &WatchConfig, input: &WatchInput, turned: Vector2<f64>, modelled: Vector2<f64>, fade: f64) {
        if self.path_fast > RESTING_RAD {
            (self.settled, self.bend, self.onset) = (false, Vector2::zeros(), Onset::None);
        } else if self.settled {
            self.bend = self.bend * fade + turned - modelled;
            let (size, onset) = (self.bend.norm(), config.onset_deg.to_radians());
            if size < 0.5 * onset {
                self.onset = Onset::None;
            } else if size > onset && self.onset == Onset::None {
                let stood = input.still_s > 2.0 * input.response_s;
                self.onset = if stood { Onset::ByItself } else { Onset::Pushed };
            }
        } else {
            self.settled = input.remaining.norm() < config.settled_deg.to_radians();
        }
    }

    fn exceeds(&mut self, config: &WatchConfig, input: &WatchInput) -> bool {
        let share = input.twist_per_bend_max.map_or(config.twist_share, |shown| config.twist_share.min(shown));
        let twist_max = config.twist_deg.to_radians() + share * self.path_slow;
        self.twisted_s = if self.twist.abs() > twist_max { self.twisted_s + input.dt_s } else { 0.0 };
        let bent = self.bend.norm() > config.bend_deg.to_radians() && self.onset == Onset::ByItself;
        config.enabled && (bent || self.twisted_s > CONFIRM_S)
    }

    /// Settled, and nothing out of the ordinary in the last second: what stands now may be returned to.
    #[must_use]
    pub fn quiet(&self) -> bool {
        self.settled && self.bend.norm() < QUIET_RAD && self.twist.abs() < QUIET_RAD
    }
}

/// Rate of the rotation vector φ = (b_y, b_x, 0) that a tip rate would make: J_r⁻¹(φ) ω.
fn constrained(bend: &Vector2<f64>, rate: &Vector3<f64>) -> Vector3<f64> {
    let phi = Vector3::new(bend.y, bend.x, 0.0);
    super::bend::right_jacobian_inverse(&phi) * rate
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.005;

    /// Runs the watch over 4 s at a bend of 40°; returns when it flags.
    fn flagged(
        rate: impl Fn(f64) -> Vector3<f64>,
        model: impl Fn(f64) -> Vector2<f64>,
        setpoint: impl Fn(f64) -> Vector2<f64>,
        remaining: Vector2<f64>,
    ) -> Option<f64> {
        let mut watch = Watch::default();
        (0..800).map(|k| f64::from(k) * DT_S).find(|&t| {
            let input = WatchInput {
                rate_rad_s: rate(t),
                estimate: Vector2::new(0.7, 0.0),
                model: model(t),
                setpoint: setpoint(t),
                remaining,
                still_s: if model(t) == model(t - DT_S) { 1.0 } else { 0.0 },
                response_s: 0.04,
                twist_per_bend_max: None,
                dt_s: DT_S,
            };
            watch.step(&WatchConfig::default(), &input)
        })
    }

    fn resting(_: f64) -> Vector2<f64> {
        Vector2::new(0.7, 0.0)
    }

    fn turn(axis: Vector3<f64>, deg: f64, over_s: f64) -> impl Fn(f64) -> Vector3<f64> {
        move |t| if (1.0..1.0 + over_s).contains(&t) { axis * (deg.to_radians() / over_s) } else { Vector3::zeros() }
    }

    #[test]
    fn a_base_turned_by_ten_degrees_is_seen_about_any_axis() {
        for axis in [Vector3::x(), Vector3::y(), Vector3::z(), Vector3::new(0.6, 0.0, 0.8), Vector3::new(0.577, -0.577, 0.577)] {
            for over_s in [0.05, 0.4, 1.0] {
                let t = flagged(turn(axis, 10.0, over_s), resting, resting, Vector2::zeros());
                assert!(t.is_some_and(|t| t - 1.0 < 1.0), "{axis} in {over_s} s: {t:?}");
            }
        }
    }

    #[test]
    fn creep_and_a_held_tip_are_not_the_base() {
        let creep = flagged(|_| Vector3::x() * 1.5f64.to_radians(), resting, resting, Vector2::zeros());
        assert_eq!(creep, None);
        let pushing = |t: f64| Vector2::new(0.7 + 0.1 * t, 0.0);
        assert_eq!(flagged(|_| Vector3::zeros(), pushing, resting, Vector2::new(0.02, 0.0)), None);
        assert_eq!(flagged(turn(Vector3::y(), 10.0, 0.3), resting, resting, Vector2::new(0.2, 0.0)), None, "not settled");
    }

    #[test]
    fn a_tip_that_has_shown_that_it_twists_little_is_allowed_little() {
        let flags = |limit: Option<f64>| {
            let mut watch = Watch::default();
            (0..200).any(|k| {
                let t = f64::from(k) * DT_S;
                let bend = Vector2::new(0.2 + t.min(1.0), 0.0);
                let twisting = if t < 0.5 { 0.4 } else { 0.0 };
                let rate_rad_s = Vector3::new(0.0, 1.0, twisting);
                let input = WatchInput {
                    rate_rad_s,
                    estimate: bend,
                    model: bend,
                    setpoint: bend,
                    remaining: bend,
                    still_s: 0.0,
                    response_s: 0.04,
                    twist_per_bend_max: limit,
                    dt_s: DT_S,
                };
                watch.step(&WatchConfig::default(), &input)
            })
        };
        assert!(!flags(None), "any tip may make 11° of twist over half a radian");
        assert!(flags(Some(0.1)) && !flags(Some(3.0)), "this one may not; and none may make more than the configured");
    }

    #[test]
    fn motion_that_was_asked_for_is_not_the_base() {
        // 60° in a second, with a fifth of it in twist and half of it not in the model
        let asked = |t: f64| Vector2::new((t - 1.0).clamp(0.0, 1.0) * 1.05, 0.0);
        let half = move |t: f64| asked(t) * 0.5;
        let rate = |t: f64| if (1.0..2.0).contains(&t) { Vector3::new(0.0, 1.05, 0.2) } else { Vector3::zeros() };
        assert_eq!(flagged(rate, half, asked, Vector2::zeros()), None);
    }
}
