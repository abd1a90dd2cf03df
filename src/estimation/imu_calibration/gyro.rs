//! Gyroscope bias from a rest, with its standard deviation.
//!
//! The noise of a MEMS gyroscope is white only up to about one second, where the Allan deviation has its minimum. The
//! sigma of the mean is therefore the larger of the white estimate s/√n and the spread of ten block means over √10.

use super::refusal::Refusal;
use super::still;
use crate::estimation::fusion::align::AlignConfig;
use crate::primitives::ImuSample;
use nalgebra::Vector3;

const BLOCKS: usize = 10;

/// Result for the gyroscope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GyroBias {
    /// Reading at rest, rad/s.
    pub bias_rad_s: Vector3<f64>,
    /// One sigma per axis, rad/s.
    pub sigma_rad_s: Vector3<f64>,
    /// Length of the rest, s.
    pub duration_s: f64,
}

/// Bias from a stretch of samples that is one rest.
///
/// # Errors
/// [`Refusal`] if it is too short, not finite, or contains motion.
pub fn at_rest(samples: &[ImuSample]) -> Result<GyroBias, Refusal> {
    let rest = still::rest(samples)?;
    // a steady rotation about the vertical, which the accelerometer does not observe, is bounded
    // by the default of an alignment
    let limit = AlignConfig::default().gyro_bias_max_rad_s;
    let have = rest.gyro_rad_s.amax();
    if have > limit {
        return Err(Refusal::Moving {
            what: "the mean of the gyroscope",
            have,
            limit,
            unit: "rad/s",
        });
    }
    let white = rest.gyro_std_rad_s / (rest.samples as f64).sqrt();
    let size = samples.len() / BLOCKS;
    let off = |block: &[ImuSample]| {
        block.iter().map(|s| s.gyro_rad_s).sum::<Vector3<f64>>() / size as f64 - rest.gyro_rad_s
    };
    let offs = samples.chunks_exact(size).take(BLOCKS).map(off);
    let squares: Vector3<f64> = offs.map(|d| d.component_mul(&d)).sum();
    let coloured = squares.map(|s| (s / (BLOCKS * (BLOCKS - 1)) as f64).sqrt());
    Ok(GyroBias {
        bias_rad_s: rest.gyro_rad_s,
        sigma_rad_s: white.zip_map(&coloured, f64::max),
        duration_s: rest.duration_s,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::units::Seconds;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A rest of `n` samples at 500 Hz; `rate` is a true rotation.
    fn recording(n: u32, bias: Vector3<f64>, rate: Vector3<f64>, seed: u64) -> Vec<ImuSample> {
        let mut rng = StdRng::seed_from_u64(seed);
        let mut noise = move |sigma: f64| {
            Vector3::from_fn(|_, _| {
                sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng)
            })
        };
        (0..n)
            .map(|k| {
                let t = f64::from(k) * 0.002;
                let back = nalgebra::Rotation3::new(-rate * t);
                ImuSample {
                    t: Seconds(t),
                    gyro_rad_s: bias + rate + noise(0.004),
                    acc_m_s2: back * Vector3::new(0.0, 0.0, 9.81) + noise(0.03),
                    mag_ut: (k % 5 == 0)
                        .then(|| back * Vector3::new(20.0, 0.0, -45.0) + noise(0.5)),
                }
            })
            .collect()
    }

    #[test]
    fn the_bias_is_found_within_its_sigma() {
        let bias = Vector3::new(0.02, -0.035, 0.011);
        let mut chi2 = 0.0;
        for seed in 0..40 {
            let fit = at_rest(&recording(1000, bias, Vector3::zeros(), seed)).expect("still");
            let z = (fit.bias_rad_s - bias).component_div(&fit.sigma_rad_s);
            assert!(z.amax() < 4.5, "seed {seed}: {z}");
            assert!(fit.sigma_rad_s.amax() < 4e-4, "2 s of 0.004 rad/s noise");
            chi2 += z.norm_squared() / 120.0;
        }
        assert!(
            (0.5..1.6).contains(&chi2),
            "the sigma matches the errors: {chi2}"
        );
    }

    #[test]
    fn slow_steady_rotation_is_refused() {
        let slow = Vector3::new(0.01, 0.0, 0.0); // 0.57 °/s, less than a typical bias
        let refused = at_rest(&recording(1000, Vector3::zeros(), slow, 1)).unwrap_err();
        assert!(
            matches!(
                refused,
                Refusal::Moving {
                    what: "the rotation from start to end",
                    ..
                }
            ),
            "{refused}"
        );
        let yaw = Vector3::new(0.0, 0.0, 0.02); // only the field observes it
        assert!(at_rest(&recording(2000, Vector3::zeros(), yaw, 2)).is_err());
        let mut shaken = recording(1000, Vector3::zeros(), Vector3::zeros(), 3);
        shaken[400].gyro_rad_s.y += 3.0;
        assert!(matches!(at_rest(&shaken), Err(Refusal::Moving { .. })));
    }

    #[test]
    fn short_and_non_finite_recordings_are_refused() {
        let still = |n| recording(n, Vector3::zeros(), Vector3::zeros(), 4);
        assert!(matches!(
            at_rest(&[]),
            Err(Refusal::TooFewSamples { have: 0, .. })
        ));
        assert!(matches!(
            at_rest(&still(400)),
            Err(Refusal::TooFewSamples {
                have: 400,
                want: 502
            })
        ));
        let mut broken = still(1000);
        broken[7].acc_m_s2.x = f64::NAN;
        assert_eq!(at_rest(&broken), Err(Refusal::NotFinite { index: 7 }));
    }
}
