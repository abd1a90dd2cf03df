//! A saved model of a rig on a fresh log.

use crate::diagnosis::rig::model::{driven, range};
use crate::diagnosis::rig::problem::WORTH;
use crate::diagnosis::rig::regress::{Columns, left, variance};
use crate::diagnosis::rig::table::MapError;
use crate::diagnosis::rig::{MapBase, Operator, SavedRig, Signals, Task};
use crate::diagnosis::{Checked, Judgement};

/// Largest nominal prediction on a fresh log, in half ranges of the fitted one.
const OUTSIDE: f64 = 2.5;
/// Part of the least that is claimed by which a model may be worse than nothing.
const WORSE: f64 = 1.0 / 3.0;

/// Columns and their fixed sizes.
type Fixed<'a> = (&'a [Vec<f64>], &'a [f64]);

/// Runs both models over a fresh log, of which only the offset and the states at the start are fitted; beside them, gains and effects
/// that are fitted to it.
///
/// # Errors
/// [`MapError`] if the model says nothing about the log.
pub fn check(saved: &SavedRig, log: &Signals) -> Result<Checked, MapError> {
    let scale = &saved.nominal;
    let inputs = driven(log, scale.swing);
    let drive = scale.drive(log, &inputs);
    let (low, high) = range(&drive.v);
    if high.max(-low) > OUTSIDE {
        return Err(MapError::Outside(log.file.clone(), high.max(-low)));
    }
    let undetermined = || MapError::Undetermined(log.file.clone());
    let rmse = |fixed: [Fixed<'_>; 2], free: [&[Vec<f64>]; 2]| {
        self::rmse(&log.output, fixed, free).ok_or_else(undetermined)
    };
    // gains, and the frequency of an oscillator, as this log has them
    let anew = MapBase::new(&saved.map, std::slice::from_ref(log)).ok_or_else(undetermined)?;
    let (offset, gains) = (&anew.base[..1], &anew.base[..]);
    let effects = saved.effects();
    let sizes: Vec<f64> = effects.iter().flat_map(|(_, e)| e.sizes.clone()).collect();
    let (mut terms, mut healed) = (vec![], vec![]);
    for (operator, e) in effects.iter().filter(|(o, _)| !o.is_state) {
        terms.extend((operator.columns)(&drive, e.value));
        healed.extend(operator.healed(&drive, e.sizes.len()));
    }
    let at = |values: &[f64], is_free: fn(&Operator) -> bool| -> Vec<Vec<f64>> {
        let all = effects.iter().zip(values).filter(|((o, _), _)| is_free(o));
        let columns = all.flat_map(|((o, _), value)| (o.columns)(&drive, *value));
        columns.collect()
    };
    let values: Vec<f64> = effects.iter().map(|(_, e)| e.value).collect();
    let none: Fixed<'_> = (&[], &[]);
    let (terms, found): (Fixed<'_>, _) = ((&terms, &sizes), at(&values, |o| o.is_state));
    let (nominal, own) = (
        (&inputs[..], &scale.weights[..]),
        (&inputs[..], &saved.with_effects[..]),
    );
    let before = rmse([nominal, none], [offset, &[]])?;
    let after = rmse([own, terms], [offset, &found])?;
    let mut refitted = rmse([none, terms], [gains, &found])?;
    // units differ by the sizes of their effects as well, where the log determines them
    for (k, (operator, e)) in effects.iter().enumerate() {
        for value in (operator.grid)(&drive).into_iter().chain([e.value]) {
            let mut values = values.clone();
            values[k] = value;
            let other = rmse([none, none], [gains, &at(&values, |_| true)]);
            refitted = refitted.min(other.unwrap_or(f64::INFINITY));
        }
    }
    let mended = rmse([own, (&healed, &sizes)], [offset, &[]])?;
    let healthy = rmse([none, none], [gains, &[]])?;
    // as RMSE, the part of the gap at which an effect is claimed; of a log that shows less, less
    let shows = (variance(&log.output).sqrt() / saved.spread).min(1.0);
    let claimed = (WORTH.sqrt() * saved.gap.recalibrated * shows).max(f64::MIN_POSITIVE);
    let is_worse = after - before >= WORSE * claimed;
    let gap = before.powi(2) - saved.gap.noise_floor.powi(2);
    let closed = (before.powi(2) - after.powi(2)) / gap.max(f64::MIN_POSITIVE);
    Ok(Checked {
        judgement: Judgement::new(is_worse, (after - refitted) / claimed, || {
            (mended.min(before) - healthy.min(refitted)) / claimed
        }),
        before,
        after,
        refitted,
        closed: closed.clamp(-1.0, 1.0),
        left_out: vec![],
        unit: Some(saved.map.output_unit.clone()),
    })
}

/// RMSE that fixed columns leave beside free ones; `None` if it is not determined.
fn rmse(y: &[f64], fixed: [Fixed<'_>; 2], free: [&[Vec<f64>]; 2]) -> Option<f64> {
    let columns = fixed.iter().flat_map(|(columns, _)| *columns);
    let columns: Vec<&[f64]> = columns.map(Vec::as_slice).collect();
    let rest = left(y, &columns, &fixed.map(|(_, sizes)| sizes).concat());
    let free = free.into_iter().flatten().map(Vec::as_slice).collect();
    let scores = Task::new([rest.as_slice()]).regress(&Columns::free(free))?;
    Some(scores.energy().sqrt()).filter(|rmse| rmse.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::diagnose;
    use crate::diagnosis::rig::{MapFile, RigProblem, oscillator, play};
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    /// What a model of the first log says of others.
    fn judged<const N: usize>(map: &str, known: &Signals, others: [Signals; N]) -> [Checked; N] {
        let map: MapFile = toml::from_str(map).unwrap();
        let logs = std::slice::from_ref(known);
        let problem = RigProblem::new(&map, logs, 1).unwrap();
        let done = diagnose(&problem);
        let saved = SavedRig::new("x.csv".to_owned(), &problem, &done);
        let saved: SavedRig = toml::from_str(&toml::to_string(&saved).unwrap()).unwrap();
        others.map(|log| check(&saved, &log).unwrap())
    }

    fn signals(inputs: Vec<Vec<f64>>, output: Vec<f64>, step_s: f64) -> Signals {
        let noise = |k: usize| ((k * 7919) % 101) as f64 * 1e-4;
        Signals {
            file: "y.csv".to_owned(),
            logged: output.len(),
            motion: inputs.first().cloned(),
            t: (0..output.len()).map(|k| k as f64 * step_s).collect(),
            output: (0..).zip(output).map(|(k, y)| y + noise(k)).collect(),
            inputs,
            clocked: true,
        }
    }

    #[test]
    fn chambers_differ_by_their_time_constant_and_not_by_the_pressure_at_the_start() {
        let log = |bar: f64, tau: f64| {
            let pressure = |k: i32| 1.0 + bar * (-f64::from(k) * 0.1 / tau).exp();
            signals(vec![], (0..1200).map(pressure).collect(), 0.1)
        };
        let map = "output = \"y\"\nrate_hz = 10.0\nnominal = \"still\"\n";
        let others = [log(1.7, 20.0), log(3.0, 50.0), log(0.2, 50.0)];
        let [same, other, small] = judged(map, &log(3.0, 20.0), others);
        assert_eq!(small.judgement, Judgement::AnotherUnit, "{small:?}");
        assert_eq!(same.judgement, Judgement::ThisMachine, "{same:?}");
        assert!(same.closed > 0.95, "{same:?}");
        assert_eq!(other.judgement, Judgement::AnotherUnit, "{other:?}");
    }

    /// The answer to inputs of about ±1 at times [`STEP_S`] apart, by the size of the effect.
    type Law = fn(&[f64], f64) -> Vec<f64>;
    /// Effects with a usual size.
    const LAWS: [(&str, Law, f64); 8] = [
        ("play", play, 0.2),
        (
            "dead band",
            |u, size| u.iter().map(|u| u - u.clamp(-size, size)).collect(),
            0.2,
        ),
        (
            "saturation",
            |u, size| u.iter().map(|u| u.clamp(-size, size)).collect(),
            0.5,
        ),
        (
            "cubic",
            |u, size| u.iter().map(|u| u + 2.0 * size * u.powi(3)).collect(),
            0.2,
        ),
        (
            "asymmetry",
            |u, size| u.iter().map(|u| u + size * u.abs()).collect(),
            0.3,
        ),
        (
            "rate limit",
            |u, size| states(u, |y, x| y + (x - y).clamp(-size * STEP_S, size * STEP_S)),
            0.6,
        ),
        (
            "lag",
            |u, size| states(u, |y, x| y + (x - y) * (1.0 - (-STEP_S / size).exp())),
            0.5,
        ),
        (
            "leak",
            |u, size| {
                let slow = states(u, |y, x| y + (x - y) * STEP_S / 6.0);
                u.iter()
                    .zip(slow)
                    .map(|(u, slow)| u - size * slow)
                    .collect()
            },
            0.4,
        ),
    ];
    const STEP_S: f64 = 0.02;

    fn states(u: &[f64], next: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        let mut y = u[0];
        let one = |x: &f64| {
            y = next(y, *x);
            y
        };
        u.iter().map(one).collect()
    }

    #[test]
    fn a_rig_whose_effect_has_another_size_is_another_and_fresh_motion_is_none() {
        let (mut rng, mut false_alarms, mut missed) = (StdRng::seed_from_u64(17), 0, 0);
        for (name, law, usual) in LAWS.into_iter().cycle().take(3 * LAWS.len()) {
            let gain = 10f64.powf(rng.random_range(0.0..2.0));
            let mut log = |size: f64| {
                let mut number = |low: f64, high: f64| rng.random_range(low..high);
                let waves: [[f64; 3]; 5] =
                    std::array::from_fn(|_| [number(0.1, 0.3), number(0.2, 2.5), number(0.0, 6.3)]);
                let at = |k: usize| {
                    let wave = |[a, w, phase]: &[f64; 3]| a * (w * k as f64 * STEP_S + phase).sin();
                    waves.iter().map(wave).sum::<f64>()
                };
                let u: Vec<f64> = (0..3000).map(at).collect();
                let y = law(&u, size).into_iter().map(|y| gain * y);
                signals(vec![u.clone()], y.collect(), STEP_S)
            };
            let known = log(usual);
            let others = [log(usual), log(0.5 * usual), log(1.5 * usual)];
            let said = judged(
                "input = \"u\"\noutput = \"y\"\ntime = \"t\"\n",
                &known,
                others,
            );
            println!("{name}: {:?}", said.each_ref().map(|c| c.judgement));
            let is_other = said.map(|c| u32::from(c.judgement != Judgement::ThisMachine));
            false_alarms += is_other[0];
            missed += 2 - is_other[1] - is_other[2];
        }
        println!(
            "of 24 the same, {false_alarms} are called another; of 48 others, {missed} are missed"
        );
        assert!(false_alarms <= 2 && missed <= 2, "{false_alarms} {missed}");
    }

    #[test]
    fn an_oscillator_is_the_same_at_another_rate_and_another_at_another_frequency() {
        let log = |step_s: f64, rad_s: f64| {
            let rows = (60.0 / step_s) as usize;
            let (wh, wave) = (2.0 * (rad_s * step_s / 2.0).tan(), |k: usize| {
                k as f64 * step_s
            });
            let u = (0..rows).map(|k| (2.1 * wave(k)).sin() + (0.04 * wave(k).powi(2)).sin());
            let u: Vec<f64> = u.collect();
            let y = oscillator(&u, wh, 0.2).into_iter().map(|v| 40.0 * v);
            signals(vec![u.clone()], y.collect(), step_s)
        };
        let map = "input = \"u\"\noutput = \"y\"\ntime = \"t\"\nnominal = \"resonance\"\n";
        let others = [log(0.01, 3.0), log(0.02, 4.0)];
        let [same, other] = judged(map, &log(0.02, 3.0), others);
        assert!(same.after < 0.1, "{same:?}");
        assert_eq!(other.judgement, Judgement::AnotherUnit, "{other:?}");
    }
}
