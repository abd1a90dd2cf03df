//! Fields of the motors' coil currents.
//!
//! Cause: each stepping motor has two coils in quadrature whose currents follow the microstep phase,
//! `I_a = I cos φ`, `I_b = I sin φ` (Acarnley, *Stepping Motors*, 4th ed. 2002, ch. 6); by Biot and
//! Savart each makes a field in proportion, in a direction fixed where the motor stands. Drivers lower the
//! current of an idle motor.
//!
//! Law: in the base frame, in which the motors are fixed, `B = g Σ_m (B_cm cos φ_m + B_sm sin φ_m)`,
//! `φ_m = 2π u_m / (64 · step)`: 64 microsteps make a cycle. `g` is 1 in motion and falls to the idle
//! factor h once the motors have stood still for about T. The sensor measures it in its own frame.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `cos_x` … `sin_z`, one set per motor | µT | 0 ± 3 | 0.1-20 |
//! | `idle` h | – | 0.5 ± 0.3 | 0.2-1 |
//! | `idle_after` T | s | 0.5 ± 0.5 | 0.1-2 |
//!
//! Signature: in the magnetometer only, following the motors. Similar to `hard_iron` (fixed
//! to the body, independent of the motors) and `gear_periodic` (moves the tip). Motors on and off while still separate it.

use crate::model::Drive;
use crate::model::effects::prelude::*;
use std::f64::consts::TAU;

/// Microsteps of one electrical cycle: four full steps of sixteen.
const CYCLE: f64 = 64.0;
/// Names of one motor's parameters.
const NAMES: [&str; 6] = ["cos_x", "cos_y", "cos_z", "sin_x", "sin_y", "sin_z"];

/// Coil fields of three motors.
#[derive(Debug, Clone, Copy)]
pub struct MotorField;

/// One component of a coil's field.
const COIL: Param = Param::new("", "µT", 0.0, 3.0, (-40.0, 40.0));

impl Effect for MotorField {
    info! {
        name: "motor_field",
        stage: Stage::Sensor,
        signature: "a disturbance of the magnetometer alone that follows the motors' microstep phase",
        confused_with: &["hard_iron", "gear_periodic"],
        separated_by: "motors on and off while the tip is still",
        params: &join::<20>(&[
            &COIL.on(1).named(NAMES),
            &COIL.on(2).named(NAMES),
            &COIL.on(3).named(NAMES),
            &[
                Param::new("idle", "", 0.5, 0.3, (0.0, 1.0)),
                Param::new("idle_after", "s", 0.5, 0.5, (0.1, 10.0)),
            ],
        ]),
    }
    /// A current that falls early, later and practically never: a fit does not recover from too early a fall.
    fn starts(&self) -> Starts {
        let after = |s: f64| [vec![0.1; 18], vec![0.5, s]].concat();
        vec![after(0.4), after(1.2), after(3.0)]
    }
    fn follows_motors(&self) -> bool {
        true
    }
    fn sensor(&self, p: &[f64], _m: &mut Memory, at: &Moment, reading: &mut ImuPrediction) {
        let mut field = Vector3::zeros();
        for (motor, u_mm) in p.chunks_exact(6).zip(at.counted_mm.iter()) {
            let (sin, cos) = (TAU * u_mm / (CYCLE * Drive::default().step_mm)).sin_cos();
            field += Vector3::new(motor[0], motor[1], motor[2]) * cos
                + Vector3::new(motor[3], motor[4], motor[5]) * sin;
        }
        reading.mag_ut +=
            reading.r_base_sensor.inverse() * (field * current(p[18], p[19], at.idle_s));
    }
}

/// Share of the current that is left after some idle time: 1, then `idle`, half-way at `after_s`.
fn current(idle: f64, after_s: f64, idle_s: f64) -> f64 {
    let late = (idle_s / after_s).powi(4);
    // late may overflow to infinity after an hour at standstill; 1/(1 + ∞) = 0 is correct
    idle + (1.0 - idle) / (1.0 + late * late)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;
    use nalgebra::UnitQuaternion;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&MotorField);
    }

    #[test]
    fn a_fit_recovers_it() {
        let mut truth: Vec<f64> = (0..18).map(|k| 6.0 * (1.7 * f64::from(k)).sin()).collect();
        truth.extend([0.3, 0.8]);
        proof::is_recovered(&MotorField, &truth);
    }

    fn field(u_mm: f64, idle_s: f64, r_base_sensor: UnitQuaternion<f64>) -> Vector3<f64> {
        let e = MotorField;
        let mut p = proof::with(&e, &[("idle", 0.4)]);
        p[6..12].copy_from_slice(&[5.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
        let zero = Vector3::zeros();
        let mut r = ImuPrediction {
            acc_m_s2: zero,
            gyro_rad_s: zero,
            mag_ut: zero,
            r_base_sensor,
        };
        let at = Moment {
            idle_s,
            ..proof::moment(0.0, Vector3::new(0.3, u_mm, 0.7))
        };
        e.sensor(&p, &mut Memory::default(), &at, &mut r);
        assert_eq!((r.acc_m_s2, r.gyro_rad_s), (zero, zero));
        r.mag_ut
    }

    #[test]
    fn the_field_follows_the_phase_of_its_own_motor() {
        let quarter_mm = 16.0 * Drive::default().step_mm;
        let still = UnitQuaternion::identity();
        assert!((field(0.0, 0.0, still) - Vector3::new(5.0, 0.0, 0.0)).norm() < 1e-12);
        assert!((field(quarter_mm, 0.0, still) - Vector3::new(0.0, 2.0, 0.0)).norm() < 1e-9);
        assert!((field(4.0 * quarter_mm, 0.0, still) - field(0.0, 0.0, still)).norm() < 1e-9);
    }

    #[test]
    fn the_field_is_fixed_in_the_base_and_weakens_when_idle() {
        let turned = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.8, 0.1));
        assert!(
            (turned * field(0.2, 0.0, turned) - field(0.2, 0.0, UnitQuaternion::identity())).norm()
                < 1e-12
        );
        let ratio = field(0.2, 3.0, turned).norm() / field(0.2, 0.0, turned).norm();
        assert!((ratio - 0.4).abs() < 1e-3, "{ratio}");
        assert!((current(0.4, 0.5, f64::MAX) - 0.4).abs() < 1e-12);
    }
}
