//! Training units: machines with none, one or two deformed effects, or one that the catalogue lacks.

use crate::diagnosis::exam::question::{Content, VISIBLE_DEG, difference_deg};
use crate::diagnosis::exam::record::record;
use crate::diagnosis::train::deform::{Deformed, Outside};
use crate::log::bend_log::BendLog;
use crate::model::effects::{Effect, Param, catalogue};
use crate::model::{DescribedMachine, Geometry, Line, RestReadings, nominal_theta};
use crate::simulation::described::Described;
use crate::supervisor::MachineError;
use nalgebra::{UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use rand::seq::{IndexedRandom, SliceRandom};
use rand::{Rng, RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// Microstep, mm.
const STEP_MM: f64 = 0.01;
/// Largest depth of the change of form of an effect.
const DEPTH: f64 = 0.16;
/// Draws of the size of an effect; the last is the largest size.
const DRAWS: usize = 6;
/// Number of small effects that every unit has.
const IMPERFECT: usize = 4;
/// Size at which their change of the signals is measured.
const TRIAL: f64 = 0.05;
/// Their largest RMS change of a signal, degrees (°/s for the gyroscope).
const IMPERFECT_DEG: f64 = 0.35;
/// Arm on which the tip carries its IMU, m.
const ARM_M: std::ops::Range<f64> = 0.0..0.015;
/// Largest unusual part of the parameters of an effect.
const UNUSUAL: f64 = 0.1;
/// When an event may happen, s.
const EVENT_S: std::ops::Range<f64> = 15.0..235.0;

/// A training log.
pub struct Unit {
    /// Effects in the log.
    pub content: Content,
    /// Their names.
    pub names: Vec<&'static str>,
    /// Whether a tracker recorded it.
    pub lab: bool,
    /// The log.
    pub log: BendLog,
    /// Calibration it was driven with.
    pub lines: [Line; 3],
}

/// An effect with its parameters.
type Cause = (Box<dyn Effect>, Vec<f64>);

/// Draws the unit of a seed and records it. The contents are as frequent as in an exam.
///
/// # Errors
/// [`MachineError`] for a machine that cannot run.
pub fn draw(seed: u64) -> Result<Unit, MachineError> {
    let mut rng = StdRng::seed_from_u64(seed);
    let content = [Content::Single, Content::Pair, Content::None, Content::Outside][match rng.random_range(0..30) {
        0..13 => 0,
        13..20 => 1,
        20..26 => 2,
        _ => 3,
    }];
    let lab = rng.random_bool(0.5);
    let mut all = catalogue();
    all.shuffle(&mut rng);
    let names: Vec<&'static str> = match content {
        Content::Single => vec![all[0].name()],
        Content::Pair => vec![all[0].name(), all[1].name()],
        Content::None | Content::Outside => vec![],
    };
    let bare = Bare::draw(&mut rng);
    let lines = bare
        .lines
        .map(|l| Line { k_epsilon: l.k_epsilon * rng.random_range(0.94..1.06), k_lambda_mm: l.k_lambda_mm * rng.random_range(0.9..1.1) });
    let (schedule, background) = (rng.next_u64(), rng.next_u64());
    let record_of = |causes| record(|noise| Ok(Described::new(bare.machine(causes), STEP_MM, noise)), &lines, schedule, true);
    let trial_deg = difference_deg(&record_of(vec![])?, &record_of(imperfections(background, TRIAL))?);
    let small = TRIAL * rng.random_range(0.0..IMPERFECT_DEG) / trial_deg.max(0.1);
    let record_with = |added: &[u64], size: &[f64]| {
        let mut causes = imperfections(background, small);
        causes.extend(added.iter().zip(size).enumerate().map(|(n, (&seed, &size))| cause(names.get(n), seed, size)));
        record_of(causes)
    };
    let wanted = if content == Content::Outside { 1 } else { names.len() };
    let (mut added, mut size) = (Vec::new(), Vec::new());
    let mut log = record_with(&added, &size)?;
    for _ in 0..wanted {
        added.push(0);
        size.push(0.0);
        for draw in 0..DRAWS {
            let last = added.len() - 1;
            added[last] = rng.next_u64();
            size[last] = if draw + 1 == DRAWS { 1.6 } else { rng.random_range(0.15..1.2) };
            let with = record_with(&added, &size)?;
            if difference_deg(&log, &with) > VISIBLE_DEG || draw + 1 == DRAWS {
                log = with;
                break;
            }
        }
    }
    if !lab {
        log.reference = None;
    }
    Ok(Unit { content, names, lab, log, lines })
}

/// A unit without effects.
struct Bare {
    lines: [Line; 3],
    lag_s: f64,
    rest: RestReadings,
}

impl Bare {
    fn draw(rng: &mut StdRng) -> Self {
        let lines = [(); 3].map(|()| Line { k_epsilon: rng.random_range(1.8..2.9), k_lambda_mm: rng.random_range(0.3..1.2) });
        let direction = |rng: &mut StdRng| UnitQuaternion::from_euler_angles(0.0, 0.0, rng.random_range(-3.1..3.1)) * tilt(rng);
        let field = Vector3::new(rng.random_range(15.0..28.0), 0.0, -rng.random_range(30.0..48.0));
        let turned = direction(rng);
        let gyro_bias_rad_s = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal)) * 0.008;
        Self {
            lines,
            lag_s: rng.random_range(0.012..0.035),
            rest: RestReadings { up: turned * Vector3::z(), field_ut: turned * field, gyro_bias_rad_s },
        }
    }

    fn machine(&self, causes: Vec<Cause>) -> DescribedMachine {
        DescribedMachine::new(Geometry::default(), self.rest, &nominal_theta(&self.lines, self.lag_s), causes)
    }
}

