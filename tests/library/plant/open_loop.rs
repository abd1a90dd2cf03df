//! A small independent implementation of the paper's open-loop experiment: schedule, feedforward, Algorithm 1.
//!
//! It uses the true bend in place of the paper's tracker, and of the product only the kinematic and transmission laws.

use nalgebra::{Matrix2, Vector2, Vector3};
use retroflex::model::arc::{Geometry, Shape};
use retroflex::model::bend::Bend;
use retroflex::model::drive::Drive;
use retroflex::model::transmission::{Line, Side, SideState};
use retroflex::primitives::units::Mm;
use retroflex::simulation::plant::{Output, Plant, PlantConfig};

const DT_S: f64 = 0.002;
const HOLD_S: f64 = 1.5;
const SCORED_S: f64 = 0.3;
const SPEED_MM_S: f64 = 20.0;
/// Travel since the last reversal after which a channel's side is known, mm.
const SIDE_TRAVEL_MM: f64 = 2.2;

/// 12 directions, out and back over five angles.
pub fn paper_states() -> Vec<(f64, f64)> {
    let angles = [15.0, 30.0, 45.0, 60.0, 75.0, 75.0, 60.0, 45.0, 30.0, 15.0];
    (0..12)
        .flat_map(|d| angles.map(|a| (a, 30.0 * f64::from(d))))
        .collect()
}

/// Compensation in use.
#[derive(Clone, Copy, PartialEq)]
pub enum Arm {
    None,
    Extension,
    Backlash,
}

/// A plant driven open loop.
pub struct Bench {
    plant: Plant,
    drive: Drive,
    geometry: Geometry,
    piston_mm: Vector3<f64>,
    sides: [SideState; 3],
    pushed: [f64; 3],
    travel_mm: [f64; 3],
}

/// One held state.
pub struct Held {
    pub error_sq_deg: f64,
    pub bend: Bend,
}

impl Bench {
    pub fn new(config: &PlantConfig, seed: u64) -> Self {
        let plant = Plant::new(config, seed).unwrap();
        let drive = Drive {
            step_mm: config.drive.step_mm,
        };
        let mut bench = Self {
            plant,
            drive,
            geometry: Geometry::default(),
            piston_mm: Vector3::zeros(),
            sides: Default::default(),
            pushed: [0.0; 3],
            travel_mm: [0.0; 3],
        };
        bench.run(&Vector3::zeros(), 2.5, |_| {});
        bench
    }

    /// Moves the pistons straight to `to_mm` and holds them until `total_s` are over.
    pub fn run(&mut self, to_mm: &Vector3<f64>, total_s: f64, mut see: impl FnMut(&Output)) {
        let from = self.piston_mm;
        let duration = (to_mm - from).amax() / SPEED_MM_S;
        for k in 1..=(total_s / DT_S).round() as usize {
            let share = if duration > 0.0 {
                (k as f64 * DT_S / duration).min(1.0)
            } else {
                1.0
            };
            self.push(&from.lerp(to_mm, share));
            see(&self.plant.step(&self.drive.steps(&self.piston_mm), DT_S));
        }
    }

    fn push(&mut self, to_mm: &Vector3<f64>) {
        for i in 0..3 {
            let step = to_mm[i] - self.piston_mm[i];
            if step * self.pushed[i] < 0.0 || (self.pushed[i] == 0.0 && step != 0.0) {
                (self.pushed[i], self.travel_mm[i]) = (step.signum(), 0.0);
            }
            self.travel_mm[i] += step.abs();
        }
        self.piston_mm = *to_mm;
    }

