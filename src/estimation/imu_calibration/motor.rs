//! Fields of the motor coils, from stepping the motors while the tip is still.
//!
//! A stepper carries two coil currents in quadrature, so its stray field at the sensor has the period of the coil cycle
//! (64 microsteps at sixteenth steps). It decreases by a factor when the driver idles:
//!
//! `m = m₀ + Σᵢ sᵢ (Cᵢ cos φᵢ + Sᵢ sin φᵢ)`, sᵢ = 1 energised, kᵢ idle; φᵢ = 2π · count / 64
//!
//! The motors are fixed in the world, so C and S are constant in the base frame, in which the readings must be given.
//! Gauss-Newton estimates (m₀, C, S, k) from this bilinear model. The prior of k has the mean and the standard deviation
//! of a uniform distribution on 0 to 1 (0.5 and 0.29) and remains if a motor never idled.

use super::entry::{Pedigree, Rows};
use super::refusal::Refusal;
use nalgebra::{SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// Microsteps in one cycle of the coil currents: four full steps of sixteen.
pub const MICROSTEPS_A_CYCLE: f64 = 64.0;
/// Phases of the coil cycle for the coverage.
const PHASES: usize = 12;
/// Smallest share of them that each motor must visit while energised.
const COVERAGE_MIN: f64 = 0.75;
/// Largest sigma of any component of a motor's field, µT: a third of a degree of heading.
const SIGMA_MAX_UT: f64 = 0.3;
/// Number of parameters: three of the ambient field, seven per motor.
const SIZE: usize = 24;
const ITERATIONS: usize = 30;
const IDLE_PRIOR: (f64, f64) = (0.5, 0.289);

/// Coil phase at a microstep count, rad.
pub fn phase_rad(count: i32) -> f64 {
    std::f64::consts::TAU * f64::from(count) / MICROSTEPS_A_CYCLE
}

/// One reading with the state of the motors at that moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorSample {
    /// Corrected field in the base frame, µT.
    pub mag_ut: Vector3<f64>,
    /// Microstep counts.
    pub counts: [i32; 3],
    /// Which drivers carry full current.
    pub energised: [bool; 3],
}

/// Fields of the three motors in the base frame: the `[imu.motor_field]` table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorField {
    /// Field with the cosine of the phase, µT; one row a motor.
    pub cos_ut: Rows,
    /// One sigma of it.
    pub cos_sigma_ut: Rows,
    /// Field with the sine of the phase, µT; one row a motor.
    pub sin_ut: Rows,
    /// One sigma of it.
    pub sin_sigma_ut: Rows,
    /// Share of the field that remains while a motor idles.
    pub idle_factor: [f64; 3],
    /// One sigma of it; 0.29 is that of the prior.
    pub idle_sigma: [f64; 3],
    /// Day of the recording.
    pub date: String,
    /// File or procedure it came from.
    pub source: String,
}

impl MotorField {
    /// Field of all motors, µT, base frame.
    pub fn at(&self, counts: &[i32; 3], energised: &[bool; 3]) -> Vector3<f64> {
        let mut field = Vector3::zeros();
        for i in 0..3 {
            let (sin, cos) = phase_rad(counts[i]).sin_cos();
            let idle = self.idle_factor[i];
            let strength = if energised[i] { 1.0 } else { idle };
            let (c, s) = (Vector3::from(self.cos_ut[i]), Vector3::from(self.sin_ut[i]));
            field += strength * (cos * c + sin * s);
        }
        field
    }
}

/// Result of [`fit`].
#[derive(Debug, Clone, PartialEq)]
pub struct MotorFit {
    /// Coil fields.
    pub field: MotorField,
    /// Field without motors, µT, base frame.
    pub ambient_ut: Vector3<f64>,
    /// rms of the residual per axis, µT.
    pub residual_ut: f64,
    /// Share of the coil cycle that each motor visited while energised.
    pub coverage: [f64; 3],
}

/// Position of a motor's C, S and k among the parameters.
fn place(motor: usize) -> (usize, usize, usize) {
    let at = 3 + 7 * motor;
    (at, at + 3, at + 6)
}

fn coverage(samples: &[MotorSample], motor: usize) -> f64 {
    let mut seen = [false; PHASES];
    for s in samples.iter().filter(|s| s.energised[motor]) {
        let turn = (f64::from(s.counts[motor]) / MICROSTEPS_A_CYCLE).rem_euclid(1.0);
        seen[((turn * PHASES as f64) as usize).min(PHASES - 1)] = true;
    }
    seen.iter().filter(|s| **s).count() as f64 / PHASES as f64
}

type Normal = (SMatrix<f64, SIZE, SIZE>, SVector<f64, SIZE>, f64);

