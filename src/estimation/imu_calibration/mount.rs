//! Orientation of the sensor in the tip, from bends.
//!
//! A pure bend by β in direction δ has the rotation vector β (sin δ, cos δ, 0) in the frame of the tip (paper, Eq. 7).
//! All bend axes therefore lie in one plane. The normal of that plane in sensor coordinates is the tip's z axis, which
//! gives two of the three mount angles independently of the commands. The third angle, about z, needs the commanded
//! directions and contains their error, such as a misplaced bellow. The plane is the smallest eigenvector of Σ w a aᵀ;
//! all three angles solve Wahba's problem by SVD (Markley 1988).
//!
//! A twist in proportion to the bend moves every axis out of the plane by the same angle. Over a full circle of
//! directions this does not tilt the normal, and [`Mount::twist_per_bend`] reports it.

use super::refusal::Refusal;
use crate::primitives::{ImuSample, Rotation, Sensor, Tip};
use nalgebra::{Matrix2, Matrix3, UnitQuaternion, Vector2, Vector3};

crate::constants! {
    /// What the bends must fulfil.
    const ENOUGH: BendLimits;
    /// Smallest bend that is used, degrees.
    bend_min_deg = 10.0;
    /// Smallest spread of the directions: 0.5 is a full circle, 0 a single direction.
    spread_min = 0.15;
    /// Largest rms angle of the bend axes out of their plane, degrees.
    out_of_plane_max_deg = 5.0;
}

/// Fewest bends.
const BENDS_MIN: usize = 4;

/// A change of the bend within one plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BendTurn {
    /// Rotation vector in the sensor frame, rad; see [`turn_of`].
    pub turn_rad: Vector3<f64>,
    /// Commanded direction δ, rad, of an increasing bend, δ + π of a decreasing one; `None` if not known.
    pub direction_rad: Option<f64>,
}

/// Rotation vector of a stretch of gyroscope samples, rad, in the sensor frame at its start.
pub fn turn_of(samples: &[ImuSample], gyro_bias_rad_s: &Vector3<f64>) -> Vector3<f64> {
    let mut q = UnitQuaternion::identity();
    for pair in samples.windows(2) {
        let dt_s = pair[1].t.0 - pair[0].t.0;
        let rate = 0.5 * (pair[0].gyro_rad_s + pair[1].gyro_rad_s) - gyro_bias_rad_s;
        q *= UnitQuaternion::from_scaled_axis(rate * dt_s);
    }
    q.scaled_axis()
}

/// Result for the mount.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mount {
    /// Sensor to tip.
    pub r_tip_sensor: Rotation<Tip, Sensor>,
    /// One sigma of a rotation about the tip's x, y and z, rad. About z it is π/√3, that of a
    /// uniform distribution, if no directions are given; the rotation then has no component about z.
    pub sigma_rad: Vector3<f64>,
    /// rms angle of the bend axes out of their plane, rad, without the twist.
    pub out_of_plane_rad: f64,
    /// Mean slope of the axes out of the plane: radians of twist per radian of bend.
    pub twist_per_bend: f64,
    /// Smaller in-plane share of the squared axes: 0.5 is a full circle, 0 a single direction.
    pub spread: f64,
    /// Number of bends used.
    pub bends: usize,
}

/// Mount from bends in several directions.
///
/// # Errors
/// [`Refusal`] if there are fewer than four bends of at least 10°, their directions are too similar, or they do not
/// share a plane.
pub fn from_bends(bends: &[BendTurn]) -> Result<Mount, Refusal> {
    Refusal::unless_finite(bends.iter().map(|b| &b.turn_rad))?;
    let large = |b: &&BendTurn| b.turn_rad.norm() >= ENOUGH.bend_min_deg.to_radians();
    let used: Vec<BendTurn> = bends.iter().filter(large).copied().collect();
    Refusal::unless_enough(used.len(), BENDS_MIN)?;
    let weight: f64 = used.iter().map(|b| b.turn_rad.norm_squared()).sum();
    // weights are |turn|², since the error of an integrated gyroscope does not depend on the angle
    let squares = used.iter().map(|b| b.turn_rad * b.turn_rad.transpose());
    let eigen = (squares.sum::<Matrix3<f64>>() / weight).symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let spread = eigen.eigenvalues[order[1]];
    if spread < ENOUGH.spread_min {
        return Err(Refusal::PoorCoverage {
            what: "the plane of bends",
            have: spread,
            want: ENOUGH.spread_min,
            advice: "bend in all directions, at most 90° apart",
        });
    }
    let normal = eigen.eigenvectors.column(order[0]).into_owned();
    match directed(&used) {
        Some(q) => evaluate(&used, q, true, spread),
        None => evaluate(&used, upright(&normal), false, spread),
    }
}

