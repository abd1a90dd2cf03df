//! The envelope: the closed loop and the best open loop over conditions of the built-in plant.
//!
//! Every row simulates several drawn units in a short form of the schedule: four directions, 40 scored states a unit. The
//! loop has the same calibration everywhere and does not know the condition.

use crate::control::LoopConfig;
use crate::experiment::arm::{ArmResult, percentile, root_mean};
use crate::experiment::error::ExperimentError;
use crate::experiment::evaluation::Arm;
use crate::simulation::MachineError;
use crate::simulation::plant::PlantConfig;
use crate::simulation::sim::Sim;
use rayon::prelude::*;
use serde::Serialize;

/// Directions of the schedule of a row.
pub const DIRECTIONS: usize = 4;
/// Bend RMSE that is good enough even where the open loop is better, degrees.
pub const GOOD_DEG: f64 = 0.3;
/// States of a cold start, and how much one may move beyond the open loop, degrees.
const COLD_STATES: usize = 5;
const COLD_MAX_DEG: f64 = 2.5;
/// Largest permitted hunting, degrees.
const HUNTING_MAX_DEG: f64 = 0.5;
/// Time at which the wall of `contact_and_release_deg` goes away: after half of the directions, s.
const RELEASE_S: f64 = 36.0;
/// Angle between the directions of successive units, degrees: the golden angle.
pub const TURN_DEG: f64 = 137.5;

/// A condition: what it changes on a unit, and the values of its rows.
#[derive(Debug, Clone, Copy)]
pub struct Condition {
    /// Name with the unit of the value.
    pub name: &'static str,
    /// Values, mildest first.
    pub values: &'static [f64],
    /// Sets a value on a unit; the last argument turns directions from unit to unit, degrees.
    pub apply: fn(&mut PlantConfig, f64, f64),
}

/// Lists conditions: a name, the values, and what a value does to a unit whose directions are turned by an angle.
macro_rules! conditions {
    ($($name:literal: $values:expr => $set:expr;)+) => {
        [$(Condition { name: $name, values: &$values, apply: $set }),+]
    };
}

/// Every condition.
pub const CONDITIONS: [Condition; 19] = conditions! {
    "line_lag_s": [0.1, 0.25, 0.6, 1.0] => |p, v, _| p.effects.line_lag.get_or_insert_default().lag_s = [v; 3];
    "dead_time_s": [0.05, 0.12, 0.2, 0.3] => dead_time;
    "sensor_latency_s": [0.05, 0.12, 0.2, 0.3] => latency;
    "dead_time_and_latency_s": [0.1, 0.2, 0.3] => |p, v, turn| {
        dead_time(p, v / 2.0, turn);
        latency(p, v / 2.0, turn);
    };
    "motor_field_ut": [0.1, 0.3, 1.0, 3.0, 8.0, 20.0] => |p, v, turn| {
        let motors = p.effects.motor_field.get_or_insert_default();
        motors.amplitude_ut = [v; 3];
        motors.azimuth_deg = motors.azimuth_deg.map(|a| (a + turn) % 360.0);
    };
    "hard_iron_ut": [5.0, 20.0, 50.0] => |p, v, turn| {
        p.effects.hard_iron.get_or_insert_default().offset_ut = askew(v, turn);
    };
    "contact_and_release_deg": [60.0, 40.0, 20.0] => |p, v, turn| {
        let wall = p.effects.contact.get_or_insert_default();
        (wall.block, wall.at_deg, wall.direction_deg, wall.until_s) = (1.0, v, turn, RELEASE_S);
    };
    "stick_slip_mm": [0.5, 1.6, 2.6] => |p, v, _| {
        p.effects.outside.stick_slip.get_or_insert_default().breakaway_mm = v;
    };
    "respiration_deg": [1.0, 3.0, 5.0] => |p, v, turn| {
        let breath = p.effects.outside.respiration.get_or_insert_default();
        (breath.amplitude_deg, breath.direction_deg) = (v, turn);
    };
    "base_sway_deg": [1.0, 3.0, 5.0] => sway;
    "base_sway_with_imu_deg": [1.0, 3.0, 5.0] => |p, v, turn| {
        sway(p, v, turn);
        p.base.imu = true;
    };
    "torsion_deg": [5.0, 10.0, 20.0] => |p, v, _| p.effects.torsion.get_or_insert_default().twist_deg = v;
    "mount_deg": [3.0, 8.0, 15.0] => |p, v, turn| {
        p.effects.mount_misalignment.get_or_insert_default().tilt_deg = askew(v, turn);
    };
    "noise_factor": [3.0, 10.0] => |p, v, _| {
        p.imu.gyro_noise_deg_s_rthz *= v;
        p.imu.acc_noise_mg_rthz *= v;
        p.imu.mag_noise_ut *= v;
    };
    "temperature_drift_mm": [1.0, 2.0, 4.0] => |p, v, _| {
        let air = p.effects.thermal_drift.get_or_insert_default();
        (air.offset_mm, air.case_s) = ([v, -0.5 * v, -0.5 * v], 40.0);
    };
    "gyro_warm_up_deg_s": [1.0, 4.0] => |p, v, turn| {
        p.effects.gyro_bias.get_or_insert_default().warm_up_deg_s = askew(v, turn);
    };
    "gyro_wander_deg_s": [0.3] => |p, v, _| p.effects.gyro_bias.get_or_insert_default().wander_deg_s = v;
    "gyro_g_sensitivity_deg_s_per_g": [1.0] => |p, v, _| {
        p.effects.outside.g_sensitivity.get_or_insert_default().deg_s_per_g = [v, -v, v];
    };
    "gyro_scale": [0.02] => |p, v, _| p.effects.outside.gyro_scale.get_or_insert_default().share = [v, -v, v];
};

