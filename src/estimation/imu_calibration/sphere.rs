//! Coverage of the sphere of directions.

use nalgebra::Vector3;

/// Share of the sphere that some directions cover: 32 cells of equal area, four bands of z times eight sectors.
pub(super) fn coverage<'a>(directions: impl Iterator<Item = &'a Vector3<f64>>) -> f64 {
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
            coverage([Vector3::z(), Vector3::zeros(), Vector3::repeat(f64::NAN)].iter()),
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
        assert_eq!(coverage(all.iter()), 1.0);
        let north: Vec<_> = all.into_iter().filter(|d| d.z > 0.0).collect();
        assert_eq!(coverage(north.iter()), 0.5);
    }
}
