//! Axes of the sensors: gravity and the magnetic field turn in them as the gyroscope says, and the gyroscope as the pistons say.
//!
//! A field that is constant in space turns in the sensor by `b = R(ω)⁻¹ a`. If the axes of its sensor are `Q a` instead, with Q a
//! permutation with signs, it turns as if the gyroscope read `P ω` with `P = det(Q) Q`, which is a rotation. If the axes of all sensors are
//! Q, this is `det(Q) ω`, and the pistons tell which. A tip that bends does not turn about its own z, so the third sign of P is not
//! seen.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Rotation within a window that counts as motion, rad (5°).
pub(super) const MOTION_RAD: f64 = 0.09;
/// Windows with motion below which the wiring is not judged.
const WINDOWS_MIN: usize = 8;
/// Correlation from which another wiring or other axes explain the rotations, and by how much they have to do it better.
pub(super) const AGREES: f64 = 0.7;
pub(super) const BETTER: f64 = 0.25;

/// What the sensors say about a window: the turn by the gyroscope as a rotation vector, rad, and the readings of specific force and
/// magnetic field at its start and end; zero without a sample.
pub(super) struct Turn {
    pub(super) gyroscope: Vector3<f64>,
    pub(super) up: [Vector3<f64>; 2],
    pub(super) north: [Vector3<f64>; 2],
}

/// Columns that stand in place of x, y and z, with their signs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Axes {
    from: [usize; 3],
    sign: [i8; 3],
}

/// The order in which columns can stand.
const ORDERS: [[usize; 3]; 6] = [
    [0, 1, 2],
    [1, 0, 2],
    [2, 1, 0],
    [0, 2, 1],
    [1, 2, 0],
    [2, 0, 1],
];

impl Axes {
    const RIGHT: Self = Self {
        from: ORDERS[0],
        sign: [1; 3],
    };

    /// All of one handedness, 1 or −1.
    fn all(handedness: i8) -> impl Iterator<Item = Self> {
        let signs = [[1, 1], [1, -1], [-1, 1], [-1, -1]];
        let all = signs.into_iter().flat_map(|[x, y]| {
            ORDERS.map(|from| Self {
                from,
                sign: [x, y, 1],
            })
        });
        all.map(move |mut axes| {
            axes.sign[2] = handedness * axes.handedness();
            axes
        })
    }

    /// 1, or −1 if left-handed.
    fn handedness(&self) -> i8 {
        let [x, y, z] = [0, 1, 2].map(|k| self.apply(&Vector3::ith(k, 1.0)));
        if x.cross(&y).dot(&z) < 0.0 { -1 } else { 1 }
    }

    /// Number of exchanged columns and of other signs.
    fn changes(&self) -> usize {
        let exchanged = (0..3).filter(|&i| self.from[i] != i).count();
        exchanged + self.sign.iter().filter(|sign| **sign < 0).count()
    }

    pub(super) fn apply(&self, v: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|i, _| f64::from(self.sign[i]) * v[self.from[i]])
    }

    /// With the other sign of z.
    fn mirrored(mut self) -> Self {
        self.sign[2] = -self.sign[2];
        self
    }

    fn inverse(&self) -> Self {
        let mut inverse = *self;
        for (i, from) in self.from.into_iter().enumerate() {
            (inverse.from[from], inverse.sign[from]) = (i, self.sign[i]);
        }
        inverse
    }

    /// These axes with the signs in `unseen` chosen such that the fewest change.
    fn simplest(self, unseen: [[i8; 3]; 2]) -> Self {
        let signed = unseen.map(|by| Self {
            sign: [0, 1, 2].map(|i| self.sign[i] * by[i]),
            ..self
        });
        let [a, b] = signed;
        if b.changes() < a.changes() { b } else { a }
    }

    /// What is said about columns with these axes.
    fn says(&self) -> String {
        let changed: Vec<&str> = (0..3)
            .filter(|&i| self.from[i] != i || self.sign[i] < 0)
            .map(|i| ["x", "y", "z"][i])
            .collect();
        match changed[..] {
            [axis] => format!("{axis} looks like it has the other sign"),
            [a, b] if self.sign == [1; 3] => format!("{a} and {b} look exchanged"),
            _ => {
                let [x, y, z] = [0, 1, 2].map(|i| {
                    let sign = if self.sign[i] < 0 { "−" } else { "" };
                    format!("{sign}{}", ["x", "y", "z"][self.from[i]])
                });
                format!("x, y and z look like {x}, {y} and {z}")
            }
        }
    }
}

