//! The laws along the counted pistons, in which the bend is linear.
//!
//! A channel gives `Q = v + Σ θ_k c_k(v)` with `v = w / ((1 + k_ε) r)`, the play output in rad, and the bend is `−(2/3) Σ s_i Q_i`
//! over the spokes `s_i`, plus a rotation and an offset. The columns `c_k` are those of the catalogue: gain, even and odd curve,
//! half-width of the play, plies of the rubber (Prandtl-Ishlinskii stops), creep and leak. The gain column is the online
//! refinement of k_ε.

use crate::model::{Geometry, Line};
use nalgebra::{SMatrix, SVector, Vector2, Vector3};

/// Number of plies, and their yield points, rad of v.
pub const PLIES: usize = 3;
const YIELD_RAD: [f64; PLIES] = [0.06, 0.16, 0.40];
/// Number of creeping elements, and their time constants, s.
pub const CREEPS: usize = 3;
const CREEP_S: [f64; CREEPS] = [0.8, 5.0, 30.0];

/// First index of the relative errors of the gains, one a channel.
pub const GAIN: usize = 0;
/// Even curves, 1/rad, one a channel.
pub const EVEN: usize = 3;
/// Odd curves, 1/rad², one a channel.
pub const ODD: usize = 6;
/// Errors of the half-widths, mm, one a channel.
pub const PLAY: usize = 9;
/// Shares of the plies.
pub const PLY: usize = 12;
/// Shares of the creeping elements.
pub const CREEP: usize = PLY + PLIES;
/// Leaks, 1/s, one a channel.
pub const LEAK: usize = CREEP + CREEPS;
/// Rotation of the bend plane, rad.
pub const ROTATION: usize = LEAK + 3;
/// Offset of the bend, rad, one an axis.
pub const OFFSET: usize = ROTATION + 1;
/// Number of parameters.
pub const LAWS: usize = OFFSET + 2;

/// Values of the parameters.
pub type Theta = SVector<f64, LAWS>;
/// Derivatives of the bend with respect to the parameters.
pub type Columns = SMatrix<f64, 2, LAWS>;

/// Least and greatest slope dQ/dv of a channel that the inverse relies on.
const SLOPE: [f64; 2] = [0.3, 1.7];
/// Distance of a piston from its play output, as a share of the half-width, from which it is engaged.
const ENGAGED: f64 = 0.98;
/// Largest |v| of the inverse, rad, and the number of bisections that solve it to 1e-10 rad.
const REACH_RAD: f64 = 2.4;
const BISECTIONS: usize = 36;

/// One play operator. Its slope is −1 or 1 where it was last engaged and 0 before any motion.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Play {
    /// Output, mm.
    pub w_mm: f64,
    /// ∂w/∂λ.
    pub slope: f64,
}

impl Play {
    fn advance(&mut self, piston_mm: f64, half_width_mm: f64) {
        if piston_mm - half_width_mm > self.w_mm {
            (self.w_mm, self.slope) = (piston_mm - half_width_mm, -1.0);
        }
        if piston_mm + half_width_mm < self.w_mm {
            (self.w_mm, self.slope) = (piston_mm + half_width_mm, 1.0);
        }
    }
}

/// State of the laws of the three channels at one instant.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Channels {
    /// The plays with the half-width in use.
    pub play: [Play; 3],
    /// The same with half-widths that are smaller and larger by `spread_mm`.
    around: [[Play; 3]; 2],
    spread_mm: [f64; 3],
    /// Play outputs, rad.
    pub v: [f64; 3],
    ply: [[f64; PLIES]; 3],
    creep: [[f64; CREEPS]; 3],
    leak: [f64; 3],
}

/// Displacement of a piston per v, mm/rad.
pub fn mm_per_rad(line: &Line, geometry: &Geometry) -> f64 {
    (1.0 + line.k_epsilon) * geometry.r_mm
}

impl Channels {
    /// One tick with the pistons at `piston_mm`.
    pub fn advance(
        &mut self,
        lines: &[Line; 3],
        geometry: &Geometry,
        piston_mm: &Vector3<f64>,
        dt_s: f64,
    ) {
        let creep = CREEP_S.map(|tau_s| -(-dt_s / tau_s).exp_m1());
        for i in 0..3 {
            let half_width_mm = lines[i].k_lambda_mm;
            self.play[i].advance(piston_mm[i], half_width_mm);
            for (plays, sign) in self.around.iter_mut().zip([-1.0, 1.0]) {
                plays[i].advance(piston_mm[i], half_width_mm + sign * self.spread_mm[i]);
            }
            let v = self.play[i].w_mm / mm_per_rad(&lines[i], geometry);
            let change = v - std::mem::replace(&mut self.v[i], v);
            for (ply, yields) in self.ply[i].iter_mut().zip(YIELD_RAD) {
                *ply = (*ply + change).clamp(-yields, yields);
            }
            for (slow, share) in self.creep[i].iter_mut().zip(creep) {
                *slow += (v - *slow) * share;
            }
            self.leak[i] += v * dt_s;
        }
    }

