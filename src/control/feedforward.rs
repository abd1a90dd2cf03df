//! Feedforward through the machine that a diagnosis describes: the laws of its effects forward, and their inverse.
//!
//! The forward part follows the play outputs and keeps the memory of every effect. The inverse looks for the play outputs whose
//! shape, once they have been held for a short horizon, is the wanted one. The horizon is the shortest at which the shape shows
//! most of the response, so that an effect that delays has an answer too. Broyden's method (*Math. Comp.* 1965) starts from the
//! last solution with the last slope, so a tick needs one or two evaluations of the laws and never more than five. Nothing
//! allocates after [`Feedforward::new`].

use crate::control::limits::relief;
use crate::model::effects::{Memory, Moment};
use crate::model::{Bend, Chain, DescribedMachine, Shape, orientation};
use crate::primitives::Rotation;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use std::sync::Arc;

/// Times for which the inverse may hold the play outputs, s. A longer horizon leads a slow line less, and follows creep later.
const HORIZONS_S: [f64; 5] = [0.02, 0.05, 0.1, 0.2, 0.3];

crate::constants! {
    /// When the inverse is solved, and how far it goes.
    const SOLVER: SolverConstants;
    /// Least share of the response at the longest horizon that the shape must show at the one that is used.
    response_min = 0.7;
    /// Error of a bellow at which the inverse is solved, mm: 0.03° of bend.
    solved_mm = 0.002;
    /// Largest change of a bellow per evaluation, mm.
    change_max_mm = 1.0;
    /// Largest distance of the solution from the nominal one, mm of bellow: the range of a bellow. A law far outside its log is not
    /// followed further.
    correction_max_mm = 9.0;
    /// Least change of a nominal bellow per common change of length.
    part_min = 0.2;
    /// Least product, in units of the squared change, with which the slope is updated.
    slope_min = 0.05;
}

/// Probe of the response, mm of play output.
const PROBE_MM: Vector3<f64> = Vector3::new(2.0, -1.0, -1.0);
/// Largest number of evaluations per tick.
const ROUNDS: usize = 5;
/// Evaluations of the drive's inverse.
const DRIVE_ROUNDS: usize = 6;

/// Feedforward through a machine: the state of its effects, and the solution of the last tick.
#[derive(Debug, Clone)]
pub struct Feedforward {
    machine: Arc<DescribedMachine>,
    memory: Vec<Memory>,
    trial: Vec<Memory>,
    t_s: f64,
    horizon_s: f64,
    up_base: Vector3<f64>,
    /// Orientation of the described tip at rest, by which zero is defined.
    rest: UnitQuaternion<f64>,
    /// Nominal bellow lengths that give the wanted shape, mm.
    solution_mm: Vector3<f64>,
    /// Change of the solution per change of the shape, both as bellow lengths.
    slope: Matrix3<f64>,
}

impl Feedforward {
    /// At rest.
    pub fn new(machine: Arc<DescribedMachine>) -> Self {
        let memory = machine.memory();
        let up = machine.rest.up;
        let mut new = Self {
            machine,
            trial: memory.clone(),
            memory,
            t_s: 0.0,
            horizon_s: HORIZONS_S[0],
            up_base: Vector3::zeros(),
            rest: UnitQuaternion::identity(),
            solution_mm: Vector3::zeros(),
            slope: Matrix3::identity(),
        };
        new.zero(up);
        let response = HORIZONS_S.map(|horizon_s| new.held(&PROBE_MM, horizon_s).bend.0.norm());
        let last = HORIZONS_S.len() - 1;
        let enough = |r: &f64| *r >= SOLVER.response_min * response[last];
        new.horizon_s = HORIZONS_S[response.iter().position(enough).unwrap_or(last)];
        new
    }

    /// Defines zero for a base in which `up` is up.
    pub fn zero(&mut self, up: Vector3<f64>) {
        if up == self.up_base {
            return;
        }
        self.up_base = up;
        let chain = self.machine.chain();
        let at = self.moment(&chain, self.horizon_s);
        self.trial.clone_from(&self.memory);
        self.rest = orientation(&chain.pose(&mut self.trial, &at, &Vector3::zeros()));
    }