/// Solution of Wahba's problem, if every bend has a direction.
fn directed(bends: &[BendTurn]) -> Option<UnitQuaternion<f64>> {
    let mut b = Matrix3::zeros();
    for bend in bends {
        let (sin, cos) = bend.direction_rad?.sin_cos();
        b += Vector3::new(sin, cos, 0.0) * bend.turn_rad.norm() * bend.turn_rad.transpose();
    }
    let svd = b.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let handed = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    Some(UnitQuaternion::from_matrix(&(u * handed * v_t)))
}

/// The smallest rotation from the normal of a plane, of either sign, to z.
fn upright(normal: &Vector3<f64>) -> UnitQuaternion<f64> {
    let up = if normal.z < 0.0 { -normal } else { *normal };
    UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_default()
}

/// Residuals and sigmas of a rotation; refuses bends that do not share a plane.
fn evaluate(
    bends: &[BendTurn],
    q: UnitQuaternion<f64>,
    yaw_known: bool,
    spread: f64,
) -> Result<Mount, Refusal> {
    let turned: Vec<Vector3<f64>> = bends.iter().map(|b| q * b.turn_rad).collect();
    let weight: f64 = turned.iter().map(|t| t.norm_squared()).sum();
    let twist_per_bend = turned.iter().map(|t| t.z * t.norm()).sum::<f64>() / weight;
    let lift = |t: &Vector3<f64>| t.z - twist_per_bend * t.norm(); // rad out of the plane
    let squares: f64 = turned.iter().map(|t| lift(t).powi(2)).sum();
    let out_of_plane_rad = (squares / weight).sqrt();
    let limit = ENOUGH.out_of_plane_max_deg;
    let rms = (turned.iter().map(|t| t.z * t.z).sum::<f64>() / weight)
        .sqrt()
        .to_degrees();
    let unit = "deg";
    if rms > limit {
        return Err(Refusal::PoorFit { rms, limit, unit });
    }
    // a rotation ε of the frame lifts a turn t by (ε × t)·z = ε_x t_y − ε_y t_x
    let information: Matrix2<f64> = turned
        .iter()
        .map(|t| Vector2::new(t.y, -t.x))
        .map(|d| d * d.transpose())
        .sum();
    let spare = (bends.len() as f64 - 3.0).max(1.0);
    let inverse = information.try_inverse().ok_or(Refusal::NotAnEllipsoid)?;
    let tilt = inverse.diagonal().map(|v| v * squares / spare);
    let yaw = yaw_sigma(bends, &turned, weight).filter(|_| yaw_known);
    let unknown = std::f64::consts::PI / 3.0_f64.sqrt();
    Ok(Mount {
        r_tip_sensor: Rotation::assert_frames(q),
        sigma_rad: Vector3::new(tilt.x.sqrt(), tilt.y.sqrt(), yaw.unwrap_or(unknown)),
        out_of_plane_rad,
        twist_per_bend,
        spread,
        bends: bends.len(),
    })
}