/// Rotation P with which a field turns in its sensor as the gyroscope says. [`OPPOSITE`] stands for `−ω` too, as a tip that bends hardly
/// tells them apart.
fn turns_as(
    turns: &[Turn],
    field: impl Fn(&Turn) -> [Vector3<f64>; 2],
    ridge: f64,
) -> Option<Axes> {
    let score = |axes: &Axes| likeness(turns, &field, axes, ridge);
    let (as_is, mirrored) = (score(&Axes::RIGHT)?, score(&OPPOSITE.mirrored())?);
    let scores = Axes::all(1).filter_map(|axes| Some((axes, score(&axes)?)));
    let (mut best, mut likeness) = scores.max_by(|a, b| a.1.total_cmp(&b.1))?;
    if mirrored > likeness - ALIKE {
        (best, likeness) = (OPPOSITE, mirrored);
    }
    // an offset may explain much of other axes
    let unexplained = |likeness: f64| 1.0 - likeness.max(0.0).powi(2);
    let is_other = likeness > AGREES && FEWER * unexplained(likeness) < unexplained(as_is);
    Some(if is_other { best } else { Axes::RIGHT })
}

/// Correlation of the changes of a field in its sensor with those that the gyroscope's turns with these axes make of it. A constant
/// offset of the sensor, such as hard iron, is fitted beside: `b − R⁻¹ a = (1 − R⁻¹) h`.
fn likeness(
    turns: &[Turn],
    field: impl Fn(&Turn) -> [Vector3<f64>; 2],
    axes: &Axes,
    ridge: f64,
) -> Option<f64> {
    let fields = || turns.iter().map(&field);
    let size = fields()
        .map(|[a, _]| a.norm())
        .fold(0.0, f64::max)
        .max(f64::MIN_POSITIVE);
    let known = turns.iter().filter_map(|turn| {
        let [a, b] = field(turn).map(|v| v / size);
        let back = UnitQuaternion::from_scaled_axis(-axes.apply(&turn.gyroscope));
        let is_known = a != Vector3::zeros() && b != Vector3::zeros();
        is_known.then(|| (a, b, back.to_rotation_matrix().into_inner()))
    });
    let known: Vec<_> = known.collect();
    let (mut normal, mut right) = (Matrix3::identity() * ridge, Vector3::zeros());
    for (a, b, back) in &known {
        let by_offset = Matrix3::identity() - back;
        normal += by_offset.transpose() * by_offset;
        right += by_offset.transpose() * (b - back * a);
    }
    let offset = normal.cholesky()?.solve(&right);
    let pairs = known
        .iter()
        .map(|(a, b, back)| (b - a, (back - Matrix3::identity()) * (a - offset)));
    correlation(pairs)
}

