//! Dead time from command to motion.
//!
//! Cause: bus, driver queue, and the sound's way down the line (Smith, *Closer control of loops with dead
//! time*, Chem. Eng. Prog. 1957). Law: `u′(t) = u(t − T)`.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `delay` T | s | 0 ± 0.08 | 0.01-0.25 |
//!
//! Signature: a phase that grows with frequency, and no rounding. Easily confused with
//! `sensor_latency` (the same but for what the reference or a body-fixed disturbance sees) and
//! `line_lag` (rounds). A chirp separates it from the lag; an outside reference from the latency.

use crate::model::effects::{Effect, EffectInfo, Param, Stage, Starts};

/// Dead time before the pistons.
#[derive(Debug, Clone, Copy, Default)]
pub struct TransportDelay;

/// The catalogue entry.
const INFO: EffectInfo = EffectInfo {
    name: "transport_delay",
    stage: Stage::Timing,
    signature: "motion comes late by a constant time: phase grows with frequency, without rounding",
    confused_with: &["sensor_latency", "line_lag"],
    separated_by: "a chirp; an outside reference",
    is_event: false,
    params: &[Param::new("delay", "s", 0.0, 0.08, (0.0, 0.5))],
};

impl Effect for TransportDelay {
    fn info(&self) -> &'static EffectInfo {
        &INFO
    }
    fn starts(&self) -> Starts {
        vec![vec![0.03], vec![0.15]]
    }
    fn transport_s(&self, p: &[f64]) -> f64 {
        p[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::proof;

    #[test]
    fn keeps_the_rules() {
        proof::keeps_the_rules(&TransportDelay);
    }

    #[test]
    fn it_delays_the_command_and_not_the_sample() {
        let e = TransportDelay;
        assert_eq!((e.transport_s(&[0.12]), e.latency_s(&[0.12])), (0.12, 0.0));
        assert!(!e.sensing_only(), "the tip moves at another time");
    }
}
