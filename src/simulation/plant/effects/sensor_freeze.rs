//! Outside the catalogue: a sensor that hangs now and then and repeats its last reading.

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.outside.sensor_freeze]`
    SensorFreeze at "effects.outside.sensor_freeze" sized by for_s {
        /// How long it hangs, s. Default 0 (never); plausible 0.3 to 3. A larger value blinds for longer.
        for_s: f64 = 0.0, "", 0.0..=1e4, "some seconds are plausible";
        /// When it first hangs, s. Default 12.
        at_s: f64 = 12.0, "", 0.0..=1e9, "seconds since the start";
        /// Time from one hang to the next, s. Default 25. A larger value hangs less often.
        every_s: f64 = 25.0, "", 0.01..=1e9, "longer than it hangs";
    }
}

impl PlantEffect for SensorFreeze {
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self {
            for_s: rng.sized(0.5, 3.0, severity),
            at_s: rng.between(8.0, 20.0),
            every_s: rng.between(10.0, 25.0),
        }
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