/// The columns that have other axes than those of the tip, and what is said about them. `driven` is the correlation of the gyroscope's
/// turns with those that the pistons drive, if its axes are these.
pub(super) fn stray(turns: &[Turn], driven: impl Fn(&Axes) -> Option<f64>) -> Option<Stray> {
    let gravity = turns_as(turns, |turn| turn.up, NO_OFFSET)?;
    let field = turns_as(turns, |turn| turn.north, ANY_OFFSET);
    let agrees = |axes: &Axes| driven(axes).is_some_and(|agrees| agrees > AGREES);
    let of_field = |axes: Axes| axes.simplest([[1; 3], [-1; 3]]).says();
    let of_gyroscope = |axes: Axes| {
        let gyroscope = axes.inverse();
        // the reading of the tip's z is nearly zero
        let unseen = [0, 1, 2].map(|i| if gyroscope.from[i] == 2 { -1 } else { 1 });
        gyroscope.simplest([[1; 3], unseen]).says()
    };
    let all = if field.is_some() { ALL } else { "acc_*, gyr_*" };
    Some(match (gravity, field) {
        (Axes::RIGHT, None | Some(Axes::RIGHT)) => return None,
        (Axes::RIGHT, Some(axes)) if agrees(&axes) && !agrees(&Axes::RIGHT) => {
            ("gyr_*", of_gyroscope(axes))
        }
        (Axes::RIGHT, Some(axes)) => ("mag_*", of_field(axes)),
        (OPPOSITE, Some(OPPOSITE)) => left_handed(all, driven),
        (axes, _) if agrees(&Axes::RIGHT) => ("acc_*", of_field(axes)),
        (OPPOSITE, None | Some(Axes::RIGHT)) => left_handed(all, driven),
        (axes, _) if agrees(&axes) => ("gyr_*", of_gyroscope(axes)),
        (axes, Some(Axes::RIGHT)) => ("acc_*", of_field(axes)),
        _ => (all, "the sensors have axes of their own".to_owned()),
    })
}

/// Columns, and what is said about them.
pub(super) type Stray = (&'static str, String);

const ALL: &str = "acc_*, gyr_*, mag_*";
/// A field turns as if the gyroscope turned the other way about x and y.
const OPPOSITE: Axes = Axes {
    sign: [-1, -1, 1],
    ..Axes::RIGHT
};
/// Factor by which other axes have to leave less unexplained.
const FEWER: f64 = 4.0;
/// Difference of two correlations that says nothing.
const ALIKE: f64 = 0.05;
/// Weights of an offset of zero, in windows of motion: hard iron may be larger than the field, and an accelerometer is not off by much.
const ANY_OFFSET: f64 = 1e-3;
const NO_OFFSET: f64 = 1e9;

/// Right-handed axes of all sensors, where no other wiring of the pistons explains the turns. Those that are turned about the tip's z are
/// those of other pistons.
pub(super) fn turned(driven: impl Fn(&Axes) -> Option<f64>) -> Option<Stray> {
    let as_is = driven(&Axes::RIGHT)?;
    let others = Axes::all(1).filter(|axes| axes.from[2] != 2);
    let scores = others.filter_map(|axes| Some((driven(&axes.inverse())?, axes)));
    let (best, axes) = scores.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best > AGREES && best - as_is > BETTER).then(|| (ALL, axes.says()))
}

/// What is said about left-handed axes of all sensors, or a gyroscope that turns the other way.
fn left_handed(all: &'static str, driven: impl Fn(&Axes) -> Option<f64>) -> Stray {
    let scores = Axes::all(-1).filter_map(|axes| Some((driven(&axes.inverse())?, axes)));
    let best = scores.max_by(|a, b| a.0.total_cmp(&b.0));
    match best.filter(|(agrees, _)| *agrees > AGREES) {
        Some((_, axes)) if axes.sign == [-1; 3] && axes.from == ORDERS[0] => {
            let says = "looks like it has the other sign, or the rows run backwards";
            ("gyr_*", says.to_owned())
        }
        Some((_, axes)) => (all, axes.says()),
        None => {
            let says = "two axes look exchanged, or one has the other sign";
            (all, says.to_owned())
        }
    }
}

/// Correlation of rotations, measured and predicted, over the windows with motion; `None` where too little moves.
pub(super) fn correlation(
    pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)>,
) -> Option<f64> {
    let (mut mp, mut mm, mut pp, mut windows) = (0.0, 0.0, 0.0, 0);
    for (measured, predicted) in pairs {
        if measured.norm().max(predicted.norm()) > MOTION_RAD {
            mp += measured.dot(&predicted);
            mm += measured.norm_squared();
            pp += predicted.norm_squared();
            windows += 1;
        }
    }
    (windows >= WINDOWS_MIN && mm > 0.0 && pp > 0.0).then(|| mp / (mm * pp).sqrt())
}
