//! Checks that every effect has to pass, and a simple chain to run it in.
//!
//! The chain is the nominal one without play and lag: pistons → 1/(1 + k_ε) → bellows →
//! constant curvature → sensor, at 100 Hz.

use crate::model::Geometry;
use crate::model::effects::{
    Effect, EffectInfo, ImuPrediction, Memory, Moment, Param, Pose, Stage, by_name,
};
use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng, rngs::StdRng};

/// Sampling period of the chain, s.
pub const DT_S: f64 = 0.01;

/// One sample on its way through the chain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    pub t_s: f64,
    pub u_mm: Vector3<f64>,
    pub w_mm: Vector3<f64>,
    pub q_mm: Vector3<f64>,
    pub pose: Pose,
    pub reading: ImuPrediction,
}

impl Link {
    fn numbers(&self) -> Vec<f64> {
        let r = &self.reading;
        let mut out = Vec::new();
        for v in [
            self.u_mm,
            self.w_mm,
            self.q_mm,
            self.pose.bellow_mm,
            r.acc_m_s2,
            r.gyro_rad_s,
            r.mag_ut,
        ] {
            out.extend(v.iter());
        }
        out.extend(self.pose.bend.iter());
        out.push(self.pose.twist);
        out
    }
}

/// Parameters at which the effect vanishes.
pub fn nothing(e: &dyn Effect) -> Vec<f64> {
    e.params().iter().map(|p| p.start).collect()
}

/// The same, except for the named parameters (all channels of that name).
pub fn with(e: &dyn Effect, set: &[(&str, f64)]) -> Vec<f64> {
    let params = e.params();
    for (name, _) in set {
        assert!(
            params.iter().any(|p| p.name == *name),
            "{} has no {name}",
            e.name()
        );
    }
    params
        .iter()
        .map(|p| {
            set.iter()
                .find(|(n, _)| *n == p.name)
                .map_or(p.start, |(_, v)| *v)
        })
        .collect()
}

pub fn moment(t_s: f64, counted_mm: Vector3<f64>) -> Moment {
    Moment {
        t_s,
        dt_s: DT_S,
        counted_mm,
        up_base: Vector3::new(0.48, -0.36, 0.8),
        k_epsilon: Vector3::new(2.22, 2.53, 2.21),
        r_mm: Geometry::default().r_mm,
        idle_s: 0.0,
    }
}

/// Drives pistons along `path` for `lasting_s`.
pub fn drive(
    e: &dyn Effect,
    p: &[f64],
    lasting_s: f64,
    path: impl Fn(f64) -> Vector3<f64>,
) -> Vec<Link> {
    let mut m = Memory::default();
    let (mut last, mut idle_s) = (Vector3::zeros(), 0.0);
    let n = (lasting_s / DT_S).round() as u32;
    let steps = (0..=n).map(|k| {
        let t_s = f64::from(k) * DT_S;
        let counted = path(t_s);
        idle_s = if counted == last { idle_s + DT_S } else { 0.0 };
        last = counted;
        link(
            e,
            p,
            &mut m,
            &Moment {
                idle_s,
                ..moment(t_s, counted)
            },
        )
    });
    steps.collect()
}

fn link(e: &dyn Effect, p: &[f64], m: &mut Memory, at: &Moment) -> Link {
    let geometry = Geometry {
        r_mm: at.r_mm,
        ..Geometry::default()
    };
    let mut u_mm = at.counted_mm;
    e.pistons(p, m, at, &mut u_mm);
    let mut w_mm = u_mm;
    e.play_output(p, m, at, &mut w_mm);
    let mut q_mm = w_mm.component_div(&at.k_epsilon.add_scalar(1.0));
    e.bellows(p, m, at, &mut q_mm);
    let bend = geometry.shape(&q_mm).bend;
    let mut pose = Pose {
        bend: bend.0,
        twist: 0.0,
        bellow_mm: q_mm,
    };
    e.shape(p, m, at, &mut pose);
    let r_base_sensor =
        UnitQuaternion::from_scaled_axis(Vector3::new(pose.bend.y, pose.bend.x, pose.twist));
    let mut reading = ImuPrediction {
        acc_m_s2: r_base_sensor.inverse() * at.up_base * 9.81,
        gyro_rad_s: Vector3::new(0.01, -0.02, 0.03),
        mag_ut: r_base_sensor.inverse() * Vector3::new(20.0, 0.0, -43.0),
        r_base_sensor,
    };
    e.sensor(p, m, at, &mut reading);
    Link {
        t_s: at.t_s,
        u_mm,
        w_mm,
        q_mm,
        pose,
        reading,
    }
}

