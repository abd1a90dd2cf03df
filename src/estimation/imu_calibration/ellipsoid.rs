//! Ellipsoid through readings of a vector of constant length.
//!
//! |M (x − b)| = 1 with M symmetric. The start is the algebraic least-squares quadric xᵀA x + 2 gᵀx = 1 (Li and
//! Griffiths 2004, without the ellipsoid constraint, which is checked afterwards) on centred and scaled data. Then
//! Levenberg-Marquardt minimises the geometric distance |M (x − b)| − 1, readings beyond four robust sigmas are
//! removed, and the minimisation is repeated. The covariance is f s² (JᵀJ)⁻¹ of the last step. The factor f ≥ 1 is the
//! variance of block means of the residuals over that of independent ones: an inhomogeneous field leaves correlated
//! residuals, which carry less information. Readings are in time order and are decimated to at most 4000.

use super::refusal::Refusal;
use crate::primitives::UNEXPLAINED_SIGMAS;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{Const, DMatrix, DVector, Dyn, Matrix3, OMatrix, SMatrix, SVector, Vector3};

type Parameters = SVector<f64, 9>;

/// Fewest readings: nine parameters are fitted.
pub const SAMPLES_MIN: usize = 20;

crate::constants! {
    /// What the readings must fulfil.
    const ENOUGH: ReadingLimits;
    /// Smallest share of the sphere of directions that the readings must cover.
    coverage_min = 0.6;
    /// Largest sigma of the centre, as a share of the radius.
    centre_sigma_max = 0.02;
    /// Largest residual, as a share of the radius. It rejects an inhomogeneous field.
    residual_max = 0.05;
    /// Largest ratio of the longest to the shortest axis. A rotation about one axis alone fits arbitrarily flat ellipsoids; real soft
    /// iron stays below 1.5.
    axes_ratio_max = 2.0;
}

/// Most readings that are used, enough for the third digit of any sigma.
const POINTS_MAX: usize = 4000;
const BLOCKS: usize = 20;

/// Errors of a sensor whose readings have a constant length: `x = matrix (x_raw − bias)`, in the unit of the readings.
#[derive(Debug, Clone, PartialEq)]
pub struct VectorFit {
    /// Bias.
    pub bias: Vector3<f64>,
    /// One sigma of it per axis.
    pub bias_sigma: Vector3<f64>,
    /// Scale and skew, symmetric, near 1.
    pub matrix: Matrix3<f64>,
    /// One sigma of each entry.
    pub matrix_sigma: Matrix3<f64>,
    /// Length of the corrected vector.
    pub length: f64,
    /// rms of the corrected length against it.
    pub residual: f64,
    /// Readings removed as outliers.
    pub outliers: usize,
    /// Share of the sphere of directions covered, 0 to 1.
    pub coverage: f64,
}

/// A measured vector of constant length, for the fit and for what is said when it is refused.
pub(super) struct Measured {
    /// Length; `None` for that of the sphere of the same volume, which gives the matrix determinant 1.
    pub length: Option<f64>,
    /// Name of the bias.
    pub bias: &'static str,
    /// How to cover more of the sphere.
    pub advice: &'static str,
    /// Unit of the readings.
    pub unit: &'static str,
}

/// Matrix entry of each parameter.
const PLACE: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

