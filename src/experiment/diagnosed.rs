//! The arm `diagnosed`: a log of the standard schedule on a world of its own, and the machine that its diagnosis describes.

use crate::control::LoopConfig;
use crate::diagnosis::excite::{Machine, ScheduleRow, standard};
use crate::diagnosis::tip::fit::best_predicting;
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::{self as diagnosis, recalibrated};
use crate::experiment::error::ExperimentError;
use crate::experiment::rig::Rig;
use crate::log::bend_log::{BendLog, ImuColumns};
use crate::model::{Bend, DescribedMachine, Shape};
use crate::simulation::Sensed;
use crate::simulation::world::World;
use nalgebra::Vector3;

/// Time of a row of the log, s.
const ROW_S: f64 = 0.02;

/// Records a log with the gains of `config` and describes the machine. The reference of the world is not used. The search for
/// the smallest set that explains the log, which names causes, is left out: a feedforward needs the set that predicts best.
///
/// # Errors
/// [`ExperimentError`] from the world, or if the log cannot be diagnosed.
pub fn described(
    config: &LoopConfig,
    rig: &diagnosis::Rig,
    world: &mut dyn World,
) -> Result<DescribedMachine, ExperimentError> {
    let rig = diagnosis::Rig {
        geometry: config.geometry,
        ..*rig
    };
    let log = record(config, &rig, world)?;
    let log = Observed::new(&log, &rig)?;
    let nominal = recalibrated(&log, &config.lines);
    let found = best_predicting(&log, &nominal, &nominal);
    let theta = &found.theta;
    let causes = found.model.each(theta).map(|(e, p)| (e, p.to_vec()));
    let rest = log.segments[0].rest;
    let machine = DescribedMachine::new(rig.geometry, rest, theta, causes.collect());
    Ok(machine.foreseeable())
}

/// Drives the standard schedule in closed loop, as `play` does, and records pistons and tip IMU, each row a mean over 20 ms. Feedback takes
/// the tip to the poses for which the feedforward is asked later; from an open loop that falls short, laws would have to be extrapolated.
///
/// # Errors
/// [`ExperimentError`] from the world or the alignment.
pub fn record(
    config: &LoopConfig,
    rig: &diagnosis::Rig,
    world: &mut dyn World,
) -> Result<BendLog, ExperimentError> {
    let machine = Machine::new(*rig, config.lines);
    let k_epsilon = config.lines.map(|line| line.k_epsilon);
    let mut bench = Rig::new(config.clone(), world);
    bench.align()?;
    let usual = config.bend_pace.speed;
    let mut log = BendLog {
        imu: Some(ImuColumns::default()),
        ..BendLog::default()
    };
    let mut mean = Mean::default();
    let mut before = ScheduleRow::rest(0.0, &rig.geometry);
    let rows = standard::rows(&machine).into_iter();
    for row in rows.filter(|r| machine.reaches(r)) {
        let (seconds, speed_deg_s) = row.segment(&before, &rig.geometry, k_epsilon);
        bench.config.bend_pace.speed = speed_deg_s.map_or(usual, f64::to_radians);
        let bend = Bend::from_deg(row.bend_deg, row.dir_deg).0;
        let mut command = Some(Shape::new(bend, row.len_mm));
        let ticks = ((seconds + row.hold_s) / bench.period_s()).round() as usize;
        for _ in 0..ticks {
            let (_, sensed) = bench.advance(command.take())?;
            mean.add(config, &sensed);
            if mean.ticks * bench.period_s() >= ROW_S - bench.period_s() / 2.0 {
                std::mem::take(&mut mean).write(&mut log);
            }
        }
        before = row;
    }
    Ok(log)
}

/// Sums of what becomes one row of the log.
#[derive(Default)]
struct Mean {
    ticks: f64,
    t_s: f64,
    piston_mm: Vector3<f64>,
    /// Specific force, rate and field, each with the number of its samples.
    imu: [(Vector3<f64>, f64); 3],
}

impl Mean {
    fn add(&mut self, config: &LoopConfig, sensed: &Sensed) {
        self.ticks += 1.0;
        self.t_s += sensed.t.0;
        self.piston_mm += config.drive.piston_mm(&sensed.counted);
        let Some(sample) = sensed.imu.sample() else {
            return;
        };
        let sample = config.imu.apply(sample);
        let values = [
            Some(sample.acc_m_s2),
            Some(sample.gyro_rad_s),
            sample.mag_ut,
        ];
        for ((sum, n), value) in self.imu.iter_mut().zip(values) {
            if let Some(value) = value {
                (*sum, *n) = (*sum + value, *n + 1.0);
            }
        }
    }

    fn write(self, log: &mut BendLog) {
        log.t_s.push(self.t_s / self.ticks);
        log.piston_mm.push(self.piston_mm / self.ticks);
        if let Some(imu) = &mut log.imu {
            let columns = [&mut imu.acc, &mut imu.gyr, &mut imu.mag];
            for (column, (sum, n)) in columns.into_iter().zip(self.imu) {
                // of no samples, the mean is not a number
                column.push(sum / n);
            }
        }
    }
}
