//! Outside the catalogue: one convolution of a bellow pops open and shut.
//!
//! A fold is bistable: past `at_mm` it pops and adds `jump_mm` within some 50 ms; it pops back only
//! once the bellow has come back by `1.5 jump` (but at least 0.5 mm) below that.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.snap_through]`
    SnapThrough at "effects.outside.snap_through" sized by jump_mm; drawn by rng, severity {
        /// Length that the popped fold adds, mm. Default 0 (none); plausible 0.2 to 1. A larger value jumps
        /// further.
        jump_mm: f64 = 0.0, 0.0..=5.0, "under 1 mm is plausible", draw rng.sized(0.4, 1.5, severity);
        /// Elongation at which it pops, mm. Default 2. A larger value pops at larger bends only.
        at_mm: f64 = 2.0, 0.1..=10.0, "a bellow elongates by 5 mm or so", draw rng.between(1.0, 2.5);
        /// Channel of the bellow, 1 to 3. Default 1.
        channel: usize = 1, 1..=3, "channels are counted from 1 to 3", draw rng.channel();
    }
    /// A fold with its state.
    Snapping runs config {
        popped: bool = false;
        decay: Decay = Decay::new(0.05);
        added_mm: f64 = 0.0;
    }
}

impl Law for Snapping {
    fn bellows(&mut self, q_mm: &mut Vector3<f64>, at: &Moment) {
        let i = self.config.channel - 1;
        let back_mm = self.config.at_mm - (1.5 * self.config.jump_mm).max(0.5);
        self.popped = q_mm[i] > self.config.at_mm || (self.popped && q_mm[i] > back_mm);
        let target = f64::from(self.popped) * self.config.jump_mm;
        self.added_mm += (target - self.added_mm) * self.decay.share(at.dt_s);
        q_mm[i] += self.added_mm;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fold_pops_with_hysteresis() {
        let mut s = Snapping::new(SnapThrough {
            jump_mm: 0.5,
            at_mm: 2.0,
            channel: 2,
        });
        let mut step = |q: f64| {
            let mut q_mm = Vector3::new(9.0, q, 9.0);
            s.bellows(
                &mut q_mm,
                &Moment {
                    t: 0.0,
                    dt_s: 0.001,
                },
            );
            q_mm - Vector3::new(9.0, q, 9.0)
        };
        let mut settle = |q: f64| (0..500).map(|_| step(q)).last().unwrap();
        assert!(settle(1.9).norm() < 1e-9);
        assert!((settle(2.1) - Vector3::new(0.0, 0.5, 0.0)).norm() < 1e-3);
        assert!(settle(1.5).y > 0.49);
        assert!(settle(1.2).y < 0.01);
    }
}
