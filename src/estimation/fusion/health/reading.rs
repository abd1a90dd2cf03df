//! The field reference of the alignment.

use nalgebra::Vector3;

/// Strength and dip of a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldShape {
    /// |m|, µT.
    pub norm_ut: f64,
    /// Angle of the field below the horizontal, rad.
    pub dip_rad: f64,
}

impl FieldShape {
    /// From the means over a still stretch; `None` when either is zero or not finite.
    pub fn from_rest(acc_m_s2: &Vector3<f64>, mag_ut: &Vector3<f64>) -> Option<Self> {
        Some(Self {
            norm_ut: mag_ut.norm(),
            dip_rad: dip(acc_m_s2, mag_ut)?,
        })
    }
}

/// Angle of `mag` below the plane orthogonal to `acc`, rad; `None` for a zero or non-finite vector.
pub(super) fn dip(acc: &Vector3<f64>, mag: &Vector3<f64>) -> Option<f64> {
    let norms = acc.norm() * mag.norm();
    (norms.is_finite() && norms > 1e-9).then(|| (-acc.dot(mag) / norms).clamp(-1.0, 1.0).asin())
}