/// Standard deviation of the mean difference between measured and commanded directions.
fn yaw_sigma(bends: &[BendTurn], turned: &[Vector3<f64>], weight: f64) -> Option<f64> {
    let mut squares = 0.0;
    for (bend, t) in bends.iter().zip(turned) {
        let (sin, cos) = bend.direction_rad?.sin_cos();
        squares += (sin * t.y - cos * t.x).powi(2); // across the command, rad
    }
    let spare = (bends.len() as f64 - 1.0).max(1.0);
    Some((squares / spare / weight).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::bend::Bend;
    use crate::primitives::units::{Rad, Seconds};
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    fn normal(rng: &mut StdRng, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| {
            sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng)
        })
    }

    fn mounted() -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(Vector3::new(7.0, -11.0, 9.0).map(f64::to_radians))
    }

    /// The gyroscope of a sensor so mounted during a bend from rest to 60°, through Eq. 7.
    fn bend(delta: f64, twist: f64, rng: &mut StdRng) -> Vec<ImuSample> {
        let attitude = |t: f64| {
            let beta = 60.0_f64.to_radians() * 0.5 * (1.0 - (std::f64::consts::PI * t).cos());
            let twisted = UnitQuaternion::from_scaled_axis(Vector3::z() * twist * beta);
            Bend::from_polar(Rad(beta), Rad(delta)).rotation().quat() * twisted
        };
        let h = 1e-4;
        (0..=200)
            .map(|k| {
                let t = f64::from(k) * 0.005;
                let rate_tip =
                    (attitude(t - h).inverse() * attitude(t + h)).scaled_axis() / (2.0 * h);
                ImuSample {
                    t: Seconds(t),
                    gyro_rad_s: mounted().inverse() * rate_tip
                        + Vector3::new(0.01, 0.0, -0.02)
                        + normal(rng, 0.01),
                    acc_m_s2: Vector3::z() * 9.81,
                    mag_ut: None,
                }
            })
            .collect()
    }

    fn bends(n: u32, known: bool, twist: f64, rng: &mut StdRng) -> Vec<BendTurn> {
        (0..n)
            .map(|k| {
                let delta = std::f64::consts::TAU * f64::from(k) / f64::from(n);
                let turn_rad = turn_of(&bend(delta, twist, rng), &Vector3::new(0.01, 0.0, -0.02));
                BendTurn {
                    turn_rad,
                    direction_rad: known.then_some(delta),
                }
            })
            .collect()
    }

    #[test]
    fn known_directions_give_all_three_angles() {
        let mut chi2 = 0.0;
        for seed in 0..20 {
            let fit = from_bends(&bends(12, true, 0.0, &mut StdRng::seed_from_u64(seed)));
            let fit = fit.expect("full circle");
            let error = (fit.r_tip_sensor.quat() * mounted().inverse()).scaled_axis();
            let z = error.component_div(&fit.sigma_rad);
            assert!(z.amax() < 5.0, "seed {seed}: {z}");
            assert!(
                error.norm() < 0.2_f64.to_radians(),
                "{}",
                error.norm().to_degrees()
            );
            assert!((fit.spread - 0.5).abs() < 0.01);
            chi2 += z.norm_squared() / 60.0;
        }
        assert!(
            (0.3..2.0).contains(&chi2),
            "the sigmas match the errors: {chi2}"
        );
    }

    #[test]
    fn the_axis_of_the_tip_needs_no_directions() {
        let fit = from_bends(&bends(8, false, 0.0, &mut StdRng::seed_from_u64(1))).expect("round");
        let axis = fit.r_tip_sensor.inverse().apply(&Vector3::z());
        let want = mounted().inverse() * Vector3::z();
        assert!(
            axis.angle(&want).to_degrees() < 0.2,
            "{}",
            axis.angle(&want).to_degrees()
        );
        assert!(fit.sigma_rad.z > 1.8 && fit.sigma_rad.x < 0.01);
        assert!(
            fit.r_tip_sensor.quat().scaled_axis().z.abs() < 1e-9,
            "there is no component about z"
        );
    }

    #[test]
    fn a_twist_is_reported_and_does_not_tilt_the_mount() {
        let fit = from_bends(&bends(12, true, 0.06, &mut StdRng::seed_from_u64(2))).expect("round");
        assert!(
            (fit.twist_per_bend - 0.06).abs() < 0.01,
            "{}",
            fit.twist_per_bend
        );
        let tilt = (fit.r_tip_sensor.quat() * mounted().inverse())
            .scaled_axis()
            .xy()
            .norm();
        assert!(tilt.to_degrees() < 0.3, "{}", tilt.to_degrees());
    }

    #[test]
    fn insufficient_bends_are_refused() {
        let mut rng = StdRng::seed_from_u64(3);
        let all = bends(12, true, 0.0, &mut rng);
        let one_way: Vec<_> = [0, 6, 0, 6, 0].map(|k| all[k]).to_vec();
        assert!(matches!(
            from_bends(&one_way),
            Err(Refusal::PoorCoverage { .. })
        ));
        let small: Vec<_> = all
            .iter()
            .map(|b| BendTurn {
                turn_rad: b.turn_rad * 0.1,
                ..*b
            })
            .collect();
        assert!(matches!(
            from_bends(&small),
            Err(Refusal::TooFewSamples { have: 0, want: 4 })
        ));
        let wild: Vec<_> = all
            .iter()
            .map(|b| BendTurn {
                turn_rad: b.turn_rad + normal(&mut rng, 0.3),
                ..*b
            })
            .collect();
        assert!(matches!(
            from_bends(&wild),
            Err(Refusal::PoorFit { unit: "deg", .. })
        ));
    }
}
