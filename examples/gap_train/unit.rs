//! Training units: machines with up to three deformed effects, or with a law that the catalogue lacks, alone or beside an effect.

use super::contents;
use super::deform::{Deformed, Outside};
use nalgebra::{UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use rand::seq::{IndexedRandom, SliceRandom};
use rand::{Rng, RngExt, SeedableRng};
use rand_distr::StandardNormal;
use retroflex::experiment::exam::{Recorded, difference_deg, record};
use retroflex::log::bend_log::BendLog;
use retroflex::model::effects::{Effect, Param, by_name, catalogue};
use retroflex::model::{DescribedMachine, Geometry, Line, RestReadings, nominal_theta};
use retroflex::simulation::described::Described;
use retroflex::supervisor::MachineError;

/// Microstep, mm.
const STEP_MM: f64 = 0.01;
/// Largest depth of the change of form of an effect.
const DEPTH: f64 = 0.25;
/// Draws of the size of an effect; the last is the largest size.
const DRAWS: usize = 6;
/// The largest size.
const LARGEST: f64 = 1.6;
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
/// Share of the laws outside the catalogue that are a law of it with a factor that changes its sign.
const FOREIGN: f64 = 0.3;
/// Effects that are a constant mount or delay, which has no form.
const KEEP_THEIR_FORM: [&str; 3] = ["mount_misalignment", "transport_delay", "sensor_latency"];

/// A training log.
pub struct Unit {
    /// Names of the effects that can be claimed of the log; `None` with a law that the catalogue lacks.
    pub names: Option<Vec<&'static str>>,
    /// The log.
    pub log: BendLog,
    /// Calibration it was driven with.
    pub lines: [Line; 3],
}

/// An effect with its parameters.
type Cause = (&'static dyn Effect, Vec<f64>);

/// An effect that lives as long as those of the catalogue.
fn lasting(effect: impl Effect + 'static) -> &'static dyn Effect {
    Box::leak(Box::new(effect))
}

/// Draws the unit of a seed and records it.
///
/// # Errors
/// [`MachineError`] for a machine that cannot run.
pub fn draw(seed: u64) -> Result<Unit, MachineError> {
    let mut rng = StdRng::seed_from_u64(seed);
    let wanted = contents(catalogue().to_vec(), &mut rng);
    let lab = rng.random_bool(0.5);
    let bare = Bare::draw(&mut rng);
    let lines = bare.lines.map(|l| Line {
        k_epsilon: l.k_epsilon * rng.random_range(0.94..1.06),
        k_lambda_mm: l.k_lambda_mm * rng.random_range(0.9..1.1),
    });
    let (schedule, background) = (rng.next_u64(), rng.next_u64());
    let record_of = |causes| {
        record(
            |noise| Ok(Described::new(bare.machine(causes), STEP_MM, noise)),
            &lines,
            schedule,
            true,
        )
    };
    let trial_deg = difference_deg(
        &record_of(vec![])?,
        &record_of(imperfections(background, TRIAL))?,
    );
    let small = TRIAL * rng.random_range(0.0..IMPERFECT_DEG) / trial_deg.max(0.1);
    let record_with = |added: &[Added]| {
        let mut causes = imperfections(background, small);
        causes.extend(added.iter().map(|a| cause(a.name, a.seed, a.size)));
        record_of(causes).map(|log| Recorded::new(log, &lines))
    };
    let mut added: Vec<Added> = Vec::new();
    let mut recorded = record_with(&added)?;
    for name in wanted.iter().map(|w| w.as_ref().map(|e| e.name())) {
        for draw in 0..DRAWS {
            let size = if draw + 1 == DRAWS {
                LARGEST
            } else {
                rng.random_range(0.15..1.2)
            };
            added.push(Added {
                name,
                seed: rng.next_u64(),
                size,
            });
            let with = record_with(&added)?;
            if !recorded.hides(&with, lab) {
                recorded = with;
                break;
            }
            // what is hidden at its largest size is left out, so that the log has what its label says
            added.pop();
        }
    }
    let names = added.iter().map(|a| a.name).collect();
    let mut log = recorded.log;
    if !lab {
        log.reference = None;
    }
    Ok(Unit { names, log, lines })
}

/// An effect of a unit, or a law that the catalogue lacks.
struct Added {
    name: Option<&'static str>,
    seed: u64,
    size: f64,
}

/// A unit without effects.
struct Bare {
    lines: [Line; 3],
    lag_s: f64,
    rest: RestReadings,
}

impl Bare {
    fn draw(rng: &mut StdRng) -> Self {
        let lines = [(); 3].map(|()| Line {
            k_epsilon: rng.random_range(1.8..2.9),
            k_lambda_mm: rng.random_range(0.3..1.2),
        });
        let direction = |rng: &mut StdRng| {
            UnitQuaternion::from_euler_angles(0.0, 0.0, rng.random_range(-3.1..3.1)) * tilt(rng)
        };
        let field = Vector3::new(
            rng.random_range(15.0..28.0),
            0.0,
            -rng.random_range(30.0..48.0),
        );
        let turned = direction(rng);
        let gyro_bias_rad_s = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal)) * 0.008;
        Self {
            lines,
            lag_s: rng.random_range(0.012..0.035),
            rest: RestReadings {
                up: turned * Vector3::z(),
                field_ut: turned * field,
                gyro_bias_rad_s,
            },
        }
    }

    fn machine(&self, causes: Vec<Cause>) -> DescribedMachine {
        DescribedMachine::new(
            Geometry::default(),
            self.rest,
            &nominal_theta(&self.lines, self.lag_s),
            causes,
        )
    }
}

/// A tilt of the base by up to 100°.
fn tilt(rng: &mut StdRng) -> UnitQuaternion<f64> {
    UnitQuaternion::from_euler_angles(rng.random_range(-1.5..1.5), rng.random_range(0.0..1.7), 0.0)
}

/// Small effects that every unit of this seed has.
fn imperfections(seed: u64, size: f64) -> Vec<Cause> {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut all = catalogue().to_vec();
    all.retain(|e| !e.info().is_event() && e.name() != "contact");
    all.shuffle(&mut rng);
    let mut causes: Vec<Cause> = all
        .into_iter()
        .take(IMPERFECT)
        .map(|e| drawn(e, &mut rng, size))
        .collect();
    causes.push((lasting(Outside::draw(&mut rng, size)), vec![]));
    causes.push((
        lasting(Outside::Acceleration(rng.random_range(ARM_M))),
        vec![],
    ));
    causes
}

/// The effect of that name, or one that the catalogue lacks.
fn cause(name: Option<&'static str>, seed: u64, size: f64) -> Cause {
    let mut rng = StdRng::seed_from_u64(seed);
    match name.and_then(by_name) {
        Some(e) => drawn(e, &mut rng, size),
        None => outside(&mut rng, size),
    }
}

/// A law that the catalogue lacks: a random one, or one of the catalogue's with a factor that changes its sign along the pistons and in
/// time.
fn outside(rng: &mut StdRng, size: f64) -> Cause {
    if !rng.random_bool(FOREIGN) {
        return (lasting(Outside::draw(rng, size)), vec![]);
    }
    let mut all = catalogue().to_vec();
    // a constant mount or delay keeps its form
    all.retain(|e| !KEEP_THEIR_FORM.contains(&e.name()) && !e.info().is_event());
    let e = all.swap_remove(rng.random_range(0..all.len()));
    let p = usual_parameters(e, rng, size);
    (lasting(Deformed::foreign(e, rng)), p)
}

/// An effect with parameters drawn from `size` times its prior, and a form of its own.
fn drawn(e: &'static dyn Effect, rng: &mut StdRng, size: f64) -> Cause {
    let p = usual_parameters(e, rng, size);
    let depth = rng.random_range(0.0..DEPTH);
    (lasting(Deformed::new(e, rng, depth)), p)
}

fn usual_parameters(e: &dyn Effect, rng: &mut StdRng, size: f64) -> Vec<f64> {
    loop {
        let p = parameters(e, rng, size);
        if e.unusual(&p) <= UNUSUAL {
            return p;
        }
    }
}

fn parameters(e: &dyn Effect, rng: &mut StdRng, size: f64) -> Vec<f64> {
    let info = e.info();
    // half of the units have the effect in every channel, the others in some
    let all = rng.random_bool(0.5);
    let sizes: Vec<usize> = (0..info.params.len())
        .filter(|&i| info.params[i].start == 0.0)
        .collect();
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
        let lines = [Line {
            k_epsilon: 2.2,
            k_lambda_mm: 0.8,
        }; 3];
        for e in catalogue()
            .iter()
            .copied()
            .filter(|e| !KEEP_THEIR_FORM.contains(&e.name()))
        {
            let name = e.name();
            let p: Vec<f64> = e
                .params()
                .iter()
                .enumerate()
                .map(|(i, x)| (x.start + [0.5, 0.2][i % 2] * x.scale).clamp(x.low, x.high))
                .collect();
            let deformed = lasting(Deformed::new(by_name(name).unwrap(), &mut rng, DEPTH));
            let log = |e: &'static dyn Effect| {
                let machine = DescribedMachine::new(
                    Geometry::default(),
                    RestReadings::default(),
                    &nominal_theta(&lines, 0.02),
                    vec![(e, p.clone())],
                );
                record(
                    |noise| Ok(Described::new(machine, STEP_MM, noise)),
                    &lines,
                    7,
                    true,
                )
                .unwrap()
            };
            let apart = difference_deg(&log(e), &log(deformed));
            assert!(apart > 1e-3, "{name}: {apart}");
        }
    }
}
