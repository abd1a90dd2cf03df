//! Ellipsoid through readings of a vector of constant length.
//!
//! |M (x − b)| = 1 with M symmetric. The start is the algebraic least-squares quadric xᵀA x + 2 gᵀx = 1 (Li and
//! Griffiths 2004, without the ellipsoid constraint, which is checked afterwards) on centred and scaled data. Then
//! Levenberg-Marquardt minimises the geometric distance |M (x − b)| − 1, readings beyond four robust sigmas are
//! removed, and the minimisation is repeated. The covariance is f s² (JᵀJ)⁻¹ of the last step. The factor f ≥ 1 is the
//! variance of block means of the residuals over that of independent ones: an inhomogeneous field leaves correlated
//! residuals, which carry less information. Readings are in time order and are decimated to at most 4000.

use super::refusal::Refusal;
use super::sphere::coverage;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, OMatrix, OVector, SMatrix, SVector, U9, Vector3};

type Parameters = SVector<f64, 9>;

/// Fewest readings: nine parameters are fitted.
pub const SAMPLES_MIN: usize = 20;
/// Smallest share of the sphere of directions that the readings must cover.
const COVERAGE_MIN: f64 = 0.6;
/// Largest sigma of the centre, as a share of the radius.
const CENTRE_SIGMA_MAX: f64 = 0.02;
/// Largest residual, as a share of the radius. It rejects an inhomogeneous field.
const RESIDUAL_MAX: f64 = 0.05;
/// Largest ratio of the longest to the shortest axis. A rotation about one axis alone fits arbitrarily flat
/// ellipsoids; real soft iron stays below 1.5.
const AXES_RATIO_MAX: f64 = 2.0;
/// Most readings that are used, enough for the third digit of any sigma.
const POINTS_MAX: usize = 4000;
const BLOCKS: usize = 20;

/// Result in the units of the readings: |M (x − b)| = 1.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ellipsoid {
    pub centre: Vector3<f64>,
    pub centre_sigma: Vector3<f64>,
    pub shape: Matrix3<f64>,
    pub shape_sigma: Matrix3<f64>,
    /// rms of |M (x − b)| − 1 over the readings kept.
    pub residual: f64,
    /// Readings removed as outliers.
    pub outliers: usize,
}

impl Ellipsoid {
    /// Checks coverage, sigma of the centre and residual; returns the coverage. `radius` is in `unit`; `quantity` and
    /// `advice` are for the refusal.
    pub fn check(
        &self,
        points: &[Vector3<f64>],
        radius: f64,
        quantity: &'static str,
        advice: &'static str,
        unit: &'static str,
    ) -> Result<f64, Refusal> {
        let directions: Vec<Vector3<f64>> = points
            .iter()
            .map(|x| self.shape * (x - self.centre))
            .collect();
        let have = coverage(directions.iter());
        if have < COVERAGE_MIN {
            return Err(Refusal::PoorCoverage {
                what: "the sphere",
                have,
                want: COVERAGE_MIN,
                advice,
            });
        }
        let (sigma, limit) = (self.centre_sigma.amax(), CENTRE_SIGMA_MAX * radius);
        if sigma > limit {
            return Err(Refusal::TooUncertain {
                what: quantity,
                sigma,
                limit,
                unit,
            });
        }
        check_residual(self.residual * radius, radius, unit)?;
        Ok(have)
    }
    /// Radius of the sphere of the same volume.
    pub fn radius(&self) -> f64 {
        self.shape.determinant().powf(-1.0 / 3.0)
    }
}

/// Matrix entry of each parameter.
const PLACE: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

fn unpack(p: &Parameters) -> (Vector3<f64>, Matrix3<f64>) {
    let mut m = Matrix3::zeros();
    for (k, (i, j)) in PLACE.into_iter().enumerate() {
        (m[(i, j)], m[(j, i)]) = (p[3 + k], p[3 + k]);
    }
    (p.fixed_rows::<3>(0).into_owned(), m)
}

