//! The nominal model run forward from the pistons, with any set of effects in it.
//!
//! pistons → play → 1/(1 + k_ε) → first-order lag τ₀ → constant curvature → tip orientation, all by
//! `model::*`; each effect changes the signal at its own place. The lag takes what comes between two
//! instants as a straight line, so its step may be longer than τ₀. The result is the tip's orientation
//! instant by instant; what the sensors make of it is [`crate::diagnosis::fit`]'s part, because most of that is
//! linear.

use crate::diagnosis::observe::Observed;
use crate::model::arc::{Geometry, Shape};
use crate::model::bend::Bend;
use crate::model::effects::{Effect, Memory, Moment, Pose};
use crate::model::transmission::Line;
use crate::primitives::units::Mm;
use nalgebra::{Matrix3, Vector3};

/// Nominal parameters: log(1 + k_ε) × 3, k_λ (mm) × 3, τ₀ (s).
pub const NOMINAL: usize = 7;
/// Largest mechanical lag that still counts as nominal, s.
pub const LAG_MAX_S: f64 = 0.05;

/// A set of effects, in catalogue order, with where their parameters stand in the vector.
#[derive(Clone)]
pub struct Model<'a> {
    /// The effects.
    pub effects: Vec<&'a dyn Effect>,
    /// First parameter of each, and one past the last of all.
    pub at: Vec<usize>,
}

impl<'a> Model<'a> {
    /// The nominal model with these effects.
    #[must_use]
    pub fn new(effects: &[&'a dyn Effect]) -> Self {
        let mut at = vec![NOMINAL];
        for e in effects {
            at.push(at[at.len() - 1] + e.params().len());
        }
        Self { effects: effects.to_vec(), at }
    }
    /// Number of parameters.
    #[must_use]
    pub fn size(&self) -> usize {
        self.at[self.effects.len()]
    }
    /// Parameters of effect `i`.
    #[must_use]
    #[inline]
    pub fn of<'p>(&self, theta: &'p [f64], i: usize) -> &'p [f64] {
        &theta[self.at[i]..self.at[i + 1]]
    }
    /// Effects with their parameters.
    pub fn each<'p>(&'p self, theta: &'p [f64]) -> impl Iterator<Item = (&'a dyn Effect, &'p [f64])> {
        self.effects.iter().enumerate().map(move |(i, e)| (*e, self.of(theta, i)))
    }
    /// Whether parameter `j` changes only what the sensors make of the motion.
    #[must_use]
    pub fn sensing_only(&self, j: usize) -> bool {
        j >= NOMINAL && (0..self.effects.len()).any(|i| (self.at[i]..self.at[i + 1]).contains(&j) && self.effects[i].sensing_only())
    }
}

/// Tip in the base, instant by instant; zero where nothing looks.
pub type Motion = Vec<Matrix3<f64>>;

/// The lines of a nominal parameter vector.
#[must_use]
pub fn lines(theta: &[f64]) -> [Line; 3] {
    std::array::from_fn(|i| Line { k_epsilon: theta[i].exp() - 1.0, k_lambda_mm: theta[3 + i].max(0.0) })
}

/// Runs the model through the whole log.
#[must_use]
pub fn run(log: &Observed, model: &Model<'_>, theta: &[f64]) -> Motion {
    let lines = lines(theta);
    let geometry = Geometry::default();
    let lag_s = theta[6].max(1e-3);
    let transport_s: f64 = model.each(theta).map(|(e, p)| e.transport_s(p)).sum();
    let mut memory = vec![Memory::default(); model.effects.len()];
    let (mut w_mm, mut lagged, mut before) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
    let mut delayed = Delayed { log, behind_s: transport_s, at: 0 };
    let start_s = log.start_s();
    let every = model.each(theta).any(|(e, p)| e.latency_s(p) > 0.0);
    let mut moment = Moment {
        t_s: 0.0,
        dt_s: 0.01,
        counted_mm: Vector3::zeros(),
        up_base: log.up_base,
        k_epsilon: Vector3::from_fn(|i, _| lines[i].k_epsilon),
        r_mm: geometry.r_mm,
        idle_s: 10.0,
    };
    let (mut keep, mut keep_dt) = (0.0, -1.0);
    let mut out = Vec::with_capacity(log.t_s.len());
    for k in 0..log.t_s.len() {
        let dt_s = if k == 0 { 0.01 } else { log.t_s[k] - log.t_s[k - 1] };
        let u = delayed.piston(k);
        (moment.t_s, moment.dt_s, moment.counted_mm, moment.idle_s) = (log.t_s[k] - start_s, dt_s, u, log.idle_s[k]);
        if (dt_s - keep_dt).abs() > 1e-7 {
            (keep, keep_dt) = ((-dt_s / lag_s).exp(), dt_s);
        }
        let q = bellows(model, theta, &mut memory, &moment, &lines, &mut w_mm);
        // a ramp is followed at the distance slope · τ₀
        let behind = (q - before) * (lag_s / dt_s);
        lagged = q - behind + (lagged - before + behind) * keep;
        before = q;
        // between the middles of bins only a late sensor looks
        let seen = every || log.middle[k];
        out.push(if seen { orientation(model, theta, &mut memory, &moment, &geometry, &lagged) } else { Matrix3::zeros() });
    }
    from_rest(&mut out);
    out
}

