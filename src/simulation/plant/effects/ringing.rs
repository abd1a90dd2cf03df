//! Outside the catalogue: a tip that rings after every move.
//!
//! A share of the motion passes through a lightly damped second-order system of unit gain,
//! `ẍ + 2 ζ ω ẋ + ω² x = ω² u`, stepped by its exact solution for an input held over the step.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.ringing]`
    Ringing at "effects.outside.ringing" sized by share; drawn by rng, severity {
        /// Share of the motion that rings. Default 0 (none); plausible 0.3 to 1. A larger value overshoots more.
        share: f64 = 0.0, 0.0..=1.0, "a share of the motion", draw rng.sized(0.4, 0.9, severity);
        /// Frequency, Hz. Default 4. A larger value rings faster.
        frequency_hz: f64 = 4.0, 0.2..=50.0, "a few Hz are plausible", draw rng.between(1.0, 4.0);
        /// Damping ratio ζ. Default 0.08. A larger value dies out sooner.
        damping: f64 = 0.08, 0.005..=0.95, "above 1 it is a lag", draw rng.between(0.03, 0.12);
    }
    /// The ringing part's state: distance from the input and speed over ω.
    Rings runs config {
        dt_s: f64 = f64::NAN;
        turn: Matrix2<f64> = Matrix2::identity();
        at_mm: Vector3<f64> = Vector3::zeros();
        speed: Vector3<f64> = Vector3::zeros();
    }
}

impl Rings {
    /// Matrix of (distance, speed/ω) over `dt_s`.
    fn transition(&self, dt_s: f64) -> Matrix2<f64> {
        let omega = std::f64::consts::TAU * self.config.frequency_hz;
        let zeta = self.config.damping;
        let root = (1.0 - zeta * zeta).sqrt();
        let (sin, cos) = (omega * root * dt_s).sin_cos();
        let (fade, side) = ((-zeta * omega * dt_s).exp(), zeta / root);
        Matrix2::new(cos + side * sin, sin / root, -sin / root, cos - side * sin) * fade
    }
}

impl Law for Rings {
    fn lagged(&mut self, q_mm: &mut Vector3<f64>, at: &Moment) {
        if at.dt_s != self.dt_s {
            self.dt_s = at.dt_s;
            self.turn = self.transition(at.dt_s);
        }
        let away = self.at_mm - *q_mm;
        self.at_mm = *q_mm + away * self.turn.m11 + self.speed * self.turn.m12;
        self.speed = away * self.turn.m21 + self.speed * self.turn.m22;
        *q_mm += (self.at_mm - *q_mm) * self.config.share;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tip_overshoots_at_its_frequency_and_settles() {
        let path = |steps: usize, dt_s: f64| -> Vec<f64> {
            let mut r = Rings::new(Ringing {
                share: 1.0,
                ..Ringing::default()
            });
            let step = |_| {
                let mut q_mm = Vector3::repeat(1.0);
                r.lagged(&mut q_mm, &Moment { t: 0.0, dt_s });
                q_mm.x
            };
            (0..steps).map(step).collect()
        };
        let (path, coarse) = (path(4000, 0.001), path(25, 0.01));
        let peak = (0..4000)
            .max_by(|&a, &b| path[a].total_cmp(&path[b]))
            .unwrap();
        assert!((peak as f64 * 0.001 - 0.125).abs() < 0.003 && path[peak] > 1.7);
        assert!((path[3999] - 1.0).abs() < 0.01);
        // a coarse step meets the fine one
        assert!((coarse[24] - path[249]).abs() < 1e-9);
    }
}
