//! Detection of base motion without a base IMU: rotation that the pistons do not explain.
//!
//! The constraint decomposes the measured rate ω: `φ̇ = J_r⁻¹(φ) ω` has a z component, which a section of constant
//! curvature cannot make, and x and y components, which the pistons should have caused. This gives two tests.
//!
//! * **Twist**: `∫ φ̇_z` with a memory of [`WatchConfig::memory_s`]. Torsion and a tilted mount cause some twist in
//!   proportion to the bend. [`TwistLaw`] learns how much with its covariance, and the test is of what that leaves, in
//!   standard deviations.
//! * **Bend**: `∫ (φ̇_xy − model)`, starting when the loop has settled on a constant set-point, since the model is not
//!   accurate enough during a motion. It counts only if the tip turned and the pistons had not driven it that way: an
//!   obstructed tip deviates by *not* turning while it is pushed, and an overestimated backlash by turning further
//!   than it is pushed.
//!
//! A twist that has reversed twice is a sway and no turn. [`super::sway`] estimates its size, so that the feedback can leave it out.
//!
//! Neither test detects a rotation that looks like bending while the tip moves. A cable that becomes taut, or an
//! obstruction, makes the tip lag its pistons by as much, and one IMU cannot tell the three apart. The residual
//! monitor of the supervisor reports larger deviations.
//!
//! A slow rotation that looks like bending (a leak, creep, a base that tilts over a minute) stays below both limits,
//! and the loop corrects it as bending. In one pose only a base IMU can detect it. Over several poses a turned base
//! causes a twist that contradicts the mechanism ([`super::bend::BendFilter::twist_misfit`]). That is reported but
//! does not freeze the feedback, since a disturbed field has the same effect.

use crate::estimation::fusion::bend::right_jacobian_inverse;
use crate::estimation::fusion::intake::share;
use crate::estimation::fusion::sway::Sway;
use crate::estimation::fusion::twist_law::TwistLaw;
use crate::model::Bend;
use crate::parameters;
use crate::primitives::{SURE_SIGMAS, lasting};
use nalgebra::{Vector2, Vector3};

parameters! {
    /// Detection of base motion without a base IMU.
    pub struct WatchConfig: Copy {
        /// Detects base motion.
        enabled: bool = true;
        /// Unexplained twist that flags base motion, in standard deviations. A larger value misses larger turns.
        twist_sigmas: f64 = 4.5, "sigma", 1.0..=100.0, "4.5 is above what torsion and tilt leave unexplained";
        /// Twist that neither bend nor noise explains on a base that stands, 1 σ. A larger value misses larger turns.
        twist_deg: f64 = 0.13, "deg", 0.01..=90.0, "0.13 is the error of a good gyroscope over a motion";
        /// Size of a turn of the base relative to its twist, once that is significant: the turn has only begun, and most of it is about
        /// other axes. A turn that is smaller than what the pistons alone may do wrong is corrected as bending. A larger value
        /// sets the feedback aside for smaller turns of a tip that is not known yet.
        turn_per_twist: f64 = 8.0, "", 0.0..=1e3, "8 is a turn of 5 deg noticed at 0.6 deg";
        /// Unexplained bend that flags base motion. A larger value misses larger turns.
        bend_deg: f64 = 5.5, "deg", 0.1..=90.0, "5.5 is above what creep makes";
        /// Unexplained bend at which it is asked whether the pistons caused it. A larger value asks later.
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

/// Input of the watch at one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WatchInput {
    /// Rate of the tip without the gyroscope bias, tip axes, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Estimated bend vector, rad.
    pub estimate: Vector2<f64>,
    /// Bend predicted from the pistons, rad.
    pub model: Vector2<f64>,
    /// Present set-point, rad.
    pub setpoint: Vector2<f64>,
    /// Target minus estimate, rad.
    pub remaining: Vector2<f64>,
    /// Time for which the pistons have stood still, s.
    pub still_s: f64,
    /// Sum of lag and dead time of the lines, s.
    pub response_s: f64,
    /// Variance of the integral of that rate over the memory, rad².
    pub turn_variance: f64,
    /// Time since the last tick, s.
    pub dt_s: f64,
}

/// State of the watch.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Watch {
    /// Model and set-point of the previous tick, rad.
    last: Option<(Vector2<f64>, Vector2<f64>)>,
    path_fast: f64,
    /// Bend that the pistons caused, and that the gyroscope measured, with the fast memory, rad.
    driven: Vector2<f64>,
    turned: Vector2<f64>,
    law: TwistLaw,
    /// Twist, and change of the bend vector and of its size, rad.
    twist: f64,
    change: Vector3<f64>,
    /// Unexplained twist, rad, and in standard deviations.
    unexplained: f64,
    sigmas: f64,
    settled: bool,
    /// Unexplained bend, rad.
    bend: Vector2<f64>,
    onset: Onset,
    /// The flag was raised by a twist.
    twisted: bool,
    /// Unexplained bend that came back by itself, rad: the tip sways, and the base does not.
    tolerated: f64,
    /// Largest unexplained bend since the flag, rad.
    excursion: f64,
    /// Time for which it has been back without a twist, s.
    back_s: f64,
    /// How much the base sways.
    pub sway: Sway,
}

