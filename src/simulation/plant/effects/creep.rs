//! Rubber that yields under load: a spectrum of retarded springs, driven more by larger strain.
//!
//! Five Kelvin-Voigt elements with retardation times spread evenly in log time from 0.4 to 100 s and
//! weights `∝ τ^α` (the spectrum of a power law over those decades), each relaxing towards its share
//! of `q (1 + ν |q| / 5 mm)`. The motion grows in holds and recovers afterwards.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.creep]`
    Creep at "effects.creep" sized by share; background 0.002; drawn by rng, severity {
        /// Final growth, as a share of the motion. Default 0 (none); typical 0.02 to 0.4.
        /// A larger value creeps further.
        share: f64 = 0.0, 0.0..=2.0, "0.02 to 0.4 is typical", draw rng.sized(0.08, 0.4, severity);
        /// Exponent α of the spectrum. Default 0.2. A larger value shifts the creep from seconds to
        /// minutes.
        exponent: f64 = 0.2, -1.0..=1.0, "0.2 is typical", draw rng.between(0.0, 0.3);
        /// Nonlinearity ν of the drive at large strain. Default 0.3. A larger value departs more from proportional.
        nonlinear: f64 = 0.3, 0.0..=3.0, "0.3 is typical", draw rng.between(0.0, 0.6);
    }
    /// Retarded strains of the three bellows.
    Creeping runs config {
        elements: [(Decay, f64, Vector3<f64>); ELEMENTS] = {
            let tau = |j: usize| SHORTEST_S * (LONGEST_S / SHORTEST_S).powf(j as f64 / (ELEMENTS - 1) as f64);
            let raw: [f64; ELEMENTS] = std::array::from_fn(|j| tau(j).powf(config.exponent));
            let sum: f64 = raw.iter().sum();
            std::array::from_fn(|j| (Decay::new(tau(j)), config.share * raw[j] / sum, Vector3::zeros()))
        };
    }
}

/// Number of elements.
const ELEMENTS: usize = 5;
/// Shortest and longest retardation time, s: the range that a log of minutes resolves.
const SHORTEST_S: f64 = 0.4;
const LONGEST_S: f64 = 100.0;
/// Strain at which the nonlinear drive counts fully, mm.
const FULL_MM: f64 = 5.0;

impl Law for Creeping {
    fn bellows(&mut self, q_mm: &mut Vector3<f64>, at: &Moment) {
        let drive = q_mm.map(|q| q * (1.0 + self.config.nonlinear * q.abs() / FULL_MM));
        let mut crept = Vector3::zeros();
        for (decay, share, strain) in &mut self.elements {
            *strain += (drive * *share - *strain) * decay.share(at.dt_s);
            crept += *strain;
        }
        *q_mm += crept;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn creep_grows_over_decades_of_time_and_recovers() {
        let mut c = Creeping::new(Creep {
            share: 0.2,
            nonlinear: 0.0,
            ..Creep::default()
        });
        let mut crept = |q: f64| {
            let mut q_mm = Vector3::repeat(q);
            c.bellows(&mut q_mm, &Moment { t: 0.0, dt_s: 0.01 });
            q_mm.x - q
        };
        let at: Vec<f64> = (0..60_000).map(|_| crept(5.0)).collect();
        assert!(at.windows(2).all(|w| w[1] > w[0]) && (at[59_999] - 1.0).abs() < 0.01);
        // each decade of time adds something: no single exponential does that
        let grown = [at[99], at[999] - at[99], at[9_999] - at[999]];
        assert!(grown.iter().all(|g| *g > 0.12), "{grown:?}");
        for _ in 0..60_000 {
            crept(0.0);
        }
        assert!(crept(0.0) < 0.01);
    }
}