fn pack(b: &Vector3<f64>, m: &Matrix3<f64>) -> Parameters {
    let mut p = Parameters::zeros();
    p.fixed_rows_mut::<3>(0).copy_from(b);
    for (k, (i, j)) in PLACE.into_iter().enumerate() {
        p[3 + k] = 0.5 * (m[(i, j)] + m[(j, i)]);
    }
    p
}

struct Distance<'a> {
    points: &'a [Vector3<f64>],
    p: Parameters,
}

impl LeastSquaresProblem<f64, Dyn, U9> for Distance<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, U9>;
    type ParameterStorage = Owned<f64, U9>;

    fn set_params(&mut self, x: &OVector<f64, U9>) {
        self.p = *x;
    }
    fn params(&self) -> OVector<f64, U9> {
        self.p
    }
    fn residuals(&self) -> Option<DVector<f64>> {
        let (b, m) = unpack(&self.p);
        Some(DVector::from_iterator(
            self.points.len(),
            self.points.iter().map(|x| (m * (x - b)).norm() - 1.0),
        ))
    }
    fn jacobian(&self) -> Option<OMatrix<f64, Dyn, U9>> {
        let (b, m) = unpack(&self.p);
        let mut j = OMatrix::<f64, Dyn, U9>::zeros(self.points.len());
        for (row, x) in self.points.iter().enumerate() {
            let d = x - b;
            let u = m * d;
            let n = u.norm().max(1e-12);
            let db = -(m * u) / n;
            for k in 0..3 {
                j[(row, k)] = db[k];
            }
            for (k, (a, c)) in PLACE.into_iter().enumerate() {
                let cross = if a == c { 0.0 } else { u[c] * d[a] };
                j[(row, 3 + k)] = (u[a] * d[c] + cross) / n;
            }
        }
        Some(j)
    }
}

/// Quadric through the points by linear least squares; `None` if it is not an ellipsoid.
fn algebraic(points: &[Vector3<f64>]) -> Option<Parameters> {
    let design = DMatrix::from_fn(points.len(), 9, |i, k| {
        let x = &points[i];
        match k {
            0..3 => x[k] * x[k],
            3 => 2.0 * x.x * x.y,
            4 => 2.0 * x.x * x.z,
            5 => 2.0 * x.y * x.z,
            _ => 2.0 * x[k - 6],
        }
    });
    let ones = DVector::from_element(points.len(), 1.0);
    let v = design.svd(true, true).solve(&ones, 1e-12).ok()?;
    let a = Matrix3::new(v[0], v[3], v[4], v[3], v[1], v[5], v[4], v[5], v[2]);
    let g = Vector3::new(v[6], v[7], v[8]);
    let b = -(a.try_inverse()? * g);
    let level = 1.0 + b.dot(&(a * b)); // (x−b)ᵀA(x−b) = level
    let eigen = (a / level).symmetric_eigen();
    if eigen.eigenvalues.min() <= 0.0 {
        return None;
    }
    let root = Matrix3::from_diagonal(&eigen.eigenvalues.map(f64::sqrt));
    Some(pack(
        &b,
        &(eigen.eigenvectors * root * eigen.eigenvectors.transpose()),
    ))
}

fn refine(points: &[Vector3<f64>], start: Parameters) -> Option<Parameters> {
    let solver = LevenbergMarquardt::new().with_tol(1e-12).with_patience(200);
    let (problem, report) = solver.minimize(Distance { points, p: start });
    let usable = report.objective_function.is_finite() && !report.termination.was_usage_issue();
    usable.then_some(problem.p)
}

/// Points within four robust sigmas of the surface.
fn near(points: &[Vector3<f64>], p: Parameters) -> Vec<Vector3<f64>> {
    let (b, m) = unpack(&p);
    let off = |x: &Vector3<f64>| ((m * (x - b)).norm() - 1.0).abs();
    let mut sizes: Vec<f64> = points.iter().map(off).collect();
    sizes.sort_by(f64::total_cmp);
    let limit = 4.0 * 1.4826 * sizes[sizes.len() / 2] + 1e-9;
    points.iter().filter(|x| off(x) <= limit).copied().collect()
}

