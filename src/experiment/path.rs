//! Paths of the tip: a file of times and bends, and the smooth curve through its rows.

use crate::control::follow::Pace;
use crate::control::limits::ActuatorLimits;
use crate::control::tick::Reference;
use crate::log::error::ReadError;
use crate::log::table::{Schema, Table};
use crate::model::arc::{Geometry, Shape};
use crate::model::bend::Bend;
use crate::model::transmission::Line;
use crate::motion::limits::MotionLimits;
use crate::primitives::units::Mm;
use nalgebra::{Matrix3, Vector2, Vector3};

const SCHEMA: Schema<'_> = Schema {
    required: &["t_s", "bend_deg", "dir_deg"],
    known: &|name| matches!(name, "t_s" | "bend_deg" | "dir_deg" | "len_mm"),
    rows_min: 2,
};
/// Interval at which a path is compared with what the pistons can do, s.
const SCAN_S: f64 = 0.005;
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
    table: Table,
    t_s: Vec<f64>,
    /// Bend vector in rad, and length in mm.
    rows: Vec<Vector3<f64>>,
    /// Second derivatives of the spline at the rows.
    second: Vec<Vector3<f64>>,
}

impl Path {
    /// Reads a file with the columns `t_s`, `bend_deg`, `dir_deg` and, if given, `len_mm`.
    ///
    /// # Errors
    /// [`ReadError`] with file, line and column: fewer than two rows, a time that does not increase, a missing value.
    pub fn open(file: &std::path::Path, geometry: &Geometry) -> Result<Self, ReadError> {
        Self::of(Table::open(file, &SCHEMA)?, geometry)
    }

    /// Reads the text of a file, which errors call `name`.
    ///
    /// # Errors
    /// As for [`Path::open`].
    pub fn parse(name: &str, text: &str, geometry: &Geometry) -> Result<Self, ReadError> {
        Self::of(Table::parse(name, text.as_bytes(), &SCHEMA)?, geometry)
    }

    fn of(table: Table, geometry: &Geometry) -> Result<Self, ReadError> {
        let t_s = table.clock("t_s")?.to_vec();
        let (bend, dir) = (table.complete("bend_deg")?, table.complete("dir_deg")?);
        let length = table.column("len_mm").map(|_| table.complete("len_mm"));
        let length = length.transpose()?;
        let row = |k: usize| {
            let length_mm = length.map_or(geometry.rest_length_mm, |l| l[k]);
            Bend::from_deg(bend[k], dir[k]).0.push(length_mm)
        };
        let rows: Vec<_> = (0..t_s.len()).map(row).collect();
        let second = natural_spline(&t_s, &rows);
        Ok(Self { table, t_s, rows, second })
    }

