//! The diagnosis of a mapped rig as a document.

use crate::diagnosis::rig::{MapFile, Member, RigProblem, Set, Signals, closed_ci95, notes};
use crate::diagnosis::verdict::Verdict;
use crate::diagnosis::{Documented, Judged, Scored};
use serde::{Deserialize, Serialize};

/// RMSE in the unit of the output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct Figures {
    /// Nominal model, on held-out blocks.
    pub recalibrated: f64,
    /// With the verdict's effects, on held-out blocks.
    pub explained: f64,
    /// White noise of a row.
    pub noise_floor: f64,
}

/// A nonlinear parameter of an effect.
#[derive(Debug, Clone, Serialize)]
pub struct Parameter {
    /// Effect.
    pub of: &'static str,
    /// Meaning.
    pub name: &'static str,
    /// Value; times in s (rows without a clock), periods in the unit of the moving signal.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

/// An effect, or the whole set of the verdict.
#[derive(Debug, Clone, Serialize)]
pub struct Entry {
    /// As in the catalogue; the effects of a set are joined by ` + `.
    pub name: String,
    /// Probability that the effect is present; for a set, that its effects are present and no others.
    pub probability: f64,
    /// RMSE without it.
    pub rmse_before: f64,
    /// RMSE with it.
    pub rmse_after: f64,
    /// Part of the gap that it closes.
    pub closed: f64,
    /// 95 % interval of that part.
    pub closed_ci95: [f64; 2],
    /// Parameters.
    pub params: Vec<Parameter>,
}

/// The unexplained remainder.
#[derive(Debug, Clone, Serialize, Default)]
pub struct Left {
    /// Probability that a cause that the operators lack is present.
    pub probability: f64,
    /// RMSE left above the noise.
    pub rmse: f64,
}

/// One of the logs that were diagnosed together.
#[derive(Debug, Clone, Serialize)]
pub struct LogEntry {
    /// Name of the file.
    pub file: String,
    /// RMSE of the nominal model on its held-out blocks.
    pub recalibrated: f64,
    /// The same with the verdict's effects.
    pub explained: f64,
}

/// The whole diagnosis.
#[derive(Debug, Clone, Serialize, Default)]
pub struct Document {
    /// Version of this document.
    pub schema: u32,
    /// `map`: a rig described by a map file.
    pub rig: &'static str,
    /// Unit of all errors.
    pub unit: String,
    /// The gap.
    pub gap: Figures,
    /// The verdict's set as a whole; empty for a verdict without effects.
    pub set: Vec<Entry>,
    /// Every single effect, most probable first.
    pub effects: Vec<Entry>,
    /// Unexplained remainder.
    pub unknown: Left,
    /// The verdict.
    pub verdict: Verdict,
    /// What this log cannot show, regardless of the scores.
    pub notes: Vec<String>,
    /// The logs.
    pub logs: Vec<LogEntry>,
}

impl Document {
    /// The document of logs that do not determine the nominal model: their verdict is `unknown`.
    pub fn empty(map: &MapFile) -> Self {
        Self {
            schema: 1,
            rig: "map",
            unit: map.output_unit.clone(),
            unknown: Left { probability: 1.0, rmse: 0.0 },
            notes: vec![
                "the inputs do not determine the nominal model: they move together or not at all. Record them one by one".to_owned(),
            ],
            ..Self::default()
        }
    }
}

impl Documented for RigProblem<'_> {
    type Document = Document;

    fn document(&self, judged: &Judged<Self>) -> Document {
        let (chosen, mut notes) = (judged.chosen(), notes(self.logs));
        let entry = |s: &Set| self.entry(judged, &self.nominal, s);
        let mut effects: Vec<Entry> = judged.found.singles.iter().map(entry).collect();
        // of equally probable effects, the one that closes most comes first
        effects.sort_by(|a, b| b.closed.total_cmp(&a.closed));
        effects.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        if self.coarse {
            notes.push("the rows are too far apart to tell noise from signal, so the parts that are closed include noise. Record more rows per second".to_owned());
        }
        Document {
            schema: 1,
            rig: "map",
            unit: self.map.output_unit.clone(),
            gap: Figures {
                recalibrated: self.nominal.energy().sqrt(),
                explained: chosen.energy().sqrt(),
                noise_floor: self.noise,
            },
            set: self.set_entries(judged),
            effects,
            unknown: Left {
                probability: judged.verdict.doubt,
                rmse: (chosen.energy() - self.noise * self.noise).max(0.0).sqrt(),
            },
            verdict: judged.verdict.clone(),
            notes,
            logs: self.log_entries(chosen),
        }
    }
}

