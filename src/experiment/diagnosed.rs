//! The arm `diagnosed`: a log of the standard schedule on a world of its own, and the machine that its diagnosis describes.

use crate::control::LoopConfig;
use crate::diagnosis::excite::{Machine, rounded, standard};
use crate::diagnosis::tip::fit::best_predicting;
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::{Rig, recalibrated};
use crate::experiment::error::ExperimentError;
use crate::log::bend_log::{BendLog, ImuColumns};
use crate::model::DescribedMachine;
use crate::simulation::world::World;
use crate::supervisor::MachineError;
use nalgebra::Vector3;

/// Time of a row of the log, s.
const ROW_S: f64 = 0.02;
/// Time over which the corners of the path are rounded, s.
const ROUNDED_S: f64 = 0.12;

/// Records a log with the gains of `config` and describes the machine. The reference of the world is not used. The search for
/// the smallest set that explains the log, which names causes, is left out: a feedforward needs the set that predicts best.
///
/// # Errors
/// [`ExperimentError`] from the world, or if the log cannot be diagnosed.
pub fn described(
    config: &LoopConfig,
    rig: &Rig,
    world: &mut dyn World,
) -> Result<DescribedMachine, ExperimentError> {
    let rig = Rig {
        geometry: config.geometry,
        ..*rig
    };
    let log = record(config, &rig, world)?;
    let log = Observed::new(&log, &rig)?;
    let nominal = recalibrated(&log, &config.lines);
    let found = best_predicting(&log, &nominal, &nominal);
    let theta = &found.theta;
    let causes = found.model.each(theta).map(|(e, p)| (e, p.to_vec()));
    let machine = DescribedMachine::new(rig.geometry, log.rest(), theta, causes.collect());
    Ok(machine.foreseeable())
}

/// Drives the standard schedule in open loop and records pistons and tip IMU, each row a mean over 20 ms.
///
/// # Errors
/// The world's.
pub fn record(
    config: &LoopConfig,
    rig: &Rig,
    world: &mut dyn World,
) -> Result<BendLog, MachineError> {
    let machine = Machine::new(*rig, config.lines);
    let mut rows = standard::rows(&machine);
    rows.retain(|r| machine.reaches(r));
    let period_s = world.info().period_s;
    let of = |time_s: f64| ((time_s / period_s).round() as usize).max(1);
    let path = rounded(&machine.drive(&rows, period_s).piston_mm, of(ROUNDED_S));
    let nan = Vector3::repeat(f64::NAN);
    let mut log = BendLog::default();
    let (mut acc, mut gyr, mut mag) = (vec![], vec![], vec![]);
    for (n, row) in path.chunks_exact(of(ROW_S)).enumerate() {
        let (mut sums, mut samples) = ([Vector3::zeros(); 3], [0.0; 3]);
        let mut piston = Vector3::zeros();
        for at in row {
            let counts = config.drive.steps(at);
            piston += config.drive.piston_mm(&counts);
            let Some(sample) = world.step(&counts)?.imu else {
                continue;
            };
            let sample = config.imu.apply(&sample);
            let (acc, gyr) = (Some(sample.acc_m_s2), Some(sample.gyro_rad_s));
            for (k, value) in [acc, gyr, sample.mag_ut].into_iter().enumerate() {
                if let Some(value) = value {
                    (sums[k], samples[k]) = (sums[k] + value, samples[k] + 1.0);
                }
            }
        }
        for (k, column) in [&mut acc, &mut gyr, &mut mag].into_iter().enumerate() {
            let any = samples[k] > 0.0;
            column.push(if any { sums[k] / samples[k] } else { nan });
        }
        // the mean of the times of a row
        let middle = (n * row.len()) as f64 + 0.5 * (row.len() + 1) as f64;
        log.t_s.push(middle * period_s);
        log.piston_mm.push(piston / row.len() as f64);
        log.command.push(nan);
    }
    log.imu = Some(ImuColumns { acc, gyr, mag });
    Ok(log)
}
