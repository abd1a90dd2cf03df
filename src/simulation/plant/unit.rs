//! One unit of a make: the configuration, varied at random by its spread.

use crate::simulation::plant::config::{PlantConfig, Spread};
use crate::simulation::plant::rng::{PlantRng, Stream};

/// Draws are limited to this many standard deviations: units beyond it fail the factory test.
const LIMIT: f64 = 2.5;

impl PlantConfig {
    /// The unit of this make with serial number `seed`: gains, geometry, sizes of effects, attitude,
    /// field and IMU biases drawn from `spread`. The spread of the result is zero.
    pub fn drawn(&self, seed: u64) -> PlantConfig {
        let (spread, mut rng) = (&self.spread, PlantRng::new(seed, Stream::Unit));
        let mut unit = PlantConfig {
            spread: Spread::default(),
            ..self.clone()
        };
        unit.effects.vary(spread.effects, &mut rng);
        let mut about = |sigma: f64| sigma * rng.normal().clamp(-LIMIT, LIMIT);
        for i in 0..3 {
            unit.line.k_epsilon[i] *= 1.0 + about(spread.k_epsilon);
            unit.line.k_lambda_mm[i] *= 1.0 + about(spread.k_lambda);
            unit.shape.r_mm[i] *= 1.0 + about(spread.r);
            unit.shape.angle_deg[i] += about(spread.angle_deg);
            unit.imu.gyro_bias_deg_s[i] += about(spread.gyro_bias_deg_s);
            unit.imu.acc_bias_mg[i] += about(spread.acc_bias_mg);
            unit.imu.mag_bias_ut[i] += about(spread.mag_bias_ut);
        }
        unit.line.lag_s *= 1.0 + about(spread.lag);
        unit.field.strength_ut *= 1.0 + about(spread.field);
        unit.field.dip_deg = (unit.field.dip_deg + about(spread.dip_deg)).clamp(-90.0, 90.0);
        unit.base.pitch_deg = wrapped(unit.base.pitch_deg + about(spread.tilt_deg));
        unit.base.roll_deg = wrapped(unit.base.roll_deg + about(spread.tilt_deg));
        let heading_deg = spread.heading_deg * rng.between(-1.0, 1.0);
        unit.base.yaw_deg = wrapped(unit.base.yaw_deg + heading_deg);
        let mut about = |sigma: f64| sigma * rng.normal().clamp(-LIMIT, LIMIT);
        let effects = &mut unit.effects;
        if spread.mount_deg > 0.0 {
            let mount = effects.mount_misalignment.get_or_insert_default();
            mount.tilt_deg = mount.tilt_deg.map(|tilt| tilt + about(spread.mount_deg));
        }
        if spread.torsion_deg > 0.0 {
            effects.torsion.get_or_insert_default().twist_deg += about(spread.torsion_deg);
        }
        if spread.motor_field_ut > 0.0 {
            let motors = effects.motor_field.get_or_insert_default();
            let field = motors.amplitude_ut;
            motors.amplitude_ut = field.map(|field| field + about(spread.motor_field_ut));
        }
        unit
    }
}

/// The same angle in −180..180 degrees.
fn wrapped(deg: f64) -> f64 {
    (deg + 180.0).rem_euclid(360.0) - 180.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spread() -> Spread {
        Spread {
            k_epsilon: 0.06,
            k_lambda: 0.1,
            r: 0.01,
            angle_deg: 1.0,
            lag: 0.2,
            effects: 0.2,
            tilt_deg: 5.0,
            heading_deg: 180.0,
            field: 0.1,
            dip_deg: 4.0,
            gyro_bias_deg_s: 0.5,
            acc_bias_mg: 5.0,
            mag_bias_ut: 0.5,
            mount_deg: 0.5,
            torsion_deg: 1.0,
            motor_field_ut: 0.1,
        }
    }

    #[test]
    fn units_differ_and_are_reproducible() {
        let make = PlantConfig {
            spread: spread(),
            ..PlantConfig::default()
        };
        assert_eq!(make.drawn(3), make.drawn(3));
        assert_ne!(make.drawn(3), make.drawn(4));
        let gains: Vec<f64> = (0..400)
            .map(|s| make.drawn(s).line.k_epsilon[0] / 2.22)
            .collect();
        let mean = gains.iter().sum::<f64>() / 400.0;
        let sigma = (gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / 400.0).sqrt();
        assert!(
            (mean - 1.0).abs() < 0.01 && (sigma - 0.06).abs() < 0.01,
            "{mean} {sigma}"
        );
        let rms = |f: fn(&PlantConfig) -> f64| {
            ((0..400).map(|s| f(&make.drawn(s)).powi(2)).sum::<f64>() / 400.0).sqrt()
        };
        assert!((rms(|u| u.effects.torsion.as_ref().unwrap().twist_deg) - 1.0).abs() < 0.1);
        assert!(
            (rms(|u| u.effects.mount_misalignment.as_ref().unwrap().tilt_deg[2]) - 0.5).abs()
                < 0.05
        );
        assert!(
            (rms(|u| u.effects.motor_field.as_ref().unwrap().amplitude_ut[1]) - 0.1).abs() < 0.01
        );
        for s in 0..400 {
            make.drawn(s).validate().unwrap();
        }
    }

    #[test]
    fn without_spread_the_unit_is_the_make() {
        let make = PlantConfig::default();
        assert_eq!(make.drawn(9), make);
    }
}