impl RigProblem<'_> {
    /// The verdict's set as a whole, and what each of several effects closes beyond the others.
    fn set_entries(&self, judged: &Judged<Self>) -> Vec<Entry> {
        let set = judged.chosen();
        let beside = |name: &&'static str| {
            let rest = judged.found.without(set, name)?;
            Some(Entry {
                name: format!("{name}, beside the other"),
                probability: judged.posterior.effect(name),
                params: vec![],
                ..self.entry(judged, rest, set)
            })
        };
        let several = set.names.iter().filter(|_| set.names.len() > 1);
        let whole = (!set.names.is_empty()).then(|| self.entry(judged, &self.nominal, set));
        let several = several.filter_map(beside);
        whole.into_iter().chain(several).collect()
    }

    /// What a set closes beyond a part of it.
    fn entry(&self, judged: &Judged<Self>, from: &Set, set: &Set) -> Entry {
        let closed = set.closed(from, self.gap);
        let floor = self.nominal.energy() - self.gap;
        let part = (from.energy() - floor).max(0.0) / self.gap;
        let [low, high] =
            closed_ci95(&from.scores, &set.scores, floor, self.seed).map(|c| c * part);
        let params = set.members.iter().filter(|m| !m.operator.eta.is_empty());
        let parameter = |m: &Member| Parameter {
            of: m.operator.name,
            name: m.operator.eta,
            value: m.eta,
            ci95: m.ci95,
        };
        Entry {
            name: set.names.join(" + "),
            probability: match set.names.as_slice() {
                [one] => judged.posterior.effect(one),
                several => judged.posterior.set(several),
            },
            rmse_before: from.energy().sqrt(),
            rmse_after: set.energy().sqrt(),
            closed,
            closed_ci95: [low.min(closed), high.max(closed)],
            params: params.map(parameter).collect(),
        }
    }

    /// What both models leave of each log.
    fn log_entries(&self, chosen: &Set) -> Vec<LogEntry> {
        let left = [&self.nominal, chosen].map(|set| self.left_out(set));
        let mut start = 0;
        let one = |log: &Signals| {
            let rows = start..start + log.output.len();
            start = rows.end;
            let [recalibrated, explained] = [0, 1].map(|k| {
                let known = left[k][rows.clone()].iter().filter(|x| !x.is_nan());
                let squares: Vec<f64> = known.map(|x| x * x).collect();
                (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
            });
            LogEntry {
                file: log.file.clone(),
                recalibrated,
                explained,
            }
        };
        self.logs.iter().map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::rig::tests::document;
    use crate::diagnosis::rig::{play, poor};
    use crate::diagnosis::verdict::VerdictKind;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    const MAP: &str = "input = \"u\"\noutput = \"y\"\ntime = \"t\"\n";

    /// A log with several speeds and amplitudes, its output by `law` with noise.
    fn log(law: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> Signals {
        let mut rng = StdRng::seed_from_u64(9);
        let t: Vec<f64> = (0..6000).map(|k| f64::from(k) * 0.01).collect();
        let u: Vec<f64> = t
            .iter()
            .map(|t| (1.0 + (0.21 * t).sin()) * (1.3 * t + 0.9 * (0.5 * t).sin()).sin())
            .collect();
        let output = law(&u, &t)
            .iter()
            .map(|y| y + 0.01 * rng.random_range(-1.0..1.0))
            .collect();
        Signals {
            file: String::new(),
            inputs: vec![u.clone()],
            output,
            motion: Some(u),
            logged: t.len(),
            t,
            clocked: true,
        }
    }

    fn diagnosis(law: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> Document {
        document(&toml::from_str(MAP).unwrap(), &[log(law)])
    }

    #[test]
    fn a_known_cause_is_named_and_no_other() {
        let d = diagnosis(|u, _| play(u, 0.3).iter().map(|w| 2.0 * w + 1.0).collect());
        assert_eq!(
            (d.verdict.kind, d.verdict.names.as_slice()),
            (VerdictKind::Effects, &["play"][..]),
            "{:?}",
            d.set
        );
        assert!(
            d.set[0].closed > 0.95 && d.set[0].closed_ci95[0] > 0.9,
            "{:?}",
            d.set
        );
        let d = diagnosis(|u, t| {
            u.iter()
                .zip(t)
                .map(|(u, t)| 3.0 * u + 0.4 * t / 60.0)
                .collect()
        });
        assert_eq!(d.verdict.names, ["drift"]);
        let d = diagnosis(|u, _| u.iter().map(|u| u + 0.2 * u.powi(3)).collect());
        assert_eq!(d.verdict.names, ["cubic"]);
    }

    /// A staircase of few poses after each of which the output stands shows no effect, whatever it looks like; one that moves on does.
    #[test]
    fn a_few_poses_claim_nothing_unless_the_output_moves_on() {
        let mut rng = StdRng::seed_from_u64(6);
        for poses in [5, 12, 20] {
            let u: Vec<f64> = (0..poses).map(|_| rng.random_range(-1.0..1.0)).collect();
            let hold = 60;
            let inputs: Vec<f64> = (0..poses * hold).map(|k| u[k / hold]).collect();
            let t: Vec<f64> = (0..poses * hold).map(|k| k as f64).collect();
            let slow = |tau: f64| {
                let mut y = 0.0;
                inputs
                    .iter()
                    .map(|u| {
                        y += (u - y) / tau;
                        y
                    })
                    .collect::<Vec<f64>>()
            };
            let signals = |output: Vec<f64>| Signals {
                file: String::new(),
                inputs: vec![inputs.clone()],
                output,
                motion: Some(inputs.clone()),
                logged: t.len(),
                t: t.clone(),
                clocked: true,
            };
            let wrong: Vec<f64> = u.iter().map(|_| rng.random_range(-1.0..1.0)).collect();
            let stands = signals(
                (0..poses * hold)
                    .map(|k| u[k / hold] + wrong[k / hold])
                    .collect(),
            );
            assert!(
                poor(std::slice::from_ref(&stands)) && !poor(&[signals(slow(80.0))]),
                "{poses}"
            );
            let d = document(&toml::from_str(MAP).unwrap(), &[stands]);
            assert!(
                d.verdict.names.is_empty() && d.notes.iter().any(|n| n.contains("distinct")),
                "{:?}",
                d.verdict
            );
        }
    }

    /// Lines with noise: nothing is claimed of a log that is long enough, and a short one has a note.
    #[test]
    fn noise_is_not_taken_for_an_effect() {
        let mut rng = StdRng::seed_from_u64(4);
        for (rows, seed) in [60, 200, 300, 500]
            .into_iter()
            .flat_map(|rows| (0..6).map(move |seed| (rows, seed)))
        {
            let t: Vec<f64> = (0..rows).map(f64::from).collect();
            let u: Vec<f64> = t
                .iter()
                .map(|t| (t * f64::from(seed + 3) * 0.04).sin())
                .collect();
            let output = u
                .iter()
                .map(|u| 2.0 * u + 0.03 * rng.random_range(-1.0..1.0))
                .collect();
            let signals = Signals {
                file: String::new(),
                inputs: vec![u.clone()],
                output,
                motion: Some(u),
                logged: t.len(),
                t,
                clocked: true,
            };
            let d = document(&toml::from_str(MAP).unwrap(), &[signals]);
            let noted = d.notes.iter().any(|n| n.contains("Record a longer log"));
            assert!(
                if rows < 200 {
                    noted
                } else {
                    !noted && d.verdict.kind == VerdictKind::None
                },
                "{rows} {seed}: {:?}",
                d.verdict
            );
        }
    }

    #[test]
    fn no_effect_is_claimed_if_the_line_suffices_or_no_operator_helps() {
        assert_eq!(
            diagnosis(|u, _| u.iter().map(|u| 3.0 * u - 1.0).collect())
                .verdict
                .kind,
            VerdictKind::None
        );
        let d = diagnosis(|u, t| {
            u.iter()
                .zip(t)
                .map(|(u, t)| u + 0.5 * (7.0 * t * t / 30.0).sin())
                .collect()
        });
        assert_eq!(d.verdict.kind, VerdictKind::Unknown, "{:?}", d.set);
    }
}