/// The rest *defines* zero bend and the base frame: a tip that sags before anything moves is straight
/// by definition, and everything later is seen from there.
fn from_rest(motion: &mut Motion) {
    let Some(back) = motion.first().map(Matrix3::transpose) else { return };
    if back != Matrix3::identity() {
        for r in motion.iter_mut() {
            *r = back * *r;
        }
    }
}

/// Pistons, play, extension and the rubber: bellow length changes before the mechanical lag.
fn bellows(
    model: &Model<'_>,
    theta: &[f64],
    memory: &mut [Memory],
    at: &Moment,
    lines: &[Line; 3],
    w_mm: &mut Vector3<f64>,
) -> Vector3<f64> {
    let mut u = at.counted_mm;
    for (i, e) in model.effects.iter().enumerate() {
        e.pistons(model.of(theta, i), &mut memory[i], at, &mut u);
    }
    for c in 0..3 {
        w_mm[c] = lines[c].play(w_mm[c], u[c]);
    }
    let mut play_output = *w_mm;
    for (i, e) in model.effects.iter().enumerate() {
        e.play_output(model.of(theta, i), &mut memory[i], at, &mut play_output);
    }
    let mut q = Vector3::from_fn(|c, _| lines[c].bellow_mm(play_output[c]));
    for (i, e) in model.effects.iter().enumerate() {
        e.bellows(model.of(theta, i), &mut memory[i], at, &mut q);
    }
    q
}

/// Constant curvature, and what bends it.
fn orientation(
    model: &Model<'_>,
    theta: &[f64],
    memory: &mut [Memory],
    at: &Moment,
    geometry: &Geometry,
    q: &Vector3<f64>,
) -> Matrix3<f64> {
    let Shape { bend, length: Mm(_) } = geometry.shape(q);
    let mut pose = Pose { bend: bend.0, twist: 0.0, bellow_mm: *q };
    for (i, e) in model.effects.iter().enumerate() {
        e.shape(model.of(theta, i), &mut memory[i], at, &mut pose);
    }
    let bent = rotation(&Bend(pose.bend));
    if pose.twist == 0.0 {
        return bent;
    }
    let (s, c) = pose.twist.sin_cos();
    bent * Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}

/// Rodrigues' formula for the axis (b_y, b_x, 0): Eq. 7 as a matrix.
fn rotation(bend: &Bend) -> Matrix3<f64> {
    let beta2 = bend.0.norm_squared();
    let beta = beta2.sqrt();
    let (s, v) = if beta < 1e-6 { (1.0, 0.5) } else { (beta.sin() / beta, (1.0 - beta.cos()) / beta2) };
    let (x, y) = (bend.0.y, bend.0.x);
    Matrix3::new(1.0 - v * y * y, v * x * y, s * y, v * x * y, 1.0 - v * x * x, -s * x, -s * y, s * x, 1.0 - v * beta2)
}

/// Reads the pistons as they were a while ago, from the log's own rows.
struct Delayed<'a> {
    log: &'a Observed,
    behind_s: f64,
    at: usize,
}

impl Delayed<'_> {
    fn piston(&mut self, k: usize) -> Vector3<f64> {
        if self.behind_s <= 0.0 {
            return self.log.piston_mm[k];
        }
        let (rows, t) = (&self.log.rows, self.log.t_s[k] - self.behind_s);
        while rows.t_s.get(self.at + 1).is_some_and(|&next| next <= t) {
            self.at += 1;
        }
        rows.piston_after(self.at, t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_matrix_is_the_models_rotation() {
        for (x, y) in [(0.0, 0.0), (0.5, -0.3), (-1.2, 0.9), (1e-8, 0.0)] {
            let b = Bend(nalgebra::Vector2::new(x, y));
            assert!((rotation(&b) - b.rotation().matrix()).norm() < 1e-12);
        }
    }
}
