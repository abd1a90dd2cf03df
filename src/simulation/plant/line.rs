//! From plungers to the air that reaches the bellows.
//!
//! `plunger → play → air in the line → flow → air delivered`, everything in mm of piston. Nominally the air
//! delivered is the play output.

use crate::simulation::plant::config::LineConfig;
use crate::simulation::plant::effects::leak::{Leak, Leaking};
use crate::simulation::plant::law::{BellowState, Law, Laws, Step, each};
use nalgebra::Vector3;

/// The three lines with their state.
#[derive(Debug)]
pub(crate) struct Line {
    half_width_mm: Vector3<f64>,
    /// Outputs of the play operators, mm of piston.
    pub(crate) play_output_mm: Vector3<f64>,
    delivered_mm: Vector3<f64>,
    /// Injected leaks.
    leaking: Leaking,
}

impl Line {
    pub(crate) fn new(config: &LineConfig) -> Self {
        // an injected leak is proportional to pressure and the same under vacuum
        let leak = Leak {
            turbulent_kpa: 1e6,
            vacuum: 1.0,
            ..Leak::default()
        };
        Self {
            half_width_mm: Vector3::from(config.k_lambda_mm),
            play_output_mm: Vector3::zeros(),
            delivered_mm: Vector3::zeros(),
            leaking: Leaking::new(leak),
        }
    }

    /// Opens all lines for a moment, pistons at zero: the air that leaked flows back.
    pub(crate) fn vent(&mut self, laws: &mut Laws) {
        each(laws, |law| law.vent());
        self.leaking.vent();
    }

    /// Air delivered to the bellows, mm of piston, after one step.
    pub(crate) fn step(
        &mut self,
        plunger_mm: &Vector3<f64>,
        bellows: &BellowState,
        now: &mut Step<'_>,
    ) -> Vector3<f64> {
        let (at, faults) = (&now.at, now.faults);
        let mut width = self.half_width_mm;
        each(now.laws, |law| law.play(&mut width, plunger_mm));
        for i in 0..3 {
            self.play_output_mm[i] = self.play_output_mm[i]
                .max(plunger_mm[i] - width[i])
                .min(plunger_mm[i] + width[i]);
        }
        let mut air_mm = self.play_output_mm;
        each(now.laws, |law| law.air(&mut air_mm, bellows, at));
        self.leaking.config.rate_per_s = faults.leak_per_s;
        self.leaking.air(&mut air_mm, bellows, at);
        each(now.laws, |law| law.flow(&mut air_mm, at));
        for i in 0..3 {
            if !faults.blocked[i] {
                self.delivered_mm[i] = air_mm[i];
            }
        }
        self.delivered_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::plant::fault::Faults;
    use crate::simulation::plant::law::Moment;

    #[test]
    fn a_loop_of_the_play_is_two_half_widths_wide() {
        let mut line = Line::new(&LineConfig {
            k_lambda_mm: [0.5; 3],
            ..LineConfig::default()
        });
        let mut at_zero = |from: f64| {
            let at = Moment {
                t: 0.0,
                dt_s: 0.001,
            };
            [from, 0.0].map(|to| {
                let now = &mut Step {
                    at,
                    laws: &mut Vec::new(),
                    faults: &Faults::default(),
                };
                line.step(&Vector3::repeat(to), &BellowState::default(), now)
                    .x
            })[1]
        };
        assert!((at_zero(2.0) - at_zero(-2.0) - 1.0).abs() < 1e-12);
    }
}