fn covariance(points: &[Vector3<f64>], p: Parameters) -> Option<(SMatrix<f64, 9, 9>, f64)> {
    let problem = Distance { points, p };
    let (r, j) = (problem.residuals()?, problem.jacobian()?);
    let variance = correlation(r.as_slice()) * r.norm_squared() / (points.len() as f64 - 9.0);
    Some((
        (j.transpose() * j).try_inverse()? * variance,
        (r.norm_squared() / points.len() as f64).sqrt(),
    ))
}

/// Variance of block means relative to that of independent residuals, at least 1.
fn correlation(residuals: &[f64]) -> f64 {
    let size = residuals.len() / BLOCKS;
    if size < 5 {
        return 1.0; // too few blocks for an estimate
    }
    let power = residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64;
    let means = residuals
        .chunks_exact(size)
        .map(|b| b.iter().sum::<f64>() / size as f64);
    let spread = means.map(|m| m * m).sum::<f64>() / (residuals.len() / size) as f64;
    (size as f64 * spread / power.max(1e-300)).max(1.0)
}

/// Refuses a residual `rms` beyond [`RESIDUAL_MAX`] of the radius.
pub(super) fn check_residual(rms: f64, radius: f64, unit: &'static str) -> Result<(), Refusal> {
    let limit = RESIDUAL_MAX * radius;
    if rms <= limit {
        Ok(())
    } else {
        Err(Refusal::PoorFit { rms, limit, unit })
    }
}

/// Fits an ellipsoid.
///
/// # Errors
/// [`Refusal`] for too few or non-finite points, points that lie on no ellipsoid, or a flat ellipsoid.
pub(super) fn fit(points: &[Vector3<f64>]) -> Result<Ellipsoid, Refusal> {
    Refusal::unless_enough(points.len(), SAMPLES_MIN)?;
    if let Some(index) = points.iter().position(|x| !x.iter().all(|c| c.is_finite())) {
        return Err(Refusal::NotFinite { index });
    }
    let every = points.len().div_ceil(POINTS_MAX);
    let points: Vec<Vector3<f64>> = points.iter().step_by(every).copied().collect();
    let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let scale = (points
        .iter()
        .map(|x| (x - mean).norm_squared())
        .sum::<f64>()
        / points.len() as f64)
        .sqrt();
    if scale < 1e-9 {
        return Err(Refusal::NotAnEllipsoid);
    }
    let unit: Vec<Vector3<f64>> = points.iter().map(|x| (x - mean) / scale).collect();
    let start = algebraic(&unit).unwrap_or_else(|| pack(&Vector3::zeros(), &Matrix3::identity()));
    let first = refine(&unit, start).ok_or(Refusal::NotAnEllipsoid)?;
    let kept = near(&unit, first);
    Refusal::unless_enough(kept.len(), SAMPLES_MIN)?;
    let p = refine(&kept, first).ok_or(Refusal::NotAnEllipsoid)?;
    let (b, m) = unpack(&p);
    let axes = m.symmetric_eigenvalues();
    if axes.min() <= 0.0 {
        return Err(Refusal::NotAnEllipsoid);
    }
    let (ratio, limit) = (axes.max() / axes.min(), AXES_RATIO_MAX);
    if ratio > limit {
        return Err(Refusal::Flat { ratio, limit });
    }
    let (cov, residual) = covariance(&kept, p).ok_or(Refusal::NotAnEllipsoid)?;
    let (b_sigma, m_sigma) = unpack(&cov.diagonal().map(|v| v.max(0.0).sqrt()));
    Ok(Ellipsoid {
        centre: mean + b * scale,
        centre_sigma: b_sigma * scale,
        shape: m / scale,
        shape_sigma: m_sigma / scale,
        residual,
        outliers: points.len() - kept.len(),
    })
}