    fn moment(&self, chain: &Chain<'_>, dt_s: f64) -> Moment {
        Moment {
            t_s: self.t_s + dt_s,
            ..chain.moment(self.up_base, dt_s)
        }
    }

    /// Advances the effects by `dt_s` with the play outputs at `play_output_mm`; returns the shape there.
    pub fn advance(&mut self, play_output_mm: &Vector3<f64>, dt_s: f64) -> Shape {
        let chain = self.machine.chain();
        let at = self.moment(&chain, dt_s);
        self.t_s += dt_s;
        shape(&chain, &mut self.memory, &at, &self.rest, play_output_mm)
    }

    /// Shape once the play outputs have been held for the horizon.
    pub fn foresee(&mut self, play_output_mm: &Vector3<f64>) -> Shape {
        self.held(play_output_mm, self.horizon_s)
    }

    /// Shape once the play outputs have been held for `horizon_s`.
    fn held(&mut self, play_output_mm: &Vector3<f64>, horizon_s: f64) -> Shape {
        let chain = self.machine.chain();
        let at = self.moment(&chain, horizon_s);
        self.trial.clone_from(&self.memory);
        shape(&chain, &mut self.trial, &at, &self.rest, play_output_mm)
    }

    /// Play outputs of the nominal channels, mm, that give the `wanted` shape, itself given as bellow lengths.
    pub fn play_outputs(&mut self, wanted_mm: &Vector3<f64>) -> Vector3<f64> {
        let bellow_mm = self.invert(wanted_mm, &Vector3::repeat(f64::INFINITY));
        self.machine.play_outputs(&bellow_mm)
    }

    /// Nominal bellow lengths, mm, whose play outputs give the `wanted` shape, itself given as bellow lengths. Where one of them is beyond
    /// its `room_mm` either way, the shape has the wanted bend and another length.
    pub fn invert(&mut self, wanted_mm: &Vector3<f64>, room_mm: &Vector3<f64>) -> Vector3<f64> {
        let mut before: Option<(Vector3<f64>, Vector3<f64>)> = None;
        for _ in 0..ROUNDS {
            let shape = self.foresee(&self.machine.play_outputs(&self.solution_mm));
            let reached = self.machine.geometry.lengths(&shape);
            if let Some((solution, shape)) = before {
                self.learn_slope(&(self.solution_mm - solution), &(reached - shape));
            }
            let part = self
                .slope
                .column_sum()
                .map(|part| part.max(SOLVER.part_min));
            let next = self.solution_mm + self.slope * (wanted_mm - reached);
            let wanted_mm = wanted_mm.add_scalar(relief(&next, &part, room_mm));
            let missing = wanted_mm - reached;
            if missing.amax() < SOLVER.solved_mm {
                break;
            }
            before = Some((self.solution_mm, reached));
            let step = self.slope * missing;
            let share = (SOLVER.change_max_mm / step.amax()).min(1.0);
            let next = self.solution_mm + step * share;
            self.solution_mm = wanted_mm
                + (next - wanted_mm)
                    .map(|d| d.clamp(-SOLVER.correction_max_mm, SOLVER.correction_max_mm));
        }
        self.solution_mm
    }

    /// Broyden's update of the inverse slope; without a usable direction the nominal slope takes its place.
    fn learn_slope(&mut self, step: &Vector3<f64>, reached: &Vector3<f64>) {
        let projected = self.slope.transpose() * step;
        let product = projected.dot(reached);
        if product > SOLVER.slope_min * step.norm_squared() {
            self.slope += (step - self.slope * reached) * projected.transpose() / product;
        } else if step.norm() > SOLVER.solved_mm {
            self.slope = Matrix3::identity();
        }
    }

    /// Counted pistons that put the true pistons at `piston_mm`.
    pub fn counted(&mut self, piston_mm: &Vector3<f64>) -> Vector3<f64> {
        let mut counted = *piston_mm;
        for _ in 0..DRIVE_ROUNDS {
            counted += piston_mm - self.pistons_at(&counted);
        }
        counted
    }

