//! A built-in blind test of the diagnosis.
//!
//! Its truth is the built-in plant, whose effects are written in other forms than the catalogue's and
//! which knows effects that the catalogue does not hold. Units, schedules, calibrations and noise are
//! drawn from a seed. Verdicts on all logs are written first; only then are the labels opened and the
//! sheet is marked ([`mark`]). Three other methods sit the same exam on the same logs ([`baseline`]).

pub mod baseline;
pub mod mark;
pub mod question;
pub mod record;
pub mod schedule;

use crate::diagnosis::diagnose::{Diagnosis, diagnose};
use crate::diagnosis::exam::baseline::Answers;
use crate::diagnosis::exam::question::{Holds, Logs, Question};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::saved::SavedModel;
use crate::model::effects::Effect;
use crate::simulation::plant::PlantError;
use rayon::prelude::*;
use thiserror::Error;

/// Every how many-th single effect is asked again with its own entry struck from the catalogue.
const LEFT_OUT_EVERY: usize = 3;

/// Why an exam cannot be held.
#[derive(Debug, Error)]
pub enum ExamError {
    /// A unit cannot run.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A log cannot be diagnosed.
    #[error("question {0}: {1}")]
    Unfit(usize, crate::diagnosis::observe::Unfit),
}

/// What was answered to one question.
#[derive(Debug, Clone)]
pub struct Answer {
    /// The diagnosis.
    pub diagnosis: Diagnosis,
    /// What `gap check` says on the fresh log.
    pub fresh_closed: f64,
    /// Verdict without the true effect's entry, if asked.
    pub left_out: Option<&'static str>,
    /// The other methods' names.
    pub others: Answers,
}

/// Answers all questions; `done` is called after each.
///
/// # Errors
/// [`ExamError`].
pub fn sit(questions: &[Question], catalogue: &[Box<dyn Effect>], done: impl Fn() + Sync) -> Result<Vec<Answer>, ExamError> {
    questions
        .par_iter()
        .enumerate()
        .map(|(n, q)| {
            // the question's names stay here: a log, its calibration and the number are all that goes on
            let struck = (q.holds == Holds::Single && n % LEFT_OUT_EVERY == 0).then(|| q.names[0]);
            let answer = answer(n, &q.draw()?, catalogue, struck);
            done();
            answer
        })
        .collect()
}

fn answer(n: usize, logs: &Logs, catalogue: &[Box<dyn Effect>], struck: Option<&str>) -> Result<Answer, ExamError> {
    let observe = |log| Observed::new(log).map_err(|e| ExamError::Unfit(n, e));
    let log = observe(&logs.log)?;
    let told = diagnose(&log, catalogue, &logs.lines, n as u64);
    let saved = SavedModel::new("exam", catalogue, &told.found, &told.chosen, &[]);
    let fresh_closed = saved.check_on(&observe(&logs.fresh)?, catalogue).closed;
    let left_out = struck.map(|name| {
        let rest: Vec<Box<dyn Effect>> = crate::model::effects::catalogue().into_iter().filter(|e| e.name() != name).collect();
        diagnose(&log, &rest, &logs.lines, n as u64).document.verdict.kind
    });
    let others = baseline::answer(&log, catalogue, &logs.lines, &told.found);
    Ok(Answer { diagnosis: told.document, fresh_closed, left_out, others })
}
