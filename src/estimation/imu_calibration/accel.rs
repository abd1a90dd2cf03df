//! Accelerometer bias and scale from rests: the specific force of a still sensor is g in every attitude.
//!
//! Six positions (each face up once) give bias and scale per axis. The classic rule, half sum and half difference of
//! opposite faces, errs by 1 − cos θ if a face is not level. It is the start for a fit of |S (a − b)| = g over all
//! rests, which holds in any attitude. Twenty or more rests in all directions also give the cross-axis terms, by the
//! ellipsoid. The scale refers to [`GRAVITY_M_S2`].

use super::ellipsoid::{self, Distance, Measured, VectorFit, check_residual, coverage};
use super::refusal::Refusal;
use super::still::Rest;
use crate::estimation::fusion::intake::GRAVITY_M_S2;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{Matrix3, SVector, Vector3};

const FACES: [&str; 6] = ["+x", "-x", "+y", "-y", "+z", "-z"];

/// Mean specific force per face that is up: the largest component selects it and must exceed 80 % of the norm.
fn by_face(rests: &[Rest]) -> [Option<Vector3<f64>>; 6] {
    let mut sums = [(Vector3::zeros(), 0_u32); 6];
    for rest in rests {
        let a = rest.acc_m_s2;
        let axis = a.iamax();
        if a[axis].abs() > 0.8 * a.norm() {
            let slot = &mut sums[2 * axis + usize::from(a[axis] < 0.0)];
            *slot = (slot.0 + a, slot.1 + 1);
        }
    }
    sums.map(|(sum, n)| (n > 0).then(|| sum / f64::from(n)))
}

/// Noise of the mean norm of a rest, as a share of g: white noise averaged over the samples, plus one part in 20 000
/// for temperature and a yielding table.
fn mean_noise(rest: &Rest) -> f64 {
    let white =
        rest.acc_std_m_s2.norm() / 3.0_f64.sqrt() / (rest.samples as f64).sqrt() / GRAVITY_M_S2;
    white.hypot(5e-5)
}

/// Bias and scale per axis from rests on the six faces, level within about 30°.
///
/// # Errors
/// [`Refusal::MissingFace`] names the first face that was never up; [`Refusal::NotAnEllipsoid`] or
/// [`Refusal::PoorFit`] if the rests contradict each other.
pub fn six_positions(rests: &[Rest]) -> Result<VectorFit, Refusal> {
    let faces = by_face(rests);
    if let Some(missing) = faces.iter().position(Option::is_none) {
        let face = FACES[missing];
        return Err(Refusal::MissingFace { face });
    }
    let mut p = SVector::<f64, 6>::zeros();
    for i in 0..3 {
        let along = |k: usize| faces[2 * i + k].map_or(0.0, |a| a[i]);
        let (up, down) = (along(0), along(1));
        p[i] = 0.5 * (up + down) / GRAVITY_M_S2;
        p[3 + i] = 2.0 * GRAVITY_M_S2 / (up - down);
    }
    let points: Vec<Vector3<f64>> = rests.iter().map(|r| r.acc_m_s2 / GRAVITY_M_S2).collect();
    let start = Distance { points: &points, p };
    let (fit, report) = LevenbergMarquardt::new().with_tol(1e-13).minimize(start);
    let (Some(r), Some(j), true) = (
        fit.residuals(),
        fit.jacobian(),
        report.objective_function.is_finite(),
    ) else {
        return Err(Refusal::NotAnEllipsoid);
    };
    let (count, spare) = (rests.len() as f64, rests.len() as f64 - 6.0);
    let expected = rests.iter().map(|r| mean_noise(r).powi(2)).sum::<f64>() / count;
    let observed = r.norm_squared() / spare;
    let variance = expected.max(if spare > 0.0 { observed } else { 0.0 });
    let information = (j.transpose() * j).try_inverse();
    let cov = information.ok_or(Refusal::NotAnEllipsoid)? * variance;
    let sigma = cov.diagonal().map(|v| v.max(0.0).sqrt());
    let residual = GRAVITY_M_S2 * (r.norm_squared() / count).sqrt();
    check_residual(residual, GRAVITY_M_S2, "m/s²")?;
    let scale = |v: &SVector<f64, 6>| Matrix3::from_diagonal(&v.fixed_rows::<3>(3).into_owned());
    Ok(VectorFit {
        bias: fit.p.fixed_rows::<3>(0) * GRAVITY_M_S2,
        bias_sigma: sigma.fixed_rows::<3>(0) * GRAVITY_M_S2,
        matrix: scale(&fit.p),
        matrix_sigma: scale(&sigma),
        length: GRAVITY_M_S2,
        residual,
        outliers: 0,
        coverage: coverage(rests.iter().map(|r| r.acc_m_s2)),
    })
}