/// A tilt of the base by up to 100°.
fn tilt(rng: &mut StdRng) -> UnitQuaternion<f64> {
    UnitQuaternion::from_euler_angles(rng.random_range(-1.5..1.5), rng.random_range(0.0..1.7), 0.0)
}

/// Small effects that every unit of this seed has.
fn imperfections(seed: u64, size: f64) -> Vec<Cause> {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut all: Vec<Box<dyn Effect>> = catalogue().into_iter().filter(|e| !e.info().is_event() && e.name() != "contact").collect();
    all.shuffle(&mut rng);
    let mut causes: Vec<Cause> = all.into_iter().take(IMPERFECT).map(|e| drawn(e, &mut rng, size)).collect();
    causes.push((Box::new(Outside::draw(&mut rng, size)), vec![]));
    causes.push((Box::new(Outside::Acceleration(rng.random_range(ARM_M))), vec![]));
    causes
}

/// The effect of that name, or one that the catalogue lacks.
fn cause(name: Option<&&'static str>, seed: u64, size: f64) -> Cause {
    let mut rng = StdRng::seed_from_u64(seed);
    match catalogue().into_iter().find(|e| Some(&e.name()) == name) {
        Some(e) => drawn(e, &mut rng, size),
        None => (Box::new(Outside::draw(&mut rng, size)), vec![]),
    }
}

/// An effect with parameters drawn from `size` times its prior, and a form of its own.
fn drawn(e: Box<dyn Effect>, rng: &mut StdRng, size: f64) -> Cause {
    let mut p = parameters(e.as_ref(), rng, size);
    while e.unusual(&p) > UNUSUAL {
        p = parameters(e.as_ref(), rng, size);
    }
    let depth = rng.random_range(0.0..DEPTH);
    (Box::new(Deformed::new(e, rng, depth)), p)
}

fn parameters(e: &dyn Effect, rng: &mut StdRng, size: f64) -> Vec<f64> {
    let info = e.info();
    // half of the units have the effect in every channel, the others in some
    let all = rng.random_bool(0.5);
    let sizes: Vec<usize> = (0..info.params.len()).filter(|&i| info.params[i].start == 0.0).collect();
    let sure = sizes.choose(rng).copied();
    let mut one = |(i, x): (usize, &Param)| {
        let z: f64 = rng.sample(StandardNormal);
        let on = all || Some(i) == sure || rng.random_bool(0.5);
        let value = match (x.start == 0.0, x.low >= 0.0) {
            (true, _) if !on => 0.0,
            (true, true) => z.abs() * x.scale * size,
            (true, false) => z * x.scale * size,
            (false, _) => x.start + z * x.scale * 0.6,
        };
        value.clamp(x.low, x.high)
    };
    let mut p: Vec<f64> = info.params.iter().enumerate().map(&mut one).collect();
    if info.is_event() {
        let group = p.len() / info.events;
        let happened = rng.random_range(1..=2);
        for (k, event) in p.chunks_exact_mut(group).enumerate() {
            event[0] = rng.random_range(EVENT_S);
            if k >= happened {
                event[group - 3..].fill(0.0);
            }
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::by_name;

    #[test]
    fn a_seed_gives_a_unit_and_another_gives_another() {
        let readings = |seed| draw(seed).unwrap().log.imu.unwrap().gyr;
        assert_eq!(readings(3), readings(3));
        assert_ne!(readings(3), readings(4));
    }

    /// The law of every effect in training differs from that of the catalogue on the same parameters, except a constant mount or delay.
    #[test]
    fn laws_are_deformed() {
        let mut rng = StdRng::seed_from_u64(5);
        let lines = [Line { k_epsilon: 2.2, k_lambda_mm: 0.8 }; 3];
        for e in catalogue().into_iter().filter(|e| !["mount_misalignment", "transport_delay", "sensor_latency"].contains(&e.name())) {
            let name = e.name();
            let p: Vec<f64> =
                e.params().iter().enumerate().map(|(i, x)| (x.start + [0.5, 0.2][i % 2] * x.scale).clamp(x.low, x.high)).collect();
            let deformed: Box<dyn Effect> = Box::new(Deformed::new(by_name(name).unwrap(), &mut rng, DEPTH));
            let log = |e: Box<dyn Effect>| {
                let machine =
                    DescribedMachine::new(Geometry::default(), RestReadings::default(), &nominal_theta(&lines, 0.02), vec![(e, p.clone())]);
                record(|noise| Ok(Described::new(machine, STEP_MM, noise)), &lines, 7, true).unwrap()
            };
            let apart = difference_deg(&log(e), &log(deformed));
            assert!(apart > 1e-3, "{name}: {apart}");
        }
    }
}