/// Standstill, then motions of several speeds and sizes on all channels, with holds.
pub fn exercise(t_s: f64) -> Vector3<f64> {
    if t_s < 2.0 {
        return Vector3::zeros();
    }
    let held = (t_s / 3.0).floor() * 3.0;
    let t = if (held as u32).is_multiple_of(2) {
        held
    } else {
        t_s
    };
    let size = 4.0 + 14.0 * (t / 60.0).min(1.0);
    Vector3::new(
        (0.9 * t).sin(),
        (0.53 * t + 1.0).sin() - 0.3,
        0.4 + (0.31 * t + 2.0).cos(),
    ) * size
}

/// The parameters are consistent; the effect vanishes at their start values, acts at every starting point of a
/// fit, and stays bounded at the ends of their ranges.
pub fn is_consistent(e: &dyn Effect) {
    consistent_parameters(e);
    vanishes_at_start_values(e);
    acts_at_every_starting_point(e);
    bounded_everywhere(e);
}

fn consistent_parameters(e: &dyn Effect) {
    let params = e.params();
    assert!(!params.is_empty(), "{}", e.name());
    for (k, p) in params.iter().enumerate() {
        assert!(
            p.low <= p.start && p.start <= p.high && p.scale > 0.0 && p.channel <= 3,
            "{}: {p:?}",
            e.name()
        );
        assert!(
            p.scale <= p.high - p.low,
            "{}: the prior is wider than the range: {p:?}",
            e.name()
        );
        let same = |q: &Param| (q.name, q.channel) == (p.name, p.channel);
        assert!(
            !params[..k].iter().any(same),
            "{}: {p:?} occurs twice",
            e.name()
        );
    }
    assert!(!e.starts().is_empty(), "{}", e.name());
    for s in e.starts() {
        assert_eq!(s.len(), params.len(), "{}", e.name());
        let inside = s
            .iter()
            .zip(params)
            .all(|(v, p)| (p.low..=p.high).contains(v));
        assert!(inside, "{}: start {s:?} outside its range", e.name());
    }
    assert!(by_name(e.name()).is_some_and(|own| own.params() == params));
}

/// An effect that does nothing.
struct Absent;

impl Effect for Absent {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            name: "absent",
            stage: Stage::Base,
            signature: "",
            confused_with: &[],
            separated_by: "",
            events: 0,
            params: &[],
            starts: &[],
        }
    }
}

/// Duration of the drive that shows an effect: longer than the latest event of any starting point, s.
const DRIVE_S: f64 = 240.0;

/// All output of an effect over a drive, as bits except for the sign of zero: the links, the base, the mount, the
/// dead times.
fn bits(e: &dyn Effect, p: &[f64]) -> Vec<u64> {
    let run = drive(e, p, DRIVE_S, exercise);
    let mut out: Vec<f64> = run.iter().flat_map(Link::numbers).collect();
    let turn = |q: Option<UnitQuaternion<f64>>| q.unwrap_or_default().coords;
    for l in run.iter().step_by(50) {
        out.extend(turn(e.base(p, &moment(l.t_s, l.u_mm))).iter());
    }
    out.extend(turn(e.mount(p)).iter());
    out.extend([e.transport_s(p), e.latency_s(p)]);
    // −0 + 0 = 0
    out.into_iter().map(|x| (x + 0.0).to_bits()).collect()
}

fn vanishes_at_start_values(e: &dyn Effect) {
    assert!(
        bits(e, &nothing(e)) == bits(&Absent, &[]),
        "{} acts at its start values",
        e.name()
    );
}

fn acts_at_every_starting_point(e: &dyn Effect) {
    let none = bits(&Absent, &[]);
    for s in e.starts() {
        assert!(
            bits(e, &s) != none,
            "{} does nothing at the starting point {s:?}",
            e.name()
        );
    }
}

fn bounded_everywhere(e: &dyn Effect) {
    let params = e.params();
    let mut rng = StdRng::seed_from_u64(7);
    for trial in 0..24 {
        let p: Vec<f64> = params
            .iter()
            .enumerate()
            .map(|(k, p)| match trial {
                0 => p.low,
                1 => p.high,
                2 | 3 => {
                    if (k + trial) % 2 == 0 {
                        p.low
                    } else {
                        p.high
                    }
                }
                _ => p.low + (p.high - p.low) * rng.random::<f64>(),
            })
            .collect();
        for l in drive(e, &p, 90.0, exercise).iter().step_by(7) {
            let bounded = l.numbers().iter().all(|x| x.is_finite() && x.abs() < 500.0);
            assert!(bounded, "{} at {p:?}: {l:?}", e.name());
            assert!(l.pose.bend.norm() < 25.0, "{} at {p:?}: {l:?}", e.name());
            let base = e.base(&p, &moment(l.t_s, l.u_mm)).unwrap_or_default();
            assert!((base.norm() - 1.0).abs() < 1e-9, "{} at {p:?}", e.name());
        }
        let dead_s = e.transport_s(&p) + e.latency_s(&p);
        assert!((0.0..=1.0).contains(&dead_s), "{} at {p:?}", e.name());
    }
}