/// How the present unexplained bend began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Onset {
    /// There is no unexplained bend.
    #[default]
    None,
    /// Not by the pistons.
    Unprovoked,
    /// By the pistons, or not known.
    Driven,
}

crate::constants! {
    /// What counts as rest, as the doing of the pistons, and as having come back.
    const WATCH: WatchConstants;
    /// Memory of the path of the set-point, in addition to twice the response time of the lines, s: it determines when the set-point counts
    /// as constant.
    path_fast_s = 0.25;
    /// Motion that counts as none, rad (1°): path of the set-point, unexplained bend, unexplained twist.
    quiet_rad = 0.017;
    /// Share of the onset from which a motion counts.
    driven_share = 0.5;
    /// Unexplained bend that counts as having come back, rad (1.5°).
    returned_rad = 0.026;
    /// Time for which it must have come back, s.
    return_after_s = 3.0;
    /// Tolerated sway, relative to the largest that came back.
    sway_margin = 1.3;
    /// Largest tolerated sway, rad (15°).
    sway_max_rad = 0.26;
}

impl Watch {
    /// Processes one tick; true when the base has moved. `open_loop_rad` is the standard deviation of the bend that the pistons alone
    /// would give, which is asked for when the twist is significant.
    pub fn step(
        &mut self,
        config: &WatchConfig,
        input: &WatchInput,
        open_loop_rad: impl FnOnce() -> f64,
    ) -> bool {
        let now = (input.model, input.setpoint);
        let (model, setpoint) = self.last.replace(now).unwrap_or(now);
        let path = (input.setpoint - setpoint).norm();
        let decay = |tau_s: f64| (-input.dt_s / (tau_s + 2.0 * input.response_s)).exp();
        self.path_fast = self.path_fast * decay(WATCH.path_fast_s) + path;
        // rate of the rotation vector φ = (b_y, b_x, 0)
        let phi = Bend(input.estimate).rotation_vector();
        let phi_rate = right_jacobian_inverse(&phi) * input.rate_rad_s;
        let fade = 1.0 - share(input.dt_s, config.memory_s);
        let twisted = phi_rate.z * input.dt_s;
        let disturbed = self.sigmas.abs() > SURE_SIGMAS;
        let change = (self.law).step(&input.estimate, twisted, disturbed, input.dt_s);
        self.twist = self.twist * fade + twisted;
        self.change = self.change * fade + change;
        self.unexplained = self.twist - self.law.twist(&self.change);
        let variance = config.twist_deg.to_radians().powi(2)
            + input.turn_variance
            + self.law.variance(&self.change);
        self.sigmas = self.unexplained / variance.sqrt();
        // b = (φ_y, φ_x)
        let turned = Vector2::new(phi_rate.y, phi_rate.x) * input.dt_s;
        self.driven = self.driven * decay(WATCH.path_fast_s) + input.model - model;
        self.turned = self.turned * decay(WATCH.path_fast_s) + turned;
        self.follow_bend(config, input, turned, input.model - model, fade);
        let significant = self.sigmas.abs() > SURE_SIGMAS;
        let side = if significant {
            self.sigmas.signum()
        } else {
            0.0
        };
        self.sway
            .step(&self.law, &change, twisted, side, input.dt_s);
        let held = (self.path_fast <= WATCH.quiet_rad)
            .then(|| (turned - (input.model - model), input.model - input.estimate));
        self.sway.hold(held, input.dt_s);
        self.exceeds(config, open_loop_rad)
    }

    fn follow_bend(
        &mut self,
        config: &WatchConfig,
        input: &WatchInput,
        turned: Vector2<f64>,
        modelled: Vector2<f64>,
        fade: f64,
    ) {
        if self.path_fast > WATCH.quiet_rad {
            (self.settled, self.bend, self.onset) = (false, Vector2::zeros(), Onset::None);
        } else if self.settled {
            self.bend = self.bend * fade + turned - modelled;
            let (size, onset) = (self.bend.norm(), config.onset_deg.to_radians());
            if size < 0.5 * onset {
                self.onset = Onset::None;
            } else if size > onset && self.onset == Onset::None {
                // the tip turned, and the pistons have not driven it that way; that the loop already corrects is no reason
                let way = self.bend / size;
                let most = WATCH.driven_share * onset;
                let turns = self.turned.dot(&way) > most && self.driven.dot(&way) < most;
                self.onset = if input.still_s > 2.0 * input.response_s || turns {
                    Onset::Unprovoked
                } else {
                    Onset::Driven
                };
            }
        } else {
            self.settled = input.remaining.norm() < config.settled_deg.to_radians();
        }
    }