/// Bias, scale and skew from rests in all directions.
///
/// # Errors
/// [`Refusal`] if there are too few, they cover too little of the sphere, or fit no ellipsoid.
pub fn ellipsoid(rests: &[Rest]) -> Result<VectorFit, Refusal> {
    let points: Vec<Vector3<f64>> = rests.iter().map(|r| r.acc_m_s2).collect();
    let gravity = Measured {
        length: Some(GRAVITY_M_S2),
        bias: "the accelerometer bias",
        advice: "place the sensor in more attitudes, upside down too",
        unit: "m/s²",
    };
    ellipsoid::fit(&points, &gravity)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::imu_calibration::still;
    use crate::primitives::sample::ImuSample;
    use crate::primitives::units::Seconds;
    use nalgebra::Rotation3;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    fn normal(rng: &mut StdRng, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| {
            sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng)
        })
    }

    /// The raw mean of a rest whose true force is g along `up`, measured with bias and scale errors.
    fn measured(
        up: Vector3<f64>,
        bias: Vector3<f64>,
        matrix: &Matrix3<f64>,
        rng: &mut StdRng,
    ) -> Rest {
        let ideal = up.normalize() * GRAVITY_M_S2;
        let acc_m_s2 = matrix.try_inverse().expect("near 1") * ideal
            + bias
            + normal(rng, 0.03 / 500.0_f64.sqrt());
        Rest {
            first: 0,
            samples: 500,
            duration_s: 1.0,
            gyro_rad_s: Vector3::zeros(),
            gyro_std_rad_s: Vector3::repeat(0.004),
            acc_m_s2,
            acc_std_m_s2: Vector3::repeat(0.03),
        }
    }

    fn six(tilt_deg: f64, bias: Vector3<f64>, scale: Vector3<f64>, rng: &mut StdRng) -> Vec<Rest> {
        let faces = [
            Vector3::x(),
            -Vector3::x(),
            Vector3::y(),
            -Vector3::y(),
            Vector3::z(),
            -Vector3::z(),
        ];
        faces
            .iter()
            .cycle()
            .take(12)
            .map(|up| {
                let tilt = Rotation3::new(normal(rng, tilt_deg.to_radians()));
                measured(tilt * up, bias, &Matrix3::from_diagonal(&scale), rng)
            })
            .collect()
    }

    #[test]
    fn six_tilted_faces_give_bias_and_scale() {
        let (bias, scale) = (
            Vector3::new(0.4, -0.25, 0.6),
            Vector3::new(1.02, 0.985, 1.01),
        );
        for seed in 0..20 {
            let rests = six(6.0, bias, scale, &mut StdRng::seed_from_u64(seed));
            let fit = six_positions(&rests).expect("six faces");
            let z = (fit.bias - bias).component_div(&fit.bias_sigma);
            let zs = (fit.matrix.diagonal() - scale).component_div(&fit.matrix_sigma.diagonal());
            assert!(z.amax() < 5.0 && zs.amax() < 5.0, "seed {seed}: {z} {zs}");
            assert!((fit.bias - bias).amax() < 0.02, "{}", fit.bias - bias);
            assert!((fit.matrix.diagonal() - scale).amax() < 1e-3);
        }
    }

    #[test]
    fn a_missing_face_is_named() {
        let mut rng = StdRng::seed_from_u64(3);
        let mut rests = six(2.0, Vector3::zeros(), Vector3::repeat(1.0), &mut rng);
        rests.retain(|r| r.acc_m_s2.y > -8.0);
        let refused = six_positions(&rests).unwrap_err();
        assert_eq!(refused, Refusal::MissingFace { face: "-y" });
    }

    #[test]
    fn rests_in_all_directions_give_the_skew() {
        let bias = Vector3::new(0.4, -0.25, 0.6);
        let matrix = Matrix3::new(1.02, 0.01, -0.006, 0.01, 0.985, 0.008, -0.006, 0.008, 1.01);
        let mut worst: f64 = 0.0;
        for seed in 0..10 {
            let mut rng = StdRng::seed_from_u64(seed);
            let rests: Vec<Rest> = (0..60)
                .map(|_| {
                    let up = normal(&mut rng, 1.0);
                    measured(up, bias, &matrix, &mut rng)
                })
                .collect();
            let fit = ellipsoid(&rests).expect("covered");
            worst = worst.max((fit.bias - bias).component_div(&fit.bias_sigma).amax());
            worst = worst.max(
                (fit.matrix - matrix)
                    .component_div(&fit.matrix_sigma)
                    .amax(),
            );
            assert!(
                (fit.matrix - matrix).amax() < 1e-3,
                "{}",
                fit.matrix - matrix
            );
        }
        assert!(
            worst > 0.5 && worst < 5.0,
            "the sigmas match the errors: {worst}"
        );
    }

    #[test]
    fn half_a_sphere_is_refused() {
        let mut rng = StdRng::seed_from_u64(5);
        let rests: Vec<Rest> = (0..80)
            .map(|_| {
                let up = Vector3::z() + 0.3 * normal(&mut rng, 1.0);
                measured(up, Vector3::zeros(), &Matrix3::identity(), &mut rng)
            })
            .collect();
        let refused = ellipsoid(&rests).unwrap_err();
        assert!(
            matches!(
                refused,
                Refusal::PoorCoverage { .. } | Refusal::TooUncertain { .. }
            ),
            "{refused}"
        );
    }

    #[test]
    fn rests_are_found_in_a_recording() {
        let mut rng = StdRng::seed_from_u64(6);
        let mut samples = Vec::new();
        for k in 0..6000_u32 {
            let t = f64::from(k) * 0.002;
            let moving = (2.5..4.0).contains(&t) || (7.0..8.0).contains(&t);
            let up = if t < 3.0 {
                Vector3::z()
            } else if t < 7.5 {
                Vector3::x()
            } else {
                -Vector3::z()
            };
            samples.push(ImuSample {
                t: Seconds(t),
                gyro_rad_s: normal(&mut rng, if moving { 1.0 } else { 0.004 }),
                acc_m_s2: up * GRAVITY_M_S2 + normal(&mut rng, 0.03),
                mag_ut: None,
            });
        }
        let rests = still::rests(&samples);
        assert_eq!(rests.len(), 3, "{rests:?}");
        for (rest, up) in rests
            .iter()
            .zip([Vector3::z(), Vector3::x(), -Vector3::z()])
        {
            assert!((rest.acc_m_s2 - up * GRAVITY_M_S2).norm() < 0.02);
            assert!(rest.duration_s >= 2.0);
        }
    }
}
