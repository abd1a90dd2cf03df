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
//! Signature: all sensors are late by the same time; the tip itself is on time. Similar to
//! `transport_delay` (tip and sensors late) and `line_lag` (rounds off). An outside reference separates it.

use crate::model::effects::prelude::*;

/// Dead time after the tip.
pub struct SensorLatency;

impl Effect for SensorLatency {
    info! {
        name: "sensor_latency",
        stage: Stage::Timing,
        signature: "all sensors are late by a constant time while the tip itself is on time",
        confused_with: &["transport_delay", "line_lag"],
        separated_by: "an outside reference; a chirp",
        params: &[Param::new("latency", "s", 0.0, 0.08, (0.0, 0.5))],
        starts: &[&[0.03], &[0.15]],
    }
    fn latency_s(&self, p: &[f64]) -> f64 {
        p[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&SensorLatency);
    }

    #[test]
    fn it_delays_the_sample_and_not_the_command() {
        let e = SensorLatency;
        assert_eq!((e.transport_s(&[0.12]), e.latency_s(&[0.12])), (0.0, 0.12));
    }
}
