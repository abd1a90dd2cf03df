//! Air that warms: a slow offset that depends on the time since the start and not on the command.
//!
//! Motors warm the case and the case warms the air, two thermal masses in series:
//! `a (1 − (τ₂ e^(−t/τ₂) − τ₁ e^(−t/τ₁)) / (τ₂ − τ₁))`, which starts without a slope.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.thermal_drift]`
    ThermalDrift at "effects.thermal_drift" sized by offset_mm; background by up_to {
        offset_mm: [up_to(0.02), -up_to(0.02), 0.0]
    }; drawn by rng, severity {
        let size = rng.sized(0.4, 3.0, severity);
        let main = rng.channel() - 1;
        let sign = rng.sign();
        let share = rng.between(-0.4, 0.4);
        /// Final offset a of each line, mm of piston. Default 0 (none); typical 0.2 to 2.5 on one line
        /// (0.5 to 7° of bend). Equal offsets lengthen the tip and do not bend it. A larger value drifts further.
        offset_mm: [f64; 3] = [0.0; 3], -20.0..=20.0, "a few mm at most are typical",
            draw std::array::from_fn(|i| if i == main { size * sign } else { size * sign * share });
        /// Time constant τ₁ of the air, s. Default 20. A larger value starts more softly.
        air_s: f64 = 20.0, 0.1..=1e5, "tens of seconds are typical", draw rng.between(6.0, 25.0);
        /// Time constant τ₂ of the case, s. Default 90. A larger value drifts for longer.
        case_s: f64 = 90.0, 0.1..=1e5, "minutes are typical", draw rng.between(30.0, 120.0);
    }
    /// Air that is warming up.
    Warming runs config {
        /// Time constant, s, decay, and what is left of the initial difference.
        air: (f64, Decay, f64) = (config.air_s, Decay::new(config.air_s), 1.0);
        case: (f64, Decay, f64) = {
            // equal time constants are the limit of unequal ones; a difference of 0.2 % keeps the formula stable
            let alike = (config.case_s / config.air_s - 1.0).abs() < 1e-3;
            let case_s = if alike { config.case_s * 1.002 } else { config.case_s };
            (case_s, Decay::new(case_s), 1.0)
        };
    }
}

impl Law for Warming {
    fn air(&mut self, air_mm: &mut Vector3<f64>, _bellows: &BellowState, at: &Moment) {
        for (_, decay, left) in [&mut self.air, &mut self.case] {
            *left -= *left * decay.share(at.dt_s);
        }
        let cooling = self.case.0 * self.case.2 - self.air.0 * self.air.2;
        *air_mm +=
            Vector3::from(self.config.offset_mm) * (1.0 - cooling / (self.case.0 - self.air.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_offset_starts_without_slope_and_ends_at_its_size() {
        for case_s in [90.0, 20.0] {
            let mut w = Warming::new(ThermalDrift {
                offset_mm: [1.0, 0.0, -0.5],
                case_s,
                ..ThermalDrift::default()
            });
            let offset = |_| {
                let mut air_mm = Vector3::zeros();
                w.air(
                    &mut air_mm,
                    &BellowState::default(),
                    &Moment { t: 0.0, dt_s: 0.1 },
                );
                air_mm
            };
            let path: Vec<_> = (0..20_000).map(offset).collect();
            assert!(path[0].norm() < 1e-4 && path[9].norm() < 2e-3);
            assert!((path[19_999] - Vector3::new(1.0, 0.0, -0.5)).norm() < 1e-4);
            assert!(path[..3000].windows(2).all(|p| p[1].x > p[0].x));
        }
    }
}