    fn exceeds(&mut self, config: &WatchConfig, open_loop_rad: impl FnOnce() -> f64) -> bool {
        let bent = self.bend.norm() > config.bend_deg.to_radians() + self.tolerated
            && self.onset == Onset::Unprovoked
            && !self.sway.is_disturbance();
        let twisted = self.sigmas.abs() > config.twist_sigmas
            && !self.sway.sways()
            && config.turn_per_twist * self.unexplained.abs() > open_loop_rad();
        self.twisted |= twisted;
        config.enabled && (bent || twisted)
    }

    /// Follows the unexplained bend since the last quiet pose while the flag is up; true once it has come back without a
    /// twist. Then it was no turn of the base, or one that was undone, and sways of that size are tolerated from now on.
    /// A base that sways passes through agreement; so it must last. A disturbance that bends the tip again and again, and does not
    /// twist it, is none of the base.
    pub fn returned(&mut self, unexplained: &Vector2<f64>, dt_s: f64) -> bool {
        let size = unexplained.norm();
        self.excursion = self.excursion.max(size);
        let agrees = size < WATCH.returned_rad && self.unexplained.abs() < WATCH.quiet_rad;
        self.back_s = lasting(agrees, self.back_s, dt_s);
        let disturbed = self.sway.is_disturbance() && !self.twisted;
        let back = self.back_s >= WATCH.return_after_s || disturbed || self.sway.sways();
        if back {
            (self.back_s, self.twisted) = (0.0, false);
            let most = self.tolerated.max(WATCH.sway_margin * self.excursion);
            self.tolerated = most.min(WATCH.sway_max_rad);
            (self.excursion, self.bend, self.onset, self.settled) =
                (0.0, Vector2::zeros(), Onset::None, false);
        }
        back
    }

    /// The base has turned: seen from where it was, the tip twists otherwise.
    pub fn forget(&mut self, config: &WatchConfig) {
        let turn = config.turn_per_twist * self.unexplained;
        self.law.forget(turn, config.memory_s);
    }

