//! Bend logs of the built-in plant.

use crate::diagnosis::exam::schedule::{self, DT_S, drive};
use crate::log::bend_log::{BendLog, ImuColumns};
use crate::model::Line;
use crate::primitives::Steps;
use crate::simulation::plant::{Plant, PlantConfig, PlantError};
use nalgebra::{UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// Plant steps per row.
const INNER: usize = 2;
/// White noise of the tracker per row and axis, degrees.
const TRACKER_DEG: f64 = 0.12;

/// Records a log of the plant on a random schedule driven with `lines`; `lab` adds the tracker.
///
/// # Errors
/// [`PlantError`] for a plant that cannot run.
pub fn record(plant: &PlantConfig, lines: &[Line; 3], seed: u64, lab: bool) -> Result<BendLog, PlantError> {
    let mut rng = StdRng::seed_from_u64(seed);
    let (path, command) = drive(&schedule::draw(&mut rng), lines, rng.random_range(8..20));
    let step_mm = plant.drive.step_mm;
    let mut tip = Plant::new(plant, rng.random())?;
    let n = path.len();
    let nan = Vector3::repeat(f64::NAN);
    let mut imus = [(); 2].map(|()| ImuColumns { acc: vec![nan; n], gyr: vec![nan; n], mag: vec![nan; n] });
    let (mut piston_mm, mut reference) = (Vec::with_capacity(n), Vec::with_capacity(n));
    for (k, p) in path.iter().enumerate() {
        let counts = Steps([p.x, p.y, p.z].map(|x| (x / step_mm).round() as i32));
        let mut last = None;
        for _ in 0..INNER {
            let out = tip.step(&counts, DT_S / INNER as f64);
            for (imu, sample) in imus.iter_mut().zip([out.imu, out.base_imu]) {
                if let Some(s) = sample {
                    (imu.acc[k], imu.gyr[k], imu.mag[k]) = (s.acc_m_s2, s.gyro_rad_s, s.mag_ut.unwrap_or(nan));
                }
            }
            last = Some(out.truth.r_base_tip.quat());
        }
        piston_mm.push(Vector3::from(counts.0.map(f64::from)) * step_mm);
        let noise = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal)) * TRACKER_DEG.to_radians();
        reference.push(last.map(|q| q * UnitQuaternion::from_scaled_axis(noise)));
    }
    let [imu, base] = imus;
    Ok(BendLog {
        file: "exam".to_owned(),
        t_s: (1..=n).map(|k| k as f64 * DT_S).collect(),
        command,
        piston_mm,
        imu: Some(imu),
        base: plant.base.imu.then_some(base),
        reference: lab.then_some(reference),
        ..BendLog::default()
    })
}
