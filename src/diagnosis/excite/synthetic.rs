//! The log that a schedule would give on a nominal machine: what distances are taken against.

use crate::diagnosis::excite::rows::{Driven, Rig};
use crate::diagnosis::observe::{G_M_S2, Observed, Unfit};
use crate::log::bend_log::{BendLog, ImuColumns};
use nalgebra::{UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Rate of the synthetic log: the diagnosis takes bins of 50 ms.
pub const PERIOD_S: f64 = 0.05;
/// Mechanical lag of the nominal machine, s.
const LAG_S: f64 = 0.025;
/// Up in the base frame: a base that lies askew, so that nothing is symmetric by accident.
const UP: Vector3<f64> = Vector3::new(-0.55, 0.35, 0.758);
/// Field in the base frame, µT.
const FIELD_UT: Vector3<f64> = Vector3::new(21.0, -17.0, -38.0);
/// White noise of a sample: m/s², rad/s, µT, and rad of the tracker.
const NOISE: [f64; 4] = [0.04, 0.004, 0.5, 0.002];

/// The log of `driven` on the nominal machine, as an IMU (and a tracker, if there is one) sees it.
///
/// # Errors
/// [`Unfit`], if the schedule is too short or too still to be diagnosed at all.
pub fn observed(rig: &Rig, driven: &Driven, tracker: bool, seed: u64) -> Result<Observed, Unfit> {
    let mut rng = StdRng::seed_from_u64(seed);
    let tips = tips(rig, driven);
    let mut noise = |size: f64| Vector3::from_fn(|_, _| size * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>());
    let up = UP.normalize() * G_M_S2;
    let mut imu = ImuColumns { acc: vec![], gyr: vec![], mag: vec![] };
    let mut reference = Vec::new();
    for (k, r) in tips.iter().enumerate() {
        let turn = if k == 0 { Vector3::zeros() } else { (tips[k - 1].inverse() * r).scaled_axis() / PERIOD_S };
        imu.acc.push(r.inverse() * up + noise(NOISE[0]));
        imu.gyr.push(turn + noise(NOISE[1]));
        imu.mag.push(r.inverse() * FIELD_UT + noise(NOISE[2]));
        reference.push(Some(r * UnitQuaternion::from_scaled_axis(noise(NOISE[3]))));
    }
    Observed::new(&BendLog {
        file: String::new(),
        t_s: driven.t_s.clone(),
        command: vec![Vector3::repeat(f64::NAN); driven.t_s.len()],
        piston_mm: driven.piston_mm.clone(),
        imu: Some(imu),
        base: None,
        reference: tracker.then_some(reference),
        pressure_kpa: None,
        temp_c: None,
        ignored: vec![],
    })
}

/// Pistons → play → extension → lag → constant curvature.
fn tips(rig: &Rig, driven: &Driven) -> Vec<UnitQuaternion<f64>> {
    let (mut w_mm, mut q_mm) = (Vector3::zeros(), Vector3::zeros());
    let keep = (-PERIOD_S / LAG_S).exp();
    let one = |u: &Vector3<f64>| {
        w_mm = Vector3::from_fn(|i, _| rig.lines[i].play(w_mm[i], u[i]));
        let to = Vector3::from_fn(|i, _| rig.lines[i].bellow_mm(w_mm[i]));
        q_mm = to + (q_mm - to) * keep;
        rig.geometry.shape(&q_mm).bend.rotation().quat()
    };
    driven.piston_mm.iter().map(one).collect()
}
