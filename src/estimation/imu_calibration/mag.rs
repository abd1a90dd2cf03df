//! Hard and soft iron from a tumble: the earth's field has one strength, so its readings lie on an
//! ellipsoid whose centre is the hard iron and whose shape is the soft iron (Kok and Schön 2016
//! derive the same model; its rotation part needs gravity and is left out).
//!
//! The strength itself cannot be known from the readings: the matrix has determinant 1, and
//! [`MagFit::field_ut`] is the strength in the sensor's own units.

use super::{CalibrationLimits, Refusal, ellipsoid, sphere_coverage};
use nalgebra::{Matrix3, Vector3};

/// What a tumble says about the magnetometer: `m = matrix (m_raw − bias)`.
#[derive(Debug, Clone, PartialEq)]
pub struct MagFit {
    /// Hard iron, µT.
    pub bias_ut: Vector3<f64>,
    /// One sigma of it per axis, µT.
    pub bias_sigma_ut: Vector3<f64>,
    /// Soft iron, symmetric, determinant 1.
    pub matrix: Matrix3<f64>,
    /// One sigma of each entry.
    pub matrix_sigma: Matrix3<f64>,
    /// Strength of the corrected field, µT.
    pub field_ut: f64,
    /// rms of the corrected norm against it, µT.
    pub residual_ut: f64,
    /// Readings left out as wild.
    pub outliers: usize,
    /// Share of the sphere of directions touched, 0 to 1.
    pub coverage: f64,
}

/// Fits a tumble, motors off.
///
/// # Errors
/// [`Refusal`] when the tumble is too short or too lazy, or the field was not one field.
pub fn ellipsoid(readings_ut: &[Vector3<f64>], limits: &CalibrationLimits) -> Result<MagFit, Refusal> {
    let e = ellipsoid::fit(readings_ut, limits)?;
    let field_ut = e.radius();
    let directions: Vec<Vector3<f64>> = readings_ut.iter().map(|x| e.shape * (x - e.centre)).collect();
    let coverage = sphere_coverage(directions.iter());
    if coverage < limits.sphere_coverage {
        let advice = "turn it over all three axes, upside down too";
        return Err(Refusal::PoorCoverage { what: "the sphere", have: coverage, want: limits.sphere_coverage, advice });
    }
    let (sigma, limit) = (e.centre_sigma.amax(), limits.centre_sigma * field_ut);
    if sigma > limit {
        return Err(Refusal::TooUncertain { what: "the hard iron", sigma, limit, unit: "µT" });
    }
    let (rms, limit) = (e.residual * field_ut, limits.ellipsoid_residual * field_ut);
    if rms > limit {
        return Err(Refusal::PoorFit { rms, limit, unit: "µT" });
    }
    Ok(MagFit {
        bias_ut: e.centre,
        bias_sigma_ut: e.centre_sigma,
        matrix: e.shape * field_ut,
        matrix_sigma: e.shape_sigma * field_ut,
        field_ut,
        residual_ut: rms,
        outliers: e.outliers,
        coverage,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    const FIELD_UT: f64 = 49.0;

    fn normal(rng: &mut StdRng, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng))
    }

    fn truth() -> (Vector3<f64>, Matrix3<f64>) {
        let m: Matrix3<f64> = Matrix3::new(1.12, 0.04, -0.03, 0.04, 0.93, 0.05, -0.03, 0.05, 1.01);
        // three hundred µT of hard iron are within the part's tolerance
        (Vector3::new(-140.0, 60.0, 210.0), m / m.determinant().cbrt())
    }

    /// Readings of a random tumble, with directions taken through `shape`.
    fn tumble(n: usize, seed: u64, shape: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Vec<Vector3<f64>> {
        let mut rng = StdRng::seed_from_u64(seed);
        let (bias, matrix) = truth();
        let inverse = matrix.try_inverse().expect("near 1");
        (0..n)
            .map(|_| {
                let direction = shape(normal(&mut rng, 1.0)).normalize();
                inverse * direction * FIELD_UT + bias + normal(&mut rng, 0.5)
            })
            .collect()
    }

    #[test]
    fn hard_and_soft_iron_are_found_within_their_sigmas() {
        let (bias, matrix) = truth();
        let mut chi2 = 0.0;
        for seed in 0..20 {
            let fit = ellipsoid(&tumble(1500, seed, |d| d), &CalibrationLimits::default()).expect("tumbled");
            let z = (fit.bias_ut - bias).component_div(&fit.bias_sigma_ut);
            let zm = (fit.matrix - matrix).component_div(&fit.matrix_sigma);
            assert!(z.amax() < 4.5 && zm.amax() < 4.5, "seed {seed}: {z} {zm}");
            assert!((fit.field_ut - FIELD_UT).abs() < 0.1 && fit.coverage > 0.99);
            assert!((fit.matrix.determinant() - 1.0).abs() < 1e-9);
            chi2 += z.norm_squared() / 60.0;
        }
        assert!((0.4..2.0).contains(&chi2), "sigma of the hard iron is honest: {chi2}");
    }

    #[test]
    fn wild_readings_are_left_out() {
        let mut readings = tumble(1500, 3, |d| d);
        for k in 0..30 {
            readings[k * 50] += Vector3::new(40.0, 0.0, -40.0);
        }
        let fit = ellipsoid(&readings, &CalibrationLimits::default()).expect("2 % wild");
        assert!((25..60).contains(&fit.outliers), "{}", fit.outliers);
        assert!((fit.bias_ut - truth().0).norm() < 0.2, "{}", fit.bias_ut - truth().0);
    }

    #[test]
    fn a_wide_cone_is_enough_and_a_narrow_one_is_refused() {
        let wide = tumble(1500, 4, |d| if d.normalize().z < -0.6 { -d } else { d });
        ellipsoid(&wide, &CalibrationLimits::default()).expect("four fifths of the sphere");
        let cap = tumble(1500, 5, |d| Vector3::new(d.x * 0.4, d.y * 0.4, d.z.abs() + 1.0));
        let refused = ellipsoid(&cap, &CalibrationLimits::default()).unwrap_err();
        assert!(matches!(refused, Refusal::PoorCoverage { .. } | Refusal::Flat { .. }), "{refused}");
        let disc = tumble(1500, 6, |d| Vector3::new(d.x, d.y, 0.0));
        let refused = ellipsoid(&disc, &CalibrationLimits::default()).unwrap_err();
        assert!(matches!(refused, Refusal::Flat { ratio, .. } if ratio > 2.0), "one axis only: {refused}");
    }

    #[test]
    fn a_field_that_changes_is_refused() {
        let mut readings = tumble(1500, 7, |d| d);
        for (k, x) in readings.iter_mut().enumerate() {
            *x += Vector3::new(12.0, 0.0, 0.0) * (k as f64 * 0.01).sin(); // a magnet passes by
        }
        let refused = ellipsoid(&readings, &CalibrationLimits::default()).unwrap_err();
        assert!(matches!(refused, Refusal::PoorFit { .. }), "{refused}");
        assert!(matches!(ellipsoid(&readings[..10], &CalibrationLimits::default()), Err(Refusal::TooFewSamples { .. })));
        assert_eq!(ellipsoid(&[Vector3::zeros(); 100], &CalibrationLimits::default()), Err(Refusal::NotAnEllipsoid));
        readings[9].y = f64::INFINITY;
        assert_eq!(ellipsoid(&readings, &CalibrationLimits::default()), Err(Refusal::NotFinite { index: 9 }));
    }
}