    /// True if the loop has settled without unexplained motion: the present state is a valid one to return to.
    pub fn quiet(&self) -> bool {
        self.settled
            && self.bend.norm() < WATCH.quiet_rad
            && self.unexplained.abs() < WATCH.quiet_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.005;

    /// Runs the watch over 4 s at a bend of 40°; returns the time at which it raises the flag, s.
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
                still_s: if model(t) == model(t - DT_S) {
                    1.0
                } else {
                    0.0
                },
                response_s: 0.04,
                turn_variance: 0.0,
                dt_s: DT_S,
            };
            watch.step(&WatchConfig::default(), &input, || 0.0)
        })
    }

    fn constant(_: f64) -> Vector2<f64> {
        Vector2::new(0.7, 0.0)
    }

    fn turn(axis: Vector3<f64>, deg: f64, over_s: f64) -> impl Fn(f64) -> Vector3<f64> {
        move |t| {
            if (1.0..1.0 + over_s).contains(&t) {
                axis * (deg.to_radians() / over_s)
            } else {
                Vector3::zeros()
            }
        }
    }

    #[test]
    fn a_base_rotation_of_ten_degrees_is_detected_about_any_axis() {
        for axis in [
            Vector3::x(),
            Vector3::y(),
            Vector3::z(),
            Vector3::new(0.6, 0.0, 0.8),
            Vector3::new(0.577, -0.577, 0.577),
        ] {
            for over_s in [0.05, 0.4, 1.0] {
                let t = flagged(
                    turn(axis, 10.0, over_s),
                    constant,
                    constant,
                    Vector2::zeros(),
                );
                assert!(
                    t.is_some_and(|t| t - 1.0 < 1.0),
                    "{axis} in {over_s} s: {t:?}"
                );
            }
        }
    }

    #[test]
    fn creep_and_an_obstructed_tip_raise_no_flag() {
        let phi = Bend(constant(0.0)).rotation_vector();
        let turns = right_jacobian_inverse(&phi).try_inverse().unwrap();
        for axis in [Vector3::x(), Vector3::y()] {
            let rate = turns * axis * 1.5f64.to_radians();
            let creep = flagged(|_| rate, constant, constant, Vector2::zeros());
            assert_eq!(creep, None);
        }
        let pushing = |t: f64| Vector2::new(0.7 + 0.1 * t, 0.0);
        assert_eq!(
            flagged(
                |_| Vector3::zeros(),
                pushing,
                constant,
                Vector2::new(0.02, 0.0)
            ),
            None
        );
        assert_eq!(
            flagged(
                turn(Vector3::y(), 10.0, 0.3),
                constant,
                constant,
                Vector2::new(0.2, 0.0)
            ),
            None,
            "the loop has not settled"
        );
    }

    /// Times at which the watch raises its flag over 80 s, in which a tip with this twist per bend bends to and fro and its base turns
    /// about the axis of the tip by `angle`, rad; and the watch at the end.
    fn over_80_s(twist: f64, angle: impl Fn(f64) -> f64) -> (Watch, Vec<f64>) {
        let mut watch = Watch::default();
        let mut flags = Vec::new();
        for k in 0..16_000 {
            let t = f64::from(k) * DT_S;
            let along = |t: f64| 0.5 + 0.4 * (0.7 * t).sin();
            let bends = along(t) - along(t - DT_S);
            let bend = Vector2::new(along(t), 0.0);
            let turned = Vector3::new(0.0, bends, twist * bends + angle(t) - angle(t - DT_S));
            let input = WatchInput {
                rate_rad_s: turned / DT_S,
                estimate: bend,
                model: bend,
                setpoint: bend,
                remaining: bend,
                still_s: 0.0,
                response_s: 0.04,
                turn_variance: 0.0,
                dt_s: DT_S,
            };
            if watch.step(&WatchConfig::default(), &input, || 0.0) {
                flags.push(t);
            }
        }
        (watch, flags)
    }

    #[test]
    fn a_tip_may_twist_in_proportion_to_its_bend_and_a_base_may_not_turn_by_less() {
        for twist in [-0.2, -0.05, 0.0, 0.1, 0.25] {
            let (_, flags) = over_80_s(twist, |_| 0.0);
            assert!(flags.is_empty(), "{twist}: {flags:?}");
            // 2° within half a second, where a tip of 0.25 twists by 11° to and fro
            let turn = |t: f64| 0.035 * ((t - 30.0) / 0.5).clamp(0.0, 1.0);
            let (_, flags) = over_80_s(twist, turn);
            let first = flags.first().copied().unwrap_or_default();
            assert!((30.0..30.5).contains(&first), "{twist}: {first}");
        }
    }

    #[test]
    fn a_base_that_turns_to_and_fro_sways_and_one_that_turns_on_does_not() {
        for (deg, period_s) in [(1.0, 3.0), (2.0, 7.0), (4.0, 15.0)] {
            let angle =
                |t: f64| f64::to_radians(deg) * (std::f64::consts::TAU * t / period_s).sin();
            let (watch, flags) = over_80_s(0.05, |t| angle((t - 20.0).max(0.0)));
            let last = flags.last().copied().unwrap_or_default();
            assert!(
                watch.sway.sways() && last < 20.0 + 1.75 * period_s,
                "{deg}° in {period_s} s: {last} s"
            );
        }
        let turns = |t: f64| {
            let by = |at: f64| 0.07 * ((t - at) / 0.5).clamp(0.0, 1.0);
            by(25.0) - by(35.0) - by(50.0) + by(75.0)
        };
        let (watch, flags) = over_80_s(0.05, turns);
        assert!(!watch.sway.sways());
        for at in [25.0, 35.0, 50.0, 75.0] {
            assert!(
                flags.iter().any(|t| (at..at + 0.6).contains(t)),
                "the turn at {at} s: {flags:?}"
            );
        }
    }

    #[test]
    fn a_commanded_motion_raises_no_flag() {
        // 60° within a second, with a fifth of it as twist and half of the bend missing from the model
        let bend = |t: f64| Vector2::new((t - 1.0).clamp(0.0, 1.0) * 1.05, 0.0);
        let mut watch = Watch::default();
        for k in 0..800 {
            let t = f64::from(k) * DT_S;
            let moves = if (1.0..2.0).contains(&t) { 1.05 } else { 0.0 };
            let input = WatchInput {
                rate_rad_s: Vector3::new(0.0, moves, moves / 5.0),
                estimate: bend(t),
                model: bend(t) * 0.5,
                setpoint: bend(t),
                remaining: Vector2::zeros(),
                still_s: 0.0,
                response_s: 0.04,
                turn_variance: 0.0,
                dt_s: DT_S,
            };
            assert!(
                !watch.step(&WatchConfig::default(), &input, || 0.0),
                "{t} s"
            );
        }
    }
}
