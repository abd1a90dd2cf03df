//! The base turns during the log.
//!
//! Cause: the holder slips, a hand shifts, a table settles, an arm sways. Law: rigid-body rotation; since the start
//! the base has turned by the rotation vector
//! `θ(t) = Σ_k θ_k s((t − t_k)/d_k) + g(t) Σ_m (a_m sin 2πf_m t + b_m cos 2πf_m t)`, s a cubic from 0 to 1, and g the same
//! after the rest at the start. A slow turn is one long event, a knock a short one, a turn and its return two events of opposite
//! sign. A sway is a sum of modes; a mode of frequency 0 is absent.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `t1_s` … `t3_s` starts of the events | s | 60, 150, 220 ± 100 | – |
//! | `lasting1` … `lasting3` d | s | 2 ± 40 | 0.2-300 |
//! | `x1` … `z3` θ, base frame | rad | 0 ± 0.08 | 0.02-0.17 (1-10°) |
//! | `frequency1` … `frequency4` f | Hz | 0 ± 0.3 | 0.05-0.5 |
//! | `sine_x1` … `cosine_z4` a, b, base frame | rad | 0 ± 0.08 | 0.01-0.17 |
//!
//! Signature: all sensors turn together and no piston explains it. Similar to
//! `missed_steps` (a jump that bends, so it depends on the pose), `thermal_drift` and `gyro_bias`
//! (gyroscope only). A second IMU on the base separates it.
//!
//! Away from the event the error surface is flat in its time, and away from a mode in its frequency, so a fit has to search for both.

use crate::model::effects::prelude::*;
use std::f64::consts::TAU;

/// Turns of the base at up to three times, and its sway.
pub struct BaseMotion;

/// Modes of a sway.
const MODES: usize = 4;
/// Parameters of a turn.
const TURN: usize = 5;
/// When a sway begins, and the time in which it grows, s: the base stands while zero is defined.
const SWAY_S: (f64, f64) = (2.0, 3.0);

/// An angle about an axis of the base.
const ANGLE: Param = Param::new("", "rad", 0.0, 0.08, (-0.8, 0.8));