    /// Channel `i` has rested with the play output `w_mm`, from which its piston is `off_mm` away.
    pub fn rest(&mut self, i: usize, w_mm: f64, off_mm: f64, half_width_mm: f64, mm_per_rad: f64) {
        let engaged = off_mm.abs() > ENGAGED * half_width_mm;
        let slope = if engaged { -off_mm.signum() } else { 0.0 };
        self.play[i] = Play { w_mm, slope };
        for (plays, sign) in self.around.iter_mut().zip([-1.0, 1.0]) {
            plays[i] = Play {
                w_mm: w_mm + slope * sign * self.spread_mm[i],
                slope,
            };
        }
        self.v[i] = w_mm / mm_per_rad;
        (self.ply[i], self.creep[i], self.leak[i]) = ([0.0; PLIES], [self.v[i]; CREEPS], 0.0);
    }

    /// Takes over that the half-width of channel `i` is larger by `change_mm` and known to `spread_mm`: engaged play outputs move along.
    pub fn widen(&mut self, i: usize, change_mm: f64, spread_mm: f64, mm_per_rad: f64) {
        let wider_mm = spread_mm - std::mem::replace(&mut self.spread_mm[i], spread_mm);
        self.play[i].w_mm += self.play[i].slope * change_mm;
        self.v[i] = self.play[i].w_mm / mm_per_rad;
        for (plays, sign) in self.around.iter_mut().zip([-1.0, 1.0]) {
            plays[i].w_mm += plays[i].slope * (change_mm + sign * wider_mm);
        }
    }

    /// ∂w/∂λ over one standard deviation either way.
    fn slope(&self, i: usize) -> f64 {
        if self.spread_mm[i] < 1e-6 {
            return self.play[i].slope;
        }
        let [narrow, wide] = self.around.map(|plays| plays[i].w_mm);
        ((wide - narrow) / (2.0 * self.spread_mm[i])).clamp(-1.0, 1.0)
    }

    /// True if the piston may or may not have crossed its play.
    pub fn is_uncertain(&self, i: usize) -> bool {
        self.around[0][i].slope != self.around[1][i].slope
    }

    /// Outputs of the plays, mm.
    pub fn play_outputs_mm(&self) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.play[i].w_mm)
    }

    /// The nominal bend, rad.
    pub fn nominal(&self) -> Vector2<f64> {
        bend_of(&self.v)
    }

    /// The columns of all parameters.
    pub fn columns(&self, lines: &[Line; 3], geometry: &Geometry) -> Columns {
        let mut columns = Columns::zeros();
        for (i, line) in lines.iter().enumerate() {
            let (v, spoke) = (self.v[i], Geometry::spoke(i) * (-2.0 / 3.0));
            let mut add = |k: usize, value: f64| {
                columns[(0, k)] += spoke.x * value;
                columns[(1, k)] += spoke.y * value;
            };
            add(GAIN + i, v);
            add(EVEN + i, even(v));
            add(ODD + i, odd(v));
            add(PLAY + i, self.slope(i) / mm_per_rad(line, geometry));
            (0..PLIES).for_each(|j| add(PLY + j, -self.ply[i][j]));
            (0..CREEPS).for_each(|j| add(CREEP + j, self.creep[i][j]));
            add(LEAK + i, -self.leak[i]);
        }
        let bend = self.nominal();
        (columns[(0, ROTATION)], columns[(1, ROTATION)]) = (-bend.y, bend.x);
        (columns[(0, OFFSET)], columns[(1, OFFSET + 1)]) = (1.0, 1.0);
        columns
    }

    /// Q of channel `i` at `v`, from the present state of plies and creep on. Extrapolated no steeper or flatter than a tip can be.
    pub fn output(&self, i: usize, v: f64, theta: &Theta) -> f64 {
        let creep: f64 = (0..CREEPS)
            .map(|j| theta[CREEP + j] * self.creep[i][j])
            .sum();
        let smooth = |v: f64| {
            v * (1.0 + theta[GAIN + i]) + theta[EVEN + i] * even(v) + theta[ODD + i] * odd(v)
        };
        let change = v - self.v[i];
        let plies = |change: f64| -> f64 {
            let of = |j: usize| (self.ply[i][j] + change).clamp(-YIELD_RAD[j], YIELD_RAD[j]);
            (0..PLIES).map(|j| theta[PLY + j] * of(j)).sum()
        };
        let (from, to) = (smooth(self.v[i]) - plies(0.0), smooth(v) - plies(change));
        let to = if change.abs() > 1e-6 {
            from + change * ((to - from) / change).clamp(SLOPE[0], SLOPE[1])
        } else {
            from
        };
        to + creep - theta[LEAK + i] * self.leak[i]
    }

    /// The v of channel `i` whose Q is `output`.
    pub fn solve(&self, i: usize, output: f64, theta: &Theta) -> f64 {
        let (mut low, mut high) = (-REACH_RAD, REACH_RAD);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if self.output(i, middle, theta) > output {
                high = middle;
            } else {
                low = middle;
            }
        }
        0.5 * (low + high)
    }

    /// Q of the three channels at their present v.
    pub fn outputs(&self, theta: &Theta) -> [f64; 3] {
        std::array::from_fn(|i| self.output(i, self.v[i], theta))
    }
}

