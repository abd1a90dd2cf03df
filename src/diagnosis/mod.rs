//! Diagnosis of the sim-to-real gap: where it lies, which effect causes it, and how much of it the effect closes.
//!
//! [`observe`] turns a log into weighted bins. [`chain`] and [`sense`] run the controller's own model forward from the
//! pistons to the readings, with any set of catalogue effects in it. [`fit`] estimates nominal gains and effect
//! parameters jointly, [`holdout`] scores a fit on parts of the log it has not seen, [`search`] tries sets of effects ([`screen`] chooses among all pairs),
//! [`decide`] chooses one, and [`diagnose`] assembles the answer. [`map`] diagnoses other rigs, [`excite`] designs
//! schedules, and [`exam`] tests the diagnosis on the built-in plant.

pub mod bins;
pub mod candidate;
pub mod candidates;
pub mod chain;
pub mod check;
pub mod confusion;
pub mod credit;
pub mod decide;
pub mod dependence;
pub mod diagnose;
pub mod document;
pub mod exam;
pub mod excite;
pub mod features;
pub mod fit;
pub mod fleet;
pub mod forecast;
pub mod holdout;
pub mod interval;
pub mod location;
pub mod map;
pub mod observe;
pub mod posterior;
pub mod problem;
pub mod quantity;
pub mod refuse;
pub mod remedy;
pub mod rig;
pub mod saved;
pub mod screen;
pub mod search;
pub mod sense;
pub mod start;
pub mod tangent;
