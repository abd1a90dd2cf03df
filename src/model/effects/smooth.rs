//! Smooth approximations of functions with corners, so that a fit has a gradient, and the relaxation step.
//!
//! All are algebraic (one square root) because they run once per channel and sample. `width` is
//! where the corner is rounded off; for `|x| ≫ width` they equal the function with the corner.

/// |x| with a rounded tip: `√(x² + width²) − width`, exactly 0 at 0.
pub fn magnitude(x: f64, width: f64) -> f64 {
    (x * x + width * width).sqrt() - width
}

/// max(x, 0) with a rounded corner, exactly 0 at 0; far below, it is `−width/2`.
pub fn positive(x: f64, width: f64) -> f64 {
    0.5 * (x + magnitude(x, width))
}

/// max(x, 0) with a rounded corner, nowhere negative; `width/2` at 0, vanishing far below.
pub fn overshoot(x: f64, width: f64) -> f64 {
    let root = (x * x + width * width).sqrt();
    // below the corner the two terms cancel: the product form is accurate
    if x > 0.0 {
        0.5 * (x + root)
    } else {
        0.5 * width * width / (root - x)
    }
}

/// sgn(x) with a rounded step.
pub fn sign(x: f64, width: f64) -> f64 {
    x / (x * x + width * width).sqrt()
}

/// Share of a gap that a first-order process closes in one step of backward Euler, `h/(1 + h)` with
/// `h = dt/τ` or rate × dt: stable for every step, and on a ramp it lags by exactly τ.
pub fn share(h: f64) -> f64 {
    h / (1.0 + h)
}

/// Logistic onset: 0 long before `at_s`, 1 long after; 10 to 90 % takes `rise_s`.
pub fn onset(t_s: f64, at_s: f64, rise_s: f64) -> f64 {
    /// 2 ln 9: the logistic goes from 10 to 90 % in this many of its time constants.
    const DECILES: f64 = 4.394_449_154_672_439;
    let x = (t_s - at_s) * DECILES / rise_s;
    if x < -36.0 {
        0.0
    } else if x > 36.0 {
        1.0
    } else {
        1.0 / (1.0 + (-x).exp())
    }
}

/// Cubic from 0 at `from_s` to 1 at `from_s + lasting_s`, level at both ends.
pub fn smoothstep(t_s: f64, from_s: f64, lasting_s: f64) -> f64 {
    let x = ((t_s - from_s) / lasting_s).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn far_from_the_corner_they_are_exact() {
        for x in [-50.0, -3.0, 3.0, 50.0f64] {
            assert!((magnitude(x, 1e-3) - x.abs()).abs() < 2e-3);
            assert!((positive(x, 1e-3) - x.max(0.0)).abs() < 1e-3);
            assert!((overshoot(x, 1e-3) - x.max(0.0)).abs() < 1e-6);
            assert!((sign(x, 1e-3) - x.signum()).abs() < 1e-6);
        }
    }

    #[test]
    fn at_zero_they_are_exactly_zero() {
        assert_eq!(
            (
                magnitude(0.0, 0.3),
                positive(0.0, 0.3),
                sign(0.0, 0.3),
                share(0.0)
            ),
            (0.0, 0.0, 0.0, 0.0)
        );
    }

    #[test]
    fn a_ramp_is_followed_with_the_lag_tau() {
        let (tau_s, dt_s, mut z) = (0.3, 0.01, 0.0);
        for k in 1..=2000 {
            z += (f64::from(k) * dt_s - z) * share(dt_s / tau_s);
        }
        assert!((20.0 - z - tau_s).abs() < 1e-9);
    }

    #[test]
    fn onsets_take_the_stated_time() {
        assert!((onset(5.0, 5.0, 0.05) - 0.5).abs() < 1e-12);
        assert!((onset(5.025, 5.0, 0.05) - 0.9).abs() < 1e-9);
        assert_eq!((onset(0.0, 5.0, 0.05), onset(9.0, 5.0, 0.05)), (0.0, 1.0));
        assert_eq!(
            (
                smoothstep(1.0, 2.0, 4.0),
                smoothstep(4.0, 2.0, 4.0),
                smoothstep(7.0, 2.0, 4.0)
            ),
            (0.0, 0.5, 1.0)
        );
    }
}
