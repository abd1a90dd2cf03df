//! Questions of an exam: a unit with zero, one or two effects, drawn from a seed, and its logs.
//!
//! Units differ in gains, play, lag, attitude and field, and all have the small imperfections of real units. The
//! calibration is a few percent off. The size of an effect is drawn; one that is too small to be claimed is drawn again, and
//! the largest is asked for in any case.

use crate::diagnosis::tip::fit::CLAIM_DEG;
use crate::diagnosis::tip::observed::{Observed, PerQuantity, Quantity};
use crate::diagnosis::tip::{Rig, recalibrated};
use crate::experiment::exam::{PERIOD_S, record};
use crate::log::bend_log::BendLog;
use crate::model::Line;
use crate::model::effects::entry;
use crate::simulation::MachineError;
use crate::simulation::plant::PlantConfig;
use crate::simulation::plant::config::{BaseConfig, Spread};
use crate::simulation::plant::imu::chip::ImuConfig;
use crate::simulation::sim::Sim;
use nalgebra::Vector3;
use rand::rngs::StdRng;
use rand::seq::{IndexedRandom, SliceRandom};
use rand::{Rng, RngExt, SeedableRng};
use serde::Serialize;
use std::collections::BTreeSet;

/// Least RMS change of some signal by an effect, degrees (°/s for the gyroscope).
pub const VISIBLE_DEG: f64 = 0.8;
/// Draws of the size of an effect; the last is the largest size.
const DRAWS: usize = 6;
/// Sets of three effects in a round.
const TRIPLES: usize = 9;

/// Effects in a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Content {
    /// No effect.
    None,
    /// One effect of the catalogue.
    Single,
    /// Two effects of the catalogue.
    Pair,
    /// Three effects of the catalogue.
    Triple,
    /// One effect outside the catalogue.
    Outside,
}

/// One question.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Question {
    /// Names of the effects, as the plant knows them.
    #[serde(rename = "truth")]
    pub names: Vec<&'static str>,
    /// Effects in the log.
    pub content: Content,
    /// Whether a tracker records the log.
    pub lab: bool,
    /// Seed of everything else.
    pub seed: u64,
}

/// Logs of a question.
#[derive(Debug, Clone)]
pub struct Logs {
    /// The log to be diagnosed.
    pub log: BendLog,
    /// A fresh log of the same unit, with another schedule and other noise.
    pub fresh: BendLog,
    /// Calibration that both are driven with.
    pub lines: [Line; 3],
    /// Whether an effect is too small to be asked for even at its largest size, [`Recorded::hides`].
    pub hidden: bool,
}

/// Questions of an exam, in random order: every effect of the catalogue and outside it `rounds` times with and without a
/// tracker, one pair and one effect-free log per catalogue effect and round, and nine triples a round. `names` are the effects that the
/// plant can have, as [`crate::model::effects::by_catalogue`] divides them.
pub fn questions(seed: u64, rounds: usize, names: &[Vec<&'static str>; 2]) -> Vec<Question> {
    let mut rng = StdRng::seed_from_u64(seed);
    let [inside, outside] = names;
    let mut out: Vec<Question> = Vec::new();
    let mut ask = |rng: &mut StdRng, content, names: Vec<&'static str>, lab| {
        let seed = rng.next_u64();
        let entries: BTreeSet<_> = names.iter().map(|name| entry(name)).collect();
        // not two variants of one effect
        out.extend((entries.len() == names.len()).then_some(Question {
            content,
            names,
            lab,
            seed,
        }));
    };
    for round in 0..rounds {
        for (n, name) in inside.iter().enumerate() {
            let other = rng.random_range(1..inside.len().max(2));
            let other = inside[(n + other) % inside.len()];
            for lab in [true, false] {
                ask(&mut rng, Content::Single, vec![name], lab);
            }
            let lab = (n + round) % 2 == 0;
            ask(&mut rng, Content::Pair, vec![name, other], lab);
            ask(&mut rng, Content::None, vec![], lab);
        }
        for n in 0..TRIPLES {
            let names = inside.sample(&mut rng, 3).copied().collect();
            ask(&mut rng, Content::Triple, names, (n + round) % 2 == 0);
        }
        for name in outside {
            for lab in [true, false] {
                ask(&mut rng, Content::Outside, vec![name], lab);
            }
        }
    }
    // so that a part of the questions is a sample of all
    out.shuffle(&mut rng);
    out
}

impl Question {
    /// The true effects, as the catalogue names them.
    pub fn truth(&self) -> Vec<&'static str> {
        self.names.iter().map(|name| entry(name)).collect()
    }

    /// Draws a unit of the built-in plant and records its logs.
    ///
    /// # Errors
    /// [`MachineError`] for a plant that cannot run.
    pub fn draw(&self) -> Result<Logs, MachineError> {
        let mut rng = StdRng::seed_from_u64(self.seed);
        let bare = unit(&mut rng);
        let lines = std::array::from_fn(|i| Line {
            k_epsilon: bare.line.k_epsilon[i] * rng.random_range(0.94..1.06),
            k_lambda_mm: bare.line.k_lambda_mm[i] * rng.random_range(0.9..1.1),
        });
        let (first, second) = (rng.next_u64(), rng.next_u64());
        let of = |make: &PlantConfig, seed, lab| {
            let sim = |noise| Ok(Sim::new(make, 0, noise, PERIOD_S)?);
            record(sim, &lines, seed, lab)
        };
        let mut recorded = Recorded::new(of(&bare, first, true)?, &lines);
        let (mut make, mut hidden) = (bare, false);
        for name in &self.names {
            for last in (1..=DRAWS).map(|draw| draw == DRAWS) {
                let severity = if last {
                    1.0
                } else {
                    rng.random_range(0.0..1.0)
                };
                let with = make.clone().with_effect(name, severity, &mut rng)?;
                let recorded_with = Recorded::new(of(&with, first, true)?, &lines);
                let hides = recorded.hides(&recorded_with, self.lab);
                if last || !hides {
                    (make, recorded, hidden) = (with, recorded_with, hidden || hides);
                    break;
                }
            }
        }
        let mut log = recorded.log;
        log.reference = log.reference.filter(|_| self.lab);
        Ok(Logs {
            log,
            fresh: of(&make, second, self.lab)?,
            lines,
            hidden,
        })
    }
}

