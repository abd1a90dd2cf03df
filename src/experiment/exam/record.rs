//! Bend logs of a simulated machine on random schedules.

use crate::diagnosis::excite::standard::tour;
use crate::diagnosis::excite::{ScheduleRow, rounded};
use crate::log::bend_log::{BendLog, ImuColumns};
use crate::model::{Drive, Geometry, Line};
use crate::simulation::MachineError;
use crate::simulation::world::World;
use nalgebra::{UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use std::iter::repeat_n;

/// Time between rows, s.
const DT_S: f64 = 0.01;
/// Period of the built-in plant while it is recorded, s.
pub const PERIOD_S: f64 = DT_S / 2.0;
/// White noise of the tracker per row and axis, degrees.
const TRACKER_DEG: f64 = 0.12;

/// Records a log of the machine that `machine` makes from the seed of its noise, on a random schedule driven with `lines`; `lab` adds
/// the tracker.
///
/// # Errors
/// [`MachineError`] for a machine that cannot be made or fails.
pub fn record<W: World>(
    machine: impl FnOnce(u64) -> Result<W, MachineError>,
    lines: &[Line; 3],
    seed: u64,
    lab: bool,
) -> Result<BendLog, MachineError> {
    let mut rng = StdRng::seed_from_u64(seed);
    let (path, command) = drive(&schedule(&mut rng), lines, rng.random_range(8..20));
    let mut tip = machine(rng.random())?;
    let (step_mm, period_s) = (tip.info().step_mm, tip.info().period_s);
    let rack = Drive { step_mm };
    let periods = (DT_S / period_s).round().max(1.0) as usize;
    let (n, nan) = (path.len(), Vector3::repeat(f64::NAN));
    let mut imus = [(); 2].map(|()| ImuColumns {
        acc: vec![nan; n],
        gyr: vec![nan; n],
        mag: vec![nan; n],
    });
    let (mut piston_mm, mut reference) = (Vec::with_capacity(n), Vec::with_capacity(n));
    let mut before = Vector3::zeros();
    for (k, p) in path.iter().enumerate() {
        let mut last = None;
        for part in 1..=periods {
            let out = tip.step(&rack.steps(&before.lerp(p, part as f64 / periods as f64)))?;
            for (imu, sample) in imus.iter_mut().zip([out.imu, out.base_imu]) {
                if let Some(s) = sample {
                    (imu.acc[k], imu.gyr[k], imu.mag[k]) =
                        (s.acc_m_s2, s.gyro_rad_s, s.mag_ut.unwrap_or(nan));
                }
            }
            last = out.truth.map(|r| r.quat());
        }
        piston_mm.push(rack.piston_mm(&rack.steps(p)));
        let noise = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal))
            * TRACKER_DEG.to_radians();
        before = *p;
        reference.push(last.map(|q| q * UnitQuaternion::from_scaled_axis(noise)));
    }
    let [imu, base] = imus;
    Ok(BendLog {
        file: "exam".to_owned(),
        t_s: (1..=n).map(|k| k as f64 * DT_S).collect(),
        command,
        piston_mm,
        imu: Some(imu),
        base: base.acc.iter().any(|a| !a.x.is_nan()).then_some(base),
        reference: lab.then_some(reference),
        ..BendLog::default()
    })
}

/// A random schedule of about 250 s: a tour of directions at increasing bends, ladders out and back at several lengths, sweeps around the
/// cone, long holds with a return to rest between them, and quick moves.
fn schedule(rng: &mut StdRng) -> Vec<ScheduleRow> {
    let row = ScheduleRow::new;
    let rest = |hold_s| row(0.0, 0.0, 20.0, hold_s, 20.0);
    let mut out = vec![rest(4.0)];
    let top = rng.random_range(68.0..78.0);
    let turn = rng.random_range(0.0..60.0);
    out.extend(tour().map(|(bend, d)| row(bend, d + turn, 20.0, rng.random_range(0.3..0.8), 20.0)));
    out.push(rest(1.0));
    let mut directions: Vec<f64> = (0..12).map(|k| f64::from(k) * 30.0 + turn).collect();
    directions.shuffle(rng);
    for (n, d) in directions.iter().take(8).enumerate() {
        let len = 20.0 + [0.0, 1.5, 3.0][n % 3];
        let steps = [0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.4, 0.2];
        out.extend(steps.map(|s| row(top * s, *d, len, 0.5, rng.random_range(14.0..26.0))));
    }
    for (bend, speed, back) in [(45.0, 8.0, false), (60.0, 24.0, true)] {
        let way = |k: i32| f64::from(if back { -k } else { k }) * 15.0 + turn;
        let hold_s = |k: i32| if k == 0 { 0.6 } else { 0.0 };
        out.extend((0..=24).map(|k| row(bend, way(k), 20.0, hold_s(k), speed)));
    }
    for _ in 0..3 {
        let d = directions[rng.random_range(0..12)];
        let [share, longer, hold] = [0.6..1.0, 0.0..3.0, 7.0..14.0].map(|of| rng.random_range(of));
        out.push(row(share * top, d, 20.0 + longer, hold, 20.0));
        out.push(rest(rng.random_range(2.0..6.0)));
    }
    for _ in 0..10 {
        let d = directions[rng.random_range(0..12)];
        let [bend, hold, speed] = [10.0..top, 0.2..1.0, 10.0..30.0].map(|of| rng.random_range(of));
        out.push(row(bend, d, 20.0, hold, speed));
    }
    out.push(rest(4.0));
    out
}

/// Counted pistons row by row, mm, and the commanded bend, direction and length. The pistons follow Eq. 16 with the calibration on straight
/// lines at the speed of the fastest piston, with rounded corners.
fn drive(
    rows: &[ScheduleRow],
    lines: &[Line; 3],
    rounding: usize,
) -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
    let geometry = Geometry::default();
    let [mut at, mut play_output, mut side] = [Vector3::zeros(); 3];
    let (mut path, mut command) = (Vec::new(), Vec::new());
    for row in rows {
        let q = row.lengths(&geometry);
        let want = Vector3::from_fn(|i, _| lines[i].play_output_mm(q[i]));
        for i in 0..3 {
            let ahead: f64 = want[i] - play_output[i];
            if ahead.abs() > 0.02 {
                side[i] = ahead.signum();
            }
        }
        play_output = want;
        let to = Vector3::from_fn(|i, _| want[i] + lines[i].k_lambda_mm * side[i]);
        let moving = ((to - at).amax() / row.speed_mm_s / DT_S).ceil().max(1.0) as usize;
        let still = (row.hold_s / DT_S) as usize;
        path.extend((1..=moving).map(|k| at + (to - at) * (k as f64 / moving as f64)));
        path.extend(repeat_n(to, still));
        let pose = Vector3::new(row.bend_deg, row.dir_deg, row.len_mm);
        command.extend(repeat_n(pose, moving + still));
        at = to;
    }
    (rounded(&path, rounding), command)
}
