//! Dead time from command to motion.
//!
//! Cause: bus, driver queue, and the propagation of sound in the line (Smith, *Closer control of loops with dead
//! time*, Chem. Eng. Prog. 1957). Law: `u′(t) = u(t − T)`.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `delay` T | s | 0 ± 0.08 | 0.01-0.25 |
//!
//! Signature: a phase that grows with frequency, and no rounding. Similar to
//! `sensor_latency` (differs only in the reference and in body-fixed disturbances) and
//! `line_lag` (rounds off). A chirp separates it from the lag; an outside reference from the latency.

use crate::model::effects::prelude::*;

/// Dead time before the pistons.
pub struct TransportDelay;

impl Effect for TransportDelay {
    info! {
        name: "transport_delay",
        stage: Stage::Timing,
        signature: "motion is late by a constant time: phase grows with frequency, without rounding",
        confused_with: &["sensor_latency", "line_lag"],
        separated_by: "a chirp; an outside reference",
        params: &[Param::new("delay", "s", 0.0, 0.08, (0.0, 0.5))],
        starts: &[&[0.03], &[0.15]],
    }
    fn transport_s(&self, p: &[f64]) -> f64 {
        p[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&TransportDelay);
    }

    #[test]
    fn it_delays_the_command_and_not_the_sample() {
        let e = TransportDelay;
        assert_eq!((e.transport_s(&[0.12]), e.latency_s(&[0.12])), (0.12, 0.0));
        assert!(!e.sensing_only(), "the tip moves at another time");
    }
}
