//! How many held poses the gains of a new unit need: the paper's scheme beside a calibration with the gains of a fleet as prior.
//!
//! Prints a JSON object: for each kind of unit the number of poses of the paper's scheme, and the largest error of any k_ε over all
//! units after 6, 12 and 24 poses with the prior, relative to 120 poses of the same unit without one.
#![allow(
    clippy::unwrap_used,
    reason = "a measurement that may stop at the first error"
)]

#[path = "../../tests/common/mod.rs"]
mod common;

use common::{plain, uncalibrated, unit};
use rayon::prelude::*;
use retroflex::control::learning::batch::Prior;
use retroflex::control::learning::identify::Identified;
use retroflex::experiment::evaluation::for_world;
use retroflex::experiment::identify::algorithm_1;
use retroflex::experiment::schedule::{Pose, paper, short};
use retroflex::model::transmission::Line;
use retroflex::simulation::sim::Sim;
use serde_json::json;

/// Units that make the prior, and units that are scored.
const FLEET: std::ops::Range<u64> = 1000..1012;
const SCORED: std::ops::Range<u64> = 1..11;
/// Poses of the short calibrations.
const POSES: [usize; 3] = [6, 12, 24];

fn identify(mut world: Sim, poses: &[Pose], prior: Option<&[Prior; 3]>) -> Identified {
    let config = for_world(&uncalibrated(), &world);
    algorithm_1(&config, &mut world, poses, prior, &mut |_| ()).unwrap()
}

/// Median and robust standard deviation.
fn spread(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let median = |mut all: Vec<f64>| {
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    let values: Vec<f64> = values.collect();
    let middle = median(values.clone());
    [
        middle,
        1.4826 * median(values.iter().map(|x| (x - middle).abs()).collect()),
    ]
}

fn main() {
    for (name, open) in [("plain", plain as fn(u64, u64) -> Sim), ("twin", unit)] {
        let fleet: Vec<[Line; 3]> = FLEET
            .into_par_iter()
            .map(|seed| identify(open(seed, 0), &paper(), None).lines())
            .collect();
        let prior: [Prior; 3] = std::array::from_fn(|i| {
            let [k_epsilon, k_epsilon_sigma] = spread(fleet.iter().map(|lines| lines[i].k_epsilon));
            let [k_lambda_mm, k_lambda_sigma_mm] =
                spread(fleet.iter().map(|lines| lines[i].k_lambda_mm));
            Prior {
                line: Line {
                    k_epsilon,
                    k_lambda_mm,
                },
                k_epsilon_sigma,
                k_lambda_sigma_mm,
            }
        });
        let alone = prior.map(|p| Prior {
            k_epsilon_sigma: 1e3,
            k_lambda_sigma_mm: 1e3,
            ..p
        });
        let one = |seed: u64| {
            let found = identify(open(seed, 60), &paper(), None);
            let full = identify(open(seed, 60), &paper(), Some(&alone)).lines();
            let worst = POSES.map(|poses| {
                let brief = identify(open(seed, 60), &short(poses), Some(&prior)).lines();
                (0..3)
                    .map(|i| (brief[i].k_epsilon / full[i].k_epsilon - 1.0).abs())
                    .fold(0.0, f64::max)
            });
            ((found.history.len() - 1) * paper().len(), worst)
        };
        let (paper_poses, errors): (Vec<usize>, Vec<[f64; 3]>) =
            SCORED.into_par_iter().map(one).unzip();
        let worst: [f64; 3] =
            std::array::from_fn(|k| errors.iter().map(|e| e[k]).fold(0.0, f64::max));
        println!(
            "{}",
            json!({"units": name, "paper_poses": paper_poses, "poses": POSES, "worst": worst})
        );
    }
}
