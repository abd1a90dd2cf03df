//! From the stick to the bend: dead zone, progressive response, limits of bend and speed.

use crate::cli::inputs::within;
use nalgebra::Vector2;

/// What the stick commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Mode {
    /// The speed of the bend: the tip stays where it is when the stick returns.
    Rate,
    /// The bend itself: the tip is straight when the stick returns.
    Position,
}

/// The law. Bend vectors in rad, b = β (cos δ, sin δ); stick vectors with the length 1 at the rim.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Law {
    /// What the stick commands: the speed of the bend, or the bend itself.
    #[arg(long, value_enum, default_value = "rate")]
    mode: Mode,
    /// Largest bend, degrees. A larger value reaches further.
    #[arg(long, default_value_t = 60.0, value_parser = within(1.0..=135.0, "degrees"))]
    bend_max: f64,
    /// Largest speed, °/s. A larger value is quicker and less precise.
    #[arg(long, default_value_t = 40.0, value_parser = within(1.0..=180.0, "°/s"))]
    speed: f64,
    /// Deflection below which the stick counts as released, of 1. A larger value tolerates a worn stick.
    #[arg(long, default_value_t = 0.12, value_parser = within(0.0..=0.9, ""))]
    dead_zone: f64,
    /// Share of a cubic response, 0 to 1. A larger value makes the centre finer.
    #[arg(long, default_value_t = 0.5, value_parser = within(0.0..=1.0, ""))]
    expo: f64,
}

impl Law {
    /// The next bend after a time, s.
    pub fn next(&self, at: &Vector2<f64>, stick: &Vector2<f64>, dt_s: f64) -> Vector2<f64> {
        let [bend_max, speed] = [self.bend_max, self.speed].map(f64::to_radians);
        let shaped = self.shaped(stick);
        let step = match self.mode {
            Mode::Rate => shaped * speed * dt_s,
            Mode::Position => (shaped * bend_max - at).cap_magnitude(speed * dt_s),
        };
        (at + step).cap_magnitude(bend_max)
    }

    /// The deflection beyond the dead zone, with the cubic response: the centre is finer than the rim.
    fn shaped(&self, stick: &Vector2<f64>) -> Vector2<f64> {
        let size = stick.norm();
        if size <= self.dead_zone {
            return Vector2::zeros();
        }
        let x = ((size - self.dead_zone) / (1.0 - self.dead_zone)).min(1.0);
        stick * (((1.0 - self.expo) * x + self.expo * x.powi(3)) / size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAW: Law = Law {
        mode: Mode::Rate,
        dead_zone: 0.1,
        expo: 0.5,
        bend_max: 1.0_f64.to_degrees(),
        speed: 0.5_f64.to_degrees(),
    };

    #[test]
    fn the_response_is_zero_in_the_dead_zone_fine_beside_it_and_full_at_the_rim() {
        let shaped = |x: f64| LAW.shaped(&Vector2::new(x, 0.0)).x;
        assert_eq!((shaped(0.0), shaped(0.1)), (0.0, 0.0));
        assert!(
            (shaped(1.0) - 1.0).abs() < 1e-12
                && (shaped(-1.0) + 1.0).abs() < 1e-12
                && (shaped(3.0) - 1.0).abs() < 1e-12
        );
        let slope = |x: f64| (shaped(x + 1e-6) - shaped(x)) / 1e-6;
        assert!(
            slope(0.15) < 0.6 && slope(0.95) > 1.5,
            "{} {}",
            slope(0.15),
            slope(0.95)
        );
    }

    #[test]
    fn a_rate_integrates_up_to_the_largest_bend_and_a_position_returns() {
        let full = Vector2::new(0.0, 1.0);
        let run = |law: Law, from: Vector2<f64>, stick: Vector2<f64>| {
            (0..100).fold(from, |at, _| law.next(&at, &stick, 0.02))
        };
        assert!(
            (run(LAW, Vector2::zeros(), full) - full).norm() < 1e-9,
            "0.5 rad/s for 2 s"
        );
        assert!((run(LAW, full * 0.8, full).norm() - 1.0).abs() < 1e-9);
        assert_eq!(run(LAW, full, Vector2::zeros()), full);
        let position = Law {
            mode: Mode::Position,
            ..LAW
        };
        assert!(run(position, full, Vector2::zeros()).norm() < 1e-9);
        assert!(
            (position.next(&full, &Vector2::zeros(), 0.02) - full).norm() < 0.5 * 0.02 + 1e-12,
            "limited in speed"
        );
    }
}
