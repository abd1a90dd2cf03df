//! A built-in blind test of the diagnosis.
//!
//! The truth is the built-in plant, whose laws differ in form from the catalogue's and which has effects that the
//! catalogue lacks, or a simulator that knows effects by name. Units, schedules, calibrations and noise are drawn from a seed. All logs are diagnosed first; only
//! then are the true labels used for scoring ([`mod@score`]). Three other methods answer the same questions ([`baseline`]).

pub mod baseline;
pub mod question;
pub mod record;
pub mod run;
pub mod score;

pub use baseline::Answers;
pub use question::{Content, Logs, Question, Recorded, difference_deg, questions};
pub use record::{PERIOD_S, record};
pub use run::Answer;
pub use score::{Count, Counts, ExamScore, Method, ReliabilityBin, score};