/// Parameters of one turn: its beginning, its duration and its rotation vector.
const fn turn(start_s: f64, [begin, lasting, x, y, z]: [&'static str; TURN]) -> [Param; TURN] {
    let [x, y, z] = ANGLE.named([x, y, z]);
    [
        Param::new(begin, "s", start_s, 100.0, (0.0, 36_000.0)),
        Param::new(lasting, "s", 2.0, 40.0, (0.1, 900.0)),
        x,
        y,
        z,
    ]
}

/// Frequency of a mode.
const FREQUENCY: Param = Param::new("", "Hz", 0.0, 0.3, (0.0, 2.0));

impl Effect for BaseMotion {
    info! {
        name: "base_motion",
        stage: Stage::Base,
        signature: "all sensors turn together and no piston explains it",
        confused_with: &["missed_steps", "thermal_drift", "gyro_bias"],
        separated_by: "an IMU on the base; returning to a known pose",
        events: 3,
        params: &join::<{ 3 * TURN + MODES * MODE_PARAMS }>(&[
            &turn(60.0, ["t1_s", "lasting1", "x1", "y1", "z1"]),
            &turn(150.0, ["t2_s", "lasting2", "x2", "y2", "z2"]),
            &turn(220.0, ["t3_s", "lasting3", "x3", "y3", "z3"]),
            &FREQUENCY.named(["frequency1"]),
            &ANGLE.named(["sine_x1", "sine_y1", "sine_z1", "cosine_x1", "cosine_y1", "cosine_z1"]),
            &FREQUENCY.named(["frequency2"]),
            &ANGLE.named(["sine_x2", "sine_y2", "sine_z2", "cosine_x2", "cosine_y2", "cosine_z2"]),
            &FREQUENCY.named(["frequency3"]),
            &ANGLE.named(["sine_x3", "sine_y3", "sine_z3", "cosine_x3", "cosine_y3", "cosine_z3"]),
            &FREQUENCY.named(["frequency4"]),
            &ANGLE.named(["sine_x4", "sine_y4", "sine_z4", "cosine_x4", "cosine_y4", "cosine_z4"]),
        ]),
    }
    /// One slow turn from the beginning, then knocks at several times.
    fn starts(&self) -> Starts {
        let none = |t_s: f64| [t_s, 2.0, 0.0, 0.0, 0.0];
        let at = |first: f64, lasting: f64, others: [f64; 2]| {
            let turns = [
                [first, lasting, 0.01, 0.01, 0.01],
                none(others[0]),
                none(others[1]),
            ];
            [turns.concat(), vec![0.0; MODES * MODE_PARAMS]].concat()
        };
        vec![
            at(5.0, 200.0, [150.0, 220.0]),
            at(40.0, 2.0, [160.0, 220.0]),
            at(120.0, 2.0, [40.0, 220.0]),
            at(200.0, 2.0, [120.0, 40.0]),
        ]
    }
    fn modes(&self) -> usize {
        MODES
    }
    fn base(&self, p: &[f64], at: &Moment) -> Option<UnitQuaternion<f64>> {
        let (turns, modes) = p.split_at(p.len() - MODES * MODE_PARAMS);
        let turns = turns.chunks_exact(TURN).map(|turn| {
            let [begin_s, lasting_s, x, y, z] = turn else {
                return Vector3::zeros();
            };
            Vector3::new(*x, *y, *z) * smoothstep(at.t_s, *begin_s, *lasting_s)
        });
        let grown = smoothstep(at.t_s, SWAY_S.0, SWAY_S.1);
        let modes = modes.chunks_exact(MODE_PARAMS).map(|mode| {
            let (sine, cosine) = (TAU * mode[0] * at.t_s).sin_cos();
            let along = |axis: usize| mode[1 + axis] * sine + mode[4 + axis] * cosine;
            let present = if mode[0] > 0.0 { grown } else { 0.0 };
            Vector3::from_fn(|axis, _| along(axis)) * present
        });
        let turned: Vector3<f64> = turns.chain(modes).sum();
        (turned != Vector3::zeros()).then(|| UnitQuaternion::from_scaled_axis(turned))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&BaseMotion);
    }

    /// Rotation vector with these turns, and modes at zero but for the given parameters.
    fn turned(turns: &[f64], t_s: f64) -> Vector3<f64> {
        swayed(turns, &[], t_s)
    }

    fn swayed(turns: &[f64], modes: &[f64], t_s: f64) -> Vector3<f64> {
        let mut p = [turns, modes].concat();
        p.resize(BaseMotion.params().len(), 0.0);
        BaseMotion
            .base(&p, &proof::moment(t_s, Vector3::zeros()))
            .map_or(Vector3::zeros(), |q| q.scaled_axis())
    }

    #[test]
    fn slow_turns_knocks_and_returns_are_few_events() {
        let slow = [
            10.0, 100.0, 0.1, 0.0, 0.0, 150.0, 2.0, 0.0, 0.0, 0.0, 220.0, 2.0, 0.0, 0.0, 0.0,
        ];
        assert!(
            (turned(&slow, 60.0).x - 0.05).abs() < 1e-9
                && (turned(&slow, 200.0).x - 0.1).abs() < 1e-9
        );
        let knock = [
            50.0, 0.3, 0.0, 0.1, 0.0, 150.0, 2.0, 0.0, 0.0, 0.0, 220.0, 2.0, 0.0, 0.0, 0.0,
        ];
        assert_eq!(turned(&knock, 49.9), Vector3::zeros());
        assert!((turned(&knock, 50.4).y - 0.1).abs() < 1e-9);
        let back = [
            50.0, 1.0, 0.0, 0.1, 0.05, 80.0, 1.0, 0.0, -0.1, -0.05, 220.0, 2.0, 0.0, 0.0, 0.0,
        ];
        assert!(turned(&back, 70.0).norm() > 0.1 && turned(&back, 90.0).norm() < 1e-12);
    }

    #[test]
    fn a_sway_is_a_sum_of_modes_that_grow_after_the_rest() {
        let turns = [0.0; 15];
        let modes = [
            0.1, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.0, 0.03, 0.0,
        ];
        assert_eq!(swayed(&turns, &modes, 1.9), Vector3::zeros());
        let at = swayed(&turns, &modes, 12.5);
        assert!(
            (at.x - 0.02).abs() < 1e-9 && (at.y - 0.03 * (TAU * 3.125).cos()).abs() < 1e-9,
            "{at}"
        );
        let mut absent = modes;
        absent[0] = 0.0;
        assert_eq!(swayed(&turns, &absent, 12.5).x, 0.0);
    }

    #[test]
    fn the_tip_itself_does_not_bend() {
        assert!(BaseMotion.sensing_only());
        let p = &BaseMotion.starts()[0];
        let run = proof::drive(&BaseMotion, p, 30.0, proof::exercise);
        let clean = proof::drive(
            &BaseMotion,
            &proof::nothing(&BaseMotion),
            30.0,
            proof::exercise,
        );
        assert_eq!(run, clean);
    }
}