    /// Duration, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.t_s[self.t_s.len() - 1] - self.t_s[0]
    }

    /// The path at a time after its first row, s. It rests before its first row and after its last.
    #[must_use]
    pub fn at(&self, after_s: f64) -> Reference {
        let t = self.t_s[0] + after_s;
        let last = self.t_s.len() - 1;
        if t < self.t_s[0] || t > self.t_s[last] {
            let end = if t < self.t_s[0] { 0 } else { last };
            return reference([self.rows[end], Vector3::zeros(), Vector3::zeros()]);
        }
        let k = self.t_s.partition_point(|&row| row <= t).clamp(1, last) - 1;
        let h = self.t_s[k + 1] - self.t_s[k];
        let b = (t - self.t_s[k]) / h;
        let a = 1.0 - b;
        let (y, m) = (&self.rows[k..], &self.second[k..]);
        reference([
            y[0] * a + y[1] * b + (m[0] * (a.powi(3) - a) + m[1] * (b.powi(3) - b)) * (h * h / 6.0),
            (y[1] - y[0]) / h + (m[1] * (3.0 * b * b - 1.0) - m[0] * (3.0 * a * a - 1.0)) * (h / 6.0),
            m[0] * a + m[1] * b,
        ])
    }

    /// What is expected of the path at `ahead_s` after the time `after_s`, from the rows up to `after_s` alone: the parabola
    /// through the last rows, with the speed and acceleration of `pace` at most.
    #[must_use]
    pub fn expected(&self, after_s: f64, ahead_s: f64, pace: &Pace) -> Reference {
        let now_s = self.t_s[0] + after_s;
        let known = self.t_s.partition_point(|&row| row <= now_s + 1e-9).max(1);
        let newest = known - 1;
        let from = self.t_s[..known].partition_point(|&row| row < self.t_s[newest] - WINDOW_S).min(known.saturating_sub(3));
        let [at, rate, acceleration] = parabola(&self.t_s[from..known], &self.rows[from..known]);
        let capped = |v: Vector3<f64>, most: f64| {
            let bend = v.xy().cap_magnitude(most);
            Vector3::new(bend.x, bend.y, v.z)
        };
        let (rate, acceleration) = (capped(rate, pace.speed), capped(acceleration, pace.acceleration));
        if now_s > self.t_s[self.t_s.len() - 1] {
            // the stream has ended
            return reference([at, Vector3::zeros(), Vector3::zeros()]);
        }
        let wanted_s = now_s + ahead_s - self.t_s[newest];
        let h = wanted_s.min(EXTRAPOLATE_S);
        let ahead = at + rate * h + acceleration * (h * h / 2.0);
        if wanted_s > h {
            return reference([ahead, Vector3::zeros(), Vector3::zeros()]);
        }
        reference([ahead, rate + acceleration * h, acceleration])
    }

    /// Refuses a path with a bend that these lines cannot hold.
    ///
    /// # Errors
    /// [`ReadError::Field`] for the first row out of reach, with the largest bend in its direction.
    pub fn within(&self, limits: &ActuatorLimits, geometry: &Geometry, lines: &[Line; 3]) -> Result<(), ReadError> {
        for (k, row) in self.rows.iter().enumerate() {
            let shape = shape(row);
            let share = limits.largest_share(geometry, lines, &shape);
            if share < 1.0 {
                let (bend_deg, dir_deg) = (shape.bend.beta().to_degrees(), shape.bend.delta().to_degrees());
                let (largest_deg, length_mm) = (share * bend_deg, row.z);
                let given = self.table.column("bend_deg").map_or(0.0, |b| b[k]).to_string();
                let expected = format!("within reach: the largest bend towards {dir_deg:.0}° at {length_mm:.1} mm is {largest_deg:.1}°");
                return Err(self.table.refuse(k, "bend_deg", &given, &expected));
            }
        }
        Ok(())
    }

    /// Largest speed and acceleration that the path asks of the pistons, as the factor by which its time must be stretched
    /// so that they can follow; at most 1 for a path that they can follow as it is.
    #[must_use]
    pub fn demand(&self, geometry: &Geometry, lines: &[Line; 3], limits: &MotionLimits) -> f64 {
        let scans = (self.duration_s() / SCAN_S).ceil() as usize;
        let pistons = |v: Vector2<f64>| {
            let q = geometry.lengths(&shape(&v.push(geometry.rest_length_mm)));
            let moves = (0..3).map(|i| lines[i].play_output_mm(q[i]).abs());
            moves.fold(0.0, f64::max)
        };
        let speed_max = USABLE * limits.speed_max_mm_s;
        let acceleration_max = USABLE * limits.acceleration_max_mm_s2;
        let mut most = 0.0f64;
        for at in (0..=scans).map(|k| self.at(k as f64 * SCAN_S)) {
            let stretch = (pistons(at.acceleration) / acceleration_max).sqrt();
            most = most.max(pistons(at.rate) / speed_max).max(stretch);
        }
        most
    }

    /// The same path with its time stretched by `factor`.
    #[must_use]
    pub fn slowed(&self, factor: f64) -> Self {
        let t_s: Vec<_> = self.t_s.iter().map(|t| t * factor).collect();
        let second = self.second.iter().map(|m| m / (factor * factor)).collect();
        Self { t_s, second, ..self.clone() }
    }
}

