//! A motor loses steps: the counter advances, the rotor does not.
//!
//! Cause: the load angle of a stepping motor passes half an electrical cycle when the required torque
//! exceeds the pull-out torque, and the rotor settles in another stable position, a multiple of four
//! full steps away (Acarnley, *Stepping Motors*, 4th ed. 2002, ch. 5).
//!
//! Law: `u_i = ũ_i + Σ_k d_ki H(t − t_k)` with ũ the counted piston, `d_ki` the offset of channel i
//! at event k (negative when steps were lost on the way out) and H a step rounded over 50 ms.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `t1_s` … `t4_s` times of four events | s | 60 … 240 ± 100 | – |
//! | `d1_1` … `d4_3` offsets | mm | 0 ± 2 | 0.5-23 (1-50 full steps) |
//!
//! Signature: a persistent jump of one channel, at high acceleration. Similar to
//! `base_motion` (all sensors turn, no bellow explains it) and a slip of the mount. Returning to a
//! pose shows that the offset persists; a sweep of acceleration shows when it occurs.
//!
//! Away from the event the error surface is flat in its time, so a fit has to search for the times.
//! Orientation does not depend on the part that lengthens all bellows alike; of all parameters with the same
//! orientations, those with the fewest channels are reported.

use crate::model::effects::prelude::*;

/// How long an event takes, 10 to 90 %, s.
const RISE_S: f64 = 0.05;

/// Steps lost at up to four instants.
pub struct MissedSteps;

/// Parameters of one event: its time and the offset of each channel.
const fn event(time_s: f64, [time, first, second, third]: [&'static str; 4]) -> [Param; 4] {
    let offset = Param::new("", "mm", 0.0, 2.0, (-24.0, 24.0));
    let [first, second, third] = offset.named([first, second, third]);
    [
        Param::new(time, "s", time_s, 100.0, (0.0, 36_000.0)),
        first.on(1),
        second.on(2),
        third.on(3),
    ]
}

impl Effect for MissedSteps {
    info! {
        name: "missed_steps",
        stage: Stage::Drive,
        signature: "a persistent jump of one channel, at high acceleration",
        confused_with: &["base_motion", "thermal_drift", "contact"],
        separated_by: "returning to a known pose; a sweep of acceleration",
        events: 4,
        params: &join::<16>(&[
            &event(60.0, ["t1_s", "d1_1", "d1_2", "d1_3"]),
            &event(150.0, ["t2_s", "d2_1", "d2_2", "d2_3"]),
            &event(200.0, ["t3_s", "d3_1", "d3_2", "d3_3"]),
            &event(240.0, ["t4_s", "d4_1", "d4_2", "d4_3"]),
        ]),
    }
    fn starts(&self) -> Starts {
        let at = |t_s: [f64; 4]| {
            let offsets = [[0.2, 0.0, -0.2], [0.0; 3], [0.0; 3], [0.0; 3]];
            t_s.into_iter()
                .zip(offsets)
                .flat_map(|(t, [a, b, c])| [t, a, b, c])
                .collect()
        };
        vec![
            at([40.0, 160.0, 200.0, 240.0]),
            at([120.0, 40.0, 200.0, 240.0]),
            at([200.0, 120.0, 40.0, 240.0]),
        ]
    }
    fn pistons(&self, p: &[f64], _m: &mut Memory, at: &Moment, u_mm: &mut Vector3<f64>) {
        for event in p.chunks_exact(4) {
            let come = onset(at.t_s, event[0], RISE_S);
            if come > 0.0 {
                *u_mm += Vector3::new(event[1], event[2], event[3]) * come;
            }
        }
    }
    fn canonical(&self, p: &mut [f64], k_epsilon: &Vector3<f64>) {
        for event in p.chunks_exact_mut(4) {
            let least = fewest_channels(&Vector3::new(event[1], event[2], event[3]), k_epsilon);
            event[1..].copy_from_slice(least.as_slice());
        }
    }
}

/// Of all offsets (mm) that bend the tip as these do, the one of least sum, which leaves at most two
/// channels off and one if one explains it: a common length, in proportion to 1 + k_ε, is free.
fn fewest_channels(offset_mm: &Vector3<f64>, k_epsilon: &Vector3<f64>) -> Vector3<f64> {
    let length = k_epsilon.add_scalar(1.0);
    let common = offset_mm.component_div(&length);
    let without = |i: usize| offset_mm - length * common[i];
    let least = |a: Vector3<f64>, b: Vector3<f64>| if b.lp_norm(1) < a.lp_norm(1) { b } else { a };
    least(least(without(0), without(1)), without(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&MissedSteps);
    }

    #[test]
    fn an_offset_is_sudden_persistent_and_of_one_channel() {
        let p = proof::with(
            &MissedSteps,
            &[
                ("t1_s", 10.0),
                ("d1_2", -3.0),
                ("t2_s", 20.0),
                ("d2_3", 1.0),
            ],
        );
        let run = proof::drive(&MissedSteps, &p, 30.0, proof::exercise);
        for l in &run {
            let gone = l.u_mm - proof::exercise(l.t_s);
            if l.t_s < 9.9 {
                assert!(gone.norm() < 1e-3);
            } else if (10.1..19.9).contains(&l.t_s) {
                assert!(
                    (gone - Vector3::new(0.0, -3.0, 0.0)).norm() < 1e-3,
                    "{gone}"
                );
            } else if l.t_s > 20.1 {
                assert!(
                    (gone - Vector3::new(0.0, -3.0, 1.0)).norm() < 1e-3,
                    "{gone}"
                );
            }
        }
    }

    #[test]
    fn a_jump_is_attributed_to_the_one_motor_that_explains_it() {
        let k = proof::moment(0.0, Vector3::zeros()).k_epsilon;
        for one in [Vector3::x() * -3.8, Vector3::y() * 1.9, Vector3::z() * 9.4] {
            for stretch in [-1.0, -0.3, 0.0, 0.7] {
                let blurred = one + k.add_scalar(1.0) * stretch;
                assert!((fewest_channels(&blurred, &k) - one).norm() < 1e-12);
            }
        }
    }
}
