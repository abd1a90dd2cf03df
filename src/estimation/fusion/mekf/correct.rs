//! Observations of the filter: bounded velocity, standstill, and the Earth's field.

use super::Mekf;
use super::block::FieldMean;
use super::covariance::{BIAS, Errors, IRON, VELOCITY};
use crate::estimation::fusion::intake;
use nalgebra::Vector3;

impl Mekf {
    /// Observes a velocity near zero; at standstill a velocity of zero and the gyroscope bias.
    pub(super) fn observe_motion(&mut self, errors: &mut Errors, dt_s: f64) {
        let c = &self.config;
        let (v, still) = (self.estimate.velocity_m_s, self.standstill.standstill());
        let near_zero = c.velocity_sigma_m_s.powi(2) * c.velocity_memory_s / dt_s;
        let at_zero = c.rest_velocity_sigma_m_s.powi(2) * c.rest_velocity_memory_s / dt_s;
        let bound = if still { at_zero } else { f64::INFINITY };
        let variance = near_zero.min(bound);
        let mut observe = |k, off, variance| {
            self.covariance.observe(errors, &[(k, 1.0)], off, variance);
        };
        for k in 0..2 {
            observe(VELOCITY + k, -v[k], variance);
        }
        if still {
            let off = self.standstill.gyro_mean_rad_s() - self.estimate.bias_rad_s;
            let sigma = c.rest_bias_sigma_deg_s.to_radians();
            let variance = sigma.powi(2) * c.rest_bias_memory_s / dt_s;
            for k in 0..3 {
                observe(BIAS + k, off[k], variance);
            }
        }
    }

    /// Observes the Earth's field, weighted by its recent misfit.
    pub(super) fn observe_field(&mut self, errors: &mut Errors, reading: &FieldMean, dt_s: f64) {
        let Some(earth) = self.estimate.field_ut else {
            return;
        };
        let model = Vector3::new(earth.x, 0.0, earth.y) + reading.to_world * self.estimate.iron_ut;
        let residual = reading.world_ut - model;
        let rows = reading.rows();
        let variances = rows.map(|row| self.covariance.variance_of(&row[..3]));
        let predicted = variances.iter().sum::<f64>() / 3.0;
        let misfit = self.track_misfit(residual.norm_squared() / 3.0, dt_s);
        let c = &self.config;
        let nominal = c.field_sigma_ut.powi(2);
        let tolerated = nominal * c.disturbed_ratio.powi(2) + predicted;
        let excess = (misfit / tolerated).max(1.0);
        self.disturbed = excess > 1.0;
        if self.disturbed {
            let growth = c.iron_unsure_rt_s.powi(2) * (misfit - tolerated) * dt_s;
            self.covariance.grow(IRON, 3, growth);
        }
        let still = self.standstill.standstill();
        let weight = if still { c.rest_field_weight } else { 1.0 };
        let variance = nominal * excess * c.field_memory_s / dt_s / weight;
        for (row, part) in rows.iter().zip(residual.iter()) {
            self.covariance.observe(errors, row, *part, variance);
        }
    }

    /// Updates the running mean square misfit; a sudden increase counts at once.
    fn track_misfit(&mut self, now_ut2: f64, dt_s: f64) -> f64 {
        let (c, running) = (&self.config, &mut self.misfit_ut2);
        *running += intake::share(dt_s, c.misfit_tau_s) * (now_ut2 - *running);
        running.max(now_ut2.min(c.misfit_step_max * running.max(c.field_sigma_ut.powi(2))))
    }
}