fn reference([at, rate, acceleration]: [Vector3<f64>; 3]) -> Reference {
    let (shape, rate, acceleration) = (shape(&at), rate.xy(), acceleration.xy());
    Reference { shape, rate, acceleration }
}

/// The shape of a row.
fn shape(row: &Vector3<f64>) -> Shape {
    let (bend, length) = (Bend(row.xy()), Mm(row.z));
    Shape { bend, length }
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
        (1, _) | (3.., None) => last,
        (2, _) => [y[1], (y[1] - y[0]) / (t[1] - t[0]), Vector3::zeros()],
        (_, Some(inverse)) => {
            let fit = inverse * right;
            [fit.row(0).transpose(), fit.row(1).transpose() / scale, fit.row(2).transpose() * (2.0 / (scale * scale))]
        }
        (0, None) => last,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(text: &str) -> Path {
        Path::parse("path.csv", &format!("t_s,bend_deg,dir_deg\n{text}"), &Geometry::default()).unwrap()
    }

    /// A circle of 20° in 2 s, with a row every 50 ms.
    fn circle() -> Path {
        path(&(0..=40).map(|k| format!("{},20,{}\n", f64::from(k) * 0.05, f64::from(k * 9 % 360))).collect::<String>())
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
            assert!((at.shape.bend.0 - on_circle(t)).norm().to_degrees() < if inner { 1e-3 } else { 0.05 }, "{t}");
            assert!((after.shape.bend.0 - at.shape.bend.0 - at.rate * 1e-5).norm() < 1e-8, "{t}");
            assert!((after.rate - at.rate - at.acceleration * 1e-5).norm() < 1e-7, "{t}");
        }
        assert_eq!((p.at(-1.0).rate, p.at(3.0).rate), (Vector2::zeros(), Vector2::zeros()));
        assert!((p.at(3.0).shape.bend.0 - on_circle(2.0)).norm() < 1e-12);
    }

    #[test]
    fn a_live_path_is_predicted_from_its_past_alone() {
        let ahead_of = |p: &Path, t: f64| p.expected(t, 0.06, &Pace { speed: 1.6, acceleration: 10.0 });
        let p = circle();
        let mut other = p.clone();
        for row in &mut other.rows[21..] {
            *row = Vector3::zeros();
        }
        for k in 4..20 {
            let t = f64::from(k) * 0.05 + 0.01;
            let ahead = ahead_of(&p, t);
            assert!((ahead.shape.bend.0 - on_circle(t + 0.06)).norm().to_degrees() < 0.2, "{t}");
            assert_eq!(ahead, ahead_of(&other, t), "{t}");
        }
    }

    #[test]
    fn paths_out_of_reach_and_too_fast_are_recognised() {
        let (geometry, lines) = (Geometry::default(), [Line { k_epsilon: 2.2, k_lambda_mm: 0.9 }; 3]);
        let limits =
            ActuatorLimits { travel_mm: 30.0, pressure_kpa_per_mm: 3.2, pressure_max_kpa: 41.0, bellow_min_mm: 14.0, bellow_max_mm: 29.0 };
        assert!(circle().within(&limits, &geometry, &lines).is_ok());
        let why = path("0,30,0\n1,120,0\n").within(&limits, &geometry, &lines).unwrap_err().to_string();
        assert!(why.starts_with("path.csv, line 3, column bend_deg: `120` is not within reach: the largest bend towards 0°"), "{why}");
        let motion = MotionLimits::of_checked(&crate::motion::config::MotionConfig::default());
        let demand = circle().demand(&geometry, &lines, &motion);
        assert!((circle().slowed(2.0).demand(&geometry, &lines, &motion) - demand / 2.0).abs() < 0.01 * demand, "{demand}");
    }
}