fn unpack<const P: usize>(p: &SVector<f64, P>) -> (Vector3<f64>, Matrix3<f64>) {
    let mut m = Matrix3::zeros();
    for ((i, j), value) in PLACE.into_iter().zip(p.iter().skip(3)) {
        (m[(i, j)], m[(j, i)]) = (*value, *value);
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

/// Distances of the points; the parameters are b and the first entries of M, of which the others are zero.
pub(super) struct Distance<'a, const P: usize> {
    pub points: &'a [Vector3<f64>],
    pub p: SVector<f64, P>,
}

impl<const P: usize> LeastSquaresProblem<f64, Dyn, Const<P>> for Distance<'_, P> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Const<P>>;
    type ParameterStorage = Owned<f64, Const<P>>;

    fn set_params(&mut self, x: &SVector<f64, P>) {
        self.p = *x;
    }
    fn params(&self) -> SVector<f64, P> {
        self.p
    }
    fn residuals(&self) -> Option<DVector<f64>> {
        let (b, m) = unpack(&self.p);
        let distances = self.points.iter().map(|x| (m * (x - b)).norm() - 1.0);
        Some(DVector::from_iterator(self.points.len(), distances))
    }
    fn jacobian(&self) -> Option<OMatrix<f64, Dyn, Const<P>>> {
        let (b, m) = unpack(&self.p);
        let mut j = OMatrix::<f64, Dyn, Const<P>>::zeros(self.points.len());
        for (row, x) in self.points.iter().enumerate() {
            let d = x - b;
            let u = m * d;
            let n = u.norm().max(1e-12);
            let db = -(m * u) / n;
            for k in 0..3 {
                j[(row, k)] = db[k];
            }
            for (k, (a, c)) in (3..P).zip(PLACE) {
                let cross = if a == c { 0.0 } else { u[c] * d[a] };
                j[(row, k)] = (u[a] * d[c] + cross) / n;
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
    let limit = UNEXPLAINED_SIGMAS * 1.4826 * sizes[sizes.len() / 2] + 1e-9;
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

/// Refuses a residual `rms` that is too large a share of the radius.
pub(super) fn check_residual(rms: f64, radius: f64, unit: &'static str) -> Result<(), Refusal> {
    let limit = ENOUGH.residual_max * radius;
    if rms <= limit {
        Ok(())
    } else {
        Err(Refusal::PoorFit { rms, limit, unit })
    }
}

impl VectorFit {
    /// Refuses readings that cover too little of the sphere, leave the bias uncertain or do not fit.
    fn check(self, of: &Measured) -> Result<Self, Refusal> {
        if self.coverage < ENOUGH.coverage_min {
            return Err(Refusal::PoorCoverage {
                what: "the sphere",
                have: self.coverage,
                want: ENOUGH.coverage_min,
                advice: of.advice,
            });
        }
        let (sigma, limit) = (
            self.bias_sigma.amax(),
            ENOUGH.centre_sigma_max * self.length,
        );
        if sigma > limit {
            return Err(Refusal::TooUncertain {
                what: of.bias,
                sigma,
                limit,
                unit: of.unit,
            });
        }
        check_residual(self.residual, self.length, of.unit)?;
        Ok(self)
    }
}

/// Fits an ellipsoid to readings in time order.
///
/// # Errors
/// [`Refusal`] for too few or non-finite readings, readings that lie on no ellipsoid or a flat one, cover too little of the
/// sphere, or leave too large a residual.
pub(super) fn fit(readings: &[Vector3<f64>], of: &Measured) -> Result<VectorFit, Refusal> {
    Refusal::unless_enough(readings.len(), SAMPLES_MIN)?;
    Refusal::unless_finite(readings.iter())?;
    let every = readings.len().div_ceil(POINTS_MAX);
    let points: Vec<Vector3<f64>> = readings.iter().step_by(every).copied().collect();
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / count;
    let squares = points.iter().map(|x| (x - mean).norm_squared());
    let scale = (squares.sum::<f64>() / count).sqrt();
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
    let (ratio, limit) = (axes.max() / axes.min(), ENOUGH.axes_ratio_max);
    if ratio > limit {
        return Err(Refusal::Flat { ratio, limit });
    }
    let (cov, residual) = covariance(&kept, p).ok_or(Refusal::NotAnEllipsoid)?;
    let (b_sigma, m_sigma) = unpack(&cov.diagonal().map(|v| v.max(0.0).sqrt()));
    let (bias, bias_sigma, shape) = (mean + b * scale, b_sigma * scale, m / scale);
    let same_volume = || shape.determinant().powf(-1.0 / 3.0);
    let length = of.length.unwrap_or_else(same_volume);
    VectorFit {
        bias,
        bias_sigma,
        matrix: shape * length,
        matrix_sigma: m_sigma / scale * length,
        length,
        residual: residual * length,
        outliers: points.len() - kept.len(),
        coverage: coverage(readings.iter().map(|x| shape * (x - bias))),
    }
    .check(of)
}

/// Share of the sphere that some directions cover: 32 cells of equal area, four bands of z times eight sectors.
pub(super) fn coverage(directions: impl Iterator<Item = Vector3<f64>>) -> f64 {
    let mut covered = 0_u32;
    for d in directions {
        let n = d.norm();
        if n > 0.0 && n.is_finite() {
            let band = ((d.z / n + 1.0) * 2.0).floor().clamp(0.0, 3.0) as u32;
            let turn = (d.y.atan2(d.x) / std::f64::consts::TAU).rem_euclid(1.0);
            let sector = (turn * 8.0).floor().clamp(0.0, 7.0) as u32;
            covered |= 1 << (8 * band + sector);
        }
    }
    f64::from(covered.count_ones()) / 32.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_counts_equal_areas() {
        assert_eq!(coverage(std::iter::empty()), 0.0);
        assert_eq!(
            coverage([Vector3::z(), Vector3::zeros(), Vector3::repeat(f64::NAN)].into_iter()),
            1.0 / 32.0
        );
        let all: Vec<_> = (0..4000)
            .map(|i| {
                let (z, a) = (
                    (f64::from(i) + 0.5) / 2000.0 - 1.0,
                    f64::from(i) * 2.399_963,
                );
                Vector3::new(
                    (1.0_f64 - z * z).sqrt() * a.cos(),
                    (1.0_f64 - z * z).sqrt() * a.sin(),
                    z,
                )
            })
            .collect();
        assert_eq!(coverage(all.iter().copied()), 1.0);
        let north: Vec<_> = all.into_iter().filter(|d| d.z > 0.0).collect();
        assert_eq!(coverage(north.into_iter()), 0.5);
    }
}