    /// True pistons that counted ones would make now.
    pub fn pistons_at(&mut self, counted_mm: &Vector3<f64>) -> Vector3<f64> {
        let chain = self.machine.chain();
        let at = self.moment(&chain, 0.0);
        self.trial.clone_from(&self.memory);
        chain.pistons(&mut self.trial, &at, counted_mm)
    }

    /// True pistons for counted ones.
    pub fn pistons(&mut self, counted_mm: &Vector3<f64>) -> Vector3<f64> {
        let piston_mm = self.pistons_at(counted_mm);
        std::mem::swap(&mut self.memory, &mut self.trial);
        piston_mm
    }
}

/// Shape relative to rest, at play outputs.
fn shape(
    chain: &Chain<'_>,
    memory: &mut [Memory],
    at: &Moment,
    rest: &UnitQuaternion<f64>,
    play_output_mm: &Vector3<f64>,
) -> Shape {
    let bellow_mm = chain.bellows(memory, at, play_output_mm);
    let pose = chain.pose(memory, at, &bellow_mm);
    let tip = rest.inverse() * orientation(&pose);
    Shape::new(
        Bend::nearest(&Rotation::assert_frames(tip)).0,
        chain.geometry.rest_length_mm + bellow_mm.sum() / 3.0,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::arc::Geometry;
    use crate::model::described::RestReadings;
    use crate::model::effects::by_name;
    use crate::model::nominal_theta;
    use crate::model::transmission::Line;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    const DT_S: f64 = 0.005;

    fn machine(causes: &[(&str, &[f64])]) -> Arc<DescribedMachine> {
        let rest = RestReadings {
            up: Vector3::new(0.6, -0.3, 0.742).normalize(),
            ..RestReadings::default()
        };
        let lines = [2.1, 2.5, 2.3].map(|k_epsilon| Line {
            k_epsilon,
            k_lambda_mm: 0.9,
        });
        let causes = causes
            .iter()
            .map(|(name, p)| (by_name(name).unwrap(), p.to_vec()))
            .collect();
        let theta = nominal_theta(&lines, 0.02);
        DescribedMachine::new(Geometry::default(), rest, &theta, causes).into()
    }

    /// Bends held one after the other: the largest error at the ends of the holds, degrees, with and without the inverse.
    fn errors(machine: &Arc<DescribedMachine>) -> [f64; 2] {
        let chain = machine.chain();
        [true, false].map(|inverted| {
            let mut state = Feedforward::new(Arc::clone(machine));
            let mut worst: f64 = 0.0;
            for (bend_deg, dir_deg) in [
                (40.0, 20.0),
                (70.0, 20.0),
                (30.0, 200.0),
                (0.0, 0.0),
                (60.0, 300.0),
                (55.0, 120.0),
            ] {
                let wanted = Bend::from_deg(bend_deg, dir_deg);
                let wanted_mm = chain
                    .geometry
                    .lengths(&Shape::new(wanted.0, chain.geometry.rest_length_mm));
                let mut reached = Bend::STRAIGHT;
                for _ in 0..500 {
                    let bellow_mm = if inverted {
                        state.invert(&wanted_mm, &ANY_ROOM)
                    } else {
                        wanted_mm
                    };
                    let play_output_mm =
                        Vector3::from_fn(|i, _| chain.lines[i].play_output_mm(bellow_mm[i]));
                    reached = state.advance(&play_output_mm, DT_S).bend;
                }
                worst = worst.max((reached.0 - wanted.0).norm().to_degrees());
            }
            worst
        })
    }

    #[test]
    fn the_inverse_reaches_the_wanted_shape_through_every_kind_of_law() {
        let all: [&[(&str, &[f64])]; 4] = [
            &[("curvature", &[0.3, 0.2]), ("gravity", &[0.08, 0.8])],
            &[
                ("hysteresis", &[0.2, 0.2, 0.1, 0.1, 0.0, 0.1, -0.1]),
                ("creep", &[0.1, 0.1, 2.0]),
            ],
            &[
                ("leak", &[0.01, 0.004, 0.008, 0.5]),
                ("asymmetry", &[0.2, 0.1, 0.15]),
            ],
            &[
                ("line_lag", &[0.5, 0.4, 0.6, 0.1, 0.1]),
                ("clocking", &[0.1, -0.05, 0.08]),
            ],
        ];
        for causes in all {
            let [inverted, nominal] = errors(&machine(causes));
            assert!(nominal > 1.0, "{causes:?} disturbs by {nominal}°");
            assert!(
                inverted < 0.1,
                "{causes:?}: {inverted}° with the inverse, {nominal}° without"
            );
        }
    }

    const ANY_ROOM: Vector3<f64> = Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY);

    /// Tips that take more of a bellow than its piston has room for, at bends that lead there from any direction.
    #[test]
    fn where_a_piston_has_no_room_the_length_gives_way_and_the_pistons_come_to_rest() {
        let mut rng = StdRng::seed_from_u64(1);
        let mut relieved = 0;
        for _ in 0..60 {
            let extra: [f64; 3] = std::array::from_fn(|_| rng.random_range(0.0..0.25));
            let taut: [f64; 2] = std::array::from_fn(|_| rng.random_range(-0.1..0.1));
            let cable = [rng.random_range(0.0..0.15), 0.0, taut[0], taut[1]];
            let machine = machine(&[("stiffening", &extra), ("cable_stiffness", &cable)]);
            let mut state = Feedforward::new(Arc::clone(&machine));
            let [bend, dir] = [55.0..70.0, 0.0..360.0].map(|of| rng.random_range(of));
            let wanted = Bend::from_deg(bend, dir);
            let shape = Shape::new(wanted.0, machine.geometry.rest_length_mm);
            let wanted_mm = machine.geometry.lengths(&shape);
            let mut hold = |room_mm: &Vector3<f64>| {
                let (mut last, mut moved) = (Vector3::zeros(), 0.0);
                let mut reached = Bend::STRAIGHT;
                for tick in 0..500 {
                    let bellow_mm = state.invert(&wanted_mm, room_mm);
                    moved += f64::from(tick > 400) * (bellow_mm - last).norm();
                    last = bellow_mm;
                    reached = state.advance(&machine.play_outputs(&bellow_mm), DT_S).bend;
                }
                assert!(moved < 0.01, "the pistons go on for {moved} mm");
                (last, (reached.0 - wanted.0).norm().to_degrees())
            };
            let (needed_mm, _) = hold(&ANY_ROOM);
            let room_mm = Vector3::repeat(rng.random_range(0.7..0.95) * needed_mm.amax());
            let (bellow_mm, error_deg) = hold(&room_mm);
            // a shorter or longer tip needs about as much of the difference of its bellows
            if needed_mm.max() - needed_mm.min() < 1.9 * room_mm[0] {
                relieved += 1;
                let beyond_mm = bellow_mm.amax() - room_mm[0];
                assert!(beyond_mm < SOLVER.solved_mm, "{bellow_mm} of {room_mm}");
                assert!(error_deg < 0.1, "{error_deg}° at {bend}° toward {dir}°");
            }
        }
        assert!(relieved > 15, "{relieved} of 60 were relieved");
    }

    #[test]
    fn without_effects_the_inverse_is_the_nominal_one() {
        let mut state = Feedforward::new(machine(&[]));
        let wanted = Vector3::new(-3.0, 1.0, 2.0);
        for _ in 0..3 {
            assert!((state.invert(&wanted, &ANY_ROOM) - wanted).amax() < SOLVER.solved_mm);
        }
        assert!((state.counted(&wanted) - wanted).amax() < 1e-12);
    }

    #[test]
    fn the_pistons_of_a_periodic_gear_come_back() {
        let machine = machine(&[("gear_periodic", &[0.2, -0.1, 0.15, 0.1, 0.05, -0.1, 3.2])]);
        let mut state = Feedforward::new(machine);
        for k in 0..40 {
            let wanted = Vector3::new(0.3, -0.2, 0.4) * f64::from(k);
            let counted = state.counted(&wanted);
            assert!((state.pistons(&counted) - wanted).amax() < 0.02, "{k}");
        }
    }
}
