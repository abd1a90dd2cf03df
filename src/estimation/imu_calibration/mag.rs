//! Hard and soft iron from a tumble. The strength of the Earth's field is constant, so the readings lie on an
//! ellipsoid whose centre is the hard iron and whose shape is the soft iron (Kok and Schön 2016 derive the same
//! model; its rotation part needs gravity and is omitted).
//!
//! The readings do not determine the absolute strength, so the matrix has determinant 1 and [`VectorFit::length`] is
//! the strength in units of the sensor.

use super::ellipsoid::{self, Measured, VectorFit};
use super::refusal::Refusal;
use nalgebra::Vector3;

/// Hard iron and soft iron from a tumble, motors off; in µT.
///
/// # Errors
/// [`Refusal`] if the tumble is too short or covers too little, or the field was not homogeneous.
pub fn ellipsoid(readings_ut: &[Vector3<f64>]) -> Result<VectorFit, Refusal> {
    let field = Measured {
        length: None,
        bias: "the hard iron",
        advice: "turn the sensor about all three axes, upside down too",
        unit: "µT",
    };
    ellipsoid::fit(readings_ut, &field)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    const FIELD_UT: f64 = 49.0;

    fn normal(rng: &mut StdRng, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| {
            sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng)
        })
    }

    fn truth() -> (Vector3<f64>, Matrix3<f64>) {
        let m: Matrix3<f64> = Matrix3::new(1.12, 0.04, -0.03, 0.04, 0.93, 0.05, -0.03, 0.05, 1.01);
        // the part tolerates 300 µT of hard iron
        (
            Vector3::new(-140.0, 60.0, 210.0),
            m / m.determinant().cbrt(),
        )
    }

    /// Readings of a random tumble, with directions taken through `shape`.
    fn tumble(
        n: usize,
        seed: u64,
        shape: impl Fn(Vector3<f64>) -> Vector3<f64>,
    ) -> Vec<Vector3<f64>> {
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
            let fit = ellipsoid(&tumble(1500, seed, |d| d)).expect("tumbled");
            let z = (fit.bias - bias).component_div(&fit.bias_sigma);
            let zm = (fit.matrix - matrix).component_div(&fit.matrix_sigma);
            assert!(z.amax() < 4.5 && zm.amax() < 4.5, "seed {seed}: {z} {zm}");
            assert!((fit.length - FIELD_UT).abs() < 0.1 && fit.coverage > 0.99);
            assert!((fit.matrix.determinant() - 1.0).abs() < 1e-9);
            chi2 += z.norm_squared() / 60.0;
        }
        assert!(
            (0.4..2.0).contains(&chi2),
            "the sigma of the hard iron matches the errors: {chi2}"
        );
    }

    #[test]
    fn outliers_are_removed() {
        let mut readings = tumble(1500, 3, |d| d);
        for k in 0..30 {
            readings[k * 50] += Vector3::new(40.0, 0.0, -40.0);
        }
        let fit = ellipsoid(&readings).expect("2 % outliers");
        assert!((25..60).contains(&fit.outliers), "{}", fit.outliers);
        assert!(
            (fit.bias - truth().0).norm() < 0.2,
            "{}",
            fit.bias - truth().0
        );
    }

    #[test]
    fn four_fifths_of_the_sphere_suffice_and_a_cap_is_refused() {
        let wide = tumble(1500, 4, |d| if d.normalize().z < -0.6 { -d } else { d });
        ellipsoid(&wide).expect("four fifths of the sphere");
        let cap = tumble(1500, 5, |d| {
            Vector3::new(d.x * 0.4, d.y * 0.4, d.z.abs() + 1.0)
        });
        let refused = ellipsoid(&cap).unwrap_err();
        assert!(
            matches!(refused, Refusal::PoorCoverage { .. } | Refusal::Flat { .. }),
            "{refused}"
        );
        let disc = tumble(1500, 6, |d| Vector3::new(d.x, d.y, 0.0));
        let refused = ellipsoid(&disc).unwrap_err();
        assert!(
            matches!(refused, Refusal::Flat { ratio, .. } if ratio > 2.0),
            "one axis only: {refused}"
        );
    }

    #[test]
    fn a_changing_field_is_refused() {
        let mut readings = tumble(1500, 7, |d| d);
        for (k, x) in readings.iter_mut().enumerate() {
            *x += Vector3::new(12.0, 0.0, 0.0) * (k as f64 * 0.01).sin(); // a magnet passes by
        }
        let refused = ellipsoid(&readings).unwrap_err();
        assert!(matches!(refused, Refusal::PoorFit { .. }), "{refused}");
        assert!(matches!(
            ellipsoid(&readings[..10]),
            Err(Refusal::TooFewSamples { .. })
        ));
        assert_eq!(
            ellipsoid(&[Vector3::zeros(); 100]),
            Err(Refusal::NotAnEllipsoid)
        );
        readings[9].y = f64::INFINITY;
        assert_eq!(ellipsoid(&readings), Err(Refusal::NotFinite { index: 9 }));
    }
}