/// Normal equations and sum of squares at `p`, without the prior.
fn normal(samples: &[MotorSample], p: &SVector<f64, SIZE>) -> Normal {
    let (mut h, mut g, mut squares) = (SMatrix::zeros(), SVector::zeros(), 0.0);
    for s in samples {
        let mut residual = s.mag_ut - p.fixed_rows::<3>(0);
        let mut terms = [(0.0, 0.0, Vector3::zeros()); 3]; // weights of C and S, slope to k
        for (i, term) in terms.iter_mut().enumerate() {
            let (c, q, k) = place(i);
            let (sin, cos) = phase_rad(s.counts[i]).sin_cos();
            let full = p.fixed_rows::<3>(c) * cos + p.fixed_rows::<3>(q) * sin;
            let (strength, slope) = if s.energised[i] {
                (1.0, Vector3::zeros())
            } else {
                (p[k], full)
            };
            residual -= full * strength;
            *term = (strength * cos, strength * sin, slope);
        }
        squares += residual.norm_squared();
        for axis in 0..3 {
            // one row of the Jacobian: ten entries that are not zero
            let mut row = [(axis, 1.0); 10];
            for (i, (wc, ws, slope)) in terms.iter().enumerate() {
                let (c, q, k) = place(i);
                row[1 + 3 * i] = (c + axis, *wc);
                row[2 + 3 * i] = (q + axis, *ws);
                row[3 + 3 * i] = (k, slope[axis]);
            }
            for (a, x) in row {
                g[a] += x * residual[axis];
                for (b, y) in row {
                    h[(a, b)] += x * y;
                }
            }
        }
    }
    (h, g, squares)
}

/// Fits the coil fields from a recording with a still tip. Each motor must move over at least one coil cycle, one
/// motor at a time, with pauses at different phases in which the drivers idle: each pause is one equation for the idle
/// factors.
///
/// # Errors
/// [`Refusal`] if a motor covers too little of its cycle, the motors cannot be separated, or the data are too few or
/// not finite.
pub fn fit(samples: &[MotorSample], from: Pedigree<'_>) -> Result<MotorFit, Refusal> {
    Refusal::unless_enough(samples.len(), 4 * SIZE)?;
    Refusal::unless_finite(samples.iter().map(|s| &s.mag_ut))?;
    let coverage = [0, 1, 2].map(|motor| coverage(samples, motor));
    let have = coverage.into_iter().fold(1.0, f64::min);
    if have < COVERAGE_MIN {
        return Err(Refusal::PoorCoverage {
            what: "a coil cycle",
            have,
            want: COVERAGE_MIN,
            advice: "step every motor through a complete cycle of 64 microsteps",
        });
    }
    let mut p = SVector::<f64, SIZE>::zeros();
    for i in 0..3 {
        p[place(i).2] = IDLE_PRIOR.0;
    }
    let mut variance = 1.0; // of a reading; from the residuals after every step
    let mut inverse = SMatrix::<f64, SIZE, SIZE>::zeros();
    for _ in 0..ITERATIONS {
        let (mut h, mut g, _) = normal(samples, &p);
        let weight = variance / IDLE_PRIOR.1.powi(2);
        for k in [0, 1, 2].map(|i| place(i).2) {
            h[(k, k)] += weight;
            g[k] += weight * (IDLE_PRIOR.0 - p[k]);
        }
        inverse = h.cholesky().ok_or(too_uncertain(f64::INFINITY))?.inverse();
        let step = inverse * g;
        p += step;
        variance = (normal(samples, &p).2 / (3 * samples.len() - SIZE) as f64).max(1e-12);
        if step.amax() < 1e-9 {
            break;
        }
    }
    let sigma = (inverse.diagonal() * variance).map(|v| v.max(0.0).sqrt());
    report(&p, &sigma, variance, coverage, from)
}

fn too_uncertain(sigma: f64) -> Refusal {
    Refusal::TooUncertain {
        what: "the field of a motor",
        sigma,
        limit: SIGMA_MAX_UT,
        unit: "µT",
    }
}

