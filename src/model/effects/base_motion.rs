//! The base turns during the log.
//!
//! Cause: the holder slips, a hand shifts, a table settles. Law: rigid-body rotation; since the start
//! the base has turned by the rotation vector
//! `θ(t) = Σ_k θ_k s((t − t_k)/d_k)`, s a cubic from 0 to 1. A slow turn is one long event,
//! a knock a short one, a turn and its return two events of opposite sign.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `t1_s` … `t3_s` starts of the events | s | 60, 150, 220 ± 100 | – |
//! | `lasting1` … `lasting3` d | s | 2 ± 40 | 0.2-300 |
//! | `x1` … `z3` θ, base frame | rad | 0 ± 0.08 | 0.02-0.17 (1-10°) |
//!
//! Signature: all sensors turn together and no piston explains it. Similar to
//! `missed_steps` (a jump that bends, so it depends on the pose), `thermal_drift` and `gyro_bias`
//! (gyroscope only). A second IMU on the base separates it.
//!
//! Away from the event the error surface is flat in its time, so a fit has to search for the times.

use crate::model::effects::prelude::*;

/// Turns of the base at up to three times.
pub struct BaseMotion;

/// Parameters of one turn: its beginning, its duration and its rotation vector.
const fn turn(start_s: f64, [begin, lasting, x, y, z]: [&'static str; 5]) -> [Param; 5] {
    let angle = Param::new("", "rad", 0.0, 0.08, (-0.8, 0.8));
    let [x, y, z] = angle.named([x, y, z]);
    [
        Param::new(begin, "s", start_s, 100.0, (0.0, 36_000.0)),
        Param::new(lasting, "s", 2.0, 40.0, (0.1, 900.0)),
        x,
        y,
        z,
    ]
}

/// The catalogue entry.
const INFO: EffectInfo = EffectInfo {
    name: "base_motion",
    stage: Stage::Base,
    signature: "all sensors turn together and no piston explains it",
    confused_with: &["missed_steps", "thermal_drift", "gyro_bias"],
    separated_by: "an IMU on the base; returning to a known pose",
    events: 3,
    params: &join::<15>(&[
        &turn(60.0, ["t1_s", "lasting1", "x1", "y1", "z1"]),
        &turn(150.0, ["t2_s", "lasting2", "x2", "y2", "z2"]),
        &turn(220.0, ["t3_s", "lasting3", "x3", "y3", "z3"]),
    ]),
    starts: &[],
};

impl Effect for BaseMotion {
    info!();
    /// One slow turn from the beginning, then knocks at several times.
    fn starts(&self) -> Starts {
        let none = |t_s: f64| [t_s, 2.0, 0.0, 0.0, 0.0];
        let at = |first: f64, lasting: f64, others: [f64; 2]| {
            [
                [first, lasting, 0.01, 0.01, 0.01],
                none(others[0]),
                none(others[1]),
            ]
            .concat()
        };
        vec![
            at(5.0, 200.0, [150.0, 220.0]),
            at(40.0, 2.0, [160.0, 220.0]),
            at(120.0, 2.0, [40.0, 220.0]),
            at(200.0, 2.0, [120.0, 40.0]),
        ]
    }
    fn base(&self, p: &[f64], at: &Moment) -> Option<UnitQuaternion<f64>> {
        let turned = p
            .chunks_exact(5)
            .fold(Vector3::zeros(), |sum: Vector3<f64>, e| {
                sum + Vector3::new(e[2], e[3], e[4]) * smoothstep(at.t_s, e[0], e[1])
            });
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

    fn turned(p: &[f64], t_s: f64) -> Vector3<f64> {
        BaseMotion
            .base(p, &proof::moment(t_s, Vector3::zeros()))
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
        assert!(
            BaseMotion
                .base(&knock, &proof::moment(49.9, Vector3::zeros()))
                .is_none()
        );
        assert!((turned(&knock, 50.4).y - 0.1).abs() < 1e-9);
        let back = [
            50.0, 1.0, 0.0, 0.1, 0.05, 80.0, 1.0, 0.0, -0.1, -0.05, 220.0, 2.0, 0.0, 0.0, 0.0,
        ];
        assert!(turned(&back, 70.0).norm() > 0.1 && turned(&back, 90.0).norm() < 1e-12);
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