/// A unit with the spread and the small imperfections of real units.
fn unit(rng: &mut StdRng) -> PlantConfig {
    let loud = rng.random_range(0.8..2.2);
    let chip = ImuConfig::default();
    let make = PlantConfig {
        base: BaseConfig {
            pitch_deg: rng.random_range(0.0..100.0),
            roll_deg: rng.random_range(-90.0..90.0),
            ..BaseConfig::default()
        },
        imu: ImuConfig {
            period_s: 0.01,
            gyro_noise_deg_s_rthz: chip.gyro_noise_deg_s_rthz * loud,
            acc_noise_mg_rthz: chip.acc_noise_mg_rthz * loud,
            mag_noise_ut: chip.mag_noise_ut * loud,
            ..chip
        },
        spread: Spread {
            k_epsilon: 0.06,
            k_lambda: 0.1,
            lag: 0.2,
            heading_deg: 180.0,
            field: 0.08,
            dip_deg: 4.0,
            gyro_bias_deg_s: 0.5,
            acc_bias_mg: 1.0,
            mag_bias_ut: 0.1,
            ..Spread::default()
        },
        ..PlantConfig::default()
    };
    make.drawn(rng.next_u64()).background(rng)
}

/// A log, and what a recalibrated model leaves of it.
pub struct Recorded {
    /// The log.
    pub log: BendLog,
    /// RMSE of each sensor, degrees or °/s; `None` for a log that cannot be diagnosed.
    left_deg: Option<PerQuantity<f64>>,
}

impl Recorded {
    /// Recalibrates the model of a log that was driven with the calibration `lines`.
    pub fn new(log: BendLog, lines: &[Line; 3]) -> Self {
        let observed = Observed::new(&log, &Rig::default()).ok();
        let left_deg = observed.map(|o| recalibrated(&o, lines).held_out.rmse_deg);
        Self { log, left_deg }
    }

    /// Whether an effect in the log `with` is too small to be asked for: no signal changes by [`VISIBLE_DEG`], or what a recalibrated model
    /// leaves of a sensor does not grow by what a diagnosis claims, so that the right verdict does not name it. Without `lab` the tracker
    /// does not count.
    pub fn hides(&self, with: &Self, lab: bool) -> bool {
        let (Some(before), Some(after)) = (&self.left_deg, &with.left_deg) else {
            return true;
        };
        let unseen = |q| q == Quantity::Reference && !lab;
        let slight = |q| unseen(q) || after[q] - before[q] < CLAIM_DEG;
        difference_deg(&self.log, &with.log) < VISIBLE_DEG || Quantity::ALL.into_iter().all(slight)
    }
}

/// Largest RMS difference of a signal between two logs, degrees (°/s for the gyroscope).
pub fn difference_deg(a: &BendLog, b: &BendLog) -> f64 {
    let rms = |squares: &mut dyn Iterator<Item = f64>| {
        let there = squares.filter(|d| !d.is_nan());
        let (sum, n) = there.fold((0.0, 0.0), |(s, n), d| (s + d, n + 1.0));
        (sum / f64::max(n, 1.0)).sqrt()
    };
    let apart = |x: &[Vector3<f64>], y: &[Vector3<f64>], unit: f64| {
        rms(&mut x.iter().zip(y).map(|(x, y)| (x - y).norm_squared())) / unit
    };
    let mut out: f64 = 0.0;
    if let (Some(x), Some(y)) = (&a.imu, &b.imu) {
        let field = y.mag.iter().find(|m| !m.x.is_nan());
        let field = field.map_or(48.0, Vector3::norm);
        // recalibration removes a constant difference of rates
        let rates = x.gyr.iter().zip(&y.gyr).map(|(x, y)| x - y);
        let rates: Vec<Vector3<f64>> = rates.filter(|d| !d.x.is_nan()).collect();
        let mean = rates.iter().sum::<Vector3<f64>>() / rates.len().max(1) as f64;
        let rate = rms(&mut rates.iter().map(|d| (d - mean).norm_squared()));
        let (acc, mag) = (apart(&x.acc, &y.acc, 9.81), apart(&x.mag, &y.mag, field));
        out = acc.max(mag).max(rate).to_degrees();
    }
    if let (Some(x), Some(y)) = (&a.reference, &b.reference) {
        let both = x.iter().zip(y).filter_map(|(x, y)| x.zip(*y));
        let squares = both.map(|(x, y)| x.angle_to(&y).powi(2));
        let mean = squares.sum::<f64>() / x.len().max(1) as f64;
        out = out.max(mean.sqrt().to_degrees());
    }
    out
}
