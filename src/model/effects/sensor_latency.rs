//! Dead time from motion to sample.
//!
//! Cause: filters in the sensor, bus, time stamps taken on arrival (Li and Mourikis, *Online temporal
//! calibration for camera-IMU systems*, Int. J. Robotics Research 2014). Law: `y′(t) = y(t − T)` for all that
//! the tip IMU reads.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `latency` T | s | 0 ± 0.08 | 0.01-0.25 |
//!
//! Signature: the sensors come late together; the tip itself is on time. Easily confused with
//! `transport_delay` (tip and sensors late) and `line_lag` (rounds). An outside reference separates it.

use crate::model::effects::{Effect, Param, Stage, Starts};

/// Dead time after the tip.
#[derive(Debug, Clone, Copy, Default)]
pub struct SensorLatency;

impl Effect for SensorLatency {
    fn name(&self) -> &'static str {
        "sensor_latency"
    }
    fn stage(&self) -> Stage {
        Stage::Timing
    }
    fn signature(&self) -> &'static str {
        "all sensors come late by a constant time while the tip itself is on time"
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["transport_delay", "line_lag"]
    }
    fn separated_by(&self) -> &'static str {
        "an outside reference; a chirp"
    }
    fn params(&self) -> Vec<Param> {
        vec![Param::new("latency", "s", 0.0, 0.08, (0.0, 0.5))]
    }
    fn starts(&self) -> Starts {
        vec![vec![0.03], vec![0.15]]
    }
    fn latency_s(&self, p: &[f64]) -> f64 {
        p[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::proof;

    #[test]
    fn keeps_the_rules() {
        proof::keeps_the_rules(&SensorLatency);
    }

    #[test]
    fn it_delays_the_sample_and_not_the_command() {
        let e = SensorLatency;
        assert_eq!((e.transport_s(&[0.12]), e.latency_s(&[0.12])), (0.0, 0.12));
    }
}
