//! Whether a plant's gyroscope measures the rotation that its `ref` shows.

use nalgebra::{UnitQuaternion, Vector3};

/// Rotation after which the check is decided, rad.
const ENOUGH_RAD: f64 = 3.0;
/// Slowest rate that counts, rad/s.
const RATE_MIN_RAD_S: f64 = 0.05;
/// Part of the gyroscope's variation that the rotation must explain.
const EXPLAINED_MIN: f64 = 0.1;
/// Largest factor between both, either way.
const FACTOR_MAX: f64 = 3.0;

const OTHER_AXES: &str = "is about other axes, or in another frame than the tip's";

/// Sums over the samples of a tip that turns.
#[derive(Debug, Default)]
pub struct RateCheck {
    last: Option<(f64, UnitQuaternion<f64>)>,
    gyro: Vector3<f64>,
    turned_rad: f64,
    rr: f64,
    rg: f64,
    gg: f64,
    decided: bool,
}

impl RateCheck {
    /// Takes a sample: its time, the true orientation then and the gyroscope's reading, rad/s. Tells once what is wrong.
    pub fn update(
        &mut self,
        t_s: f64,
        orientation: &UnitQuaternion<f64>,
        gyro: &Vector3<f64>,
    ) -> Option<String> {
        let (last_s, last) = self.last.replace((t_s, *orientation))?;
        let period_s = t_s - last_s;
        let rate = (last.inverse() * orientation).scaled_axis() / period_s;
        if self.turned_rad == 0.0 && rate.norm() < RATE_MIN_RAD_S {
            // the bias, before the first motion
            self.gyro += (gyro - self.gyro) * 0.02;
        }
        if self.decided || rate.norm() < RATE_MIN_RAD_S {
            return None;
        }
        let measured = gyro - self.gyro;
        self.turned_rad += rate.norm() * period_s;
        self.rr += rate.norm_squared();
        self.rg += rate.dot(&measured);
        self.gg += measured.norm_squared();
        if self.turned_rad < ENOUGH_RAD {
            return None;
        }
        self.decided = true;
        let factor = self.rg / self.rr;
        let explained = self.rg * self.rg.abs() / (self.rr * self.gg);
        let like = 1f64.to_degrees();
        let cause = match factor {
            x if explained < -EXPLAINED_MIN && x < 0.0 => "has the other sign".to_owned(),
            _ if explained < EXPLAINED_MIN => OTHER_AXES.to_owned(),
            x if (0.7..1.4).contains(&(x / like)) => "looks like °/s".to_owned(),
            x if !(1.0 / FACTOR_MAX..FACTOR_MAX).contains(&x) => format!("is {x:.3} times it"),
            _ => return None,
        };
        Some(format!(
            "the plant's `gyr` does not measure the rotation of its `ref`: it {cause}; `gyr` is the mean rate over the period, rad/s, in the axes of the tip"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the check says of a tip that swings in two planes, whose gyroscope makes this of the rate.
    fn said(gyro: impl Fn(Vector3<f64>) -> Vector3<f64>) -> String {
        let (mut check, mut at) = (RateCheck::default(), UnitQuaternion::identity());
        let one = |k: i32| {
            let t = f64::from(k) * 0.005;
            let moving = if t < 1.0 { 0.0 } else { 1.0 };
            let rate = Vector3::new((2.0 * t).sin(), 1.3 * (1.1 * t).cos(), 0.0) * moving;
            at *= UnitQuaternion::from_scaled_axis(rate * 0.005);
            check.update(t, &at, &(gyro(rate) + Vector3::new(0.02, -0.01, 0.03)))
        };
        (0..4000).filter_map(one).collect()
    }

    #[test]
    fn wrong_units_signs_and_axes_are_told_and_a_good_gyroscope_is_not() {
        assert_eq!(said(|rate| rate), "");
        assert_eq!(said(|rate| rate * 0.9), "");
        for (text, gyro) in [
            (
                "°/s",
                &(|rate: Vector3<f64>| rate.map(f64::to_degrees)) as &dyn Fn(_) -> _,
            ),
            ("other sign", &|rate: Vector3<f64>| -rate),
            ("other axes", &|rate: Vector3<f64>| {
                Vector3::new(rate.z, rate.z, rate.x)
            }),
            ("is 0.2", &|rate: Vector3<f64>| rate * 0.2),
        ] {
            let said = said(gyro);
            assert!(said.contains(text), "{text}: {said}");
        }
    }
}
