//! The log of a schedule on the nominal machine, relative to which distances are computed.

use crate::diagnosis::excite::Machine;
use crate::diagnosis::tip::observed::{BIN_S, G_M_S2, ObserveError, Observed};
use crate::log::bend_log::{BendLog, ImuColumns};
use nalgebra::{UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Period of the synthetic log, s: one row per bin.
pub const PERIOD_S: f64 = BIN_S;
/// Up in the base frame: a tilted base, so that no symmetry hides an effect.
const UP: Vector3<f64> = Vector3::new(-0.55, 0.35, 0.758);
/// Field in the base frame, µT.
const FIELD_UT: Vector3<f64> = Vector3::new(21.0, -17.0, -38.0);
/// White noise of a sample: m/s², rad/s, µT, and rad for the tracker.
const NOISE: [f64; 4] = [0.04, 0.004, 0.5, 0.002];

/// The log of these pistons on the nominal machine with an IMU and, if asked for, a tracker.
///
/// # Errors
/// [`ObserveError`] if the schedule is too short or moves too little to be diagnosed.
pub fn observed(
    machine: &Machine,
    piston_mm: Vec<Vector3<f64>>,
    tracker: bool,
    seed: u64,
) -> Result<Observed, ObserveError> {
    let mut rng = StdRng::seed_from_u64(seed);
    let tips = tips(machine, &piston_mm);
    let mut noise = |size: f64| {
        Vector3::from_fn(|_, _| size * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>())
    };
    let up = UP.normalize() * G_M_S2;
    let mut imu = ImuColumns::default();
    let mut reference = Vec::new();
    for (k, r) in tips.iter().enumerate() {
        let turn = match k {
            0 => Vector3::zeros(),
            _ => (tips[k - 1].inverse() * r).scaled_axis() / PERIOD_S,
        };
        imu.acc.push(r.inverse() * up + noise(NOISE[0]));
        imu.gyr.push(turn + noise(NOISE[1]));
        imu.mag.push(r.inverse() * FIELD_UT + noise(NOISE[2]));
        reference.push(Some(r * UnitQuaternion::from_scaled_axis(noise(NOISE[3]))));
    }
    let log = BendLog {
        t_s: (1..=tips.len()).map(|k| PERIOD_S * k as f64).collect(),
        piston_mm,
        imu: Some(imu),
        reference: tracker.then_some(reference),
        ..BendLog::default()
    };
    Observed::new(&log, &machine.rig)
}

/// Pistons → play → extension → lag → constant curvature.
fn tips(machine: &Machine, piston_mm: &[Vector3<f64>]) -> Vec<UnitQuaternion<f64>> {
    let (mut w_mm, mut q_mm) = (Vector3::zeros(), Vector3::zeros());
    let keep = (-PERIOD_S / machine.rig.prior_lag_s).exp();
    let one = |u: &Vector3<f64>| {
        w_mm = Vector3::from_fn(|i, _| machine.lines[i].play(w_mm[i], u[i]));
        let to = Vector3::from_fn(|i, _| machine.lines[i].bellow_mm(w_mm[i]));
        q_mm = to + (q_mm - to) * keep;
        machine.rig.geometry.shape(&q_mm).bend.rotation().quat()
    };
    piston_mm.iter().map(one).collect()
}