/// Largest |v| of the curves, rad (75°): beyond it they go on straight, because no pose has shown them there.
const CURVED_RAD: f64 = 1.3;

/// v², straight beyond [`CURVED_RAD`].
fn even(v: f64) -> f64 {
    let beyond = (v.abs() - CURVED_RAD).max(0.0);
    let within = v.abs() - beyond;
    within * within + 2.0 * within * beyond
}

/// v³, straight beyond [`CURVED_RAD`].
fn odd(v: f64) -> f64 {
    let beyond = (v.abs() - CURVED_RAD).max(0.0);
    let within = v.abs() - beyond;
    v.signum() * within * within * (within + 3.0 * beyond)
}

/// Bend of the outputs of the three channels, rad.
pub fn bend_of(outputs: &[f64; 3]) -> Vector2<f64> {
    (0..3)
        .map(|i| Geometry::spoke(i) * (-2.0 / 3.0 * outputs[i]))
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LINES: [Line; 3] = [Line {
        k_epsilon: 2.2,
        k_lambda_mm: 0.9,
    }; 3];

    /// Channels after the pistons have been led along a path.
    fn led(path: &[[f64; 3]]) -> Channels {
        let mut channels = Channels::default();
        let mut at = Vector3::zeros();
        for to in path {
            for _ in 0..20 {
                at += (Vector3::from(*to) - at) * 0.3;
                channels.advance(&LINES, &Geometry::default(), &at, 0.05);
            }
        }
        channels
    }

    fn path() -> impl Strategy<Value = Vec<[f64; 3]>> {
        prop::collection::vec(prop::array::uniform3(-25.0..25.0f64), 1..6)
    }

    proptest! {
        /// What the filter predicts with the columns is what the inverse computes with the laws.
        #[test]
        fn the_columns_are_those_of_the_laws(path in path(), values in prop::array::uniform21(-0.1..0.1f64)) {
            let channels = led(&path);
            let mut theta = Theta::zeros();
            theta.rows_mut(0, ROTATION).copy_from_slice(&values);
            theta.rows_mut(PLAY, 3).fill(0.0);
            let by_columns = channels.nominal() + channels.columns(&LINES, &Geometry::default()) * theta;
            prop_assert!((by_columns - bend_of(&channels.outputs(&theta))).norm() < 1e-9);
        }

        #[test]
        fn the_inverse_finds_the_play_output(path in path(), values in prop::array::uniform21(-0.05..0.05f64), i in 0..3usize, to in -1.0..1.0f64) {
            let channels = led(&path);
            let mut theta = Theta::zeros();
            theta.rows_mut(0, ROTATION).copy_from_slice(&values);
            let v = channels.solve(i, to, &theta);
            prop_assert!(v.abs() > 2.39 || (channels.output(i, v, &theta) - to).abs() < 1e-6);
        }

        /// ∂w/∂λ, by operators whose half-widths differ.
        #[test]
        fn a_wider_play_moves_what_is_engaged(path in path()) {
            let (mut channels, mut wide) = (Channels::default(), Channels::default());
            let wider = LINES.map(|l| Line { k_lambda_mm: l.k_lambda_mm + 1e-3, ..l });
            for at in path.iter().map(|p| Vector3::from(*p)) {
                channels.advance(&LINES, &Geometry::default(), &at, 0.05);
                wide.advance(&wider, &Geometry::default(), &at, 0.05);
            }
            let mut widened = channels;
            (0..3).for_each(|i| widened.widen(i, 1e-3, 0.0, mm_per_rad(&LINES[i], &Geometry::default())));
            for i in 0..3 {
                prop_assert!((widened.play[i].w_mm - wide.play[i].w_mm).abs() < 2.1e-3);
            }
        }
    }

    #[test]
    fn curves_go_on_straight_beyond_what_poses_show() {
        let step = 1e-4;
        for (law, slope) in [(even as fn(f64) -> f64, 2.6), (odd, 3.0 * 1.69)] {
            for v in [1.3 - step, 1.3 + step, 2.0, 2.3] {
                let rise = (law(v + step) - law(v - step)) / (2.0 * step);
                assert!((rise - slope).abs() < 1e-3, "{v}: {rise}");
            }
        }
        assert!(even(-0.5) == 0.25 && odd(-0.5) == -0.125);
    }
}