fn dead_time(p: &mut PlantConfig, s: f64, _: f64) {
    p.effects.transport_delay.get_or_insert_default().delay_s = s;
}

fn latency(p: &mut PlantConfig, s: f64, _: f64) {
    p.effects.sensor_latency.get_or_insert_default().latency_s = s;
}

fn sway(p: &mut PlantConfig, deg: f64, turn_deg: f64) {
    let base = p.effects.base_motion.get_or_insert_default();
    (base.sway_deg, base.axis) = (deg, askew(1.0, turn_deg));
}

/// A vector of length `size` that is inclined to all axes and turns about z.
fn askew(size: f64, turn_deg: f64) -> [f64; 3] {
    let (sin, cos) = turn_deg.to_radians().sin_cos();
    [0.8 * size * cos, 0.8 * size * sin, 0.6 * size]
}

/// Units and loop of a study.
#[derive(Debug, Clone)]
pub struct Study {
    /// Loop of every run.
    pub config: LoopConfig,
    /// Make of the units.
    pub make: PlantConfig,
    /// Serial number before that of the first unit.
    pub seed: u64,
    /// Number of units.
    pub units: u64,
}

/// One row of the envelope.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SweepRow {
    /// Name of the condition, with its unit.
    pub condition: &'static str,
    /// Its value.
    pub value: f64,
    /// Bend RMSE of the best of the open arms, degrees.
    pub open_deg: f64,
    /// Bend RMSE of the closed loop, degrees.
    pub closed_deg: f64,
    /// 95th percentile of the absolute bend error of a held state in the closed loop, degrees.
    pub p95_deg: f64,
    /// How much more a held state moves in the closed loop than in the best open arm, peak to peak, degrees; the largest from the
    /// sixth state after a start on.
    pub hunting_deg: f64,
    /// The same of the first five states.
    pub cold_deg: f64,
    /// Closed ≤ max(0.3°, open), hunting ≤ 0.5° and cold ≤ 2.5°.
    pub ok: bool,
}

impl Study {
    /// The unit `n` (from 0) of the study.
    pub fn unit(&self, n: u64) -> PlantConfig {
        self.make.drawn(self.seed + 1 + n)
    }

    /// The unit `n` under a condition.
    pub fn unit_under(&self, condition: &Condition, value: f64, n: u64) -> PlantConfig {
        let mut unit = self.unit(n);
        (condition.apply)(&mut unit, value, TURN_DEG * n as f64 % 360.0);
        unit
    }

    /// An arm on a unit.
    ///
    /// # Errors
    /// [`ExperimentError`] from the plant.
    pub fn run(
        &self,
        config: &LoopConfig,
        arm: Arm,
        unit: &PlantConfig,
        n: u64,
    ) -> Result<ArmResult, ExperimentError> {
        let noise = 10 * (self.seed + n) + arm as u64;
        let mut world = Sim::new(unit, 0, noise, self.make.period_s).map_err(MachineError::from)?;
        arm.run(config, &mut world, DIRECTIONS, &mut || ())
    }
}

/// Runs every row of `conditions`; `progress` is called after each unit of a row, from several threads.
///
/// # Errors
/// [`ExperimentError`] from a plant.
pub fn run(
    study: &Study,
    conditions: &[Condition],
    progress: &(dyn Fn() + Sync),
) -> Result<Vec<SweepRow>, ExperimentError> {
    let row = |&(condition, value): &(&Condition, f64)| {
        let unit = |n: u64| {
            let unit = study.unit_under(condition, value, n);
            let arms = Arm::PAPER.map(|arm| study.run(&study.config, arm, &unit, n));
            progress();
            arms.into_iter().collect::<Result<Vec<_>, _>>()
        };
        let units: Result<Vec<_>, _> = (0..study.units).into_par_iter().map(unit).collect();
        Ok(judge(condition.name, value, &units?))
    };
    rows(conditions).par_iter().map(row).collect()
}

