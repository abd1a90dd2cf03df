//! Bend logs of a simulated machine.

use crate::diagnosis::exam::schedule;
use crate::diagnosis::exam::{DT_S, drive};
use crate::log::bend_log::{BendLog, ImuColumns};
use crate::model::Line;
use crate::primitives::Steps;
use crate::simulation::world::World;
use crate::supervisor::MachineError;
use nalgebra::{UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

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
    let (path, command) = drive(&schedule::draw(&mut rng), lines, rng.random_range(8..20));
    let mut tip = machine(rng.random())?;
    let (step_mm, periods) = (
        tip.info().step_mm,
        (DT_S / tip.info().period_s).round().max(1.0) as usize,
    );
    let n = path.len();
    let nan = Vector3::repeat(f64::NAN);
    let mut imus = [(); 2].map(|()| ImuColumns {
        acc: vec![nan; n],
        gyr: vec![nan; n],
        mag: vec![nan; n],
    });
    let (mut piston_mm, mut reference) = (Vec::with_capacity(n), Vec::with_capacity(n));
    let counted = |p: Vector3<f64>| Steps([p.x, p.y, p.z].map(|x| (x / step_mm).round() as i32));
    let mut before = Vector3::zeros();
    for (k, p) in path.iter().enumerate() {
        let mut last = None;
        for part in 1..=periods {
            let out = tip.step(&counted(before.lerp(p, part as f64 / periods as f64)))?;
            for (imu, sample) in imus.iter_mut().zip([out.imu, out.base_imu]) {
                if let Some(s) = sample {
                    (imu.acc[k], imu.gyr[k], imu.mag[k]) =
                        (s.acc_m_s2, s.gyro_rad_s, s.mag_ut.unwrap_or(nan));
                }
            }
            last = out.truth.map(|r| r.quat());
        }
        piston_mm.push(Vector3::from(counted(*p).0.map(f64::from)) * step_mm);
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
