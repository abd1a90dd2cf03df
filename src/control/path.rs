//! Paths of the tip: the smooth curve through given rows, and what is expected of one that is not known in advance.

use crate::control::follow::Pace;
use crate::control::limits::ActuatorLimits;
use crate::control::tick::Reference;
use crate::model::{Geometry, Line, Shape};
use crate::motion::MotionLimits;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Interval at which the motion along a path is looked at, s.
const SCAN_S: f64 = 0.005;
/// Time before the first row in which the pistons cross their backlash towards the motion: the longest crossing, s.
pub const RUN_UP_S: f64 = 0.4;
/// Share of the pistons' speed and acceleration that a path may use; the rest is for feedback and backlash.
const USABLE: f64 = 0.9;
/// Rows of a live path from which its motion is estimated: those of this time, and at least three, s.
const WINDOW_S: f64 = 0.08;
/// Longest time for which a live path is extrapolated beyond its last row, s.
const EXTRAPOLATE_S: f64 = 0.2;

/// A path: the bend vector and the length over time.
///
/// Between the rows it is the natural cubic spline of bend vector and length, whose rate and acceleration are continuous.
/// The spline is of the vector, not of angle and direction, so a direction that passes 360° or a bend that passes 0 is no
/// jump.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    t_s: Vec<f64>,
    /// Bend vector in rad, and length in mm.
    rows: Vec<Vector3<f64>>,
    /// Second derivatives of the spline at the rows.
    second: Vec<Vector3<f64>>,
}

impl Path {
    /// The path through rows of bend vector in rad and length in mm at increasing times in s; `None` for fewer than two, or if a
    /// time is missing or does not increase.
    pub fn new(t_s: Vec<f64>, rows: Vec<Vector3<f64>>) -> Option<Self> {
        let increases = t_s.windows(2).all(|t| t[1] > t[0]);
        if t_s.len() < 2 || t_s.len() != rows.len() || !increases {
            return None;
        }
        let second = natural_spline(&t_s, &rows);
        Some(Self { t_s, rows, second })
    }

    /// Times in s, and rows of bend vector in rad and length in mm.
    pub fn rows(&self) -> (&[f64], &[Vector3<f64>]) {
        (&self.t_s, &self.rows)
    }

    /// Duration, s.
    pub fn duration_s(&self) -> f64 {
        self.t_s[self.t_s.len() - 1] - self.t_s[0]
    }

    /// The path at a time after its first row, s. It rests after its last row, and before its first, where for [`RUN_UP_S`] its
    /// acceleration is the mean one that leads to the initial rate: so the pistons cross their backlash before the tip is to move.
    pub fn at(&self, after_s: f64) -> Reference {
        let t = self.t_s[0] + after_s;
        let last = self.t_s.len() - 1;
        if t < self.t_s[0] {
            let mut reference = self.at(0.0);
            let ready = if after_s < -RUN_UP_S {
                0.0
            } else {
                1.0 / RUN_UP_S
            };
            reference.acceleration = std::mem::take(&mut reference.rate) * ready;
            return reference;
        }
        if t > self.t_s[last] {
            return reference([self.rows[last], Vector3::zeros(), Vector3::zeros()]);
        }
        let k = self.t_s.partition_point(|&row| row <= t).clamp(1, last) - 1;
        let h = self.t_s[k + 1] - self.t_s[k];
        let b = (t - self.t_s[k]) / h;
        let a = 1.0 - b;
        let (y, m) = (&self.rows[k..], &self.second[k..]);
        reference([
            y[0] * a + y[1] * b + (m[0] * (a.powi(3) - a) + m[1] * (b.powi(3) - b)) * (h * h / 6.0),
            (y[1] - y[0]) / h
                + (m[1] * (3.0 * b * b - 1.0) - m[0] * (3.0 * a * a - 1.0)) * (h / 6.0),
            m[0] * a + m[1] * b,
        ])
    }

    /// What is expected of the path at `ahead_s` after the time `after_s`, from the rows up to `after_s` alone.
    pub fn expected(&self, after_s: f64, ahead_s: f64, pace: &Pace) -> Reference {
        let now_s = self.t_s[0] + after_s;
        let known = self.t_s.partition_point(|&row| row <= now_s + 1e-9).max(1);
        if now_s > self.t_s[self.t_s.len() - 1] {
            // the stream has ended
            return reference([self.rows[known - 1], Vector3::zeros(), Vector3::zeros()]);
        }
        let (t_s, rows) = (&self.t_s[..known], &self.rows[..known]);
        expected(t_s, rows, now_s + ahead_s, pace)
    }

