//! Answers the questions of an exam.

use crate::diagnosis::diagnose;
use crate::diagnosis::tip::observed::{ObserveError, Observed};
use crate::diagnosis::tip::{Diagnosis, Rig, SavedModel, TipProblem, check};
use crate::diagnosis::verdict::VerdictKind;
use crate::experiment::exam::{Answers, Content, Logs, Question, baseline};
use crate::model::effects::{Effect, catalogue};
use crate::simulation::MachineError;
use rayon::prelude::*;
use serde::Serialize;
use thiserror::Error;

/// Every how many questions a single effect is diagnosed again without its own catalogue entry.
const LEFT_OUT_EVERY: usize = 3;

/// Why an exam cannot run.
#[derive(Debug, Error)]
pub enum ExamError {
    /// A unit cannot run.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// A log cannot be diagnosed.
    #[error("question {0}: {1}")]
    Observe(usize, ObserveError),
}

/// The answer to one question.
#[derive(Debug, Clone, Serialize)]
pub struct Answer {
    /// Whether an effect is too small to be asked for even at its largest size.
    #[serde(skip)]
    pub hidden: bool,
    /// Part of the gap that the saved model closes on the fresh log.
    pub fresh_closed: f64,
    /// Verdict without the catalogue entry of the true effect, if asked for.
    pub left_out: Option<VerdictKind>,
    /// Names given by the other methods.
    #[serde(flatten)]
    pub others: Answers,
    /// The diagnosis.
    pub diagnosis: Diagnosis,
}

/// Answers all questions in parallel from the logs that `draw` makes, [`Question::draw`] for the built-in plant; `done` is called after
/// each. A question is answered from its logs and the calibration alone.
///
/// # Errors
/// [`ExamError`].
pub fn run(
    questions: &[Question],
    draw: impl Fn(&Question) -> Result<Logs, MachineError> + Sync,
    done: impl Fn() + Sync,
) -> Result<Vec<Answer>, ExamError> {
    let answer = |(n, q): (usize, &Question)| {
        let logs = draw(q)?;
        let observe =
            |log| Observed::new(log, &Rig::default()).map_err(|e| ExamError::Observe(n, e));
        let (log, fresh) = (observe(&logs.log)?, observe(&logs.fresh)?);
        let with = |effects: &[&'static dyn Effect]| {
            diagnose(&TipProblem::new(&log, effects, &logs.lines, n as u64))
        };
        let diagnosed = with(catalogue());
        let saved = SavedModel::new("exam", &diagnosed);
        let again = q.content == Content::Single && n % LEFT_OUT_EVERY == 0;
        let left_out = again.then(|| {
            let mut rest = catalogue().to_vec();
            rest.retain(|e| e.name() != q.truth()[0]);
            with(&rest).document.verdict.kind
        });
        let answer = Answer {
            fresh_closed: check(&saved, &fresh).closed,
            others: baseline::answer(&log, &logs.lines, &diagnosed.found),
            diagnosis: diagnosed.document,
            hidden: logs.hidden,
            left_out,
        };
        done();
        Ok(answer)
    };
    questions.par_iter().enumerate().map(answer).collect()
}