/// A bend vector from degrees.
pub fn bend_deg(beta: f64, delta: f64) -> Vector2<f64> {
    crate::model::bend::Bend::from_deg(beta, delta).0
}

/// The shape hook on its own, at rest first and then at a bend that no bellow change explains.
pub fn shaped(e: &dyn Effect, p: &[f64], bend: Vector2<f64>, up_base: Vector3<f64>) -> Pose {
    let mut m = Memory::default();
    let at = Moment {
        up_base,
        ..moment(5.0, Vector3::zeros())
    };
    let geometry = Geometry::default();
    let mut out = None;
    for b in [Vector2::zeros(), bend] {
        let q = Vector3::from_fn(|i, _| -geometry.r_mm * Geometry::spoke(i).dot(&b));
        let mut pose = Pose {
            bend: b,
            twist: 0.0,
            bellow_mm: q,
        };
        e.shape(p, &mut m, &at, &mut pose);
        out = Some(pose);
    }
    out.expect("two poses were shaped")
}

/// Data of a fit, at 5 Hz: bend, twist and the three sensors, each about one in size.
fn data(e: &dyn Effect, p: &[f64]) -> DVector<f64> {
    let run = drive(e, p, 150.0, exercise);
    let row = |l: &Link| {
        let r = &l.reading;
        let mut out = vec![l.pose.bend.x, l.pose.bend.y, l.pose.twist];
        out.extend(
            (r.acc_m_s2 / 9.81)
                .iter()
                .chain(r.gyro_rad_s.iter())
                .chain((r.mag_ut / 50.0).iter()),
        );
        out
    };
    DVector::from_vec(run.iter().step_by(20).flat_map(row).collect())
}

/// Levenberg-Marquardt from one start, in units of the parameters' scales, kept inside their ranges.
fn fit(e: &dyn Effect, start: &[f64], want: &DVector<f64>) -> (Vec<f64>, f64) {
    let params = e.params();
    let moved = |p: &[f64], step: &DVector<f64>| -> Vec<f64> {
        let at = |k: usize| (p[k] + step[k] * params[k].scale).clamp(params[k].low, params[k].high);
        (0..p.len()).map(at).collect()
    };
    let (mut p, mut damping) = (start.to_vec(), 1e-3);
    let mut residual = want - data(e, &p);
    for _ in 0..40 {
        let mut slopes = DMatrix::zeros(residual.len(), p.len());
        for k in 0..p.len() {
            let mut step = DVector::zeros(p.len());
            step[k] = if p[k] + 1e-4 * params[k].scale > params[k].high {
                -1e-4
            } else {
                1e-4
            };
            slopes.set_column(
                k,
                &((data(e, &moved(&p, &step)) - (want - &residual)) / step[k]),
            );
        }
        let (normal, pull) = (slopes.tr_mul(&slopes), slopes.tr_mul(&residual));
        let before = residual.norm();
        for _ in 0..8 {
            let damped =
                &normal + DMatrix::from_diagonal(&(normal.diagonal() * damping).add_scalar(1e-12));
            let Some(step) = damped.cholesky().map(|c| c.solve(&pull)) else {
                break;
            };
            let next = moved(&p, &step);
            let left = want - data(e, &next);
            if left.norm() < residual.norm() {
                (p, residual, damping) = (next, left, damping * 0.2);
                break;
            }
            damping *= 5.0;
        }
        if residual.norm() > before * (1.0 - 1e-6) || residual.norm() < 1e-7 {
            break;
        }
    }
    let rms = (residual.norm_squared() / residual.len() as f64).sqrt();
    (p, rms)
}

/// Best fit, over the effect's own starting points, to data that contain the effect with parameters `truth` alone.
pub fn fitted(e: &dyn Effect, truth: &[f64]) -> Vec<f64> {
    let want = data(e, truth);
    let mut best = (Vec::new(), f64::INFINITY);
    for start in e.starts() {
        let next = fit(e, &start, &want);
        if next.1 < best.1 {
            best = next;
        }
        if best.1 < 1e-7 {
            break;
        }
    }
    assert!(
        best.1 < 1e-4,
        "{} leaves {:.2e} at {:?}, truth {truth:?}",
        e.name(),
        best.1,
        best.0
    );
    best.0
}

/// A fit recovers the true parameters.
pub fn is_recovered(e: &dyn Effect, truth: &[f64]) {
    for ((param, found), true_value) in e.params().iter().zip(fitted(e, truth)).zip(truth) {
        assert!(
            (found - true_value).abs() < 0.05 * param.scale,
            "{} {param:?}: {found}, not {true_value}",
            e.name()
        );
    }
}