    /// Largest speed and acceleration that the path asks of the pistons, as the factor by which its time must be stretched
    /// so that they can follow; at most 1 for a path that they can follow as it is.
    pub fn demand(&self, geometry: &Geometry, lines: &[Line; 3], limits: &MotionLimits) -> f64 {
        let pistons = |v: Vector2<f64>| {
            let q = geometry.lengths(&Shape::new(v, geometry.rest_length_mm));
            let each = (0..3).map(|i| lines[i].play_output_mm(q[i]).abs());
            each.fold(0.0, f64::max)
        };
        let speed_max = USABLE * limits.speed_max_mm_s;
        let acceleration_max = USABLE * limits.acceleration_max_mm_s2;
        self.along().fold(0.0, |most: f64, at| {
            most.max(pistons(at.rate) / speed_max)
                .max((pistons(at.acceleration) / acceleration_max).sqrt())
        })
    }

    /// Largest rate of the bend, rad/s.
    pub fn speed_max(&self) -> f64 {
        self.along().map(|at| at.rate.norm()).fold(0.0, f64::max)
    }

    /// The motion from the first row to the last.
    fn along(&self) -> impl Iterator<Item = Reference> {
        let scans = (self.duration_s() / SCAN_S).ceil() as usize;
        (0..=scans).map(|k| self.at(k as f64 * SCAN_S))
    }

    /// The first row with a bend that these lines cannot hold, and what is expected instead.
    pub fn out_of_reach(
        &self,
        limits: &ActuatorLimits,
        geometry: &Geometry,
        lines: &[Line; 3],
    ) -> Option<(usize, String)> {
        self.rows.iter().enumerate().find_map(|(k, row)| {
            let shape = Shape::new(row.xy(), row.z);
            let share = limits.largest_share(geometry, lines, &shape);
            let most = share * shape.bend.beta().to_degrees();
            let dir_deg = shape.bend.delta().to_degrees();
            (share < 1.0).then(|| (k, format!("within reach: the largest bend towards {dir_deg:.0}° at {:.1} mm is {most:.1}°", row.z)))
        })
    }

    /// The same path with its time stretched by `factor`.
    pub fn slowed(&self, factor: f64) -> Self {
        let mut slowed = self.clone();
        for (t, second) in slowed.t_s.iter_mut().zip(&mut slowed.second) {
            *t *= factor;
            *second /= factor * factor;
        }
        slowed
    }
}

/// What is expected at the time `wanted_s` after these rows, of which there is at least one: the parabola through the last ones, with
/// the speed and acceleration of `pace` at most. Times in s, bend vectors in rad and lengths in mm.
pub fn expected(t_s: &[f64], rows: &[Vector3<f64>], wanted_s: f64, pace: &Pace) -> Reference {
    let newest_s = t_s[t_s.len() - 1];
    let recent = t_s.partition_point(|&row| row < newest_s - WINDOW_S);
    let from = recent.min(t_s.len().saturating_sub(3));
    let [at, rate, acceleration] = parabola(&t_s[from..], &rows[from..]);
    let capped = |v: Vector3<f64>, most: f64| v.xy().cap_magnitude(most).push(v.z);
    let rate = capped(rate, pace.speed);
    let acceleration = capped(acceleration, pace.acceleration);
    let h = (wanted_s - newest_s).min(EXTRAPOLATE_S);
    let ahead = at + rate * h + acceleration * (h * h / 2.0);
    if wanted_s - newest_s > h {
        return reference([ahead, Vector3::zeros(), Vector3::zeros()]);
    }
    reference([ahead, rate + acceleration * h, acceleration])
}

fn reference([at, rate, acceleration]: [Vector3<f64>; 3]) -> Reference {
    Reference {
        shape: Shape::new(at.xy(), at.z),
        rate: rate.xy(),
        acceleration: acceleration.xy(),
    }
}

/// Second derivatives of the natural cubic spline at its rows (Thomas' algorithm).
fn natural_spline(t: &[f64], y: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let n = t.len();
    let mut second = vec![Vector3::zeros(); n];
    let mut above = vec![0.0; n];
    for k in 1..n - 1 {
        let (left, right) = (t[k] - t[k - 1], t[k + 1] - t[k]);
        let bend = (y[k + 1] - y[k]) / right - (y[k] - y[k - 1]) / left;
        let pivot = 2.0 * (left + right) - left * above[k - 1];
        above[k] = right / pivot;
        second[k] = (bend * 6.0 - second[k - 1] * left) / pivot;
    }
    for k in (1..n - 1).rev() {
        let next = second[k + 1];
        second[k] -= next * above[k];
    }
    second
}