    fn feedforward(&mut self, bend: &Bend, lines: &[Line; 3], arm: Arm) -> Vector3<f64> {
        let q = self.geometry.lengths(&Shape {
            bend: *bend,
            length: Mm(self.geometry.rest_length_mm),
        });
        Vector3::from_fn(|i, _| match arm {
            Arm::None => q[i],
            Arm::Extension => lines[i].play_output_mm(q[i]),
            Arm::Backlash => {
                let (u, next) =
                    Side::Band { band_mm: 0.05 }.invert(&lines[i], self.sides[i], q[i], DT_S);
                self.sides[i] = next;
                u
            }
        })
    }

    /// Holds one pose and scores it.
    pub fn hold(&mut self, want_deg: f64, dir_deg: f64, lines: &[Line; 3], arm: Arm) -> Held {
        let target = self.feedforward(&Bend::from_deg(want_deg, dir_deg), lines, arm);
        let (mut k, mut n, mut sq, mut bend) = (0, 0.0, 0.0, Vector2::zeros());
        let scored_from = ((HOLD_S - SCORED_S) / DT_S).round() as usize;
        self.run(&target, HOLD_S, |out| {
            k += 1;
            if k > scored_from {
                let b = Bend::from_rotation(&out.truth.r_base_tip);
                let error = want_deg - b.beta().to_degrees();
                (n, sq, bend) = (n + 1.0, sq + error * error, bend + b.0);
            }
        });
        Held {
            error_sq_deg: sq / n,
            bend: Bend(bend / n),
        }
    }
}

/// All 120 states on a fresh plant.
pub fn arm(config: &PlantConfig, seed: u64, lines: &[Line; 3], arm: Arm) -> Vec<Held> {
    let mut bench = Bench::new(config, seed);
    paper_states()
        .into_iter()
        .map(|(b, d)| bench.hold(b, d, lines, arm))
        .collect()
}

/// Root mean square of desired − true bend, degrees.
pub fn rmse(held: &[Held]) -> f64 {
    (held.iter().map(|h| h.error_sq_deg).sum::<f64>() / held.len() as f64).sqrt()
}

/// Algorithm 1 from zero on a plant of its own; gains and passes taken.
pub fn identify(config: &PlantConfig, seed: u64) -> ([Line; 3], usize) {
    let mut bench = Bench::new(config, seed);
    let mut lines = [Line {
        k_epsilon: 0.0,
        k_lambda_mm: 0.0,
    }; 3];
    for pass in 1..=12 {
        let mut normal = [Matrix2::zeros(); 3];
        let mut rhs = [Vector2::zeros(); 3];
        for (b, d) in paper_states() {
            let held = bench.hold(b, d, &lines, Arm::Backlash);
            let q = bench.geometry.lengths(&Shape {
                bend: held.bend,
                length: Mm(bench.geometry.rest_length_mm),
            });
            for i in (0..3).filter(|&i| bench.travel_mm[i] > SIDE_TRAVEL_MM) {
                let a = Vector2::new(q[i], bench.pushed[i]);
                normal[i] += a * a.transpose();
                rhs[i] += a * (bench.piston_mm[i] - q[i]);
            }
        }
        let next = [0, 1, 2].map(|i: usize| {
            let k = normal[i]
                .try_inverse()
                .expect("out and back over five angles fix both gains")
                * rhs[i];
            Line {
                k_epsilon: k.x,
                k_lambda_mm: k.y.max(0.0),
            }
        });
        let (moved, size) = (
            distance(&next, &lines),
            distance(
                &lines,
                &[Line {
                    k_epsilon: 0.0,
                    k_lambda_mm: 0.0,
                }; 3],
            ),
        );
        lines = next;
        if size > 0.0 && moved / size < 0.02 {
            return (lines, pass);
        }
    }
    (lines, 12)
}

fn distance(a: &[Line; 3], b: &[Line; 3]) -> f64 {
    let sq = |x: &Line, y: &Line| {
        (x.k_epsilon - y.k_epsilon).powi(2) + (x.k_lambda_mm - y.k_lambda_mm).powi(2)
    };
    a.iter().zip(b).map(|(x, y)| sq(x, y)).sum::<f64>().sqrt()
}