fn report(
    p: &SVector<f64, SIZE>,
    sigma: &SVector<f64, SIZE>,
    variance: f64,
    coverage: [f64; 3],
    from: Pedigree<'_>,
) -> Result<MotorFit, Refusal> {
    let triple = |v: &SVector<f64, SIZE>, at: usize| [v[at], v[at + 1], v[at + 2]];
    let pick =
        |v: &SVector<f64, SIZE>, part: fn(usize) -> usize| [0, 1, 2].map(|i| triple(v, part(i)));
    let idle = |v: &SVector<f64, SIZE>| [0, 1, 2].map(|i| v[place(i).2]);
    let field = MotorField {
        cos_ut: pick(p, |i| place(i).0),
        cos_sigma_ut: pick(sigma, |i| place(i).0),
        sin_ut: pick(p, |i| place(i).1),
        sin_sigma_ut: pick(sigma, |i| place(i).1),
        idle_factor: idle(p),
        idle_sigma: idle(sigma),
        date: from.date.to_owned(),
        source: from.source.to_owned(),
    };
    let sigmas = field.cos_sigma_ut.iter().chain(&field.sin_sigma_ut);
    let worst = sigmas.flatten().copied().fold(0.0, f64::max);
    if worst > SIGMA_MAX_UT {
        return Err(too_uncertain(worst));
    }
    Ok(MotorFit {
        field,
        ambient_ut: p.fixed_rows::<3>(0).into_owned(),
        residual_ut: variance.sqrt(),
        coverage,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    const FROM: Pedigree<'_> = Pedigree {
        date: "2025-01-31",
        source: "steps.csv",
    };

    fn truth() -> MotorField {
        MotorField {
            cos_ut: [[6.0, -2.0, 1.0], [0.5, 4.0, -3.0], [-1.5, 0.3, 2.2]],
            sin_ut: [[-1.0, 5.0, 2.0], [3.0, 0.2, 1.0], [0.4, -2.5, 0.6]],
            cos_sigma_ut: [[0.0; 3]; 3],
            sin_sigma_ut: [[0.0; 3]; 3],
            idle_factor: [0.5, 0.3, 0.7],
            idle_sigma: [0.0; 3],
            date: String::new(),
            source: String::new(),
        }
    }

    /// Each motor in turn: two cycles energised, then a pause with the driver idle, at 100 Hz.
    fn recording(seed: u64, noise_ut: f64, idles: bool, together: bool) -> Vec<MotorSample> {
        let mut rng = StdRng::seed_from_u64(seed);
        let (truth, ambient) = (truth(), Vector3::new(20.0, 1.0, -45.0));
        let (mut counts, mut samples) = ([3, -20, 11], Vec::new());
        for motor in 0..3 {
            for k in 0..400 {
                let moving = k < 128;
                for (i, count) in counts.iter_mut().enumerate() {
                    *count += i32::from(moving && (together || i == motor));
                }
                if together {
                    counts = [counts[0]; 3];
                }
                let energised = [true; 3].map(|_| moving || !idles);
                let noise = Vector3::from_fn(|_, _| {
                    noise_ut
                        * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng)
                });
                let mag_ut = ambient + truth.at(&counts, &energised) + noise;
                samples.push(MotorSample {
                    mag_ut,
                    counts,
                    energised,
                });
            }
        }
        samples
    }

    fn scores(have: &Rows, want: &Rows, sigma: &Rows) -> Vec<f64> {
        (0..9)
            .map(|k| (have[k / 3][k % 3] - want[k / 3][k % 3]) / sigma[k / 3][k % 3])
            .collect()
    }

    #[test]
    fn coil_fields_are_found_within_their_sigmas() {
        let truth = truth();
        let (mut chi2, mut n) = (0.0, 0.0);
        for seed in 0..20 {
            let fit = fit(&recording(seed, 0.5, true, false), FROM).expect("stepped");
            let f = &fit.field;
            let mut z = scores(&f.cos_ut, &truth.cos_ut, &f.cos_sigma_ut);
            z.extend(scores(&f.sin_ut, &truth.sin_ut, &f.sin_sigma_ut));
            z.extend((0..3).map(|i| (f.idle_factor[i] - truth.idle_factor[i]) / f.idle_sigma[i]));
            for z in z {
                assert!(z.abs() < 5.0, "seed {seed}: {z}");
                chi2 += z * z;
                n += 1.0;
            }
            assert!((fit.residual_ut - 0.5).abs() < 0.04, "{}", fit.residual_ut);
            assert!((fit.ambient_ut - Vector3::new(20.0, 1.0, -45.0)).amax() < 0.3);
            let (counts, on) = ([17, 40, -9], [true; 3]);
            assert!((f.at(&counts, &on) - truth.at(&counts, &on)).amax() < 0.5);
        }
        assert!(
            (0.6..1.6).contains(&(chi2 / n)),
            "the sigmas match the errors: {}",
            chi2 / n
        );
    }

    #[test]
    fn a_motor_that_never_idles_keeps_the_prior() {
        let fit = fit(&recording(1, 0.5, false, false), FROM).expect("stepped");
        assert_eq!(
            fit.field.idle_factor.map(|k| (k * 1e6).round() / 1e6),
            [0.5; 3]
        );
        assert!(
            fit.field
                .idle_sigma
                .iter()
                .all(|s| (s - 0.289).abs() < 1e-3),
            "{:?}",
            fit.field.idle_sigma
        );
    }

    #[test]
    fn motors_that_step_together_are_refused() {
        let refused = fit(&recording(2, 0.5, true, true), FROM).unwrap_err();
        assert!(matches!(refused, Refusal::TooUncertain { .. }), "{refused}");
    }

    #[test]
    fn a_motor_without_steps_is_refused() {
        let samples: Vec<_> = recording(3, 0.5, true, false)
            .into_iter()
            .take(700)
            .collect();
        let refused = fit(&samples, FROM).unwrap_err();
        assert!(
            matches!(refused, Refusal::PoorCoverage { have, .. } if have < 0.1),
            "{refused}"
        );
        assert!(matches!(
            fit(&samples[..50], FROM),
            Err(Refusal::TooFewSamples { .. })
        ));
    }

    #[test]
    fn a_cycle_is_64_microsteps() {
        let t = truth();
        let on = [true; 3];
        assert!((t.at(&[0, 0, 0], &on) - t.at(&[64, -64, 128], &on)).amax() < 1e-12);
        assert!(
            (t.at(&[16, 0, 0], &on) - t.at(&[0, 0, 0], &on) - Vector3::new(-7.0, 7.0, 1.0)).amax()
                < 1e-12
        );
    }
}
