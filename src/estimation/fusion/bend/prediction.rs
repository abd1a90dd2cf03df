//! Prediction of the bend filter: the gyroscope between two corrections, and what the errors do meanwhile.

use super::bank::{DRIFTS, DRIFTS_SLOWLY, SWAYS, WRONG_RATE};
use super::kalman::{ACC, BASE, FIELD, GYRO, KalmanState, MAG, SCALE, TWIST};
use super::laws::velocity;
use super::state::BendFilter;
use super::window::Window;
use crate::estimation::fusion::base::BaseTurn;
use crate::estimation::fusion::filter::{TipEstimator, TipSample};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

crate::constants! {
    /// Noise of the prediction beside the settings of the filter.
    const PROCESS: ProcessNoise;
    /// Ratio of the process noise to the noise during alignment: motion adds vibration.
    gyro_factor = 1.5;
    /// Correlation time of the error of the rate, s: `rate_error` and `wrong_rate_error` are stated for it.
    rate_error_time_s = 0.1;
    /// Random walk that the bias of the gyroscope on the base adds, rad/s/√s: it is constant in other axes.
    base_gyro_walk_rad_s_rts = 3e-4;
    /// Turn of the tip after which the error of the field is another, rad.
    field_turn_rad = 1.5;
    /// Random walk of the scale per √rad of motion while the rate is wrong.
    scale_walk = 0.02;
    /// Time in which a base that sways turns back, s.
    sway_back_s = 1.5;
    /// Time for which a base that sways turns the same way, s.
    sway_time_s = 1.2;
    /// Creep of the tip meanwhile, rad/√s.
    sway_creep = 0.003;
    /// Time after which a turn of the base that lasts is no sway, s.
    sway_mean_s = 8.0;
}

impl BendFilter {
    /// Integrates one sample, and adds it to the window.
    pub(super) fn predict(&mut self, sample: &TipSample) {
        let (TipSample { imu, base, .. }, dt_s) = (sample, sample.dt_s);
        let measured = imu.gyro_rad_s - self.s.inverse() * base.rate_rad_s - self.gyro_bias;
        let rate = measured - measured.component_mul(&self.gyro_scale);
        self.rate_rad_s = rate.norm();
        let half = UnitQuaternion::from_scaled_axis(rate * (dt_s / 2.0));
        let midway = self.s * half;
        self.s = UnitQuaternion::new_normalize((midway * half).into_inner());
        let midway = midway.to_rotation_matrix().into_inner();
        self.turn_rate = midway * rate;
        let uses_field = self.uses_field();
        let window = &mut self.window;
        window.length_s += dt_s;
        window.base_acc.add(base.acc_change_m_s2);
        window.base_mag.add(base.mag_change_ut);
        window.turns_s += midway * dt_s;
        window.scaled += midway * Matrix3::from_diagonal(&(rate * dt_s));
        window.turned += self.turn_rate * dt_s;
        window.path += self.rate_rad_s * dt_s;
        let s = self.s.to_rotation_matrix().into_inner();
        if sample.acc {
            window.acc.add(&(imu.acc_m_s2 - self.acc_bias), &s);
        }
        if let Some(m) = imu.mag_ut.filter(|_| uses_field && sample.mag) {
            window.mag.add(&(m - self.mag_bias), &s);
        }
        window.samples += 1;
        if sample.still {
            window.still += rate;
            window.still_n += 1;
        }
    }

    /// What the base measures of gravity and field is compared with what the tip measures: the attitude of the base, with the drift
    /// of its gyroscope, is only used where it does not measure.
    pub(super) fn follow_base(&mut self, base: &BaseTurn) {
        let half_s = self.window.length_s / 2.0;
        let midway = UnitQuaternion::from_scaled_axis(base.rate_rad_s * half_s);
        let turn = midway * base.r_rest_now.inverse();
        let by_turn = |rest: Vector3<f64>| turn * rest - rest;
        let (acc, mag) = (self.window.base_acc.get(), self.window.base_mag.get());
        let rest_ut = self.alignment.mag_rest_ut.unwrap_or_default();
        let gravity = self.alignment.acc_rest_m_s2 - self.acc_bias;
        self.acc_change = acc.unwrap_or_else(|| by_turn(gravity));
        self.mag_change = mag.unwrap_or_else(|| by_turn(rest_ut - self.mag_bias));
    }

    /// Propagates every hypothesis over the window.
    pub(super) fn propagate(&mut self) {
        let (c, w) = (self.config, self.window);
        let t = w.length_s;
        let white = (PROCESS.gyro_factor * self.gyro_sigma_rad_s()).powi(2)
            * self.alignment.periods_s().0.max(1e-4)
            * t;
        let keep = (-t / c.field_time_s - w.path / PROCESS.field_turn_rad).exp();
        let field = self.field_level() * (1.0 - keep * keep);
        self.field_offset *= keep;
        let sways = self.sway_level();
        let base_walk = w
            .base_acc
            .get()
            .map_or(0.0, |_| PROCESS.base_gyro_walk_rad_s_rts);
        for (j, f) in self.bank.filters.iter_mut().enumerate() {
            f.propagate_turn(&[(GYRO, -w.turns_s), (SCALE, -w.scaled)]);
            f.widen(0, white);
            let (walk, error) = match j {
                DRIFTS => (c.gyro_drift_rad_s_rts, c.rate_error),
                DRIFTS_SLOWLY => (c.gyro_drift_rad_s_rts / 2.0, c.rate_error),
                WRONG_RATE => (c.gyro_walk_rad_s_rts, c.wrong_rate_error),
                _ => (c.gyro_walk_rad_s_rts, c.rate_error),
            };
            // what a wrong rate adds is along the turn
            let along = error * error * PROCESS.rate_error_time_s / t;
            for k in 0..3 {
                for i in 0..3 {
                    f.p[i][k] += along * w.turned[i] * w.turned[k];
                }
            }
            f.widen(GYRO, (walk * walk + base_walk * base_walk) * t);
            f.widen(ACC, c.acc_walk_m_s2_rts.powi(2) * t);
            f.widen(MAG, c.mag_walk_ut_rts.powi(2) * t);
            f.p[TWIST][TWIST] += c.twist_walk.powi(2) * w.path;
            f.fade(FIELD, keep);
            f.widen(FIELD, field);
            match j {
                WRONG_RATE => f.widen(SCALE, PROCESS.scale_walk * PROCESS.scale_walk * w.path),
                SWAYS => sway(f, &w, sways),
                _ => (),
            }
        }
    }

    /// Mean acceleration of the sensor on its arc over the window, m/s²; zero where its beginning is not known.
    pub(super) fn accelerates(&mut self) -> Vector3<f64> {
        let now = velocity(&self.config, &self.bend().0, &self.turn_rate);
        let before = self.velocity_m_s.replace(now).unwrap_or(now);
        (now - before) / self.window.length_s
    }
}

/// Propagates the rotation of a base that sways with a mean square rate. While the pistons stand, what the gyroscope measures is the
/// base; while they move it may be either.
fn sway(f: &mut KalmanState, w: &Window, rate2: f64) {
    if w.still_n == w.samples {
        f.fade(BASE, (-w.length_s / PROCESS.sway_mean_s).exp());
        for i in 0..3 {
            f.x[BASE + i] -= w.turned[i];
        }
        f.widen(BASE, PROCESS.sway_creep * PROCESS.sway_creep * w.length_s);
    } else {
        f.fade(BASE, (-w.length_s / PROCESS.sway_back_s).exp());
        f.widen(BASE, 2.0 * PROCESS.sway_time_s * rate2 * w.length_s);
    }
}
