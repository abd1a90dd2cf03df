//! Outside the catalogue: a sensor that hangs now and then and repeats its last reading.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.sensor_freeze]`
    SensorFreeze at "effects.outside.sensor_freeze" sized by for_s; drawn by rng, severity {
        /// How long it hangs, s. Default 0 (never); plausible 0.3 to 3. A larger value blinds for longer.
        for_s: f64 = 0.0, 0.0..=1e4, "some seconds are plausible", draw rng.sized(0.5, 3.0, severity);
        /// When it first hangs, s. Default 12.
        at_s: f64 = 12.0, 0.0..=1e9, "seconds since the start", draw rng.between(8.0, 20.0);
        /// Time from one hang to the next, s. Default 25. A larger value hangs less often.
        every_s: f64 = 25.0, 0.01..=1e9, "longer than it hangs", draw rng.between(10.0, 25.0);
    }
}

impl Law for SensorFreeze {
    fn hangs(&self, t: f64) -> bool {
        t >= self.at_s && (t - self.at_s) % self.every_s < self.for_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_freeze_recurs() {
        let f = SensorFreeze {
            for_s: 1.0,
            at_s: 5.0,
            every_s: 10.0,
        };
        assert!(!f.hangs(4.9) && f.hangs(5.5) && !f.hangs(6.5) && f.hangs(15.5));
    }
}