/// Every value of every condition.
pub fn rows(conditions: &[Condition]) -> Vec<(&Condition, f64)> {
    let mut all = Vec::new();
    for condition in conditions {
        all.extend(condition.values.iter().map(|&value| (condition, value)));
    }
    all
}

/// The row of the units, each with its arms in the order of [`Arm::PAPER`].
fn judge(condition: &'static str, value: f64, units: &[Vec<ArmResult>]) -> SweepRow {
    let held = |arm: Arm| units.iter().flat_map(move |arms| &arms[arm as usize].held);
    let rmse = |arm: Arm| root_mean(held(arm).map(|h| h.bend_error_sq));
    let mut best = Arm::None;
    for arm in [Arm::Extension, Arm::Backlash] {
        best = if rmse(arm) < rmse(best) { arm } else { best };
    }
    let (open_deg, closed_deg) = (rmse(best), rmse(Arm::Closed));
    let p95_deg = percentile(held(Arm::Closed).map(|h| h.bend_error_deg.abs()), 0.95);
    let (mut hunting_deg, mut cold_deg) = (0.0f64, 0.0f64);
    for arms in units {
        let pairs = arms[Arm::Closed as usize]
            .held
            .iter()
            .zip(&arms[best as usize].held);
        for (k, (closed, open)) in pairs.enumerate() {
            let most = if k < COLD_STATES {
                &mut cold_deg
            } else {
                &mut hunting_deg
            };
            *most = most.max(closed.peak_to_peak_deg - open.peak_to_peak_deg);
        }
    }
    let ok = closed_deg <= open_deg.max(GOOD_DEG)
        && hunting_deg <= HUNTING_MAX_DEG
        && cold_deg <= COLD_MAX_DEG;
    SweepRow {
        condition,
        value,
        open_deg,
        closed_deg,
        p95_deg,
        hunting_deg,
        cold_deg,
        ok,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::arm::Held;

    /// A unit whose arms have the given errors and motions, degrees, in the order of [`Arm::PAPER`].
    fn unit(arms: [(f64, f64); 4], states: usize) -> Vec<ArmResult> {
        let held = |(error, moves): (f64, f64)| Held {
            bend_error_deg: error,
            bend_error_sq: error * error,
            peak_to_peak_deg: moves,
            ..Held::default()
        };
        Arm::PAPER
            .iter()
            .zip(arms)
            .map(|(a, figures)| ArmResult {
                name: a.name().to_owned(),
                held: (0..states)
                    .map(|k| {
                        held(if k + 1 == states {
                            figures
                        } else {
                            (figures.0, 0.0)
                        })
                    })
                    .collect(),
                ..ArmResult::default()
            })
            .collect()
    }

    #[test]
    fn a_row_fails_if_the_loop_is_worse_than_open_or_hunts() {
        let after = |states, closed| {
            judge(
                "x",
                1.0,
                &[unit([(30.0, 0.0), (8.0, 0.0), (6.0, 0.2), closed], states)],
            )
        };
        let row = |closed| after(6, closed);
        let good = row((0.4, 0.6));
        assert!(
            good.ok
                && (good.open_deg, good.closed_deg, good.p95_deg) == (6.0, 0.4, 0.4)
                && (good.hunting_deg - 0.4).abs() < 1e-12,
            "{good:?}"
        );
        assert!(!row((6.1, 0.2)).ok, "worse than open");
        assert!(!row((0.1, 0.8)).ok, "hunts");
        let cold = after(5, (0.1, 2.6));
        assert!(
            cold.ok && cold.hunting_deg == 0.0 && (cold.cold_deg - 2.4).abs() < 1e-12,
            "{cold:?}"
        );
        assert!(!after(5, (0.1, 2.8)).ok, "jumps at a cold start");
        let small = judge(
            "x",
            1.0,
            &[unit([(0.2, 0.0), (0.1, 0.0), (0.1, 0.0), (0.29, 0.0)], 1)],
        );
        assert!(small.ok, "0.3° is good enough");
    }

    #[test]
    fn every_condition_changes_a_unit_and_is_valid() {
        for c in &CONDITIONS {
            for &value in c.values {
                let mut unit = PlantConfig::default();
                (c.apply)(&mut unit, value, 137.5);
                unit.validate()
                    .unwrap_or_else(|e| panic!("{} = {value}: {e}", c.name));
                assert_ne!(unit, PlantConfig::default(), "{}", c.name);
            }
        }
    }
}