/// Value, rate and acceleration, at the last of these rows, of the parabola that fits them best.
fn parabola(t: &[f64], y: &[Vector3<f64>]) -> [Vector3<f64>; 3] {
    let now = t[t.len() - 1];
    let last = [y[y.len() - 1], Vector3::zeros(), Vector3::zeros()];
    let scale = (now - t[0]).max(1e-6);
    let (mut normal, mut right) = (Matrix3::zeros(), Matrix3::zeros());
    for (&t, y) in t.iter().zip(y) {
        let x = (t - now) / scale;
        let powers = Vector3::new(1.0, x, x * x);
        normal += powers * powers.transpose();
        right += powers * y.transpose();
    }
    match (t.len(), normal.try_inverse()) {
        (2, _) => [y[1], (y[1] - y[0]) / (t[1] - t[0]), Vector3::zeros()],
        (3.., Some(inverse)) => {
            let fit = inverse * right;
            [
                fit.row(0).transpose(),
                fit.row(1).transpose() / scale,
                fit.row(2).transpose() * (2.0 / (scale * scale)),
            ]
        }
        _ => last,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Bend;

    /// A circle of 20° in 2 s, with a row every 50 ms.
    fn circle() -> Path {
        let row = |k: u32| Bend::from_deg(20.0, f64::from(k * 9 % 360)).0.push(20.0);
        Path::new(
            (0..=40).map(|k| f64::from(k) * 0.05).collect(),
            (0..=40).map(row).collect(),
        )
        .unwrap()
    }

    fn on_circle(t: f64) -> Vector2<f64> {
        Bend::from_deg(20.0, 180.0 * t).0
    }

    #[test]
    fn the_spline_passes_its_rows_and_is_smooth_across_360_degrees() {
        let p = circle();
        for k in 0..400 {
            let t = f64::from(k) * 0.005;
            let (at, after) = (p.at(t), p.at(t + 1e-5));
            let inner = (0.3..1.7).contains(&t);
            assert!(
                (at.shape.bend.0 - on_circle(t)).norm().to_degrees()
                    < if inner { 1e-3 } else { 0.05 },
                "{t}"
            );
            assert!(
                (after.shape.bend.0 - at.shape.bend.0 - at.rate * 1e-5).norm() < 1e-8,
                "{t}"
            );
            assert!(
                (after.rate - at.rate - at.acceleration * 1e-5).norm() < 1e-7,
                "{t}"
            );
        }
        assert_eq!(
            (p.at(-1.0).rate, p.at(3.0).rate),
            (Vector2::zeros(), Vector2::zeros())
        );
        assert!((p.at(3.0).shape.bend.0 - on_circle(2.0)).norm() < 1e-12);
    }

    #[test]
    fn a_live_path_is_predicted_from_its_past_alone() {
        let ahead_of = |p: &Path, t: f64| {
            p.expected(
                t,
                0.06,
                &Pace {
                    speed: 1.6,
                    acceleration: 10.0,
                },
            )
        };
        let p = circle();
        let mut other = p.clone();
        for row in &mut other.rows[21..] {
            *row = Vector3::zeros();
        }
        for k in 4..20 {
            let t = f64::from(k) * 0.05 + 0.01;
            let ahead = ahead_of(&p, t);
            assert!(
                (ahead.shape.bend.0 - on_circle(t + 0.06))
                    .norm()
                    .to_degrees()
                    < 0.2,
                "{t}"
            );
            assert_eq!(ahead, ahead_of(&other, t), "{t}");
        }
    }

    #[test]
    fn paths_that_are_too_fast_are_recognised() {
        let (geometry, lines) = (
            Geometry::default(),
            [Line {
                k_epsilon: 2.2,
                k_lambda_mm: 0.9,
            }; 3],
        );
        let motion = MotionLimits::default();
        let demand = circle().demand(&geometry, &lines, &motion);
        assert!(
            (circle().slowed(2.0).demand(&geometry, &lines, &motion) - demand / 2.0).abs()
                < 0.01 * demand,
            "{demand}"
        );
        let row = Vector3::zeros();
        assert!(
            Path::new(vec![0.0], vec![row]).is_none()
                && Path::new(vec![1.0, 1.0], vec![row; 2]).is_none()
        );
    }
}
